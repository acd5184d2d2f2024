"""Where a robot that swims is by the tags of one rendered frame, at rest: how far off, and whether it says so.

At each place: a frame with the lens where it rests between sweeps, and one with it anywhere. Depth and level are
measured as drifting pressure sensors measure them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.projection import readable, view
from agent.capabilities.swim.tag_fix import Map, TagFix, priors, tag_fix
from agent.core.attitude import Attitude, Zeros, zeros
from agent.core.config import Fleet, Pose
from agent.core.linear_algebra import distance2, wrap
from agent.core.ranging.camera_model import Calibration, at_lens_position, gimbal_deg, servos_us
from agent.core.ranging.focus import lens_position
from agent.experiments.ball_measurements import PosedRobot, level_of, rotation_of
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, percentile
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK
from agent.perception.flow import REST_M
from agent.perception.tags import Found, find_tags
from hw.twin.scene import generator
from hw.twin.truth import true_tags

SENSOR = "imx519_640"  # a preset of hw.twin.optics.lens

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
    zeros: Zeros  # of the sensors that measured it


def fixes(seed: int, places: int = PLACES) -> list[Row]:
    """Two rows for each place. Raises CalibrationRefused."""
    fleet = basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0))}, seed)
    assert fleet.landmarks is not None
    known = Map(fleet.landmarks, markers(fleet.landmarks))
    robot = PosedRobot(fleet, "r1", SENSOR)
    calibration = robot.calibrate()
    robot.submerge("tap", (), true_tags(fleet.landmarks, seed))
    rng = generator(seed, "fixes")
    rest = round(lens_position(calibration.swept, REST_M))
    rows = []
    for stand in stands(robot, fleet, calibration, places, rng):
        for wanted in (rest, int(rng.integers(calibration.swept.lowest, calibration.swept.highest + 1))):
            lens = robot.set_focus(wanted)
            found = find_tags(robot.read(settle_s=FIX_SETTLE_S).image, at_lens_position(calibration.camera, lens))
            row = judged(found, lens, stand, fleet, calibration, known, rng)
            rows.append({"at_rest": wanted == rest, **row})
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
        level, on_s = level_of(depth_m, roll_deg, pitch_deg, rng)
        yield Stand(x, y, math.radians(yaw_deg), level, gimbal_deg(camera, body, us), zeros(fleet.budget, on_s))


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
    before = priors(stand.level, stand.gimbal_deg, 0.0, turning=False, zeros=stand.zeros)
    tags = readable([one.seen for one in found], known.landmarks.size_m, calibration.swept, lens)
    fix = tag_fix(of, before, known, tags, start)
    blurs = [one.blur_px for one in found if one.blur_px is not None]
    row: Row = {"blur_px": float(np.median(blurs)) if blurs else None}
    if not isinstance(fix, TagFix):
        return {**row, "refused": fix.reason}
    e = fix.theta[0] - stand.x_m, fix.theta[1] - stand.y_m, wrap(fix.theta[2] - stand.yaw)
    return {
        **row,
        "error_mm": 1e3 * math.hypot(*e[:2]),
        "error_deg": math.degrees(abs(e[2])),
        "nees": distance2(fix.covariance, e) / 3.0,
    }


# --- the claim ---

SHARP_PX = 6.0  # diameter of the blur up to which fixes have to be good


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    places: int = PLACES


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    return fixes(seed, settings.places)


def summary(rows: Rows) -> dict[str, Value]:
    """Of frames with the lens at rest, and of others that are measurably blurred by no more than SHARP_PX. Frames
    without tags, or whose tags gave no fix, are left out."""
    good = [row for row in rows["all"] if "nees" in row and (row["at_rest"] or _sharp(row))]
    return {
        "p90_mm": percentile([row["error_mm"] for row in good], 90.0),
        "p90_deg": percentile([row["error_deg"] for row in good], 90.0),
        "nees": float(np.mean([row["nees"] for row in good])) if good else None,
    }


def _sharp(row: Row) -> bool:
    return row["blur_px"] is not None and row["blur_px"] <= SHARP_PX


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"places": 3},
    measured_on="twin",
    figures=(
        Figure("p90_mm", "place by one frame with tags, 90 % within", "mm", most=5.0),
        Figure("p90_deg", "its yaw, 90 % within", "deg", most=0.25),
        Figure("nees", "its error as it says: NEES/3", "", least=0.8, most=1.3),
    ),
    explanation="""A robot stands at ten drawn places of a basin and looks anywhere; its frames are rendered. Each seed
        is another lens, calibration and survey of the tags. The figures are those of frames with the lens at rest, or
        blurred by at most 6 px; NEES is the error squared in units of the stated covariance, 3 where it is honest.""",
)
