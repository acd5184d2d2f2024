"""Whether balls are found in pictures as other cameras would have taken them: marked folders, each changed in one way.

Gains, gammas, exposures, noise, JPEG and size differ from camera to camera (cameras.py); what holds under all of these
changes is likely to hold on a camera that nobody here has. Found: of the marked balls from 10 px radius on; false with
balls: in pictures that hold some, another colour's included; false without: in those that hold none. Nothing is printed
where the pictures (AUCAMP_DATA, else ../shared/data) are absent: give your own folders by AUCAMP_DATA.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from agent.experiments.detection_pictures import JUDGED_PX, MarkedBall, Seen, look, marked_pictures, relative_error
from hw.camera.files import read_picture
from tests.bench.pictures.cameras import CHANGES, Changed
from tests.places import DATA

FOLDERS = tuple(DATA / "real_water" / name for name in ("balls", "balls_composite", "no_balls"))
Picture = tuple[Path, np.ndarray, list[MarkedBall]]


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
