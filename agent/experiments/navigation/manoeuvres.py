"""Hold, goto, turn, orbit and fix: how well one robot does what it is told, and finds itself, by the truth.

A fleet file tells the robot what to do. Last come the figures of all navigation cases, from the rows of their seeds.
Each manoeuvre runs from when the robot, armed and sure of itself, first asks for a force. A tether pulls by 0.05 N rms,
forgotten after 4 s. A seed is a body and a survey of the tags; places and directions are drawn from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.projection import readable, view
from agent.capabilities.swim.tag_fix import Map, TagFix, priors, tag_fix
from agent.core.attitude import Attitude
from agent.core.config import Behaviour, Fleet, Goto, Look, Orbit, Pose, Turn
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, at_lens_position, gimbal_deg, servos_us
from agent.core.ranging.focus import lens_position
from agent.experiments.ball_measurements import PosedRobot, level_of, rotation_of
from agent.experiments.experiment import DEFAULT_SENSOR, NavigationCase, Row, rms, spread
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK, twin_bodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.perception.flow import REST_M
from agent.perception.tags import Found, find_tags
from hw.twin.scene import generator
from hw.twin.truth import true_tags

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
    return {
        "rms_mm": 1e3 * rms(np.hypot(*off.T)),
        "yaw_rms_deg": math.degrees(rms(turned)),
        "worst_mm": 1e3 * float(np.hypot(*off.T).max()),
        "path": path,
    }


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
    return {"s": settled_s(path[:, 0], off, THERE_M), "overshoot_mm": 1e3 * max(float(beyond.max()), 0.0), "path": path}


def turn(seed: int) -> Row:
    """A quarter turn on the spot, to either side. s: until it is within 3 degrees for good."""
    rng = generator(seed, "turn")
    x, y = MIDDLE_M[0] + float(rng.uniform(-0.7, 0.7)), MIDDLE_M[1] + float(rng.uniform(-0.3, 0.3))
    before_deg, quarter_deg = float(rng.uniform(-180.0, 180.0)), QUARTER_DEG * float(rng.choice((-1.0, 1.0)))
    goal_deg = before_deg + quarter_deg
    told = Turn(yaw_deg=math.degrees(wrap(math.radians(goal_deg))))
    path = _swum(seed, Pose(x_m=x, y_m=y, yaw_deg=before_deg), told, basin.FLOOR_LOOK, TURN_S)
    off = np.array([abs(wrap(psi - math.radians(goal_deg))) for psi in path[:, 3]])
    return {"s": settled_s(path[:, 0], off, math.radians(THERE_DEG)), "path": path}


def orbit(seed: int, gaps: bool = False) -> Row:
    """Round a point at 0.1 m/s, facing it, the camera at the floor; with gaps, no tags for 2 s in every 4."""
    rng = generator(seed, "orbit")
    cx, cy = MIDDLE_M[0] + float(rng.uniform(-0.5, 0.5)), MIDDLE_M[1]
    first = float(rng.uniform(-math.pi, math.pi))
    x, y = cx + ORBIT_M * math.cos(first), cy + ORBIT_M * math.sin(first)
    pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(wrap(first + math.pi)))
    told = Orbit(x_m=cx, y_m=cy, radius_m=ORBIT_M, speed_m_s=ORBIT_M_S)
    sees = _in_gaps if gaps else _always
    path = _swum(seed, pose, told, basin.FLOOR_LOOK, SETTLE_S + WATCH_S, sees)
    watched = path[path[:, 0] > SETTLE_S]
    off = off_orbit(watched, (cx, cy))
    return {"rms_mm": 1e3 * rms(off), "worst_mm": 1e3 * float(off.max()), "path": path}


def off_orbit(path: Path, centre_m: tuple[float, float]) -> NDArray[np.float64]:
    """How far from a point that goes round as it should, m, (n,); where that began is fitted: a steady lag is none."""
    east, north = path[:, 1] - centre_m[0], path[:, 2] - centre_m[1]
    ways = np.arctan2(north, east) - ORBIT_M_S / ORBIT_M * path[:, 0]
    began = math.atan2(float(np.sin(ways).mean()), float(np.cos(ways).mean()))
    there = began + ORBIT_M_S / ORBIT_M * path[:, 0]
    return np.hypot(east - ORBIT_M * np.cos(there), north - ORBIT_M * np.sin(there))


def settled_s(t_s: NDArray[np.float64], off: NDArray[np.float64], limit: float) -> float | None:
    """When `off` came to stay below the limit; None: not by the end."""
    beyond = np.flatnonzero(off > limit)
    if not len(beyond):
        return 0.0
    return None if beyond[-1] == len(off) - 1 else float(t_s[beyond[-1] + 1])


def _swum(
    seed: int,
    pose: Pose,
    what: Behaviour | None,
    look: Look,
    seconds: float,
    sees: Callable[[int], bool] | None = None,
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


def _always(now_ns: int) -> bool:
    return True


def _in_gaps(now_ns: int) -> bool:
    return (now_ns * 1e-9) % GAP_OF_S < GAP_OF_S - GAP_S


def _before_a_wall(rng: np.random.Generator) -> tuple[float, float, float]:
    """x, y and yaw of a robot that looks at one of the long walls from 0.6 to 0.9 m."""
    away_m, along_m = float(rng.uniform(0.6, 0.9)), float(rng.uniform(CLEAR_M, TANK.size_m[0] - CLEAR_M))
    aside = float(rng.uniform(-0.3, 0.3))
    if rng.random() < 0.5:
        return along_m, away_m, wrap(-0.5 * math.pi + aside)
    return along_m, TANK.size_m[1] - away_m, 0.5 * math.pi + aside


# --- fix: how well a robot finds itself by the tags of one rendered frame, at rest ---
# The tags are surveyed as a lab would survey them. A seed is a robot with a lens, servos and a calibration from its own
# bench, and a basin whose tags hang a little elsewhere than surveyed. At each place: a frame with the lens where it
# rests between sweeps, and one with it anywhere. Depth and level are measured as drifting pressure sensors measure
# them.

PLACES = 10  # of a robot; two frames at each
FIX_SETTLE_S = 0.1
FIX_CLEAR_M = 0.35  # from walls to a robot's middle
DEPTH_M = (0.2, 0.4)
TILTED_DEG = 0.5  # roll and pitch, one sigma
PAN_DEG, TILT_DEG = (-60.0, 60.0), (-50.0, 20.0)
OFF_M, OFF_DEG = 0.03, 2.0  # of the prediction that a fix begins at, one sigma


class Stand(NamedTuple):
    """A robot at a place."""

    x_m: float
    y_m: float
    yaw: float  # rad
    level: Attitude  # as measured
    gimbal_deg: tuple[float, float]  # by calibration


def fixes(seed: int, places: int = PLACES) -> list[Row]:
    """Two rows for each place. Raises CalibrationRefused."""
    fleet = basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0))}, seed)
    assert fleet.landmarks is not None
    known = Map(fleet.landmarks, markers(fleet.landmarks))
    robot = PosedRobot(fleet, "r1", DEFAULT_SENSOR)
    calibration = robot.calibrate()
    robot.submerge("tap", (), true_tags(fleet.landmarks, seed))
    rng = generator(seed, "fixes")
    rest = round(lens_position(calibration.focus, REST_M))
    rows = []
    for stand in stands(robot, fleet, calibration, places, rng):
        for wanted in (rest, int(rng.integers(calibration.focus.lowest, calibration.focus.highest + 1))):
            lens = robot.set_focus(wanted)
            found = find_tags(robot.read(settle_s=FIX_SETTLE_S).image, at_lens_position(calibration.camera, lens))
            row = judged(found, lens, stand, fleet, calibration, known, rng)
            rows.append({"seed": seed, "at_rest": wanted == rest, **row})
    return rows


def stands(
    robot: PosedRobot, fleet: Fleet, calibration: Calibration, places: int, rng: np.random.Generator
) -> Iterator[Stand]:
    """Put it anywhere, looking anywhere, again and again."""
    camera, body = calibration.camera, fleet.body
    for _ in range(places):
        x, y = (float(rng.uniform(FIX_CLEAR_M, side_m - FIX_CLEAR_M)) for side_m in TANK.size_m[:2])
        depth_m, yaw_deg = float(rng.uniform(*DEPTH_M)), float(rng.uniform(-180.0, 180.0))
        roll_deg, pitch_deg = (float(deg) for deg in rng.normal(0.0, TILTED_DEG, 2))
        us = servos_us(camera, body, float(rng.uniform(*PAN_DEG)), float(rng.uniform(*TILT_DEG)))
        robot.stand((x, y, TANK.surface_m - depth_m), rotation_of(roll_deg, pitch_deg, yaw_deg), us)
        level = Attitude(*level_of(depth_m, roll_deg, pitch_deg, rng))
        yield Stand(x, y, math.radians(yaw_deg), level, gimbal_deg(camera, body, us))


def judged(
    found: list[Found],
    lens: int,
    stand: Stand,
    fleet: Fleet,
    calibration: Calibration,
    known: Map,
    rng: np.random.Generator,
) -> Row:
    """What the tags of a frame say, and how wrong that is; "refused": why they say nothing."""
    off = rng.normal(0.0, (OFF_M, OFF_M, math.radians(OFF_DEG)))
    start = stand.x_m + float(off[0]), stand.y_m + float(off[1]), wrap(stand.yaw + float(off[2]))
    of = view(calibration.camera, fleet.body, TANK.surface_m, lens)
    before = priors(stand.level, stand.gimbal_deg, 0.0, turning=False)
    tags = readable([one.seen for one in found], known.landmarks.size_m, of, calibration.focus, lens)
    fix = tag_fix(of, before, known, tags, start)
    blurs = [one.blur_px for one in found if one.blur_px is not None]
    ways = [_distance_m(known.markers[one.seen.id].middle_m, stand) for one in found]
    row: Row = {
        "tags": len(found),
        "blur_px": float(np.median(blurs)) if blurs else None,
        "distance_m": float(np.mean(ways)) if ways else None,
    }
    if not isinstance(fix, TagFix):
        return {**row, "refused": fix.reason}
    e = np.array([fix.theta[0] - stand.x_m, fix.theta[1] - stand.y_m, wrap(fix.theta[2] - stand.yaw)])
    xx, xy, xp, yy, yp, pp = fix.covariance
    covariance = np.array([[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]])
    return {
        **row,
        "error_mm": 1e3 * float(np.hypot(e[0], e[1])),
        "error_deg": math.degrees(abs(float(e[2]))),
        "nees": float(e @ np.linalg.solve(covariance, e)) / 3.0,
        "sigma_mm": 1e3 * math.sqrt(xx + yy),
    }


def _distance_m(tag_m: Vector, stand: Stand) -> float:
    return math.dist(tag_m, (stand.x_m, stand.y_m, TANK.surface_m - stand.level.depth_m))


# --- summaries: from the rows of all seeds to the figures of result.json ---
# None: no number, for no robot ever got there.

AIDED = ("aid", "aid with gyro")
SHARP_PX = 6.0  # diameter of the blur up to which fixes have to be good

Draws = Mapping[str, list[Row]]


def summarise_fix(draws: Draws) -> Row:
    """Of frames with the lens at rest, and of others that are measurably blurred by no more than SHARP_PX.

    Frames without tags, or whose tags gave no fix, are left out: the table counts them.
    """
    good = [row for row in draws["fix"] if "nees" in row and (row["at_rest"] or _sharp(row))]
    if not good:
        return {"p90_mm": None, "p90_deg": None, "nees": None}
    return {
        "p90_mm": float(np.percentile([row["error_mm"] for row in good], 90)),
        "p90_deg": float(np.percentile([row["error_deg"] for row in good], 90)),
        "nees": float(np.mean([row["nees"] for row in good])),
    }


def summarise_hold(draws: Draws) -> Row:
    return {key: pooled(draws["hold"], key) for key in ("rms_mm", "yaw_rms_deg")}


def summarise_goto(draws: Draws) -> Row:
    rows = draws["goto"]
    return {"s": p95([row["s"] for row in rows]), "overshoot_mm": p95([row["overshoot_mm"] for row in rows])}


def summarise_turn(draws: Draws) -> Row:
    return {"s": p95([row["s"] for row in draws["turn"]])}


def summarise_orbit(draws: Draws) -> Row:
    return {"rms_mm": pooled(draws["orbit"], "rms_mm"), "gap_rms_mm": pooled(draws["orbit with gaps"], "rms_mm")}


def summarise_separation(draws: Draws) -> Row:
    return {"least_m": min(row["least_m"] for row in draws["separation"])}


def summarise_target(draws: Draws) -> Row:
    """Root mean square over seeds and robots, to that of the bound; a robot that knows nothing leaves no number."""
    rows = draws["target"]
    if any(row["told"] < row["robots"] for row in rows):
        return {"ratio_to_bound": None, "nees": None}
    errors_mm, nees = ([value for row in rows for value in row[key]] for key in ("error_mm", "nees"))
    return {"ratio_to_bound": rms(errors_mm) / rms([row["bound_mm"] for row in rows]), "nees": float(np.mean(nees))}


def summarise_aid(draws: Draws) -> Row:
    """Of the robots whose tags are rare, all together, with a gyro and without."""
    rows = [row for name in AIDED for row in draws[name]]
    nees = [value for row in rows for value in row["nees"]]
    found = {key: rms([off for row in rows for off in row[key][1:]]) for key in ("own_mm", "aided_mm")}
    return {**found, "nees": float(np.mean(nees)) if nees else None}


def summarise_follow(draws: Draws) -> Row:
    """Of robots that are told where the target is."""
    rows = draws["follow"]
    return {
        "rms_mm": pooled(rows, "off_mm"),
        "gap_deg": pooled(rows, "gap_deg"),
        "least_m": min(row["least_m"] for row in rows),
    }


def summarise_search(draws: Draws) -> Row:
    rows = draws["search"]
    return {
        "s": p95([row["s"] for row in rows]),
        "alone_s": p95([row["s"] for row in draws["search alone"]]),
        "least_m": min(row["least_m"] for row in rows),
    }


def _sharp(row: Row) -> bool:
    return row["blur_px"] is not None and row["blur_px"] <= SHARP_PX


def pooled(rows: Sequence[Row], key: str) -> float | None:
    """Root mean square of the seeds' own."""
    value = rms([row[key] for row in rows])
    return value if math.isfinite(value) else None


def p95(values: Sequence[float | None]) -> float | None:
    """The smallest that at least 95 % of the seeds keep."""
    return spread(values)["p95"]


SUMMARIES: dict[NavigationCase, Callable[[Draws], Row]] = {
    "fix": summarise_fix,
    "hold": summarise_hold,
    "goto": summarise_goto,
    "turn": summarise_turn,
    "orbit": summarise_orbit,
    "separation": summarise_separation,
    "target": summarise_target,
    "aid": summarise_aid,
    "follow": summarise_follow,
    "search": summarise_search,
}
