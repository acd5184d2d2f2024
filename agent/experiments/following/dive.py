"""One fleet and one target in one world: what truly was, and what each robot saw and believed, frame by frame.

They find it by their own drawn frames, as bearings and, by the box of a fish that shows its side or its head, hardly
any range. Robots hide it from those behind them, and so do weeds. One robot's camera is covered for some seconds: it
sees neither target nor tags.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.pursuit import carried_on
from agent.core.config import Body, Fleet, Pose
from agent.core.estimation.protocols import dynamics
from agent.core.messages import Estimate, Message, Vector
from agent.core.ranging.camera_model import camera_pose, look_at
from agent.experiments.following.basin import fleet_of, weeds
from agent.experiments.following.cases import Case
from agent.experiments.following.drawn_fish import NEAREST_M, DrawnFish
from agent.experiments.navigation.bodies import twin_bodies
from agent.experiments.navigation.drawn_ball import BALL_FARTHEST_M, Pillar, hides, ring
from agent.experiments.navigation.pursuit.wanderer import Wanderer
from agent.experiments.navigation.swimmers import FRAME_STEPS, Swimmers
from agent.robot.step import Agent
from hw.twin.scene import generator

FIND_S, WATCH_S = 20.0, 30.0
COVERED_S = 10.0, 15.0  # of the watch
FRESH_NS = 250_000_000  # a track of so long ago still says how well it is known
STEPS_S = 20.0

Array = NDArray[np.float64]


class Draw(NamedTuple):
    """n frames, k robots. From the beginning; `watched` is the first frame that counts."""

    t_s: Array  # (n,)
    target_m: Array  # (n, 3)
    robots: Array  # (n, k, 3): x, y (m), yaw (rad)
    sees: NDArray[np.bool_]  # (n, k): whether each robot's frame shows it
    in_sight: NDArray[np.bool_]  # (n, k): whether nothing is in between
    in_reach: NDArray[np.bool_]  # (n, k): whether the camera can be turned to it, and it is not too near for a picture
    covered: NDArray[np.bool_]  # (n, k)
    landmarks: NDArray[np.bool_]  # (n, k): its camera is turned to landmarks
    error_m: Array  # (n, k): of where each robot believes it to be now; nan: it does not know
    nees: Array  # (n, k): squared error by its own covariance, 3 where that is right; nan: no track of that time
    watched: int
    weeds: tuple[Pillar, ...]
    does: tuple[tuple[str, ...], ...] = ()  # what each robot says that it does, of each frame


def dive(case: Case, seed: int, watch_s: float = WATCH_S) -> Draw:
    """Raises Failed where a firmware hangs."""
    fleet, pillars = fleet_of(case, seed), weeds(seed)
    names, rng = list(fleet.robot), generator(seed, "follow")
    rng.uniform()  # drawn for where they begin
    wanderer = Wanderer(rng, case.speed_m_s, FIND_S + watch_s, pillars)
    blind = names[seed % case.robots]
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies)
        swimmers.lost = Channel(case, seed).loses
        for name, eyes in swimmers.eyes.items():
            eyes.hide, eyes.pillars = fleet.robot[name].neighbours, pillars
            eyes.ball = DrawnFish(fleet, name, bodies.camera(name), wanderer.at)
        began_ns, rows, told = bodies.now_ns, list[list[Array]](), list[tuple[str, ...]]()
        for step in range(1, round((FIND_S + watch_s) * STEPS_S) + 1):
            at_s = step / STEPS_S - FIND_S
            swimmers.eyes[blind].covered = COVERED_S[0] <= at_s < COVERED_S[1]
            swimmers.step()
            if swimmers.steps % FRAME_STEPS == 0:
                rows.append(row(swimmers, fleet, wanderer.at(bodies.now_ns), pillars))
                told.append(tuple(_does(agent) for agent in swimmers.agents.values()))
    t_s = (1 + np.arange(len(rows))) * FRAME_STEPS / STEPS_S
    target_m = np.array([wanderer.at(began_ns + round(t * 1e9)) for t in t_s])
    cells = np.array(rows)
    sees, in_sight, in_reach, covered, landmarks = np.moveaxis(cells[:, :, 3:8].astype(bool), 2, 0)
    error_m, nees = np.moveaxis(cells[:, :, 8:], 2, 0)
    watched = int(np.searchsorted(t_s, FIND_S, side="right"))
    seen = sees, in_sight, in_reach, covered, landmarks
    return Draw(t_s, target_m, cells[:, :, :3], *seen, error_m, nees, watched, pillars, tuple(told))


def row(swimmers: Swimmers, fleet: Fleet, target_m: Vector, pillars: tuple[Pillar, ...]) -> list[Array]:
    """Of each robot, after the step in which a frame was exposed."""
    found = []
    for name, agent in swimmers.agents.items():
        eyes, place = swimmers.eyes[name], swimmers.place(name)
        newest = eyes.coming[-1].sighting
        others = [ring(swimmers.bodies.pose(other)) for other in fleet.robot if other != name]
        near = np.hypot(target_m[0] - place[0], target_m[1] - place[1]) < BALL_FARTHEST_M
        clear = not any(hides(pillar, place[:2], target_m) for pillar in (*pillars, *others))
        reach = reaches(fleet.body, place, target_m)
        flags = newest is not None and newest.found, near and clear and not eyes.covered, reach, eyes.covered
        believed = judged(agent, fleet, target_m, swimmers.now_ns)
        found.append(np.array([*place, *flags, agent.swimmer is not None and agent.swimmer.glances, *believed], float))
    return found


def reaches(body: Body, place: Vector, target_m: Vector) -> bool:
    """Whether a gimbal of a robot there (x, y, yaw) pans as far as to the target, which is beyond the nearest that a
    lens makes a picture of."""
    pose, level = Pose(x_m=place[0], y_m=place[1], yaw_deg=math.degrees(place[2])), (0.0, 0.0, 0.0, 0.0)
    pan_deg, _ = look_at(target_m, pose, body, *level)
    eye_m = camera_pose(pose, body, *level[:3], 0.0, 0.0, level[3]).position_m
    low, high = body.pan_limit_deg
    return math.dist(eye_m[:2], target_m[:2]) > NEAREST_M and low <= pan_deg <= high


def judged(agent: Agent, fleet: Fleet, target_m: Vector, now_ns: int) -> tuple[float, float]:
    """Error of where it is believed to be now, m, and normalised error squared of a fresh track."""
    believed = agent.targets["ball"].estimator.posterior
    if believed is None:
        return np.nan, np.nan
    off = np.array(carried_on(believed, dynamics(fleet.target["ball"]), now_ns)) - target_m
    if now_ns - believed.t_ns > FRESH_NS:
        return float(np.linalg.norm(off)), np.nan
    xx, xy, xz, yy, yz, zz = believed.cov_m2
    return float(np.linalg.norm(off)), float(
        off @ np.linalg.solve(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), off)
    )


class Channel:
    """What does not arrive."""

    def __init__(self, case: Case, seed: int) -> None:
        self._rng, self._loss = generator(seed, "loss"), case.loss
        self._silent = case.policy == "silent"

    def loses(self, letter: Message) -> bool:
        return (self._silent and isinstance(letter, Estimate)) or bool(self._loss and self._rng.uniform() < self._loss)


def _does(agent: Agent) -> str:
    return "" if agent.swimmer is None else agent.swimmer.does
