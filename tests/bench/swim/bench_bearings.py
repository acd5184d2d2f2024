"""How well three cameras' bearings follow the twin's fish, and for how long it is known unseen:
`python -m tests.bench.swim.bench_bearings SEED ...`.

Cameras stand where they see it all the time, ten times a second, and err by 3 mrad white; poses are known. The fish
turns by the twin's law, the track believes another one: how little T matters is a row of its own.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.core.estimation.track import Dynamics, FixedLagFilter, Held, Track, predict, swimming
from agent.core.linear_algebra import apply
from agent.core.target_state import bearing
from hw.twin.creatures import School
from hw.twin.scene import Creature, load_scene

TANK_M = (3.0, 2.0, 0.5)
CAMERAS_M = np.array([[0.3, 0.3, 0.25], [2.7, 0.4, 0.2], [1.4, 1.8, 0.3]])
SIGMA_RAD, STEP_TICKS, SECONDS, BEGUN = 0.003, 10, 60, 10
UNSEEN_NS = 1_000_000_000
SEEDS = (11, 12, 13)

Array = NDArray[np.float64]


def way_m(seed: int, speed_m_s: float) -> Array:
    """(n, 3) middles of a fish, ten a second."""
    school = School([Creature(name="fish", speed_m_s=speed_m_s)], seed, TANK_M, load_scene("fish").solid)
    places = []
    for k in range(SECONDS * 100):
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
        xx, xy, xz, yy, yz, zz = track.A
        error = np.array(track.x_m) - place_m
        squares.append(error @ error)
        normalised.append(error @ np.linalg.solve(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), error))
    return 1e3 * math.sqrt(np.mean(squares)), float(np.mean(normalised))


def figures(seed: int, speed_m_s: float, dynamics: Dynamics) -> tuple[float, float, float, float]:
    """Error (mm) and normalised error squared: seen, and a second after it was seen last."""
    path_m = way_m(seed, speed_m_s)
    tracks, later = followed(path_m, dynamics, seed), UNSEEN_NS // (STEP_TICKS * 10_000_000)
    unseen = [predict(track, track.t_ns + UNSEEN_NS, dynamics) for track in tracks[:-later]]
    return *judged(tracks, path_m[BEGUN:]), *judged(unseen, path_m[BEGUN + later :])


def run(seeds: Sequence[int] = SEEDS) -> dict[str, dict]:
    """At 15 cm/s, which is what the track is told."""
    fish = swimming(0.15, 2.0)
    turning, straight = (
        np.mean([figures(seed, 0.15, how) for seed in seeds], axis=0) for how in (fish, fish._replace(turn_s=math.inf))
    )
    names = ("followed", "followed_nees", "unseen_1s", "unseen_1s_nees")
    units, against = ("mm rms", "", "mm rms", ""), "a velocity that wanders without end"
    return {
        f"fish_{name}": {"value": float(a), "unit": unit, "against": against, "ratio": float(a / b)}
        for name, unit, a, b in zip(names, units, turning, straight, strict=True)
    }


if __name__ == "__main__":
    chosen = tuple(map(int, sys.argv[1:])) or SEEDS
    for speed_m_s in (0.1, 0.15, 0.2):
        for turn_s in (0.6, 1.0, 2.0, 4.0, math.inf):
            how = swimming(speed_m_s, min(turn_s, 2.0))._replace(turn_s=turn_s) if turn_s == math.inf else None
            dynamics = how or swimming(speed_m_s, turn_s)
            row = np.mean([figures(seed, speed_m_s, dynamics) for seed in chosen], axis=0)
            print(f"{speed_m_s} m/s, T {turn_s} s:", *(f"{figure:.2f}" for figure in row), flush=True)
