"""Three robots follow a wandering target of which they are told where it is; three or one search for a ball at rest.

`follow`: how well they keep their distance to the target, their sides of it, and apart. How robots follow a target that
they see themselves is an experiment of its own (agent.experiments.following). `search`: how soon the ball is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np

from agent.capabilities.swim.barrier import RINGS_M
from agent.core.config import Follow, Look, Pose, Search
from agent.core.estimation.interface import EstimateCache, Posterior, Prior, Update, Word
from agent.core.linear_algebra import wrap
from agent.core.messages import Estimate, Vector
from agent.core.trust import CachedMessage
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value, rms
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
AHEAD = Look(tilt_deg=-10.0)


def follow(seed: int, watch_s: float = WATCH_S) -> Row:
    """The target swims at 0.1 m/s in one seed and 0.2 in the next.

    off_mm: rms of the distance less the standoff; gap_deg: rms of the angle between neighbours on the circle less an
    even one; least_m: between any two robots.
    """
    rng, speed_m_s = generator(seed, "follow"), SPEEDS_M_S[seed % 2]
    near = float(rng.uniform(-math.pi, math.pi)) > 0.0  # all on one side, half a metre apart
    poses = [
        Pose(x_m=0.6 + 0.55 * k, y_m=0.45, yaw_deg=90.0) if near else Pose(x_m=2.4 - 0.55 * k, y_m=1.55, yaw_deg=-90.0)
        for k in range(ROBOTS)
    ]
    fleet = basin.linked(poses, seed, AHEAD, [Follow(target="ball", standoff_m=STANDOFF_M)] * ROBOTS)
    wanderer = Wanderer(rng, speed_m_s, FIND_S + SETTLE_S + watch_s)
    arms, least_m = [], math.inf
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, wanderer.at)
        for agent in swimmers.agents.values():
            agent.targets["ball"].estimator = ToldEstimator(wanderer, lambda: bodies.now_ns, seed)
        for _ in swimmers.each_step(FIND_S + SETTLE_S):
            pass
        for _ in swimmers.each_step(watch_s):
            x, y, _ = wanderer.at(bodies.now_ns)
            arms.append([(px - x, py - y) for px, py, _ in map(swimmers.place, fleet.robot)])
            least_m = min(least_m, swimmers.least_apart_m())
    return {**kept(np.array(arms)), "least_m": least_m}


def kept(arms: np.ndarray) -> Row:
    """Of the distance and of the angles. arms: from the target to each robot, m, (steps, robots, 2)."""
    distance = np.linalg.norm(arms, axis=2)
    ways = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    gaps = np.diff(np.concatenate([ways, ways[:, :1] + 2.0 * math.pi], axis=1), axis=1)
    return {
        "off_mm": 1e3 * float(np.sqrt(np.mean(np.square(distance - STANDOFF_M)))),
        "gap_deg": math.degrees(float(np.sqrt(np.mean(np.square(gaps - EVEN_RAD))))),
    }


# --- search: robots that do not know where the ball lies look for it ---
# Three robots divide the basin, or one searches alone. The ball lies where none of the three sees it from where it
# starts, looking ahead.

SEARCH_FIND_S, SEARCH_S = 12.0, 180.0
TELLS_S = 5.0  # after the first has measured the ball: until all have heard of it
APART_M, CLEAR_M, BALL_M = 0.6, 0.35, 0.25  # of starts from each other and from walls; of the ball from walls
BLIND_DEG, FAR_M = 40.0, 1.7  # a start sees within so much of straight ahead, and so far


def search(seed: int, robots: int = ROBOTS, search_s: float = SEARCH_S) -> Row:
    """s: from when the first robot swims until any has measured the ball, None if that does not happen; least_m:
    between any two, None of one; told: how many know it 5 s later."""
    poses, ball_m = starts(seed)
    fleet = basin.linked(poses[:robots], seed, AHEAD, [Search(target="ball")] * robots)
    swimmers = Swimmers(fleet, PlanarBodies(fleet), ball_m)
    for _ in swimmers.each_step(SEARCH_FIND_S):
        if any(map(swimmers.swims, fleet.robot)):
            break
    found_s, least_m, told = None, math.inf, 0
    for now_s in swimmers.each_step(search_s + TELLS_S):
        least_m = min(least_m, swimmers.least_apart_m())
        told = sum(a.measuring.current.estimator.posterior is not None for a in swimmers.agents.values())
        if found_s is None and told:
            found_s = now_s
        if now_s >= (search_s if found_s is None else found_s + TELLS_S):
            break
    return {"s": found_s, "least_m": least_m if robots > 1 else None, "told": told, "robots": robots}


def starts(seed: int) -> tuple[list[Pose], Vector]:
    """Poses of three, and a place of the ball that none sees ahead of it."""
    rng = generator(seed, "search")
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        places = rng.uniform(low, high, (ROBOTS, 2))
        yaws = rng.uniform(-math.pi, math.pi, ROBOTS)
        ball = rng.uniform(BALL_M, np.array(TANK.size_m[:2]) - BALL_M)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(ROBOTS, 1)]
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


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    watch_s: float = WATCH_S  # how long robots that follow are watched
    search_s: float = SEARCH_S  # at most


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a firmware hangs."""
    if case == "follow":
        return [follow(seed, settings.watch_s)]
    return [search(seed, ROBOTS if case == "search" else 1, settings.search_s)]


def summary(rows: Rows) -> dict[str, Value]:
    """Root mean squares are those of all seeds' own."""
    found: dict[str, Value] = {}
    if "follow" in rows:
        found["follow_off_mm"] = rms([row["off_mm"] for row in rows["follow"]])
        found["follow_gap_deg"] = rms([row["gap_deg"] for row in rows["follow"]])
    if "search" in rows:
        found["search_told"] = Share(
            sum(row["told"] for row in rows["search"]), sum(row["robots"] for row in rows["search"])
        )
    for case in {"search", "search-alone"} & set(rows):
        found[f"{case}_s"] = Quantile([row["s"] for row in rows[case]], 95.0)
    for case in {"follow", "search"} & set(rows):
        least_m = [row["least_m"] for row in rows[case]]
        found[f"{case}_least_m"] = min(least_m)
        found[f"{case}_keep"] = Share(sum(apart_m >= RINGS_M for apart_m in least_m), len(least_m))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("follow", "search", "search-alone"),
    quick={"watch_s": 5.0, "search_s": 20.0},
    measured_on="twin",
    figures=(
        Figure("follow_off_mm", "three follow a target: their distance to it less 0.7 m, rms", "mm"),
        Figure("follow_gap_deg", "the angle between neighbours around it less 120 deg, rms", "deg"),
        Figure("follow_keep", "no two nearer than 0.34 m, share of dives", "%", least=95.0),
        Figure("follow_least_m", "their least distance in all dives", "m"),
        Figure("search_s", "three search a ball: until one has measured it, 95 % of seeds", "s"),
        Figure("search_told", "share of robots that know it 5 s later", "%"),
        Figure("search_keep", "no two nearer than 0.34 m, share of dives", "%", least=95.0),
        Figure("search_least_m", "their least distance in all dives", "m"),
        Figure("search-alone_s", "one searches alone: until it has measured it, 95 %", "s"),
    ),
    seeds=60,  # as many as the shares take
    explanation="""The target that is followed wanders at 0.1 or 0.2 m/s, and the robots, on the twin's bodies under the
        board's firmware, are told where it is as a track by bearings would tell them. The ball that is searched lies
        where no robot sees it at first; these robots are planar. The thruster rings of two robots touch at 0.34 m.""",
)
