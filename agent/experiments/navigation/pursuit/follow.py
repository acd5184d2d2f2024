"""Three robots follow a target that wanders: how well they keep their distance, their sides of it, and apart.

They find it by their own frames, for which their fleet file says that it swims: by bearings alone, or with the range
that a ball's size gives; or by sweeps, where the file does not say so; or they are told where it is. Of those that go
by frames each hides the target from those behind it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np

from agent.experiments.navigation import basin
from agent.experiments.navigation.bodies import twin_bodies
from agent.experiments.navigation.pursuit.wanderer import ToldEstimator, Wanderer
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.result import Row
from agent.experiments.spread import rms
from agent.kernel.config import Follow, Look, Pose, Ranging
from agent.kernel.estimation.interface import Posterior
from hw.twin.scene import generator

ROBOTS, STANDOFF_M = 3, 0.7
SPEEDS_M_S = (0.1, 0.2)
FIND_S, SETTLE_S, WATCH_S = 12.0, 8.0, 30.0
EVEN_RAD = 2.0 * math.pi / ROBOTS
By = Literal["bearings", "frames", "sweeps", "told"]
FRAMES = ("bearings", "frames")


def follow(seed: int, speed_m_s: float | None = None, by: By = "told", watch_s: float = WATCH_S) -> Row:
    """speed_m_s: of the target, by default 0.1 in one seed and 0.2 in the next.

    off_mm: rms of the distance less the standoff; gap_deg: rms of the angle between neighbours on the circle less an
    even one; nearest_m: of any robot to the target; least_m: of two robots; each_sees, one_sees: share of the frames
    that show the target; known: share of the time in which a robot has an estimate of it; track_mm: rms of that in
    the plane; nees: its squared error by its own covariance, 2 where that is right, mean over all moments.
    """
    rng = generator(seed, "follow")
    speed_m_s = SPEEDS_M_S[seed % 2] if speed_m_s is None else speed_m_s
    names = [f"r{i + 1}" for i in range(ROBOTS)]
    what = Follow(target="ball", standoff_m=STANDOFF_M, search=by != "told")
    first, robots = float(rng.uniform(-math.pi, math.pi)), {}
    for k, name in enumerate(names):  # all on one side, half a metre apart
        x, y = (0.6 + 0.55 * k, 0.45) if first > 0.0 else (2.4 - 0.55 * k, 1.55)
        others = tuple(other for other in names if other != name)
        pose = Pose(x_m=x, y_m=y, yaw_deg=90.0 if first > 0.0 else -90.0)
        robots[name] = basin.robot(name, pose, what, Look(tilt_deg=-10.0), others)
    swims = msgspec.structs.replace(basin.BALL, speed_m_s=speed_m_s, turn_s=basin.TURN_S)
    fleet = basin.fleet(robots, seed, swims if by in FRAMES else basin.BALL)
    if by == "bearings":
        fleet = msgspec.structs.replace(fleet, ranging=Ranging(cues="focus"))
    wanderer = Wanderer(rng, speed_m_s, FIND_S + SETTLE_S + watch_s)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, wanderer.at)
        if by in FRAMES:
            for name, eyes in swimmers.eyes.items():
                eyes.hide = fleet.robot[name].neighbours
        if by == "told":
            for agent in swimmers.agents.values():
                agent.targets["ball"].estimator = ToldEstimator(wanderer, lambda: bodies.now_ns, seed)
        for _ in range(round((FIND_S + SETTLE_S) * 20.0)):
            swimmers.step()
        rows, seen, tracks = [], [], []
        for _ in range(round(watch_s * 20.0)):
            swimmers.step()
            x, y, _ = wanderer.at(bodies.now_ns)
            rows.append([(px - x, py - y) for px, py, _ in map(swimmers.place, names)])
            frames = [swimmers.inputs[name].sightings for name in names]
            if all(frames):
                seen.append([any(frame.found for frame in of) for of in frames])
            tracks += [off(agent.current.estimator.posterior, wanderer) for agent in swimmers.agents.values()]
    return {**figures(np.array(rows), np.array(seen)), **track_figures(tracks), "speed_m_s": speed_m_s}


def off(believed: Posterior | None, wanderer: Wanderer) -> tuple[float, float] | None:
    """Squared error of an estimate of that moment, in the plane: in m^2, and by its own covariance."""
    if believed is None:
        return None
    x, y, _ = wanderer.at(believed.t_ns)
    error, (xx, xy, _, yy, _, _) = np.array([believed.x_m[0] - x, believed.x_m[1] - y]), believed.cov_m2
    return float(error @ error), float(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))


def track_figures(tracks: Sequence[tuple[float, float] | None]) -> Row:
    known = np.array([track for track in tracks if track is not None]).reshape(-1, 2)
    if not len(known):
        return {"known": 0.0, "track_mm": math.nan, "nees": math.nan}
    m2, nees = known.mean(axis=0)
    return {"known": len(known) / len(tracks), "track_mm": 1e3 * math.sqrt(m2), "nees": float(nees)}


def figures(arms: np.ndarray, seen: np.ndarray) -> Row:
    """arms: from the target to each robot, m, (steps, robots, 2); seen: of each frame, whether each saw it."""
    distance = np.linalg.norm(arms, axis=2)
    ways = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    gaps = np.diff(np.concatenate([ways, ways[:, :1] + 2.0 * math.pi], axis=1), axis=1)
    apart = np.linalg.norm(arms[:, :, None] - arms[:, None], axis=3)[:, *np.triu_indices(arms.shape[1], 1)]
    return {
        "off_mm": 1e3 * rms((distance - STANDOFF_M).ravel()),
        "gap_deg": math.degrees(rms((gaps - EVEN_RAD).ravel())),
        "nearest_m": float(distance.min()),
        "least_m": float(apart.min()),
        "each_sees": float(seen.mean()),
        "one_sees": float(seen.any(axis=1).mean()),
    }
