"""What doubting each in turn costs robots that are all honest: their error, and its square normalised, against belief.

Random worlds of the localization experiment, with systematic errors. No clock in it: the figures are always the same.
"""

import math
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np

from agent.core.estimation.fuse import Opinion, fuse, vote
from agent.core.linear_algebra import apply, inverse, invert, quadratic, upper
from agent.core.messages import Symmetric, Vector
from agent.experiments.localization.draws import Case, mean_score, score_draw
from agent.experiments.localization.lockstep import TARGET_M, draw_dive, draw_world

DRAWS = {3: 1500, 5: 1000, 10: 500}
SAMPLES = (1, 10, 60)  # of each robot
SWIMS = Case("evidence", "full", 3, 30, (60,), loss=0.1, systematic=True, speed_mm_s=20.0)
NEVER = {"LOW": 1e6, "HIGH": 2e6}  # sigma; nobody stands so far out


def run() -> dict[str, dict]:
    resting = {f"doubt: {n} robots, {k} samples each": at_rest(n, k) for n in DRAWS for k in SAMPLES}
    return {**resting, "doubt: 3 robots, target at 20 mm/s": moving()}


def moving() -> dict:
    """The whole estimator, whose tracks are doubted too."""
    doubting, nees = swum_mm()
    with patch.multiple("agent.core.estimation.fuse", **NEVER):
        believing, nees_before = swum_mm()
    return compared(doubting, nees, believing, nees_before)


def swum_mm() -> tuple[float, float]:
    score = mean_score([score_draw(SWIMS, 5, number)[0] for number in range(SWIMS.draws)])
    assert score.square is not None
    return 1e3 * math.sqrt(score.square), score.nees


def at_rest(robots: int, samples: int) -> dict:
    draws = [opinions(robots, samples, number) for number in range(DRAWS[robots])]
    found = [fuse(draw) for draw in draws]
    doubting, nees = rms_mm([(f.x_m, f.cov_m2) for f in found if f is not None])
    believing, nees_before = rms_mm([mean(draw) for draw in draws])
    return compared(doubting, nees, believing, nees_before)


def compared(doubting: float, nees: float, believing: float, nees_before: float) -> dict:
    """A row of the table: millimetres, and the mean normalised error squared."""
    return {
        "value": doubting,
        "unit": f"mm, nees {nees:.2f}",
        "against": f"who agrees is believed: {believing:.3f} mm, nees {nees_before:.2f}",
        "ratio": doubting / believing,
    }


def opinions(robots: int, samples: int, number: int) -> list[Opinion]:
    rng = np.random.default_rng((9, number))
    world = draw_world(robots, "aniso", True, rng)
    x_m = draw_dive(world, "all", 0.0, samples, rng).sample_m.mean(axis=0)
    cov_m2 = [upper(cov) for cov in world.random_m2 / samples + world.systematic_m2]
    return [Opinion(f"r{i:02}", tuple(x_m[i].tolist()), cov_m2[i], invert(cov_m2[i])) for i in range(robots)]


def mean(draw: Sequence[Opinion]) -> tuple[Vector, Symmetric]:
    """Of the largest group that agrees, as if nobody could be wrong."""
    group = [opinion for opinion in draw if opinion.origin in vote(draw).group]
    words = [(*o.precision, *apply(o.precision, o.x_m)) for o in group]
    total = [math.fsum(column) for column in zip(*words, strict=True)]
    covariance = invert(tuple(total[:6]))
    return apply(covariance, tuple(total[6:])), covariance


def rms_mm(found: Sequence[tuple[Vector, Symmetric]]) -> tuple[float, float]:
    """Error, and mean normalised error squared: 3 where covariances are true."""
    errors = [(tuple(a - b for a, b in zip(x, TARGET_M, strict=True)), cov) for x, cov in found]
    squares = [math.fsum(e * e for e in error) for error, _ in errors]
    nees = [quadratic(information, error) for error, cov in errors if (information := inverse(cov)) is not None]
    return 1e3 * math.sqrt(np.mean(squares)), float(np.mean(nees))
