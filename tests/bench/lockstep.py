"""Robots of a dive with their real firmware, vision and kernels, in one process and on the dive's own clock, which
waits for each of them: it comes out the same on any machine, however busy. Frames are rendered."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from unittest.mock import patch

from msgspec import UNSET

from agent.core.config import Fleet
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Heard, Inputs, Outputs, SetPoint, Sighting
from agent.experiments.ball_measurements import Host, PosedRobot, hosts_of
from agent.perception.detection.detectors import load_detectors
from agent.perception.flow import LandmarkWatch
from agent.perception.vision import Vision
from agent.robot.step import Agent
from hw.camera.camera import FocusRange, Frame, Roi, deliverable
from hw.twin.camera_device import DELIVERY_NS, FRAME_NS, DiveCamera, FrameClock, unhurried
from hw.twin.dive import Dive
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.scene import generator, lamp_place, scene_of
from hw.twin.truth import true_tags

START_NS, STEP_TICKS = 10**15, 5


@contextlib.contextmanager
def divers_of(fleet: Fleet) -> Iterator[tuple[Dive, dict[str, Diver]]]:
    """All robots of a fleet, each calibrated on its bench. Raises CalibrationRefused."""
    scene = scene_of(fleet)
    known = {name: PosedRobot(fleet, name, scene.camera).calibrate() for name in fleet.robot}
    dive = Dive(fleet, list(fleet.robot), START_NS, scene=scene)
    with hosts_of(dive) as hosts, patch("agent.perception.vision.Part", LockstepPart):
        yield dive, {name: Diver(fleet, name, dive, host, known[name]) for name, host in hosts.items()}


class Diver:
    """One robot of the dive."""

    def __init__(self, fleet: Fleet, name: str, dive: Dive, host: Host, known: Calibration) -> None:
        seed, scene = fleet.twin.seed, scene_of(fleet)
        self._dive, self._host, self._clock = dive, host, LockstepClock(dive)
        lens = draw_lens(scene.camera, generator(seed, name, "lens"))
        tags = true_tags(fleet.landmarks, seed)
        painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, name, tags)
        painter.prepare()
        shutter = FrameClock(START_NS + int(generator(seed, name, "shutter").integers(FRAME_NS)))
        camera, vcm = LockstepCamera(self._clock, shutter), Vcm(lens, generator(seed, name, "vcm"))
        seen = (dive.history, lens, vcm, painter, fleet.body.camera_m, dive.stage, shutter, camera.now_ns)
        swims = scene.creature, seed, None, lamp_place(fleet, scene)
        camera.device = DiveCamera(dive.robots.index(name), *seen, unhurried, scene.motion_blur, *swims)
        follow = fleet.navigation and fleet.navigation.follow_hz
        self._watch = LandmarkWatch(known.camera, known.focus, follow) if follow else None
        detectors = load_detectors(fleet, known.camera)
        self._eyes = Vision(lambda: camera, fleet, known.camera, detectors, self._clock, name, landmarks=self._watch)
        self._eyes.start()  # its thread ends with the process: it sleeps on a clock that stands
        self._clock.begin()
        self.agent = Agent(fleet, name, known, START_NS)
        self._wanted = SetPoint(depth_m=fleet.robot[name].depth_m)
        self.post: list[Heard] = []
        self.sightings: tuple[Sighting, ...] = ()  # of the newest step

    def tick(self) -> Outputs | None:
        """10 ms; in every fifth a step, whose outputs are returned."""
        self._clock.run_who_is_due()
        outputs = self._step() if self._dive.ticks % STEP_TICKS == 0 else None
        self._host.exchange(self._wanted, self._dive)
        return outputs

    def _step(self) -> Outputs:
        tags, flow = self._watch.drain() if self._watch else ((), ())
        self.sightings = tuple(self._eyes.drain())
        inputs = Inputs(
            telemetry=tuple(self._host.heard),
            sightings=self.sightings,
            heard=tuple(self.post),
            landmarks=tags or UNSET,
            flow=flow or UNSET,
        )
        self._host.heard.clear()
        self.post.clear()
        outputs = self.agent.step(inputs, self._dive.now_ns)
        self._wanted = outputs.set_point
        if outputs.sweep is not None:
            self._eyes.plan(outputs.sweep)
        if outputs.lens is not UNSET:
            self._eyes.rest(outputs.lens)
        return outputs


# --- what stands in for clock and camera ---


class LockstepClock:
    """The dive's time; a thread that waits has given the baton away and gets it back when its time has come."""

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
