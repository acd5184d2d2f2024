"""One fleet follows one target in one world: what truly was, and what each robot saw and believed, frame by frame.

Robots find the target in their own drawn frames, as bearings; the box of a fish that shows its side or its head gives
hardly any range. Robots hide it from robots behind them, and so do weeds. One robot's camera is covered for some
seconds: it sees neither target nor tags.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.pursuit import carried_on
from agent.core.config import Body, Fleet, Follow, Look, Pose, Target
from agent.core.estimation.protocols import dynamics
from agent.core.linear_algebra import difference, distance2, wrap
from agent.core.messages import Estimate, Message, Vector
from agent.core.ranging.camera_model import CameraFit, camera_pose, look_at, pixel
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, TANK, twin_bodies
from agent.experiments.navigation.swimmers import (
    BALL_FARTHEST_M,
    FRAME_STEPS,
    BallPath,
    DrawnTarget,
    Pillar,
    Swimmers,
    frame_error_m,
    hides,
    ring,
)
from agent.robot.step import Agent
from hw.twin.camera_device import look
from hw.twin.creatures import STRIDE, Attitude, swimming
from hw.twin.dive import RobotPose
from hw.twin.scene import Creature, generator
from replay.report.creature_track import SETTLES_NS

# --- cases ---

LENGTH_M = 0.15  # of the fish

ROBOTS = 3


class Case(NamedTuple):
    """How the robots of a fleet talk."""

    loss: float = 0.0  # share of all words
    silent: bool = False  # no robot says anything of the target, each says where it is itself


# --- basin: the fleet, where it begins, and weeds that hide its target ---

STANDOFF_M = 0.7
WEEDS, WEED_M, WALL_M, APART_M = 2, 0.08, 0.5, 0.8  # how many, their radius; from walls, and from each other


def fleet_of(speed_m_s: float, seed: int) -> Fleet:
    """All of them know how fast the target swims, and how long it is."""
    fish = Target(detector="creature", length_m=LENGTH_M, speed_m_s=speed_m_s, turn_s=basin.TURN_S)
    does = [Follow(target="ball", standoff_m=STANDOFF_M, search=True)] * ROBOTS
    return basin.linked(starts(seed), seed, Look(tilt_deg=-10.0), does, fish)


def starts(seed: int) -> list[Pose]:
    """All on one side, half a metre apart."""
    near = float(generator(seed, "follow").uniform(-math.pi, math.pi)) > 0.0
    return [
        Pose(x_m=0.6 + k * 0.55, y_m=0.45, yaw_deg=90.0) if near else Pose(x_m=2.4 - k * 0.55, y_m=1.55, yaw_deg=-90.0)
        for k in range(ROBOTS)
    ]


def weeds(seed: int) -> tuple[Pillar, ...]:
    """Upright from floor to surface. What is behind one is hidden; they stop no robot."""
    rng, found = generator(seed, "weeds"), list[Pillar]()
    length_m, breadth_m, _ = TANK.size_m
    while len(found) < WEEDS:
        x, y = rng.uniform((WALL_M, WALL_M), (length_m - WALL_M, breadth_m - WALL_M)).tolist()
        if all(np.hypot(x - other.x_m, y - other.y_m) > APART_M for other in found):
            found.append(Pillar(x, y, WEED_M))
    return tuple(found)


# --- the target's way: it wanders about the basin at one speed, as a fish does ---
# Its turning is an Ornstein-Uhlenbeck process; near a wall it turns towards the middle. It does not shy away from
# robots.

TURNS_S, TURNS_RAD_S = 1.5, 1.2  # how long its turning is alike, and how fast it is (rms over a root second)
SHY_M, AWAY_RAD_S = 0.45, 1.5  # from a wall, and how fast it turns away there
NEAREST_WALL_M = 0.25  # it comes no nearer to one
BEFORE_M, BODY_M = 0.3, 0.08  # from a pillar: there it turns aside, and it comes no nearer
HEIGHT_M = 0.25  # above the floor
STEP_S = 0.05


class Wanderer:
    """Its path, drawn once; `at` is where it is, x, y and z (m), and holds still outside the time that was drawn."""

    def __init__(
        self, rng: np.random.Generator, speed_m_s: float, seconds: float, pillars: Sequence[Pillar] = ()
    ) -> None:
        x, y = (float(rng.uniform(0.8, side - 0.8)) for side in TANK.size_m[:2])
        heading, rate, rows = float(rng.uniform(-math.pi, math.pi)), 0.0, []
        keeps = math.exp(-STEP_S / TURNS_S)
        for _ in range(round(seconds / STEP_S) + 1):
            rows.append((x, y, HEIGHT_M))
            rate = keeps * rate + TURNS_RAD_S * math.sqrt(STEP_S) * float(rng.normal())
            inwards = wrap(math.atan2(0.5 * TANK.size_m[1] - y, 0.5 * TANK.size_m[0] - x) - heading)
            near = min(x, y, TANK.size_m[0] - x, TANK.size_m[1] - y) < SHY_M
            turn = math.copysign(AWAY_RAD_S, inwards) if near and abs(inwards) > 0.5 else rate
            heading += STEP_S * (turn + sum(_aside(pillar, x, y, heading) for pillar in pillars))
            x, y = (
                min(max(at + STEP_S * speed_m_s * way, NEAREST_WALL_M), side - NEAREST_WALL_M)
                for at, way, side in zip((x, y), (math.cos(heading), math.sin(heading)), TANK.size_m, strict=False)
            )
            for pillar in pillars:
                x, y = _outside(pillar, x, y)
        self._rows: list[Vector] = rows

    def at(self, now_ns: int) -> Vector:
        k = round((now_ns - START_NS) * 1e-9 / STEP_S)
        return self._rows[min(max(k, 0), len(self._rows) - 1)]


def _aside(pillar: Pillar, x: float, y: float, heading: float) -> float:
    """How fast it turns away from one that it swims at, rad/s."""
    east, north = pillar.x_m - x, pillar.y_m - y
    off = wrap(math.atan2(north, east) - heading)
    near = math.hypot(east, north) < pillar.radius_m + BEFORE_M and abs(off) < 1.2
    return math.copysign(2.0 * AWAY_RAD_S, -off) if near else 0.0


def _outside(pillar: Pillar, x: float, y: float) -> tuple[float, float]:
    """Beside it, where that place is inside."""
    east, north = x - pillar.x_m, y - pillar.y_m
    off, least = math.hypot(east, north), pillar.radius_m + BODY_M
    if off >= least or off == 0.0:
        return x, y
    return pillar.x_m + east * least / off, pillar.y_m + north * least / off


# --- drawn fish ---
# What one robot's camera would tell of a fish that swims: the box around what it shows of itself, never rendered.
# The body is the twin's, bent as it swims: seen from the side its box is three times as wide as head-on. So how far
# it is by its size is wrong by half, and for as long as it keeps its side.

SHOWN = 1.0 / 3.0  # of its box in the picture, or it is not found (docs/experiments.md, Detection)
NEAREST_M = 0.1  # of its middle from the lens; nearer, it is a blur of colour
EDGE_PX = 2.0  # of its box: the detector's pixels are four of the picture's
AROUND_NS = 50_000_000  # its heading is the way that it swims in so long before and after

Array = NDArray[np.float64]


class DrawnFish(DrawnTarget):
    """A fish; path: of its middle. No robot sweeps a target that swims."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit, path: BallPath) -> None:
        super().__init__(fleet, path)
        self._rng, self._seed = generator(fleet.twin.seed, name, "drawn fish"), fleet.twin.seed
        self._way, self._camera, self._camera_m = path, camera, fleet.body.camera_m

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        seen = self._box(pose, t_ns, at_m)
        if seen is None:
            return None
        left, top, right, bottom = seen
        return {
            "centre_px": (0.5 * (left + right), 0.5 * (top + bottom)),
            "size_px": (right - left, bottom - top),
            "area_px": (right - left) * (bottom - top),
            "score": 1.0,
        }

    def _box(self, pose: RobotPose, t_ns: int, fish_m: Vector) -> tuple[float, float, float, float] | None:
        """Left, top, right and bottom, px, of what the picture shows; None: too little."""
        eye, _ = look(pose, self._camera_m)
        rotation = np.asarray(eye.rotation)
        x, y, z = ((np.array(fish_m) - np.asarray(eye.position_m)) @ rotation).tolist()
        if not z - self._camera.ahead_m > NEAREST_M or math.hypot(x, y, z) > BALL_FARTHEST_M:
            return None
        low, high = self._extent(t_ns, fish_m, np.asarray(eye.position_m), rotation)
        size = np.array([self._camera.width_px, self._camera.height_px], float)
        corners = [pixel(self._camera, (*slopes.tolist(), 1.0 + self._camera.ahead_m)) for slopes in (low, high)]
        edges = np.array(corners, float)
        whole = float(np.prod(edges[1] - edges[0]))
        edges = np.clip(edges + self._rng.normal(0.0, EDGE_PX, (2, 2)), 0.0, size)
        if float(np.prod(edges[1] - edges[0])) < SHOWN * whole or (edges[1] <= edges[0]).any():
            return None
        (left, top), (right, bottom) = edges.tolist()
        return left, top, right, bottom

    def _extent(self, t_ns: int, fish_m: Vector, eye_m: Array, rotation: Array) -> tuple[Array, Array]:
        """Slopes (right, down) of the least and the most that any part of it comes to."""
        then, soon = np.array(self._way(t_ns - AROUND_NS)), np.array(self._way(t_ns + AROUND_NS))
        way_m = soon - then
        speed_m_s = float(np.linalg.norm(way_m)) / (2e-9 * AROUND_NS)
        beat = 2.0 * math.pi * speed_m_s / (STRIDE * LENGTH_M) * t_ns * 1e-9
        attitude = Attitude(*fish_m, math.atan2(way_m[1], way_m[0]), 0.0, beat, 1.0)
        body = swimming(Creature(name="fish", length_m=LENGTH_M), attitude, self._seed)
        low, high = np.full(2, math.inf), np.full(2, -math.inf)
        for part in body.parts:
            x, y, z = (np.asarray(part.position_m) - eye_m) @ rotation
            depth_m = max(z - self._camera.ahead_m, 0.5 * NEAREST_M)
            axes = (np.asarray(part.rotation) * np.asarray(part.radii_m)).T @ rotation
            half = np.linalg.norm(axes[:, :2], axis=0)
            low = np.minimum(low, (np.array([x, y]) - half) / depth_m)
            high = np.maximum(high, (np.array([x, y]) + half) / depth_m)
        return low, high


# --- dive ---

FIND_S, WATCH_S = 20.0, 30.0
COVERED_S = 10.0, 15.0  # of WATCH_S
FRESH_NS = 250_000_000  # a track of so long ago still says how well it is known
STEPS_S = 20.0


class Draw(NamedTuple):
    """n frames of k robots, from the beginning."""

    t_s: Array  # (n,)
    sees: NDArray[np.bool_]  # (n, k): whether each robot's frame shows it
    in_sight: NDArray[np.bool_]  # (n, k): whether nothing is in between
    in_reach: NDArray[np.bool_]  # (n, k): whether the camera can be turned to it, and it is not too near for a picture
    covered: NDArray[np.bool_]  # (n, k)
    landmarks: NDArray[np.bool_]  # (n, k): its camera is turned to landmarks
    error_m: Array  # (n, k): of where each robot believes it to be now; nan: it does not know
    nees: Array  # (n, k): squared error by its own covariance, 3 where that is right; nan: no track of that time
    first: int  # frame in which a robot that swims sees it; n: none ever does
    watched: int  # first frame that counts
    least_m: float  # of any two robots


def dive(case: Case, speed_m_s: float, seed: int, watch_s: float = WATCH_S) -> Draw:
    """FIND_S and watch_s, at 10 frames a second; what counts begins FIND_S after the start at the latest. Raises Failed
    where a firmware hangs."""
    fleet, pillars = fleet_of(speed_m_s, seed), weeds(seed)
    names, rng = list(fleet.robot), generator(seed, "follow")
    rng.uniform()  # drawn for where they begin
    wanderer = Wanderer(rng, speed_m_s, FIND_S + watch_s, pillars)
    blind = names[seed % ROBOTS]
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies)
        swimmers.lost = Channel(case, seed).loses
        for name, eyes in swimmers.eyes.items():
            eyes.hide, eyes.pillars = fleet.robot[name].neighbours, pillars
            eyes.ball = DrawnFish(fleet, name, bodies.camera(name), wanderer.at)
        rows, least_m = list[list[Array]](), math.inf
        for step in range(1, round((FIND_S + watch_s) * STEPS_S) + 1):
            at_s = step / STEPS_S - FIND_S
            swimmers.eyes[blind].covered = COVERED_S[0] <= at_s < COVERED_S[1]
            swimmers.step()
            if swimmers.steps % FRAME_STEPS == 0:
                rows.append(row(swimmers, fleet, wanderer.at(bodies.now_ns), pillars))
                least_m = min(least_m, swimmers.least_apart_m())
    t_s = (1 + np.arange(len(rows))) * FRAME_STEPS / STEPS_S
    cells = np.array(rows)
    sees, in_sight, in_reach, covered, landmarks, swims = np.moveaxis(cells[:, :, :6].astype(bool), 2, 0)
    error_m, nees = np.moveaxis(cells[:, :, 6:], 2, 0)
    seen = np.flatnonzero((sees & swims).any(axis=1))
    first = int(seen[0]) if len(seen) else len(t_s)
    frames_s = STEPS_S / FRAME_STEPS
    watched = min(first + round(SETTLES_NS * 1e-9 * frames_s), round(FIND_S * frames_s))
    return Draw(t_s, sees, in_sight, in_reach, covered, landmarks, error_m, nees, first, watched, least_m)


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
        does = swimmers.swimmer(name).at_landmarks, swimmers.swims(name)
        found.append(np.array([*flags, *does, *believed], float))
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
    off = difference(carried_on(believed, dynamics(fleet.target["ball"]), now_ns), target_m)
    fresh = now_ns - believed.t_ns <= FRESH_NS
    of_frame = difference(off, frame_error_m(fleet))
    return math.hypot(*off), distance2(believed.cov_m2, of_frame) if fresh else np.nan


class Channel:
    """What does not arrive."""

    def __init__(self, case: Case, seed: int) -> None:
        self._rng, self._loss = generator(seed, "loss"), case.loss
        self._silent = case.silent

    def loses(self, letter: Message) -> bool:
        return (self._silent and isinstance(letter, Estimate)) or bool(self._loss and self._rng.uniform() < self._loss)
