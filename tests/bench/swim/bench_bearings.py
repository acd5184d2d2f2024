"""How well three cameras' bearings follow the twin's fish, and for how long it is known unseen.

Cameras err by 3 mrad white. The fish turns by the twin's law; the track believes that it keeps a course for `turn_s`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.estimation.track import Dynamics, FixedLagFilter, Held, Track, predict, swimming
from agent.core.linear_algebra import apply, full
from agent.core.target_state import bearing
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from hw.twin.creatures import School
from hw.twin.scene import Creature, load_scene

TANK_M = (3.0, 2.0, 0.5)
CAMERAS_M = np.array([[0.3, 0.3, 0.25], [2.7, 0.4, 0.2], [1.4, 1.8, 0.3]])
SIGMA_RAD, STEP_TICKS, BEGUN = 0.003, 10, 10
UNSEEN_NS = 1_000_000_000
TURN_S = 2.0  # for which a fish of the twin keeps a course, about

Array = NDArray[np.float64]


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    speed_m_s: float = 0.15  # of the fish, and as the track is told
    seconds: int = 60


def way_m(seed: int, settings: Settings) -> Array:
    """(n, 3) middles of a fish, ten a second."""
    school = School([Creature(name="fish", speed_m_s=settings.speed_m_s)], seed, TANK_M, load_scene("fish").solid)
    places = []
    for k in range(settings.seconds * 100):
        school.tick(CAMERAS_M, ())
        if k % STEP_TICKS == STEP_TICKS - 1:
            places.append(school.attitudes[0][:3])
    return np.array(places)


def followed(path_m: Array, dynamics: Dynamics, seed: int) -> list[Track]:
    """The track at each place of the path, each bearing weighed by the track's own range."""
    rng, tracker, tracks = np.random.default_rng(seed), FixedLagFilter(dynamics, TANK_M), list[Track]()
    for k, place_m in enumerate(path_m):
        t_ns, seen = (k + 1) * STEP_TICKS * 10_000_000, []
        for camera_m in CAMERAS_M:
            way = place_m - camera_m
            far = float(np.linalg.norm(way))
            ray = way / far + rng.normal(0, SIGMA_RAD, 2) @ np.linalg.svd(way[None])[2][1:]
            believed = math.dist(tracks[-1].x_m, camera_m) if tracks else far
            one = bearing(tuple(camera_m.tolist()), tuple(ray.tolist()), believed, SIGMA_RAD, t_ns)
            seen.append(Held(t_ns, one.information, apply(one.information, one.x_m)))
        track = tracker.run(seen, t_ns, t_ns)
        assert track is not None
        tracks.append(track)
    return tracks[BEGUN:]


def judged(tracks: Sequence[Track], path_m: Array) -> tuple[float, float]:
    """Root mean square error, mm, and the mean of the normalised error squared; one track a place."""
    squares, normalised = [], []
    for track, place_m in zip(tracks, path_m, strict=True):
        error = np.array(track.x_m) - place_m
        squares.append(error @ error)
        normalised.append(error @ np.linalg.solve(full(track.A), error))
    return 1e3 * math.sqrt(np.mean(squares)), float(np.mean(normalised))


# --- the claim ---

TURNS = {"half": 0.5, "right": 1.0, "double": 2.0, "straight": math.inf}  # believed, of TURN_S
KEYS = {
    "seen_mm": ("a fish that three cameras see: off, rms", "mm"),
    "seen_nees": ("its error as it says: NEES", ""),
    "unseen_mm": ("a second after it was seen last: off, rms", "mm"),
    "unseen_nees": ("its error then as it says: NEES", ""),
}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """While it is seen, and a second after it was seen last."""
    dynamics = swimming(settings.speed_m_s, TURN_S)._replace(turn_s=TURNS[case] * TURN_S)
    path_m, later = way_m(seed, settings), UNSEEN_NS // (STEP_TICKS * 10_000_000)
    tracks = followed(path_m, dynamics, seed)
    unseen = [predict(track, track.t_ns + UNSEEN_NS, dynamics) for track in tracks[:-later]]
    return [dict(zip(KEYS, (*judged(tracks, path_m[BEGUN:]), *judged(unseen, path_m[BEGUN + later :])), strict=True))]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for case, of in rows.items():
        for key in KEYS:
            values = [row[key] for row in of]
            found[f"{case}_{key}"] = rms(values) if key.endswith("_mm") else math.fsum(values) / len(values)
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(TURNS),
    quick={"seconds": 10},
    measured_on="model",
    figures=tuple(
        Figure(f"{case}_{key}", f"{'no turns' if case == 'straight' else f'turn_s x {times:g}'}: {words}", unit)
        for case, times in TURNS.items()
        for key, (words, unit) in KEYS.items()
    ),
    explanation="""A fish of the twin wanders at 0.15 m/s between three cameras that see it ten times a second, and know
        where they are. The kernel's track is made of their bearings alone, and believes that the fish keeps a course
        for `turn_s`: as long as fits it, half or twice as long, or for ever. NEES is the error squared in units of the
        stated covariance, 3 where it is honest.""",
)
