"""Whether balls are found in pictures as other cameras would have taken them: marked folders, each changed in one way.

What holds under all of these changes is likely to hold on a camera that nobody here has.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import msgspec
import numpy as np

from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value
from agent.experiments.detection_pictures import JUDGED_PX, MarkedBall, look, marked_pictures
from agent.perception.detection.detectors import LIGHTS
from hw.camera.files import read_picture
from tests.bench.timing import one_thread
from tests.places import shared

# --- what other cameras would have made of a picture ---

NOISE = 4.0  # standard deviation, of 255
SMALLER = 0.75

Image = np.ndarray


class Changed(NamedTuple):
    """What another camera makes of a picture, and where that leaves the balls."""

    image: Callable[[Image], Image]
    ball: Callable[[MarkedBall, int], MarkedBall] = lambda ball, width_px: ball


def noisy(image: Image) -> Image:
    noise = np.random.Generator(np.random.PCG64(1)).normal(0.0, NOISE, image.shape)
    return np.uint8(np.clip(np.rint(image + noise), 0, 255))


def jpeg(image: Image) -> Image:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 50])[1], cv2.IMREAD_COLOR)


def mirrored(ball: MarkedBall, width_px: int) -> MarkedBall:
    return ball._replace(centre_px=(width_px - 1 - ball.centre_px[0], ball.centre_px[1]))


def smaller(ball: MarkedBall, width_px: int) -> MarkedBall:
    u, v = ((at + 0.5) * SMALLER - 0.5 for at in ball.centre_px)
    return MarkedBall(ball.colour, (u, v), ball.radius_px * SMALLER, ball.tolerance_px * SMALLER)


CHANGES: dict[str, Changed] = {
    "as-taken": Changed(lambda image: image),
    "mirrored": Changed(lambda image: np.ascontiguousarray(image[:, ::-1]), mirrored),
    "gamma-0.7": Changed(LIGHTS["gamma 0.7"]),
    "gamma-1.4": Changed(LIGHTS["gamma 1.4"]),
    "jpeg-50": Changed(jpeg),
    "warmer": Changed(LIGHTS["warmer light"]),
    "colder": Changed(LIGHTS["colder light"]),
    "exposure-0.7": Changed(LIGHTS["less light"]),
    "exposure-1.3": Changed(LIGHTS["more light"]),
    "noise-4": Changed(noisy),
    "size-0.75": Changed(lambda image: cv2.resize(image, None, fx=SMALLER, fy=SMALLER, interpolation=3), smaller),
}


# --- the claim ---

FOLDERS = ("balls", "balls_composite", "no_balls")  # photographs, balls drawn into photographs, and none


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    every: int = 1  # of so many pictures one


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each picture. Raises ConfigError where there are none."""
    change, rows = CHANGES[case], list[Row]()
    with one_thread():
        for folder in FOLDERS:
            for path, marked in marked_pictures(shared("real_water", folder))[:: settings.every]:
                image = read_picture(path)
                seen = look(change.image(image), [change.ball(ball, image.shape[1]) for ball in marked])
                judged = [one.ball is not None for one in seen.outcomes if one.marked.radius_px >= JUDGED_PX]
                found = {"judged": len(judged), "found": sum(judged), "false": len(seen.false)}
                rows.append({"marked": len(marked), **found})
    return rows


def summary(rows: Rows) -> dict[str, Value]:
    figures: dict[str, Value] = {}
    for case, pictures in rows.items():
        beside, without = ([row for row in pictures if bool(row["marked"]) is some] for some in (True, False))
        figures[f"{case}_found"] = Share(*(sum(row[key] for row in pictures) for key in ("found", "judged")))
        figures[f"{case}_false_beside"] = Share(sum(row["false"] > 0 for row in beside), len(beside))
        figures[f"{case}_false"] = Share(sum(row["false"] > 0 for row in without), len(without))
    return figures


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"every": 20},
    cases=tuple(CHANGES),
    measured_on="real pictures",
    figures=tuple(
        Figure(f"{change}_{key}", f"{change.replace('-', ' ', 1)}: {words}", "%")
        for change in CHANGES
        for key, words in (
            ("found", "balls of 8 px radius and more found"),
            ("false_beside", "pictures with balls in which something else is called one"),
            ("false", "pictures without balls in which something is called one"),
        )
    ),
    exact=True,
    explanation="""Marked pictures of pools and of open water, real balls and balls drawn into real backgrounds, and
        pictures without any. Each is changed as another camera would have taken it, and searched for balls of four
        colours. What is false beside balls is nearly always a ball of another colour. The limits of the detector were
        chosen on these pictures as they were taken; the changes say what another camera does to it.""",
)
