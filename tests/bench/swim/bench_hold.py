"""How well a robot holds its place and orbits in the rendered basin: its true path against what was asked for, and
against what it believes.

Robots of the shipped fleet `swim`, each alone. A seed is another world: body, lens, gimbal, water, survey of the tags.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import msgspec
import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Behaviour, Look, Orbit
from agent.core.linear_algebra import wrap
from agent.core.step_io import Inputs, SetPoint
from agent.experiments.ball_measurements import Host, PosedRobot
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from agent.perception.detection.detectors import load_detectors
from agent.perception.flow import LandmarkWatch
from agent.perception.vision import Vision
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from hw.twin.board import Board, interpreter
from hw.twin.camera_device import FRAME_NS, DiveCamera, FrameClock
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.physics.body import euler_rad
from hw.twin.scene import generator, scene_of
from hw.twin.truth import true_tags
from tests.bench.swim.lockstep import START_NS, STEP_TICKS, LockstepCamera, LockstepClock, LockstepPart

FROM_S = 15.0  # of a dive, what counts of it begins


class Case(NamedTuple):
    """A robot of the fleet, what it is told, and where it looks if not as the fleet file says."""

    robot: str
    words: str
    behaviour: Orbit | None = None
    look: Look | None = None


CASES = {  # a robot that swims alone sees its target where it looks, or never
    "tags": Case("r1", "holds its place, tags in sight"),
    "no-tags": Case("r3", "holds its place, no tags in sight", look=Look(pan_deg=10.0, tilt_deg=-13.0)),
    "orbit": Case("r2", "orbits, few tags in sight", Orbit(x_m=1.6, y_m=1.05, radius_m=0.7)),
}


def swim(name: str, seed: int, seconds: float, behaviour: Behaviour | None, look: Look | None) -> np.ndarray:
    """Rows (n, 6) of each step: t s, true x, y m and yaw rad, believed x and y (NaN: none). Rendered, with the robot's
    real firmware, vision and kernel in one process."""
    fleet = load_fleet(fleet_file("swim"))
    robot = replace(fleet.robot[name], neighbours=(), behaviour=behaviour, look=look or fleet.robot[name].look)
    fleet = replace(fleet, robot={name: robot}, twin=replace(fleet.twin, seed=seed))
    scene = scene_of(fleet)
    calibration = PosedRobot(fleet, name, scene.camera).calibrate()
    lens = draw_lens(scene.camera, generator(seed, name, "lens"))
    tags = true_tags(fleet.landmarks, seed)
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, name, tags)
    painter.prepare()
    dive = Dive(fleet, [name], START_NS, scene=scene)
    clock = LockstepClock(dive)
    shutter = FrameClock(START_NS + int(generator(seed, name, "shutter").integers(FRAME_NS)))
    camera, vcm = LockstepCamera(clock, shutter), Vcm(lens, generator(seed, name, "vcm"))
    seen = (dive.history, lens, vcm, painter, fleet.body.camera_m, dive.stage, shutter, camera.now_ns)
    camera.device = DiveCamera(0, *seen, blurs=scene.motion_blur)
    watch = LandmarkWatch(calibration.camera, calibration.focus, fleet.navigation.follow_hz)
    agent, wanted, rows = Agent(fleet, name, calibration, START_NS), SetPoint(depth_m=robot.depth_m), []
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        board = Board(name, folder, dive.tare_pa[0], interpreter=interpreter())
        dive.boards = [board]
        stack.callback(board.close)
        board.start()
        host = stack.enter_context(Host(board))
        stack.enter_context(patch("agent.perception.vision.Part", LockstepPart))
        detectors = load_detectors(fleet, calibration.camera)
        eyes = Vision(lambda: camera, fleet, calibration.camera, detectors, clock, name, landmarks=watch)
        eyes.start()  # its thread ends with the process: it sleeps on a clock that stands
        clock.begin()
        while dive.now_ns - START_NS < seconds * 1e9:
            clock.run_who_is_due()
            if dive.ticks % STEP_TICKS == 0:
                said, found, (seen_tags, flow) = tuple(host.heard), tuple(eyes.drain()), watch.drain()
                host.heard.clear()
                inputs = Inputs(telemetry=said, sightings=found, landmarks=seen_tags or UNSET, flow=flow or UNSET)
                outputs = agent.step(inputs, dive.now_ns)
                wanted = outputs.set_point
                if outputs.sweep is not None:
                    eyes.plan(outputs.sweep)
                if outputs.lens is not UNSET:
                    eyes.rest(outputs.lens)
                state, here = dive.states[0], swimmer_of(agent.capabilities).localizer.at(dive.now_ns)
                true = *state["position_m"][:2], euler_rad(state["quaternion"])[2]
                believed = (np.nan, np.nan) if here is None else here.pose[:2]
                rows.append([(dive.now_ns - START_NS) * 1e-9, *true, *believed])
            host.exchange(wanted, dive)
            run_in_lock_step(dive, 1)
    return np.array(rows, float)


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seconds: float = 32.0


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Root mean squares. A robot that does not know where it is has no number."""
    name, _, behaviour, look = CASES[case]
    way = swim(name, seed, settings.seconds, behaviour, look)
    way = way[way[:, 0] > FROM_S]
    off_m, off_rad = _off(way, name, behaviour)
    own_m = np.hypot(*(way[:, 4:6] - way[:, 1:3]).T)
    off = {"off_mm": 1e3 * off_m, "yaw_deg": np.degrees(off_rad), "own_mm": 1e3 * own_m}
    return [{key: rms(values.tolist()) for key, values in off.items()}]


def _off(way: np.ndarray, name: str, behaviour: Orbit | None) -> tuple[np.ndarray, np.ndarray]:
    """How far it truly is from where it shall be: from its pose, or from its circle; and from its yaw."""
    pose = load_fleet(fleet_file("swim")).robot[name].pose
    wrapped = np.vectorize(wrap)
    if behaviour is None:
        return np.hypot(way[:, 1] - pose.x_m, way[:, 2] - pose.y_m), wrapped(way[:, 3] - math.radians(pose.yaw_deg))
    x, y = behaviour.x_m - way[:, 1], behaviour.y_m - way[:, 2]
    return np.hypot(x, y) - behaviour.radius_m, wrapped(np.arctan2(y, x) - way[:, 3])


KEYS = {"off_mm": "off, rms", "yaw_deg": "yaw off, rms", "own_mm": "its own estimate of its place off, rms"}


def summary(rows: Rows) -> dict[str, Value]:
    """Of all seeds."""
    found: dict[str, Value] = {}
    for case, of in rows.items():
        for key in KEYS:
            values = [row[key] for row in of]
            found[f"{case}_{key}"] = None if None in values else rms(values)
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(CASES),
    quick={"seconds": 17.0},
    seeds=10,
    measured_on="twin",
    figures=tuple(
        Figure(f"{case}_{key}", f"{of.words}: {words}", key.rpartition("_")[2])
        for case, of in CASES.items()
        for key, words in KEYS.items()
    ),
    explanation="""One robot of the fleet `swim` at a time swims in its rendered basin, under its own firmware, vision
        and kernel; all wait for the twin's clock. Without tags it goes by points of floor and walls that it follows
        from frame to frame.""",
)
