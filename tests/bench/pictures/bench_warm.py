"""Whether enhancement leaves warm buoys warm: marked balls of real pictures, seen by each way.

Of the pixels inside the marks of red, orange and yellow balls those count that are warm and vivid after plain white
balance (grey world, so its own row says nothing); kept are those that are still warm. By pixels of all balls together,
large ones first, and as the mean over the balls. Nothing is printed where the pictures (AUCAMP_DATA, else
../shared/data) are absent: give your own folder with a truth.csv (file, colour, u_px, v_px, radius_px) by AUCAMP_DATA.
"""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from agent.tools.evaluate_enhance import Kept, kept_warm
from tests.places import DATA

BALLS = DATA / "real_water" / "balls"
WARM_BALLS = ("red", "orange", "yellow")
INNER = 0.85  # of the radius: the rim is mixed with the water

Way = Callable[[np.ndarray], np.ndarray]


def run() -> dict[str, dict]:
    if not (BALLS / "truth.csv").is_file():
        return {}
    from agent.perception.enhancement import enhance
    from agent.perception.enhancement.enhance import clahe, classic, white_balance

    ways: dict[str, Way] = {"identity": lambda image: image, "grey_world": white_balance, "clahe": clahe}
    ways["classic"] = classic
    ways |= {name: enhance.enhancer("fast", file).apply for name, file in enhance.shipped_files().items()}
    return {name: value for way, apply in ways.items() for name, value in rows(way, kept(BALLS, apply)).items()}


def kept(folder: Path, way: Way) -> list[Kept]:
    """Of each warm ball."""
    return [
        kept_warm(after, balanced, disc)
        for image, discs in balls(folder)
        for after, balanced in [(way(image), _balanced(image))]
        for disc in discs
    ]


def balls(folder: Path) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
    """Each picture with warm balls, and the pixels of each of them."""
    with (folder / "truth.csv").open(newline="") as file:
        marks = [mark for mark in csv.DictReader(file) if mark["colour"] in WARM_BALLS]
    for name in sorted({mark["file"] for mark in marks}):
        image = cv2.imread(str(folder / name))
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        yield (
            image,
            [
                np.hypot(x - float(m["u_px"]), y - float(m["v_px"])) < INNER * float(m["radius_px"])
                for m in marks
                if m["file"] == name
            ],
        )


def rows(way: str, found: list[Kept]) -> dict[str, dict]:
    seen = [ball for ball in found if ball.pixels]
    pooled = sum(ball.kept for ball in seen) / sum(ball.pixels for ball in seen)
    each = float(np.mean([ball.kept / ball.pixels for ball in seen]))
    against = f"{len(seen)} balls"
    return {
        f"warm_{way}_pixels": {"value": 100 * pooled, "unit": "%", "against": against, "ratio": None},
        f"warm_{way}_balls": {"value": 100 * each, "unit": "%", "against": against, "ratio": None},
    }


def _balanced(image: np.ndarray) -> np.ndarray:
    from agent.perception.enhancement.enhance import white_balance

    return white_balance(image)
