"""Detectors: each finds a target in a frame, behind one interface.

A ball is found by colour and shape, a creature by colour alone, all else by what a box showed. A ball or a creature is
found in each frame by itself. A thing in a box is followed from frame to frame, and first looked for in the whole
picture, in many sizes, by its likeness to the picture in which the box was drawn. `colours_too_alike` reports ball
targets that would be taken for each other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Colour, ConfigError, Fleet, Target
from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.perception.detection.colour import (
    ENCODED,
    NAMED,
    ColourModel,
    Light,
    Sample,
    exposed,
    sampled,
    tone_of,
    weights,
)
from agent.perception.detection.detect import LIMIT, find_ball
from agent.perception.tracking.appearance import Box, Image
from agent.perception.tracking.follow import Follower, load_box_tracker, model_files
from hw.camera.files import read_picture

# --- detectors of the targets of a fleet file ---

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
    """A thing in a box, by a follower that expects it. It takes whole frames of one size."""

    remembers = True

    def __init__(self, follower: Follower) -> None:
        self._follower = follower
        self._drawn: tuple[Image, Box] | None = None  # not yet looked for

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
    """The colour of a ball target: the one that it names, or that of its box against the border of its picture.

    size: (width, height) of the picture, pixels. Raises ConfigError for a picture or box that shows no colour.
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
    """The picture in which the box of a target was drawn.

    Raises ConfigError if there is none of this width and height, in pixels.
    """
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
    follower = Follower(load_box_tracker(None if target.models is None else model_files(Path(target.models))))
    follower.expect(image, Box(*target.box))
    return BoxDetector(follower)


# --- a coloured animal of any shape ---
#
# A body that bends, turns and swims away looks like no picture of it for long, but keeps its colours. Water makes all
# that is grey bluish, the more the farther it is, and never redder: so colours are compared with the least bluish
# greys of the frame, in the plane of chromaticity of logarithms of light. What differs from these by enough, and in the
# animal's hue, is a part of it; parts that lie together are one animal, and its box is around all of them. Each frame
# stands alone: nothing has to be remembered, so nothing can be followed by mistake.

FINEST = 2  # pixels are looked at so many together, across and down
# Chosen on frames of the twin's koi (seeds 1, 2, 4, 11 and 12): its orange has 0.37 to 1.1, a near stone
# before a far wall 0.35.
STRONG, WEAK = 0.40, 0.20  # difference of logarithms of light: of what is surely its colour, and of what belongs to it
LEAST_STRONG = 12  # of these larger pixels: in less there is no colour but noise
SLACK_RAD = 0.2  # beyond the hues of balls: no outline says what is paint and what is not
TURN_RAD = math.radians(15.0)  # of a sampled hue: the koi's is within 5 degrees of itself, other robots are 25 away
WARM = 0.35  # redder than that no grey is, by a camera's own white
GREYS = (75.0, 90.0)  # percentiles, of how red they are: the least bluish ones, and how red the reddest of them is
EVERY = 4  # of rows and columns, one is enough to know the greys
JOINED = 0.5  # of the larger part: what is nearer to it is of the same animal
PARTS = 40  # the largest
SAMPLED = 40  # of the larger pixels have to have a colour in a sample


class Hues(NamedTuple):
    """Hues that count, radians as in `ColourModel`."""

    low_rad: float
    high_rad: float


class Blob(NamedTuple):
    """Pixels of the image, x0 <= x < x1."""

    x0: int
    y0: int
    x1: int
    y1: int
    strong: int  # of the larger pixels
    strength: float  # their mean


def named_hues(colour: Colour) -> Hues:
    model = NAMED[colour]
    return Hues(model.low_rad - SLACK_RAD, model.high_rad + SLACK_RAD)


def sampled_hues(image: Image, box: tuple[float, float, float, float]) -> Hues | None:
    """Those of what is in a box (x, y, width, height) of a picture; None where it is grey."""
    strength, hue = _chromaticity(image)
    x0, y0 = round(box[0] / FINEST), round(box[1] / FINEST)
    x1, y1 = round((box[0] + box[2]) / FINEST), round((box[1] + box[3]) / FINEST)
    inside = strength[y0:y1, x0:x1] > STRONG
    if np.count_nonzero(inside) < SAMPLED:
        return None
    at = hue[y0:y1, x0:x1][inside].astype(float)
    middle = math.atan2(float(np.sin(at).mean()), float(np.cos(at).mean()))
    return Hues(middle - TURN_RAD, middle + TURN_RAD)


def find_creature(image: Image, hues: Hues) -> Blob | None:
    """The one of an image (height, width, 3) blue green red that shows most of these hues; None if nothing does."""
    strength, hue = _chromaticity(image)
    middle = 0.5 * (hues.low_rad + hues.high_rad)
    off = np.abs(np.remainder(hue - middle + math.pi, 2.0 * math.pi) - math.pi)
    its = off <= 0.5 * (hues.high_rad - hues.low_rad)
    strong = its & (strength > STRONG)
    if np.count_nonzero(strong) < LEAST_STRONG:
        return None
    number, labels, stats, _ = cv2.connectedComponentsWithStats((its & (strength > WEAK)).view(np.uint8))
    counts = np.bincount(labels[strong], minlength=number)
    sums = np.bincount(labels[strong], strength[strong], minlength=number)
    largest = sorted(range(1, number), key=lambda k: -counts[k])[:PARTS]
    parts = [_part(stats[k], int(counts[k]), float(sums[k])) for k in largest if counts[k] >= LEAST_STRONG]
    if not parts:
        return None
    x0, y0, x1, y1, n, mean = max(_joined(parts), key=lambda part: part.strong)
    height, width = image.shape[:2]
    return Blob(FINEST * x0, FINEST * y0, min(FINEST * x1, width), min(FINEST * y1, height), n, mean)


def _chromaticity(image: Image) -> tuple[Light, Light]:
    """Of each of the larger pixels, how far from the picture's greys it is, and in which hue."""
    size = max(image.shape[1] // FINEST, 1), max(image.shape[0] // FINEST, 1)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    log_light = cv2.LUT(small, exposed(image).log_light)
    b, g, r = log_light[..., 0], log_light[..., 1], log_light[..., 2]
    red = cv2.GaussianBlur(np.asarray(r - np.float32(0.5) * (g + b)), (5, 5), 1.0)
    green = cv2.GaussianBlur(np.asarray(np.float32(math.sqrt(0.75)) * (g - b)), (5, 5), 1.0)
    some_red, some_green = red[::EVERY, ::EVERY].ravel(), green[::EVERY, ::EVERY].ravel()
    cold = some_red < WARM
    if np.count_nonzero(cold) > 0.02 * len(cold):
        some_red, some_green = some_red[cold], some_green[cold]
        least, most = np.percentile(some_red, GREYS)
        red = red - np.float32(most)
        green = green - np.float32(np.median(some_green[some_red >= least]))
    return np.asarray(np.hypot(red, green), np.float32), np.asarray(np.arctan2(green, red), np.float32)


def _part(row: NDArray[np.int32], strong: int, total: float) -> Blob:
    x, y, width, height = (int(side) for side in row[:4])
    return Blob(x, y, x + width, y + height, strong, total / strong)


def _joined(parts: list[Blob]) -> list[Blob]:
    """Boxes that lie together made one, until none do."""
    apart: list[Blob] = []
    for part in parts:
        while (other := next((one for one in apart if _near(one, part)), None)) is not None:
            apart.remove(other)
            part = _both(other, part)
        apart.append(part)
    return apart


def _near(a: Blob, b: Blob) -> bool:
    gap = max(max(a.x0, b.x0) - min(a.x1, b.x1), max(a.y0, b.y0) - min(a.y1, b.y1))
    return gap < JOINED * max(a.x1 - a.x0, a.y1 - a.y0, b.x1 - b.x0, b.y1 - b.y0)


def _both(a: Blob, b: Blob) -> Blob:
    n = a.strong + b.strong
    mean = (a.strong * a.strength + b.strong * b.strength) / n
    return Blob(min(a.x0, b.x0), min(a.y0, b.y0), max(a.x1, b.x1), max(a.y1, b.y1), n, mean)


# --- pixels as another camera, or another light, would have made them: gamma, white balance, exposure ---

Change = Callable[[Image], Image]  # pixels (..., 3), blue green red


def gamma(power: float) -> Change:
    """Values to a power: brighter below 1, darker above."""
    curve = np.rint(255.0 * (np.arange(256) / 255.0) ** power).astype(np.uint8)
    return lambda image: np.asarray(curve[image], np.uint8)


def gains(blue: float, green: float, red: float) -> Change:
    """Factors of light, for 8-bit values encoded with a power of 1 / ENCODED."""
    factors = np.array([blue, green, red]) ** (1.0 / ENCODED)
    return lambda image: np.rint(np.minimum(image * factors, 255.0)).astype(np.uint8)


LIGHTS: Mapping[str, Change] = {
    "as it is": lambda image: image,
    "gamma 0.7": gamma(0.7),
    "gamma 1.4": gamma(1.4),
    "warmer light": gains(0.85, 1.0, 1.15),
    "colder light": gains(1.15, 1.0, 0.85),
    "less light": gains(0.7, 0.7, 0.7),
    "more light": gains(1.3, 1.3, 1.3),
}


# --- whether balls of two colours are told apart, in the light of their pictures and in others ---
#
# Each search is asked about the other's paint, by the rules by which it judges what it finds in a frame. A sample
# brings the paint with it, as its picture shows it. A named colour has one of the hue at which it is looked for,
# moderately strong, on grey.

GREY = 0.07  # light around a named paint: dark enough for none of the lights to burn the paint out
STRENGTH = 1.0  # of a named paint against it, logarithm of light: between a ball near by and one far away


class Sought(NamedTuple):
    """A colour that is looked for, and how a thing of it looks."""

    model: ColourModel
    sample: Sample


def named_paint(model: ColourModel) -> Sample:
    """One pixel of a paint of the model's hue, and one of grey around it."""
    light = GREY * np.exp(STRENGTH * np.stack([weights(model.hue_rad) / 1.5, np.zeros(3)]))  # 1.5: see weights()
    values = np.rint(255.0 * light ** (1.0 / ENCODED)).astype(np.uint8)
    return Sample(values[:1], values[1:])


def mistaken_in(one: Sought, other: Sought) -> str | None:
    """The first of LIGHTS in which a thing of one colour counts for the other as well; None where there is none."""
    pairs = (one.model, other.sample), (other.model, one.sample)
    for name, change in LIGHTS.items():
        if any(model.fits(tone_of(_in_light(change, sample)), 0.0) for model, sample in pairs):
            return name
    return None


def _in_light(change: Change, sample: Sample) -> Sample:
    return Sample(change(sample.thing), change(sample.around))
