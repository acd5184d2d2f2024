"""One face for whatever finds a target in a frame: a ball by its colour and shape, anything else by what a box showed.

A ball is found in each frame by itself. A thing in a box is followed from frame to frame, and first looked for in the
whole picture, in many sizes, by its likeness to the picture in which the box was drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from agent.config import Colour, ConfigError, Fleet, Target
from agent.perception.detect import find_ball
from agent.perception.engines import load_engine, model_files
from agent.perception.follow import Follower
from agent.perception.likeness import Box, Image
from agent.ranging.calibration import CameraFit, at_lens


class Found(NamedTuple):
    """A target in the full frame. Pixels from the centre of the upper left pixel, u right, v down."""

    centre_px: tuple[float, float]  # where the ray to a ball's centre meets the image; middle of a box
    score: float  # 0 to 1
    radius_px: float | None = None  # of a ball
    size_px: tuple[float, float] | None = None  # of a box: width and height

    @property
    def box(self) -> Box:
        width, height = self.size_px or (2.0 * (self.radius_px or 0.0),) * 2
        return Box(self.centre_px[0] + 0.5 - width / 2, self.centre_px[1] + 0.5 - height / 2, width, height)


class Seeker(Protocol):
    """Give it frames in the order in which they were taken; parts of them, if any, around where the target was last."""

    @property
    def remembers(self) -> bool:
        """Whether it compares a frame with earlier ones, so that all must be treated alike: none enhanced."""

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens: int | None = None) -> Found | None:
        """The target in an image (height, width, 3) blue green red; None if it is not there.

        offset_px: where the image's upper left pixel lies in the full frame. lens: position at which it was taken.
        """


class BallSeeker:
    """A ball of one colour."""

    remembers = False

    def __init__(self, camera: CameraFit, colour: Colour) -> None:
        self._camera, self._colour = camera, colour

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens: int | None = None) -> Found | None:
        ball = find_ball(image, at_lens(self._camera, lens), offset_px, self._colour)
        return None if ball is None else Found(ball.centre_px, ball.score, radius_px=ball.radius_px)


class BoxSeeker:
    """What a follower knows, who has been told to start or to expect something. Wants whole frames of one size."""

    remembers = True

    def __init__(self, follower: Follower) -> None:
        self._follower = follower

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens: int | None = None) -> Found | None:
        now = self._follower.look(image)
        return None if now.lost else boxed(now.box, now.score, offset_px)


def boxed(box: Box, score: float, offset_px: tuple[int, int] = (0, 0)) -> Found:
    """What is in a box of an image whose upper left pixel lies at offset_px of the full frame."""
    u, v = box.centre_px
    return Found((u + offset_px[0], v + offset_px[1]), score, size_px=(box.width, box.height))


def seekers(fleet: Fleet, camera: CameraFit) -> Mapping[str, Seeker]:
    """One for each target. Raises ConfigError for a picture or models that are not there or do not fit."""
    return {
        name: _box_seeker(name, target, (camera.width_px, camera.height_px))
        if target.detector == "box"
        else BallSeeker(camera, target.ball_colour)
        for name, target in fleet.target.items()
    }


def _box_seeker(name: str, target: Target, size: tuple[int, int]) -> BoxSeeker:
    assert target.picture is not None and target.box is not None  # load_fleet has seen to it
    path = Path(target.picture)
    image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
    if image is None:
        raise ConfigError(f"{path}: no picture for target '{name}'; put one there that this camera has taken")
    if (image.shape[1], image.shape[0]) != size:
        its, wanted = f"{image.shape[1]}x{image.shape[0]}", f"{size[0]}x{size[1]}"
        raise ConfigError(f"{path}: {its} pixels, the camera has {wanted}; take another picture for target '{name}'")
    follower = Follower(load_engine(*((None, None) if target.models is None else model_files(Path(target.models)))))
    follower.expect(np.asarray(image, np.uint8), Box(*target.box))
    return BoxSeeker(follower)
