"""Hold, goto, turn and orbit: how well one robot does what it is told, by the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Behaviour, Goto, Look, Orbit, Pose, Turn
from agent.core.linear_algebra import wrap
from agent.experiments.claim import Claim, Figure, NoSettings, Quantile, Row, Rows, Value, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK, twin_bodies
from agent.experiments.navigation.swimmers import Swimmers
from hw.twin.scene import generator

Path = NDArray[np.float64]  # (n, 4): t, x, y, yaw

FIND_S = 12.0  # from boot until it swims: 3 s of neutral pulses, then arming
SETTLE_S, WATCH_S = 5.0, 20.0
WAY_M, THERE_M, GOTO_S = 0.5, 0.02, 10.0
QUARTER_DEG, THERE_DEG, TURN_S = 90.0, 3.0, 6.0
ORBIT_M, ORBIT_M_S = 0.5, 0.1
GAP_S, GAP_OF_S = 2.0, 4.0  # of every so many seconds the last ones show no tags
CLEAR_M = 0.45  # from walls: where a robot may be told to swim
WALL_LOOK = Look(tilt_deg=8.0)  # at the upper row of tags
MIDDLE_M = (0.5 * TANK.size_m[0], 0.5 * TANK.size_m[1])


def hold(seed: int) -> Row:
    """Before a wall, the camera at its tags. Errors from where it found itself: rms of place (mm) and yaw (deg)."""
    rng = generator(seed, "hold")
    x, y, yaw = _before_a_wall(rng)
    path = _swum(seed, Pose(x_m=x, y_m=y, yaw_deg=math.degrees(yaw)), None, WALL_LOOK, SETTLE_S + WATCH_S)
    watched = path[path[:, 0] > SETTLE_S]
    off = watched[:, 1:3] - (x, y)
    turned = np.array([wrap(psi - yaw) for psi in watched[:, 3]])
    return {"rms_mm": rms(1e3 * np.hypot(*off.T)), "yaw_rms_deg": rms(np.degrees(turned))}


def goto(seed: int) -> Row:
    """Half a metre in any direction, the way it looks being the same. s: until it is within 20 mm for good."""
    rng = generator(seed, "goto")
    while True:
        x, y = (float(rng.uniform(CLEAR_M, side_m - CLEAR_M)) for side_m in TANK.size_m[:2])
        way = float(rng.uniform(-math.pi, math.pi))
        gx, gy = x + WAY_M * math.cos(way), y + WAY_M * math.sin(way)
        if CLEAR_M < gx < TANK.size_m[0] - CLEAR_M and CLEAR_M < gy < TANK.size_m[1] - CLEAR_M:
            break
    pose = Pose(x_m=x, y_m=y, yaw_deg=float(rng.uniform(-180.0, 180.0)))
    path = _swum(seed, pose, Goto(x_m=gx, y_m=gy, yaw_deg=pose.yaw_deg), basin.FLOOR_LOOK, GOTO_S)
    off = np.hypot(path[:, 1] - gx, path[:, 2] - gy)
    beyond = (path[:, 1] - gx) * math.cos(way) + (path[:, 2] - gy) * math.sin(way)
    return {"s": settled_s(path[:, 0], off, THERE_M), "overshoot_mm": 1e3 * max(float(beyond.max()), 0.0)}


def turn(seed: int) -> Row:
    """A quarter turn on the spot, to either side. s: until it is within 3 degrees for good."""
    rng = generator(seed, "turn")
    x, y = MIDDLE_M[0] + float(rng.uniform(-0.7, 0.7)), MIDDLE_M[1] + float(rng.uniform(-0.3, 0.3))
    before_deg, quarter_deg = float(rng.uniform(-180.0, 180.0)), QUARTER_DEG * float(rng.choice((-1.0, 1.0)))
    goal_deg = before_deg + quarter_deg
    told = Turn(yaw_deg=math.degrees(wrap(math.radians(goal_deg))))
    path = _swum(seed, Pose(x_m=x, y_m=y, yaw_deg=before_deg), told, basin.FLOOR_LOOK, TURN_S)
    off = np.array([abs(wrap(psi - math.radians(goal_deg))) for psi in path[:, 3]])
    return {"s": settled_s(path[:, 0], off, math.radians(THERE_DEG))}


def orbit(seed: int, gaps: bool = False) -> Row:
    """Round a point at 0.1 m/s, facing it, the camera at the floor; with gaps, no tags for 2 s in every 4."""
    rng = generator(seed, "orbit")
    cx, cy = MIDDLE_M[0] + float(rng.uniform(-0.5, 0.5)), MIDDLE_M[1]
    first = float(rng.uniform(-math.pi, math.pi))
    x, y = cx + ORBIT_M * math.cos(first), cy + ORBIT_M * math.sin(first)
    pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(wrap(first + math.pi)))
    told = Orbit(x_m=cx, y_m=cy, radius_m=ORBIT_M, speed_m_s=ORBIT_M_S)
    path = _swum(seed, pose, told, basin.FLOOR_LOOK, SETTLE_S + WATCH_S, _in_gaps if gaps else None)
    watched = path[path[:, 0] > SETTLE_S]
    return {"rms_mm": rms((1e3 * off_circle(watched, (cx, cy))).tolist()), "swum": gone_round(watched, (cx, cy))}


def off_circle(path: Path, centre_m: tuple[float, float]) -> NDArray[np.float64]:
    """How far from its circle, m, (n,). An orbit waits for a robot that is unsure of its place: when it is where on the
    circle is another number."""
    return np.asarray(np.abs(np.hypot(path[:, 1] - centre_m[0], path[:, 2] - centre_m[1]) - ORBIT_M))


def gone_round(path: Path, centre_m: tuple[float, float]) -> float:
    """What it swam, from second to second and either way round, of what its speed makes; a share."""
    if not np.isfinite(path).all():
        return 0.0
    seconds = path[np.searchsorted(path[:, 0], np.arange(path[0, 0], path[-1, 0], 1.0))]
    ways = np.unwrap(np.arctan2(seconds[:, 2] - centre_m[1], seconds[:, 1] - centre_m[0]))
    return float(np.abs(np.diff(ways)).sum() / (ORBIT_M_S / ORBIT_M * (seconds[-1, 0] - seconds[0, 0])))


def settled_s(t_s: NDArray[np.float64], off: NDArray[np.float64], limit: float) -> float | None:
    """When `off` came to stay below the limit; None: not by the end."""
    beyond = np.flatnonzero(off > limit)
    if not len(beyond):
        return 0.0
    return None if beyond[-1] == len(off) - 1 else float(t_s[beyond[-1] + 1])


def _swum(
    seed: int, pose: Pose, what: Behaviour | None, look: Look, seconds: float, sees: Callable[[int], bool] | None = None
) -> Path:
    """The true path, from when it first asks for a force; t from then."""
    fleet = basin.fleet({"r1": basin.robot("r1", pose, what, look)}, seed)
    with twin_bodies(fleet) as bodies:
        one = Swimmers(fleet, bodies)
        if not one.until_swims("r1", FIND_S):
            return np.array([(0.0, *one.place("r1")), (seconds, math.inf, math.inf, math.nan)])
        if sees is not None:
            one.sees_tags = sees
        return one.path("r1", seconds)


def _in_gaps(now_ns: int) -> bool:
    return (now_ns * 1e-9) % GAP_OF_S < GAP_OF_S - GAP_S


def _before_a_wall(rng: np.random.Generator) -> tuple[float, float, float]:
    """x, y and yaw of a robot that looks at one of the long walls from 0.6 to 0.9 m."""
    away_m, along_m = float(rng.uniform(0.6, 0.9)), float(rng.uniform(CLEAR_M, TANK.size_m[0] - CLEAR_M))
    aside = float(rng.uniform(-0.3, 0.3))
    if rng.random() < 0.5:
        return along_m, away_m, wrap(-0.5 * math.pi + aside)
    return along_m, TANK.size_m[1] - away_m, 0.5 * math.pi + aside


# --- the claim ---

MANOEUVRES: dict[str, Callable[[int], Row]] = {
    "hold": hold,
    "goto": goto,
    "turn": turn,
    "orbit": orbit,
    "orbit-gaps": partial(orbit, gaps=True),
}


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises Failed where a firmware hangs."""
    return [MANOEUVRES[case](seed)]


def summary(rows: Rows) -> dict[str, Value]:
    """Root mean squares are those of all seeds' own; a robot that never swam or never came leaves no number."""
    found: dict[str, Value] = {}
    for case, key in (("hold", "rms_mm"), ("hold", "yaw_rms_deg"), ("orbit", "rms_mm"), ("orbit-gaps", "rms_mm")):
        if case in rows:
            values = [row[key] for row in rows[case]]
            found[f"{case}_{key}"] = None if None in values else rms(values)
    if "orbit-gaps" in rows:
        found["orbit-gaps_swum"] = 100.0 * fmean(row["swum"] for row in rows["orbit-gaps"])
    for case, key in (("goto", "s"), ("goto", "overshoot_mm"), ("turn", "s")):
        if case in rows:
            found[f"{case}_{key}"] = Quantile([row[key] for row in rows[case]], 95.0)
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(MANOEUVRES),
    measured_on="twin",
    figures=(
        Figure("hold_rms_mm", "holds its place, the tether pulls by 0.05 N rms: off, rms", "mm", most=6.0),
        Figure("hold_yaw_rms_deg", "its yaw meanwhile, rms", "deg", most=0.7),
        Figure("goto_s", "goes 0.5 m: within 20 mm for good, 95 % of seeds", "s", most=5.0),
        Figure("goto_overshoot_mm", "its overshoot, 95 %", "mm", most=30.0),
        Figure("turn_s", "turns by 90 deg: within 3 deg for good, 95 %", "s", most=3.0),
        Figure("orbit_rms_mm", "orbits at 0.1 m/s: off its circle, rms", "mm"),
        Figure("orbit-gaps_rms_mm", "the same, 2 s of every 4 s without tags", "mm", most=8.0),
        Figure("orbit-gaps_swum", "what it swims then, of the way of 0.1 m/s", "%"),
    ),
    seeds=60,  # as many as the 95 % take
    explanation="""One robot does what its fleet file tells it, from when it is armed and sure of itself. Its body is
        the twin's under the board's own firmware; its tags are drawn, not rendered. Each seed draws another body,
        survey of the tags, pull of the tether, place and direction.""",
)
