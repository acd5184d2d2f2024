"""Whatever finds a target in a frame, behind one interface: a ball by colour and shape, a creature by colour alone, all
else by what a box showed.

A ball or a creature is found in each frame by itself. A thing in a box is followed from frame to frame, and first
looked for in the whole picture, in many sizes, by its likeness to the picture in which the box was drawn.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from agent.core.config import Colour, ConfigError, Fleet, Target
from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.perception.detection.colour import NAMED, ColourModel, Sample, sampled
from agent.perception.detection.colours_apart import Sought, mistaken_in, named_paint
from agent.perception.detection.creature import STRONG, Hues, find_creature, named_hues, sampled_hues
from agent.perception.detection.detect import LIMIT, find_ball
from agent.perception.tracking.box import Box, Image
from agent.perception.tracking.box_trackers import load_box_tracker, model_files
from agent.perception.tracking.follow import Follower
from hw.picture_files import read_picture

# Least score of a ball in a dark tank: lit from aside it has a shadow on it and an edge of two kinds, and scored from
# 0.26 on in pictures of the twin. There is little else in the dark that is taken for one.
BY_LAMPS = 0.22


class Found(NamedTuple):
    """A target in the full frame. Pixels from the centre of the upper left pixel, u right, v down."""

    centre_px: tuple[float, float]  # where the ray to a ball's centre meets the image; middle of a box
    score: float  # 0 to 1
    radius_px: float | None = None  # of a ball
    size_px: tuple[float, float] | None = None  # of a box: width and height
    radius_sigma_px: float | None = None  # standard deviation of a ball's radius

    @property
    def box(self) -> Box:
        width, height = self.size_px or (2.0 * (self.radius_px or 0.0),) * 2
        return Box(self.centre_px[0] + 0.5 - width / 2, self.centre_px[1] + 0.5 - height / 2, width, height)


class Detector(Protocol):
    """Give it frames in the order in which they were taken; parts of them, if any, around where the target was last."""

    @property
    def remembers(self) -> bool:
        """Whether it compares a frame with earlier ones, so that all must be treated alike: none enhanced."""

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens_position: int | None = None) -> Found | None:
        """The target in an image (height, width, 3) blue green red; None if it is not there.

        offset_px: where the image's upper left pixel lies in the full frame. lens_position: at which it was taken.
        """


class BallDetector:
    """A ball of one colour, named or sampled."""

    remembers = False

    def __init__(self, camera: CameraFit, colour: Colour | ColourModel, by_lamps: bool = False) -> None:
        self._camera, self._colour, self._by_lamps = camera, colour, by_lamps

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens_position: int | None = None) -> Found | None:
        camera, limit = at_lens_position(self._camera, lens_position), BY_LAMPS if self._by_lamps else LIMIT
        ball = find_ball(image, camera, offset_px, self._colour, limit, self._by_lamps)
        if ball is None:
            return None
        return Found(ball.centre_px, ball.score, ball.radius_px, radius_sigma_px=ball.radius_sigma_px)


class CreatureDetector:
    """A coloured animal, whatever its shape, in a box around all that shows of it."""

    remembers = False

    def __init__(self, hues: Hues) -> None:
        self._hues = hues

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens_position: int | None = None) -> Found | None:
        found = find_creature(image, self._hues)
        if found is None:
            return None
        box = Box(found.x0, found.y0, found.x1 - found.x0, found.y1 - found.y0)
        return boxed(box, min(0.5 * found.strength / STRONG, 1.0), offset_px)


class BoxDetector:
    """What a follower knows, who has been told to start or to expect something. Wants whole frames of one size."""

    remembers = True

    def __init__(self, follower: Follower) -> None:
        self._follower = follower
        self._drawn: tuple[Image, Box] | None = None  # by somebody, and not yet looked for

    def expect(self, image: Image, box: Box) -> None:
        """Look for what is in this box of an earlier frame from the next one on. From any thread."""
        self._drawn = image, box

    def find(self, image: Image, offset_px: tuple[int, int] = (0, 0), lens_position: int | None = None) -> Found | None:
        if (drawn := self._drawn) is not None:
            self._drawn = None
            self._follower.expect(*drawn)
        now = self._follower.look(image)
        return None if now.lost else boxed(now.box, now.score, offset_px)


def boxed(box: Box, score: float, offset_px: tuple[int, int] = (0, 0)) -> Found:
    """What is in a box of an image whose upper left pixel lies at offset_px of the full frame."""
    u, v = box.centre_px
    return Found((u + offset_px[0], v + offset_px[1]), score, size_px=(box.width, box.height))


def load_detectors(fleet: Fleet, camera: CameraFit) -> Mapping[str, Detector]:
    """One for each target. Raises ConfigError for a picture or models that are not there or do not fit."""
    size = camera.width_px, camera.height_px
    by_lamps = fleet.lighting is not None
    return {name: _detector(name, target, size, camera, by_lamps) for name, target in fleet.target.items()}


def _detector(name: str, target: Target, size: tuple[int, int], camera: CameraFit, by_lamps: bool) -> Detector:
    match target.detector:
        case "box":
            return _box_detector(name, target, size)
        case "creature":
            return CreatureDetector(creature_hues(name, target, size))
        case "ball":
            return BallDetector(camera, _colour(name, target, size), by_lamps)


def creature_hues(name: str, target: Target, size: tuple[int, int]) -> Hues:
    """Those of a creature that is a target. Raises ConfigError for a picture or box that shows no colour."""
    if target.box is None:
        return named_hues(target.ball_colour)
    hues = sampled_hues(target_picture(name, target, size), target.box)
    if hues is None:
        raise ConfigError(
            f"{target.picture}: the box of target '{name}' is as grey as the rest; draw it on the coloured creature, "
            'or follow it by its look, with detector = "box"'
        )
    return hues


def _colour(name: str, target: Target, size: tuple[int, int]) -> Colour | ColourModel:
    """What a ball target names, or shows. Raises ConfigError for a picture or box that shows no colour."""
    return target.ball_colour if target.box is None else sought(name, target, size).model


def sought(name: str, target: Target, size: tuple[int, int]) -> Sought:
    """The colour of a ball target: the one that it names, or that of a part of it in a picture of (width, height)
    against the picture's border.

    Raises ConfigError for a picture or box that shows no colour.
    """
    if target.box is None:
        named = NAMED[target.ball_colour]
        return Sought(named, named_paint(named))
    image = target_picture(name, target, size)
    x, y, width, height = (round(value) for value in target.box)
    part = image[y : y + height, x : x + width].reshape(-1, 3)
    sample = Sample(part, np.concatenate([image[0], image[-1], image[1:-1, 0], image[1:-1, -1]]))
    model = sampled(sample) if len(part) else None
    if model is None:
        why = "lies outside of it" if not len(part) else "is as grey as its border"
        raise ConfigError(f"{target.picture}: the box of target '{name}' {why}; draw it on the coloured ball")
    return Sought(model, sample)


def colours_too_alike(fleet: Fleet) -> Iterator[str]:
    """A line for each two ball targets of which one would be found as the other. Raises ConfigError as sought() does.

    Of named colours alone the fleet's own rules have judged; the pictures of the others are read.
    """
    size = fleet.camera.width_px, fleet.camera.height_px
    balls = {name: target for name, target in fleet.target.items() if target.detector == "ball"}
    if len(balls) < 2 or all(target.box is None for target in balls.values()):
        return
    colours = {name: sought(name, target, size) for name, target in balls.items()}
    for one, other in itertools.combinations(colours, 2):
        if (light := mistaken_in(colours[one], colours[other])) is not None:
            yield (
                f"targets '{one}' and '{other}' are too alike in colour to be told apart (light of their pictures: "
                f"{light}), and one may be measured as the other; take colours that are farther apart"
            )


def target_picture(name: str, target: Target, size: tuple[int, int]) -> Image:
    """The picture in which the box of a target was drawn. Raises ConfigError if there is none of this width and height,
    in pixels."""
    path = Path(target.picture or "")
    try:
        image = read_picture(path)
    except ConfigError:
        text = f"{path}: no picture for target '{name}'; put one there that this camera has taken"
        raise ConfigError(text) from None
    if (image.shape[1], image.shape[0]) != size:
        its, wanted = f"{image.shape[1]}x{image.shape[0]}", f"{size[0]}x{size[1]}"
        raise ConfigError(f"{path}: {its} pixels, the camera has {wanted}; take another picture for target '{name}'")
    return image


def _box_detector(name: str, target: Target, size: tuple[int, int]) -> BoxDetector:
    assert target.box is not None  # load_fleet has seen to it
    image = target_picture(name, target, size)
    follower = Follower(
        load_box_tracker(*((None, None) if target.models is None else model_files(Path(target.models))))
    )
    follower.expect(image, Box(*target.box))
    return BoxDetector(follower)
