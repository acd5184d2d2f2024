"""One robot of the shipped fleet `swim`, alone in its basin: rendered, with its real firmware, vision and kernel, all
in one process and on the dive's own clock, which waits for each of them. Nobody tells it anything.
"""

import contextlib
import os
import tempfile
import threading
from pathlib import Path
from unittest.mock import patch

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.swim import swimmer_of
from agent.core.codec import encode
from agent.core.config import Behaviour, Look
from agent.core.step_io import Inputs
from agent.experiments.ball_measurements import PosedRobot
from agent.perception.detection.detectors import load_detectors
from agent.perception.flow import LandmarkWatch
from agent.perception.vision import Vision
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from hw.camera.camera import FocusRange, Frame, Roi, deliverable
from hw.stm32.protocol import HostProtocol
from hw.twin.board import Board, interpreter
from hw.twin.camera_device import DELIVERY_NS, FRAME_NS, DiveCamera, FrameClock
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.physics.body import euler_rad
from hw.twin.scene import generator, scene_of
from hw.twin.truth import true_tags
from tests.replay.step_box import StepBox

START_NS, STEP_TICKS = 10**15, 5


class LockstepClock:
    """The dive's time; whose thread waits has given the baton away and gets it back when its time has come."""

    camera_offset_ns, start_ns = 0, None

    def __init__(self, dive: Dive) -> None:
        self._dive, self.wake_ns = dive, 0
        self._ours, self._theirs = threading.Semaphore(0), threading.Semaphore(0)

    def now_ns(self) -> int:
        return self._dive.now_ns

    def sleep_until(self, t_ns: int) -> None:
        """By the other thread."""
        self.wake_ns = t_ns
        self._ours.release()
        self._theirs.acquire()

    def begin(self) -> None:
        """Wait until the other thread, just started, sleeps."""
        self._ours.acquire()

    def run_who_is_due(self) -> None:
        if self.wake_ns <= self.now_ns():
            self._theirs.release()
            self._ours.acquire()


class LockstepPart:
    """Stands in for agent.clock.clock.Part."""

    def __init__(self, clock: LockstepClock, name: str, slack_s: float) -> None:
        self._clock = clock

    def wait_changed(self, condition: threading.Condition, until_ns: int) -> bool:
        if self._clock.now_ns() >= until_ns:
            return False
        condition.release()
        self._clock.sleep_until(until_ns)
        condition.acquire()
        return self._clock.now_ns() < until_ns

    def resume(self) -> None:
        self._clock.wake_ns = self._clock.now_ns()


class LockstepCamera:
    """A camera of hw.camera.camera whose frames come when the dive has got there."""

    def __init__(self, clock: LockstepClock, shutter: FrameClock) -> None:
        self._clock, self._shutter = clock, shutter
        self._asked_ns: int | None = None  # for the frame that is rendered now
        self._settled_ns = 0
        self.device: DiveCamera | None = None  # that has now_ns for its clock

    @property
    def size(self) -> tuple[int, int]:
        return self.device.size

    def now_ns(self) -> int:
        return self._clock.now_ns() if self._asked_ns is None else self._asked_ns

    def focus_range(self) -> FocusRange:
        return self.device.focus_range

    def set_focus(self, lens_position: int) -> int:
        self._settled_ns = self._clock.now_ns()
        return self.device.set_focus(lens_position)

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = 0.0) -> Frame:
        asked_ns = max(self._clock.now_ns(), self._settled_ns + round(settle_s * 1e9))
        opens_ns = self._shutter.opens_ns(self._shutter.next(asked_ns))
        self._clock.sleep_until(opens_ns + DELIVERY_NS)
        self._asked_ns = opens_ns
        frame = self.device.read(deliverable(roi, self.size), 0.0)
        self._asked_ns = None
        return frame

    def close(self) -> None:
        pass


def swim(
    name: str,
    seed: int,
    seconds: float,
    behaviour: Behaviour | None = None,
    look: Look | None = None,
    into: Path | None = None,
):
    """Rows (n, 9) of each step: t s, true x, y m and yaw rad, believed x, y and yaw (NaN: none), sigma of place m, and
    whether a sweep is under way. look: at what, if not as the fleet file says; into: where to write its steps."""
    fleet = load_fleet(fleet_file("swim"))
    robot = replace(fleet.robot[name], neighbours=(), behaviour=behaviour, look=look or fleet.robot[name].look)
    fleet = replace(fleet, robot={name: robot}, twin=replace(fleet.twin, seed=seed))
    scene = scene_of(fleet)
    calibration = PosedRobot(fleet, name, scene.camera).calibrate()
    tags = true_tags(fleet.landmarks, seed)
    lens = draw_lens(scene.camera, generator(seed, name, "lens"))
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, name, tags)
    painter.prepare()
    dive = Dive(fleet, [name], START_NS, scene=scene)
    clock = LockstepClock(dive)
    shutter = FrameClock(START_NS + int(generator(seed, name, "shutter").integers(FRAME_NS)))
    camera, vcm = LockstepCamera(clock, shutter), Vcm(lens, generator(seed, name, "vcm"))
    seen = (dive.history, lens, vcm, painter, fleet.body.camera_m, dive.stage, shutter, camera.now_ns)
    camera.device = DiveCamera(0, *seen, blurs=scene.motion_blur)
    watch = LandmarkWatch(calibration.camera, calibration.focus, fleet.navigation.follow_hz)
    agent, rows = Agent(fleet, name, calibration, START_NS), []
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        dive.boards = [Board(name, folder, dive.tare_pa[0], interpreter=interpreter())]
        stack.callback(dive.boards[0].close)
        dive.boards[0].start()
        port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        stack.callback(os.close, port)
        stack.enter_context(patch("agent.perception.vision.Part", LockstepPart))
        detectors = load_detectors(fleet, calibration.camera)
        eyes = Vision(lambda: camera, fleet, calibration.camera, detectors, clock, name, landmarks=watch)
        eyes.start()  # its thread ends with the process: it sleeps on a clock that stands
        clock.begin()
        protocol = HostProtocol(1)
        protocol.connected()
        protocol.arm()
        box = None if into is None else stack.enter_context(StepBox(into, fleet, name, calibration, START_NS))
        while dive.now_ns - START_NS < seconds * 1e9:
            clock.run_who_is_due()
            with contextlib.suppress(BlockingIOError):
                protocol.receive(os.read(port, 4096), dive.now_ns)
            out = protocol.due(dive.now_ns)
            if dive.ticks % STEP_TICKS == 0:
                out += _step(agent, protocol, eyes, watch, dive, box)
                rows.append(_row(agent, dive))
            if out:
                os.write(port, out)
            run_in_lock_step(dive, 1)
    return np.array(rows, float)


def _step(
    agent: Agent, protocol: HostProtocol, eyes: Vision, watch: LandmarkWatch, dive: Dive, box: StepBox | None
) -> bytes:
    tags, flow = watch.drain()
    telemetry = tuple(each for each in protocol.telemetry if each.t_ns < dive.now_ns)
    protocol.telemetry.clear()
    inputs = Inputs(telemetry=telemetry, sightings=tuple(eyes.drain()), landmarks=tags or UNSET, flow=flow or UNSET)
    outputs = agent.step(inputs, dive.now_ns)
    if box is not None:
        box.add(dive.now_ns, encode(inputs), encode(outputs))
    if outputs.sweep is not None:
        eyes.plan(outputs.sweep)
    if outputs.lens is not UNSET:
        eyes.rest(outputs.lens)
    return protocol.set_point(outputs.set_point, dive.now_ns)


def _row(agent: Agent, dive: Dive) -> list[float]:
    state, here = dive.states[0], swimmer_of(agent.capabilities).localizer.at(dive.now_ns)
    believed, sigma_m = [np.nan] * 3, np.nan
    if here is not None:
        believed, sigma_m = list(here.pose), np.sqrt(here.covariance[0] + here.covariance[3])
    true = [*state["position_m"][:2], euler_rad(state["quaternion"])[2]]
    return [(dive.now_ns - START_NS) * 1e-9, *true, *believed, sigma_m, agent.target_search.measuring]
