"""A black box of two seconds in virtual time: frames of a red disc, telemetry, and a robot that sees its target.

Four sweeps of nine positions, with an idle frame before each.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.messages import LogLine, NeighbourState, State
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting, Telemetry
from agent.robot.fleet_reader import load_fleet
from replay.files.info import RateNotes
from replay.files.log import LogWriter
from replay.recorder import BlackBoxWriter, black_box_log
from replay.viewers.viewer_channels import SweepDepth, SweepFrame
from tests.known_lens import CAMERA, PLAIN
from tests.places import ROOT
from tests.replay.paced_clock import PacedClock
from tests.sample_messages import telemetry

START_NS = 1_767_225_600_000_000_000  # 2026-01-01
STEP_NS = 50_000_000
STEPS = 40
TANK = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
FLEET = replace(TANK, camera=replace(TANK.camera, sweep_steps=9))
CALIBRATION = Calibration(robot="r1", made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)


def write_box(folder: Path, views: bool = True, lossless: bool = False, pace: float = 1.0) -> Path:
    """Write r1.mcap into a folder; `pace`: of the dive's clock."""
    clock = PacedClock(START_NS, pace)
    log = black_box_log(
        folder, FLEET, "r1", CALIBRATION, {"kind": "black box", "robot": "r1", "incarnation": 1}, views, flat
    )
    with log:
        fill(log, clock, lossless)
    return log.path


def flat(frames: Sequence[SweepFrame], calibration: Calibration, tilt_rad: float) -> SweepDepth:
    """A wall half a metre away, in four blocks of which one has no texture."""
    range_m = np.array([[0.5, 0.5], [0.5, np.nan]])
    sharp = np.full((80, 80, 3), (20, 50, 180), np.uint8)
    return SweepDepth(frames[0].sighting.t_ns, 500, 40, *frames[0].roi[:2], range_m, sharp)


def fill(log: LogWriter, clock: PacedClock, lossless: bool = False) -> None:
    box = BlackBoxWriter(log, "r1", clock.now_ns, lossless, RateNotes(clock, clock.unix_ns))
    for step in range(STEPS):
        clock.go_on(STEP_NS * 1e-9)
        now_ns = clock.now_ns()
        sighting = seen(now_ns, step)
        part = (0, 0, 640, 480) if step % 10 == 0 else (200, 120, 240, 240)
        box.serial(True, b"\x01telemetry\x00")
        box.serial(False, b"\x02set point\x00")
        box.frame(disc(step)[part[1] : part[1] + part[3], part[0] : part[0] + part[2]], part, sighting)
        inputs = Inputs(telemetry=(reading(now_ns),), sightings=(sighting,))
        says = LogLine(robot="r1", sent_ns=now_ns, level="warning", text=f"step {step}")
        outputs = Outputs(set_point=SetPoint(depth_m=0.4), state=state(now_ns, step), log=(says,))
        box.step(step, now_ns, encode(inputs), encode(outputs))


@cache
def disc(step: int) -> np.ndarray:
    """A red disc on grey, with a grain that no two frames share."""
    image = np.full((480, 640, 3), 110, np.uint8)
    cv2.circle(image, (320, 240), 90, (50, 50, 180), -1)
    return image + np.random.default_rng(step).integers(0, 12, (480, 640, 1), dtype=np.uint8)


def seen(now_ns: int, step: int) -> Sighting:
    return Sighting(
        t_ns=now_ns - 20_000_000,
        frame=step,
        sweep=1 + step // 10 if step % 10 else 0,
        index=step % 10 or -1,
        focus=300 + step,
        target="ball",
        found=True,
        centre_px=(320.0, 240.0),
        radius_px=90.0,
        clarity=100.0 + step,
        area_px=6000.0,
        score=0.9,
    )


def reading(now_ns: int) -> Telemetry:
    return telemetry(
        now_ns,
        roll_deg=1.0,
        pitch_deg=-2.0,
        sensor_depth_m=(0.39, 0.4, 0.4, 0.41),
        pulses_us=(1500, 1501, 1502, 1503, 1504, 1505, 1506, 1507),
        servos_us=(1500, 1510, 1520, 1530),
        battery_v=14.5,
        loop_us=900,
    )


def state(now_ns: int, step: int) -> State:
    return State(
        fleet="tank",
        robot="r1",
        incarnation=1,
        seq=step,
        sent_ns=now_ns,
        target="ball",
        knows="sees",
        t=step,
        prior_m=(0.75, 0.55, 0.07),
        posterior_m=(0.76, 0.56, 0.07),
        posterior_sigma_m=0.004,
        neighbours=(NeighbourState(robot="r2", age_s=0.1, valid=True, used=True, heard=step),),
        depth_m=0.4,
        roll_deg=1.0,
        pitch_deg=-2.0,
        pan_deg=12.0,
        tilt_deg=-20.0,
    )
