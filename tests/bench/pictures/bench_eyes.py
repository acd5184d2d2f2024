"""Whether balls are found in pictures as other cameras would have taken them: marked folders, each changed in one way.

Gains, gammas, exposures, noise, JPEG and size differ from camera to camera; what holds under all of these changes is
likely to hold on a camera that nobody here has. Found: of the marked balls from 10 px radius on; false with balls: in
pictures that hold some, another colour's included; false without: in those that hold none. Nothing is printed where
the pictures (AUCAMP_DATA, else ../shared/data) are absent: give your own folders by AUCAMP_DATA.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from agent.experiments.detection.marked_pictures import MarkedBall, marked_pictures
from agent.experiments.detection.picture_run import JUDGED_PX, Seen, look, relative_error
from hw.picture_files import read_picture
from tests.places import DATA

FOLDERS = tuple(DATA / "real_water" / name for name in ("balls", "balls_composite", "no_balls"))
NOISE = 4.0  # standard deviation, of 255
SMALLER = 0.75

Image = np.ndarray
Change = Callable[[Image], Image]
Picture = tuple[Path, Image, list[MarkedBall]]


class Changed(NamedTuple):
    """What another camera makes of a picture, and where that leaves the balls."""

    image: Change
    ball: Callable[[MarkedBall, int], MarkedBall] = lambda ball, width_px: ball


def gamma(power: float) -> Changed:
    return Changed(lambda image: cv2.LUT(image, np.uint8(np.rint(255.0 * (np.arange(256) / 255.0) ** power))))


def gains(blue: float, green: float, red: float) -> Changed:
    """Factors of light, for 8-bit values encoded with a power of 1 / 2.2."""
    factors = np.array([blue, green, red]) ** (1.0 / 2.2)
    return Changed(lambda image: np.uint8(np.rint(np.minimum(image * factors, 255.0))))


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
    "as_taken": Changed(lambda image: image),
    "mirrored": Changed(lambda image: np.ascontiguousarray(image[:, ::-1]), mirrored),
    "gamma_0.7": gamma(0.7),
    "gamma_1.4": gamma(1.4),
    "jpeg_50": Changed(jpeg),
    "warmer": gains(0.85, 1.0, 1.15),
    "colder": gains(1.15, 1.0, 0.85),
    "exposure_0.7": gains(0.7, 0.7, 0.7),
    "exposure_1.3": gains(1.3, 1.3, 1.3),
    "noise_4": Changed(noisy),
    "size_0.75": Changed(lambda image: cv2.resize(image, None, fx=SMALLER, fy=SMALLER, interpolation=3), smaller),
}


def run() -> dict[str, dict]:
    pictures = [
        (path, read_picture(path), marked)
        for folder in FOLDERS
        if folder.is_dir()
        for path, marked in marked_pictures(folder)
    ]
    if not pictures:
        return {}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return {name: row for change in CHANGES for name, row in rows(change, pictures).items()}
    finally:
        cv2.setNumThreads(threads)


def rows(change: str, pictures: list[Picture]) -> dict[str, dict]:
    start = time.process_time()
    seen = list(searched(CHANGES[change], pictures))
    spent_ms = (time.process_time() - start) * 1e3 / len(pictures)
    judged = [one for picture in seen for one in picture.outcomes if one.marked.radius_px >= JUDGED_PX]
    found = [one for one in judged if one.ball]
    with_balls, without = ([s for s in seen if bool(s.outcomes) == some] for some in (True, False))
    table = {
        "found": (100.0 * len(found) / max(len(judged), 1), "%", f"{len(judged)} balls from {JUDGED_PX:g} px on"),
        "radius_off": (100.0 * float(np.median([relative_error(one) for one in found] or [np.nan])), "%", "median"),
        "false_with_balls": (sum(len(s.false) for s in with_balls), "", f"{len(with_balls)} pictures"),
        "false_without": (sum(len(s.false) for s in without), "", f"{len(without)} pictures"),
        "cpu": (spent_ms, "ms", "a picture, all four colours"),
    }
    return {
        f"eyes_{change}_{name}": {"value": value, "unit": unit, "against": against, "ratio": None}
        for name, (value, unit, against) in table.items()
    }


def searched(change: Changed, pictures: list[Picture]) -> Iterator[Seen]:
    """Each picture, changed, with what was found in it."""
    for path, image, marked in pictures:
        yield look(path, change.image(image), [change.ball(ball, image.shape[1]) for ball in marked])
