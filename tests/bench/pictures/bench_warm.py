"""Whether enhancement leaves warm buoys warm: marked balls of real pictures, seen by each way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from agent.core.config import ConfigError
from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Share, Value
from agent.experiments.detection_pictures import marked_pictures
from agent.perception.enhancement.enhance import classic, enhancer, missing, shipped_files, white_balance
from agent.tools.evaluate_enhance import kept_warm
from hw.camera.files import read_picture
from tests.bench.timing import one_thread
from tests.places import DATA, shared

BALLS = DATA / "real_water" / "balls"
WARM_BALLS = ("red", "orange", "yellow")
INNER = 0.85  # of the radius: the rim is mixed with the water
MOST = 0.5  # of a ball's warm pixels
NETWORK = ("own", "real")
LEAST = 80.0  # %, of the network
WAYS = {
    "raw": "the picture as it is",
    "classic": "white balance and CLAHE",
    "own": "network, weights of drawn scenes",
    "real": "network, weights of real pairs, the default",
}


def way_of(case: str) -> Callable[[np.ndarray], np.ndarray]:
    """Raises ConfigError where the network is not installed."""
    if case in ("raw", "classic"):
        return classic if case == "classic" else lambda image: image
    if lacks := missing(None):
        raise ConfigError(f"experiment warm: {case}: {lacks}")
    return enhancer("fast", shipped_files()[case]).apply


def balls(folder: Path) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
    """Each picture with warm balls, and the pixels of each of them."""
    for path, marked in marked_pictures(folder):
        warm = [ball for ball in marked if ball.colour in WARM_BALLS]
        if warm:
            image = read_picture(path)
            y, x = np.mgrid[: image.shape[0], : image.shape[1]]
            away = [np.hypot(x - ball.centre_px[0], y - ball.centre_px[1]) for ball in warm]
            yield image, [px < INNER * ball.radius_px for px, ball in zip(away, warm, strict=True)]


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """A row for each ball that has warm pixels."""
    with one_thread():
        apply, rows = way_of(case), list[Row]()
        for image, discs in balls(shared("real_water", "balls")):
            after, balanced = apply(image), white_balance(image)
            found = [kept_warm(after, balanced, disc) for disc in discs]
            rows += [{"pixels": one.pixels, "kept": one.kept} for one in found if one.pixels]
        return rows


def summary(rows: Rows) -> dict[str, Value]:
    figures: dict[str, Value] = {}
    for case, seen in rows.items():
        figures[f"{case}_pixels"] = 100.0 * sum(ball["kept"] for ball in seen) / sum(ball["pixels"] for ball in seen)
        figures[f"{case}_balls"] = Share(sum(ball["kept"] >= MOST * ball["pixels"] for ball in seen), len(seen))
    return figures


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(WAYS),
    measured_on="real pictures",
    figures=tuple(
        Figure(f"{way}_{key}", f"{words}: {what}", "%", least=LEAST if way in NETWORK else None)
        for way, words in WAYS.items()
        for key, what in (("pixels", "warm pixels that stay warm"), ("balls", "balls of which half of them do"))
    ),
    exact=True,
    explanation="""Marked red, orange and yellow balls in real pictures of pools. A pixel of a ball counts that is warm
        and vivid after plain white balance; it is kept where it is still warm, from red to yellow, after enhancement.
        Large balls weigh more among the pixels.""",
)
