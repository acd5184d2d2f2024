"""Weights by which paints.py might tell neighbouring colours apart, fitted, and their worth on a source left out.

Tones are taken at the marked circles, each picture as taken and as drawn cameras would have taken it (cameras.py).
Logistic regression, every colour of every source with the same weight. Held out: of the balls of a source, how many
are named right by weights fitted on all other sources; the shipped ones have seen all. Nothing is printed where the
pictures (AUCAMP_DATA, else ../shared/data) are absent.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from agent.experiments.detection.marked_pictures import marked_pictures
from agent.perception.detection.colour import MIN_STRENGTH, Tone
from agent.perception.detection.cone import CIRCLE
from agent.perception.detection.paints import WARM_OR_YELLOW, YELLOW_OR_GREEN, between
from agent.perception.detection.patch import patch
from agent.perception.detection.picture import exposed
from hw.picture_files import read_picture
from tests.bench.pictures.cameras import AS_TAKEN, drawn
from tests.places import DATA

FOLDERS = tuple(DATA / "real_water" / name for name in ("balls", "balls_composite"))
CAMERAS = (AS_TAKEN, *(drawn(seed) for seed in range(10, 15)))
SMALLEST_PX = 8.0
ORDER = {"red": 0, "orange": 0, "yellow": 1, "green": 2}  # ever less red
RIDGE = 2e-3
NEIGHBOURS = {"warm_or_yellow": (0, WARM_OR_YELLOW), "yellow_or_green": (1, YELLOW_OR_GREEN)}

Array = np.ndarray


class Marked(NamedTuple):
    source: str
    colour: int  # of ORDER
    tone: Tone


def run() -> dict[str, dict]:
    balls = list(marked_tones())
    if not balls:
        return {}
    rows: dict[str, tuple[float, str, str]] = {}
    for name, (redder, shipped) in NEIGHBOURS.items():
        for part, value, now in zip(("place", "redder", "strength"), fitted(balls, redder), shipped, strict=True):
            rows[f"{name}_{part}"] = (value, "", f"{now:.2f} in paints.py")
    for source in sorted({ball.source for ball in balls}):
        others = [ball for ball in balls if ball.source != source]
        held_out = tuple(fitted(others, redder) for redder, _ in NEIGHBOURS.values())
        own = [ball for ball in balls if ball.source == source]
        rows[f"{source}_held_out"] = (100.0 * named_right(own, held_out), "%", f"{len(own)} tones, its own left out")
        shipped = (WARM_OR_YELLOW, YELLOW_OR_GREEN)
        rows[f"{source}_shipped"] = (100.0 * named_right(own, shipped), "%", "the same, by the shipped weights")
    return {
        f"paints_{name}": {"value": value, "unit": unit, "against": against, "ratio": None}
        for name, (value, unit, against) in rows.items()
    }


def marked_tones() -> Iterator[Marked]:
    """Every marked ball under every camera that shows a colour of it."""
    for folder in FOLDERS:
        for path, marked in marked_pictures(folder) if folder.is_dir() else ():
            source = path.name.rsplit("_", 1)[0].split("_front")[0]
            image = read_picture(path) if marked else None
            for camera in CAMERAS if marked else ():
                picture = exposed(camera.image(image))
                for ball in marked:
                    centre = np.array(ball.centre_px)
                    found = patch(picture, centre + ball.radius_px * CIRCLE, centre)
                    if found and ball.radius_px >= SMALLEST_PX and found.tone.strength >= MIN_STRENGTH:
                        yield Marked(source, ORDER[ball.colour], found.tone)


def fitted(balls: list[Marked], redder: int) -> tuple[float, float, float]:
    """Weights for this colour of ORDER against the next one."""
    pair = [ball for ball in balls if ball.colour in (redder, redder + 1)]
    groups = [(ball.source, ball.colour) for ball in pair]
    weight = np.array([1.0 / groups.count(group) for group in groups])
    sign = np.array([1.0 if ball.colour == redder else -1.0 for ball in pair])
    parts = np.array([[between(unit, ball.tone) for unit in np.eye(3)] for ball in pair])

    def loss(weights: Array) -> float:
        doubt = np.logaddexp(0.0, -sign * (parts @ weights))
        return float(weight @ doubt / weight.sum() + RIDGE * (weights[1:] @ weights[1:]))

    place, of_redder, of_strength = minimize(loss, np.zeros(3), method="BFGS").x
    return float(place), float(of_redder), float(of_strength)


def named_right(balls: list[Marked], weights: tuple[tuple[float, float, float], ...]) -> float:
    """Share of balls, every colour with the same weight."""
    shares = []
    for colour in {ball.colour for ball in balls}:
        tones = [ball.tone for ball in balls if ball.colour == colour]
        shares.append(np.mean([sum(between(one, tone) <= 0.0 for one in weights) == colour for tone in tones]))
    return float(np.mean(shares))
