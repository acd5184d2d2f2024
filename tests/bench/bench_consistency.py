"""Is a measurement as far from the truth as its covariance says, and how far is that, by focus, by size and by both?"""

from __future__ import annotations

import msgspec
import numpy as np

from agent.core.config import Cues
from agent.experiments.ball_measurements import RANGE_M, ball_measurements
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value, rms

CUES: dict[Cues, str] = {"both": "focus and size", "focus": "focus alone", "size": "size alone"}
BANDS_M = {"near": (RANGE_M[0], 0.40), "middle": (0.40, 0.90), "far": (0.90, RANGE_M[1])}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    places: int = 25  # of a robot
    sensor: str = "imx519_640"  # a preset of hw.twin.optics.lens


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each place of one robot. Raises CalibrationRefused."""
    return list(ball_measurements(seed, settings.places, settings.sensor))


def summary(rows: Rows) -> dict[str, Value]:
    """Places without a measurement count in `measured` alone."""
    places = rows["all"]
    good = [row for row in places if "nees" in row["both"]]
    found: dict[str, Value] = {"measured": Share(len(good), len(places))}
    for cue in CUES:
        of_cue = [(row["distance_m"], row[cue]) for row in good if "nees" in row[cue]]
        found[f"{cue}_nees"] = float(np.mean([one["nees"] for _, one in of_cue])) if of_cue else None
        found[f"{cue}_mm"] = rms([one["error_mm"] for _, one in of_cue])
        for band, (low, high) in BANDS_M.items():
            found[f"{cue}_{band}_mm"] = rms([one["range_mm"] for m, one in of_cue if low <= m <= high])
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"places": 3},
    measured_on="twin",
    figures=(
        Figure("both_nees", "error as the covariance says, focus and size: mean NEES", "", least=2.5, most=3.5),
        *(Figure(f"{cue}_nees", f"{CUES[cue]}: mean NEES") for cue in ("focus", "size")),
        Figure("measured", "places that give a measurement", "%"),
        *(
            Figure(f"{cue}_mm", f"{words}: place of the ball in the world, rms error", "mm")
            for cue, words in CUES.items()
        ),
        *(
            Figure(f"{cue}_{band}_mm", f"{words}: range from the camera, {low:g} to {high:g} m, rms error", "mm")
            for band, (low, high) in BANDS_M.items()
            for cue, words in CUES.items()
        ),
    ),
    seeds=40,  # their errors of calibration stay with all places of a robot
    explanation="""A robot with a lens, servos and a calibration of its own looks at a ball from 25 places, 0.25 to
        1.2 m away, in one of three kinds of water. Frames, detection, a full sweep, its peak, place and covariance are
        all as in a dive. NEES is the error squared in units of the stated covariance, 3 where that is honest. A ball
        that is larger than the frame gives no measurement.""",
)
