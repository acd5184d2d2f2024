"""`aucamp experiment consistency`: is a measurement as far from the truth as its covariance says?

Robots of the twin, each with a lens, servos and a calibration of its own, look at a ball from many places. Every
measurement goes the whole way: frames, detection, a full sweep, its peak, then the place with its 3x3 covariance. The
normalised error squared e^T C^-1 e has the mean 3 where the covariance is honest, is larger where it boasts, smaller
where it is timid. The same frames are evaluated with both cues, with focus alone and with size alone.

What a robot does not know is drawn from the twin's own figures: the survey, what is left of it by the mooring's sway,
drift and noise of the pressure sensors, and the tolerance of the ball.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.config import Cues, Fleet, Pose, Target, load_fleet
from agent.control.sweep import Measurement, Sweep
from agent.experiments.posed import PosedRobot, rotation_of
from agent.experiments.result import make_room, write_result
from agent.launch import shipped_fleet
from agent.messages import Sighting, Vector
from agent.perception.region import around
from agent.perception.seekers import seekers
from agent.perception.vision import HOMING_S, Vision
from agent.ranging.calibration import Calibration, at_lens
from agent.ranging.camera_model import Eye, camera_pose, gimbal_deg, look_at, pixel, servos_us, to_camera
from agent.ranging.cues import distance
from agent.ranging.fix import locate
from agent.ranging.focus import Refused
from hw.camera import CameraError
from hw.twin.body import SENSOR_M, SURVEY_DEG, SURVEY_M
from hw.twin.scene import Solid
from hw.twin.sensors import CORNERS, DRIFT_M_S, NOISE_M

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]  # measurements done, in all

ROBOT, SENSOR = "r1", "imx519_640"
PLACES = 25  # measurements of one robot; the next has another lens, calibration and ball
RANGES_M = (0.25, 0.40, 0.60, 0.90, 1.20)
WATERS = ("tap", "pool", "coastal")
SWAY_M, SWAY_DEG = 0.001, 0.1  # of a moored robot
HOVER_DEG = 0.3  # roll and pitch
DIVE_S = 120.0  # sensors have drifted for up to so long
AVERAGED = 10  # samples of a pressure sensor, 0.1 s: what the control module's observer makes of them
AIM_DEG = 2.0  # a ball nearer to the middle than this is not followed
CLEAR_M = 0.10  # from a wall to the middle of a robot
CORNER_M = (0.20, 0.40)  # from two walls to the ball
HEIGHT_M = (0.09, 0.30)  # of the camera
PAN_DEG = 60.0
OUTLINE = 360  # points on the ball's outline
EXPECTED = (2.5, 3.5)  # of the mean, for three degrees of freedom


class Case(NamedTuple):
    """One place of a robot: truth, and what the robot believes."""

    distance_m: float  # camera to ball
    position_m: Vector
    roll_pitch_yaw_deg: Vector
    pose: Pose  # surveyed
    level: Vector  # depth_m, roll_deg, pitch_deg as measured


def consistency(seed: int, count: int, out: Path, progress: Progress) -> dict[str, Any]:
    """`count` measurements in worlds from `seed` on; writes result.json into `out`, returns its content.

    Raises ConfigError where `out` holds a result already.
    """
    make_room(out)
    taken: list[dict[str, Any]] = []
    progress(0, count)
    for k in range(-(-count // PLACES)):
        for one in robot_measurements(1000 * seed + k, min(PLACES, count - k * PLACES)):
            taken.append(one)
            progress(len(taken), count)
    result: dict[str, Any] = {"schema": 1, "source": "twin", "seed": seed, "count": count, "expected": EXPECTED}
    result["cases"] = [row(taken, cue, low, high) for cue in get_args(Cues) for low, high in bands()]
    result["measurements"] = taken
    write_result(out, result)
    return result


def bands() -> list[tuple[float, float]]:
    return [*itertools.pairwise(RANGES_M), (RANGES_M[0], RANGES_M[-1])]


def row(taken: list[dict[str, Any]], cue: str, low: float, high: float) -> dict[str, Any]:
    """All measurements with one cue in one band of range."""
    within = [one for one in taken if low <= one["distance_m"] <= high]
    good = [one[cue] for one in within if "nees" in one[cue]]
    nees = np.array([one["nees"] for one in good])
    figures: dict[str, Any] = {"cues": cue, "range_m": [low, high], "count": len(within), "measured": len(good)}
    if not good:
        return {**figures, "nees": None, "nees_median": None, "error_rms_mm": None, "sigma_mm": None}
    return {
        **figures,
        "nees": float(nees.mean()),
        "nees_median": float(np.median(nees)),  # 2.37 for three degrees of freedom
        "error_rms_mm": float(np.sqrt(np.mean([one["error_mm"] ** 2 for one in good]))),
        "sigma_mm": float(np.sqrt(np.mean([one["sigma_mm"] ** 2 for one in good]))),
    }


def robot_measurements(
    seed: int, count: int, sensor: str = SENSOR, distance_m: float | None = None
) -> Iterator[dict[str, Any]]:
    """One robot, calibrated on its bench, then at `count` places around its ball, at one distance or at any."""
    rng = np.random.Generator(np.random.PCG64([seed, 4]))
    fleet = load_fleet(shipped_fleet())
    fleet = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, seed=seed))
    name, target = next(iter(fleet.target.items()))
    robot = PosedRobot(fleet, ROBOT, sensor)
    known = robot.calibrate()
    assert target.radius_m is not None  # a ball
    radius_m = target.radius_m + float(rng.normal(0.0, target.radius_sigma_m))
    near = [float(rng.uniform(*CORNER_M)) for _ in range(2)]  # a corner: the rest of the tank is as far as can be
    x, y = (n if rng.random() < 0.5 else side - n for n, side in zip(near, fleet.tank.size_m[:2], strict=True))
    ball_m = (x, y, radius_m)
    robot.dive(WATERS[seed % len(WATERS)], Solid(kind="ball", position_m=ball_m, radii_m=(radius_m,) * 3))
    vision = Vision(_no_camera, fleet, known.camera, seekers(fleet, known.camera), epoch_offset_ns=0)
    for _ in range(count):
        reach_m = float(rng.uniform(RANGES_M[0], RANGES_M[-1])) if distance_m is None else distance_m
        case = draw(fleet, ball_m, reach_m, rng)
        eye = stand(robot, fleet, known, case, ball_m, rng)
        result = sweep(robot, vision, fleet, name, known)
        if isinstance(result, Refused) and result.reason.startswith("target seen"):
            arc_deg = outline_deg(known, eye, ball_m)
            if arc_deg < 360.0:
                result = Refused(f"ball larger than the frame, {arc_deg:.0f} deg of its outline show: {result.reason}")
        one: dict[str, Any] = {"seed": seed, "distance_m": case.distance_m}
        for cue in get_args(Cues):
            one[cue] = judge(result, eye, known, target, cue, ball_m, case.distance_m)
        yield one


def draw(fleet: Fleet, ball_m: Vector, distance_m: float, rng: np.random.Generator) -> Case:
    """A place in the tank from which the ball is in reach of the gimbal."""
    width, depth, _ = fleet.tank.size_m
    while True:
        height_m = float(rng.uniform(*HEIGHT_M))
        flat = math.sqrt(max(distance_m**2 - (height_m - ball_m[2]) ** 2, 0.0))
        azimuth, pan_deg = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(-PAN_DEG, PAN_DEG))
        yaw_deg = math.degrees(azimuth) + pan_deg
        roll_deg, pitch_deg = (float(a) for a in rng.normal(0.0, HOVER_DEG, 2))
        camera = np.array(ball_m) - (flat * math.cos(azimuth), flat * math.sin(azimuth), 0.0)
        camera[2] = height_m
        x, y, z = (float(v) for v in camera - rotation_of(roll_deg, pitch_deg, yaw_deg) @ fleet.body.camera_m)
        if CLEAR_M <= x <= width - CLEAR_M and CLEAR_M <= y <= depth - CLEAR_M:
            break
    off_m, off_deg = math.hypot(SURVEY_M, SWAY_M), math.hypot(SURVEY_DEG, SWAY_DEG)
    pose = Pose(
        x_m=x + float(rng.normal(0.0, off_m)),
        y_m=y + float(rng.normal(0.0, off_m)),
        yaw_deg=yaw_deg + float(rng.normal(0.0, off_deg)),
    )
    drift = rng.normal(0.0, DRIFT_M_S, 4) * rng.uniform(0.0, DIVE_S)
    error_m = drift + rng.normal(0.0, NOISE_M / math.sqrt(AVERAGED), 4)
    # z rises to the left with roll, and falls ahead with pitch: a sensor that reads too deep stands too low.
    roll_off, pitch_off = (float(math.degrees((error_m * CORNERS[:, k]).sum() / (4.0 * SENSOR_M))) for k in (1, 0))
    level = (fleet.tank.surface_m - z + float(error_m.mean()), roll_deg - roll_off, pitch_deg + pitch_off)
    return Case(distance_m, (x, y, z), (roll_deg, pitch_deg, yaw_deg), pose, level)


def stand(
    robot: PosedRobot, fleet: Fleet, known: Calibration, case: Case, ball_m: Vector, rng: np.random.Generator
) -> Eye:
    """Put the robot there, its gimbal about towards the ball; where it believes its camera to be."""
    body, surface_m = fleet.body, fleet.tank.surface_m
    pan, tilt = look_at(ball_m, case.pose, body, *case.level, surface_m)
    off = rng.uniform(-AIM_DEG, AIM_DEG, 2)
    us = servos_us(known.camera, body, pan + float(off[0]), tilt + float(off[1]))
    robot.stand(case.position_m, rotation_of(*case.roll_pitch_yaw_deg), us)
    return camera_pose(case.pose, body, *case.level, *gimbal_deg(known.camera, body, us), surface_m)


def sweep(robot: PosedRobot, vision: Vision, fleet: Fleet, target: str, known: Calibration) -> Measurement | Refused:
    """One full sweep as the vision worker does it, and what the sweep's state machine makes of it."""
    state = Sweep(known.focus, fleet.camera.sweep_steps)
    plan = state.start(0)
    middle = robot.set_focus(round(0.5 * (known.focus.lowest + known.focus.highest)))
    seen = vision.sight(robot.read(settle_s=HOMING_S), target, middle, 0, -1, None)
    robot.set_focus(plan.focus[0])
    robot.read(settle_s=HOMING_S)
    first: Sighting | None = None
    for index, position in enumerate(plan.focus[1:], start=1):
        lens = robot.set_focus(position)
        frame = robot.read(around(seen.centre_px, seen.radius_px, robot.size), settle_s=fleet.camera.settle_s)
        seen = vision.sight(frame, target, lens, plan.sweep, index, first)
        state.frame(seen)
        if first is None and seen.found:
            first = seen
    result = state.finish(10**12)
    return result if isinstance(result, Measurement) else Refused(result.reason if result else "unfinished")


def outline_deg(known: Calibration, eye: Eye, ball_m: Vector) -> float:
    """How much of the ball's outline a frame shows that is taken with the lens at its nearest position.

    The picture is largest there: a ball that is whole at the far end of a sweep may overflow at the near end.
    """
    camera = at_lens(known.camera, known.focus.highest if known.focus.b_m > 0.0 else known.focus.lowest)
    x, y, z = to_camera(eye, ball_m)
    z -= camera.ahead_m
    d = math.sqrt(x * x + y * y + z * z)
    axis, radius_m = np.array((x, y, z)) / d, ball_m[2]  # it lies on the floor
    theta = math.asin(min(radius_m / d, 1.0))
    side = np.cross(axis, (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side)
    phi = np.linspace(0.0, 2.0 * math.pi, OUTLINE, endpoint=False)[:, None]
    ring = math.cos(theta) * axis + math.sin(theta) * (np.cos(phi) * side + np.sin(phi) * np.cross(axis, side))
    seen = [pixel(camera, (a, b, c + camera.ahead_m)) for a, b, c in ring.tolist()]
    inside = [px and 0.0 <= px[0] <= camera.width_px - 1 and 0.0 <= px[1] <= camera.height_px - 1 for px in seen]
    return 360.0 * sum(map(bool, inside)) / OUTLINE


def judge(
    found: Measurement | Refused,
    eye: Eye,
    known: Calibration,
    ball: Target,
    cue: Cues,
    truth_m: Vector,
    distance_m: float,
) -> dict[str, Any]:
    """The error of one measurement in millimetres, and in standard deviations; or why there is none.

    "range": of the camera's own distance to the ball, without what the robot does not know of its place.
    """
    if isinstance(found, Refused):
        return {"refused": found.reason}
    measured = found.outline, found.focus, found.sigma, ball, cue
    fix, reach = locate(known, eye, *measured), distance(known, *measured, math.asin(eye.rotation[2][2]))
    if isinstance(fix, Refused) or isinstance(reach, Refused):
        return {"refused": fix.reason if isinstance(fix, Refused) else ""}
    e = np.array(fix.position_m) - truth_m
    xx, xy, xz, yy, yz, zz = fix.covariance_m2
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return {
        "nees": float(e @ np.linalg.solve(covariance, e)),
        "error_mm": 1e3 * float(np.linalg.norm(e)),
        "sigma_mm": 1e3 * math.sqrt(xx + yy + zz),
        "range_mm": 1e3 * (reach.distance_m + known.camera.ahead_m - distance_m),
        "range_sigma_mm": 1e3 * math.sqrt(reach.variance_m2),
        "focus_share": fix.focus_share,
    }


def _no_camera() -> NoReturn:
    raise CameraError("frames are handed over")
