"""Three robots follow a wandering target of which they are told where it is; three or one search for a ball at rest.

`follow`: how well they keep their distance to the target, their sides of it, and apart. How robots follow a target that
they see themselves is an experiment of its own (agent.experiments.following). `search`: how soon the ball is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from agent.core.config import Follow, Look, Pose, Search
from agent.core.estimation.interface import EstimateCache, Posterior, Prior, Update, Word
from agent.core.linear_algebra import wrap
from agent.core.messages import Estimate, Vector
from agent.core.trust import CachedMessage
from agent.experiments.experiment import Row, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, TANK, PlanarBodies, twin_bodies
from agent.experiments.navigation.swimmers import Pillar, Swimmers
from hw.twin.scene import generator

# --- a target that wanders about the basin at one speed, as a fish does, and what a fleet would know of it ---
# Its turning is an Ornstein-Uhlenbeck process; near a wall it turns towards the middle. It does not shy away from
# robots.

TURNS_S, TURNS_RAD_S = 1.5, 1.2  # how long its turning is alike, and how fast it is (rms over a root second)
SHY_M, AWAY_RAD_S = 0.45, 1.5  # from a wall, and how fast it turns away there
WALL_M = 0.25  # it comes no nearer to one
BEFORE_M, BODY_M = 0.3, 0.08  # from a pillar: there it turns aside, and it comes no nearer
HEIGHT_M = 0.25  # above the floor
STEP_S = 0.05
NOISE_M, NOISE_M_S, NEWS_S, LATE_S = 0.015, 0.03, 0.2, 0.15  # a track by bearings of three robots in this basin


class Wanderer:
    """Its path, drawn once; `at` is where it is, x, y and z (m), and holds still outside the time that was drawn."""

    def __init__(
        self, rng: np.random.Generator, speed_m_s: float, seconds: float, pillars: Sequence[Pillar] = ()
    ) -> None:
        x, y = (float(rng.uniform(0.8, side - 0.8)) for side in TANK.size_m[:2])
        heading, rate, rows = float(rng.uniform(-math.pi, math.pi)), 0.0, []
        keeps = math.exp(-STEP_S / TURNS_S)
        for _ in range(round(seconds / STEP_S) + 1):
            rows.append((x, y, speed_m_s * math.cos(heading), speed_m_s * math.sin(heading)))
            rate = keeps * rate + TURNS_RAD_S * math.sqrt(STEP_S) * float(rng.normal())
            inwards = wrap(math.atan2(0.5 * TANK.size_m[1] - y, 0.5 * TANK.size_m[0] - x) - heading)
            near = min(x, y, TANK.size_m[0] - x, TANK.size_m[1] - y) < SHY_M
            turn = math.copysign(AWAY_RAD_S, inwards) if near and abs(inwards) > 0.5 else rate
            heading += STEP_S * (turn + sum(_aside(pillar, x, y, heading) for pillar in pillars))
            x, y = (
                min(max(at + STEP_S * speed_m_s * way, WALL_M), side - WALL_M)
                for at, way, side in zip((x, y), (math.cos(heading), math.sin(heading)), TANK.size_m, strict=False)
            )
            for pillar in pillars:
                x, y = _outside(pillar, x, y)
        self._rows = np.array(rows)

    def at(self, now_ns: int) -> Vector:
        x, y, _, _ = self._row(now_ns)
        return float(x), float(y), HEIGHT_M

    def speed(self, now_ns: int) -> Vector:
        """Its velocity, m/s."""
        _, _, vx, vy = self._row(now_ns)
        return float(vx), float(vy), 0.0

    def _row(self, now_ns: int) -> np.ndarray:
        k = round((now_ns - START_NS) * 1e-9 / STEP_S)
        row: np.ndarray = self._rows[min(max(k, 0), len(self._rows) - 1)]
        return row


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


class ToldEstimator:
    """An agreed track as bearings at frame rate would make it, in place of one by sweeps: late, noisy, the same for all
    robots."""

    def __init__(self, wanderer: Wanderer, now_ns: Callable[[], int], seed: int) -> None:
        self.t, self.valid = 0, True
        self._wanderer, self._now_ns, self._seed = wanderer, now_ns, seed

    @property
    def posterior(self) -> Posterior:
        """Where it is by what was seen LATE_S ago, carried on by its speed."""
        block = round((self._now_ns() - START_NS) * 1e-9 / NEWS_S - 0.5)
        seen_ns = START_NS + round((block * NEWS_S - LATE_S) * 1e9)
        rng = np.random.default_rng((self._seed, max(block, 0)))
        (x, y, z), (vx, vy, _) = self._wanderer.at(seen_ns), self._wanderer.speed(seen_ns)
        vx, vy = (v + float(rng.normal(0.0, NOISE_M_S)) for v in (vx, vy))
        x, y = (at + float(rng.normal(0.0, NOISE_M)) for at in (x, y))
        since_s = (self._now_ns() - seen_ns) * 1e-9
        m2 = NOISE_M * NOISE_M + (NOISE_M_S * since_s) ** 2
        return Posterior(
            (x + since_s * vx, y + since_s * vy, z), (m2, 0.0, 0.0, m2, 0.0, m2), (vx, vy, 0.0), self._now_ns()
        )

    def trust(self, keys: Mapping[str, bytes]) -> None: ...
    def adopt(self, t: int) -> None: ...

    def hear(self, letter: CachedMessage[Estimate]) -> tuple[str, ...]:
        return ()

    def by_others(self) -> None:
        return None

    def tick(self, prior: Prior | None, cache: EstimateCache, now_ns: int) -> Update:
        self.t += 1
        return Update(self.t, "told", 0.0, ())

    def say(self, to: str, now_ns: int) -> Word:
        return Word(None, None)


# --- follow ---

ROBOTS, STANDOFF_M = 3, 0.7
SPEEDS_M_S = (0.1, 0.2)
FIND_S, SETTLE_S, WATCH_S = 12.0, 8.0, 30.0
EVEN_RAD = 2.0 * math.pi / ROBOTS


def follow(seed: int, watch_s: float = WATCH_S) -> Row:
    """The target swims at 0.1 m/s in one seed and 0.2 in the next.

    off_mm: rms of the distance less the standoff; gap_deg: rms of the angle between neighbours on the circle less an
    even one; nearest_m: of any robot to the target; least_m: of two robots.
    """
    rng, speed_m_s = generator(seed, "follow"), SPEEDS_M_S[seed % 2]
    names = [f"r{i + 1}" for i in range(ROBOTS)]
    what = Follow(target="ball", standoff_m=STANDOFF_M)
    first, robots = float(rng.uniform(-math.pi, math.pi)), {}
    for k, name in enumerate(names):  # all on one side, half a metre apart
        x, y = (0.6 + 0.55 * k, 0.45) if first > 0.0 else (2.4 - 0.55 * k, 1.55)
        others = tuple(other for other in names if other != name)
        pose = Pose(x_m=x, y_m=y, yaw_deg=90.0 if first > 0.0 else -90.0)
        robots[name] = basin.robot(name, pose, what, Look(tilt_deg=-10.0), others)
    fleet = basin.fleet(robots, seed)
    wanderer = Wanderer(rng, speed_m_s, FIND_S + SETTLE_S + watch_s)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, wanderer.at)
        for agent in swimmers.agents.values():
            agent.targets["ball"].estimator = ToldEstimator(wanderer, lambda: bodies.now_ns, seed)
        for _ in range(round((FIND_S + SETTLE_S) * 20.0)):
            swimmers.step()
        rows = []
        for _ in range(round(watch_s * 20.0)):
            swimmers.step()
            x, y, _ = wanderer.at(bodies.now_ns)
            rows.append([(px - x, py - y) for px, py, _ in map(swimmers.place, names)])
    return {**figures(np.array(rows)), "speed_m_s": speed_m_s}


def figures(arms: np.ndarray) -> Row:
    """arms: from the target to each robot, m, (steps, robots, 2)."""
    distance = np.linalg.norm(arms, axis=2)
    ways = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    gaps = np.diff(np.concatenate([ways, ways[:, :1] + 2.0 * math.pi], axis=1), axis=1)
    apart = np.linalg.norm(arms[:, :, None] - arms[:, None], axis=3)[:, *np.triu_indices(arms.shape[1], 1)]
    return {
        "off_mm": 1e3 * rms((distance - STANDOFF_M).ravel()),
        "gap_deg": math.degrees(rms((gaps - EVEN_RAD).ravel())),
        "nearest_m": float(distance.min()),
        "least_m": float(apart.min()),
    }


# --- search: robots that do not know where the ball lies look for it ---
# Three robots divide the basin, or one searches alone. The ball lies where none of the three sees it from where it
# starts, looking ahead.

SEARCH_ROBOTS, SEARCH_FIND_S, SEARCH_S = 3, 12.0, 180.0
APART_M, CLEAR_M, BALL_M = 0.6, 0.35, 0.25  # of starts from each other and from walls; of the ball from walls
BLIND_DEG, FAR_M = 40.0, 1.7  # a start sees within so much of straight ahead, and so far


def search(seed: int, robots: int = SEARCH_ROBOTS, search_s: float = SEARCH_S) -> Row:
    """s: from when the first robot swims until any has measured the ball, None if that does not happen; least_m:
    between any two; told: share of robots that know it 5 s later."""
    poses, ball_m = starts(seed)
    names = [f"r{i + 1}" for i in range(robots)]
    what = Search(target="ball")
    fleet = basin.fleet(
        {
            name: basin.robot(name, pose, what, Look(tilt_deg=-10.0), tuple(other for other in names if other != name))
            for name, pose in zip(names, poses, strict=False)
        },
        seed,
    )
    bodies = PlanarBodies(fleet)
    swimmers = Swimmers(fleet, bodies, ball_m)
    for _ in range(round(SEARCH_FIND_S * 20.0)):
        swimmers.step()
        if any(swimmers.swims(name) for name in names):
            break
    began_ns, found_ns, least_m, path = bodies.now_ns, None, math.inf, []
    while bodies.now_ns - began_ns < search_s * 1e9:
        swimmers.step()
        here = np.array([swimmers.place(name)[:2] for name in names])
        path.append(here)
        apart = np.linalg.norm(here[:, None] - here[None], axis=2)[np.triu_indices(robots, 1)]
        least_m = min([least_m, *apart.tolist()])
        knows = [agent.measuring.current.estimator.posterior is not None for agent in swimmers.agents.values()]
        if found_ns is None and any(knows):
            found_ns = bodies.now_ns
        if found_ns is not None and bodies.now_ns - found_ns >= 5e9:
            break
    seconds = None if found_ns is None else (found_ns - began_ns) * 1e-9
    return {"s": seconds, "least_m": least_m, "told": float(np.mean(knows)), "path": np.array(path), "ball_m": ball_m}


def starts(seed: int) -> tuple[list[Pose], Vector]:
    """Poses of three, and a place of the ball that none sees ahead of it."""
    rng = generator(seed, "search")
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        places = rng.uniform(low, high, (SEARCH_ROBOTS, 2))
        yaws = rng.uniform(-math.pi, math.pi, SEARCH_ROBOTS)
        ball = rng.uniform(BALL_M, np.array(TANK.size_m[:2]) - BALL_M)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(SEARCH_ROBOTS, 1)]
        way = ball - places
        off = [abs(wrap(math.atan2(y, x) - yaw)) for (x, y), yaw in zip(way.tolist(), yaws.tolist(), strict=True)]
        hidden = (np.array(off) > math.radians(BLIND_DEG)) | (np.linalg.norm(way, axis=1) > FAR_M)
        if apart.min() > APART_M and hidden.all() and np.linalg.norm(way, axis=1).min() > APART_M:
            break
    poses = [
        Pose(x_m=float(x), y_m=float(y), yaw_deg=math.degrees(yaw))
        for (x, y), yaw in zip(places, yaws.tolist(), strict=True)
    ]
    return poses, (float(ball[0]), float(ball[1]), 0.07)
