"""A fleet with lamps in the dark: rendered, with real firmware, vision and kernels, all in one process and on the
dive's own clock, which waits for each of them. Messages go from one step to the next; some are lost if so asked.

What `aucamp demo` does with processes and sockets, and the same on any machine, however busy.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from random import Random
from typing import NamedTuple
from unittest.mock import patch

from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.linear_algebra import difference, inverse, quadratic
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Heard, Inputs, Outputs, Sighting
from agent.core.topics import LIGHT, NEAR
from agent.demo.demo import SETTLE_ITERATIONS, SETTLE_M, SETTLE_WINDOW
from agent.demo.summary import History, settled
from agent.experiments.ball_measurements import PosedRobot
from agent.experiments.claim import Row
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.robot.step import Agent
from hw.stm32.protocol import HostProtocol
from hw.twin.board import Board, interpreter
from hw.twin.camera_device import FRAME_NS, DiveCamera, FrameClock, unhurried
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.scene import generator, in_daylight, lamp_place, scene_of
from hw.twin.truth import true_tags
from tests.bench.swim.lockstep import START_NS, STEP_TICKS, LockstepCamera, LockstepClock, LockstepPart


class Sweeps(NamedTuple):
    """Of one robot so far."""

    first_s: float | None = None  # when the ball was in one of its frames for the first time
    kept: int = 0  # that gave a place
    by_lent: int = 0  # of them by another's lamp
    rejected: int = 0


class Wire:
    """The cable between a robot's computer and its board. A pty carries bytes when the kernel has time, and the dive
    would come out otherwise on a busy machine; these are there at once."""

    def __init__(self) -> None:
        self._to_board, self._to_agent = b"", b""

    def plug(self) -> None:
        pass

    def unplug(self) -> None:
        pass

    def receive(self) -> bytes:
        """By the board."""
        data, self._to_board = self._to_board, b""
        return data

    def send(self, data: bytes) -> None:
        """By the board."""
        self._to_agent += data

    def read(self) -> bytes:
        data, self._to_agent = self._to_agent, b""
        return data

    def write(self, data: bytes) -> None:
        self._to_board += data


class Diver:
    """One robot of the dive."""

    def __init__(self, fleet: Fleet, name: str, me: int, dive: Dive, folder: Path, calibration: Calibration) -> None:
        seed, scene = fleet.twin.seed, scene_of(fleet)
        self.name, self._dive = name, dive
        self.clock = LockstepClock(dive)
        lens = draw_lens(scene.camera, generator(seed, name, "lens"))
        tags = true_tags(fleet.landmarks, seed)
        painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, name, tags)
        painter.prepare()
        shutter = FrameClock(START_NS + int(generator(seed, name, "shutter").integers(FRAME_NS)))
        camera, vcm = LockstepCamera(self.clock, shutter), Vcm(lens, generator(seed, name, "vcm"))
        seen = (dive.history, lens, vcm, painter, fleet.body.camera_m, dive.stage, shutter, camera.now_ns)
        swims = scene.creature, seed, None, lamp_place(fleet, scene)
        camera.device = DiveCamera(me, *seen, unhurried, scene.motion_blur, *swims)
        self.board = Board(name, folder, dive.tare_pa[me], interpreter=interpreter())
        self.board._cable = self._wire = Wire()
        dive.boards.append(self.board)
        self.board.start()
        detectors = load_detectors(fleet, calibration.camera)
        self._eyes = Vision(lambda: camera, fleet, calibration.camera, detectors, self.clock, name)
        self._eyes.start()  # its thread ends with the process: it sleeps on a clock that stands
        self.clock.begin()
        self._protocol = HostProtocol(1)
        self._protocol.connected()
        self._protocol.arm()
        self.agent = Agent(fleet, name, calibration, START_NS)
        self.post: list[Heard] = []
        self.history = History([])
        self.sweeps = Sweeps()

    def tick(self) -> Outputs | None:
        """10 ms; in every fifth a step, whose outputs are returned."""
        self.clock.run_who_is_due()
        self._protocol.receive(self._wire.read(), self._dive.now_ns)
        out, outputs = self._protocol.due(self._dive.now_ns), None
        if self._dive.ticks % STEP_TICKS == 0:
            outputs = self._step()
            out += self._protocol.set_point(outputs.set_point, self._dive.now_ns)
        self._wire.write(out)
        return outputs

    def close(self) -> None:
        self.board.close()

    def _step(self) -> Outputs:
        now_ns = self._dive.now_ns
        telemetry = tuple(each for each in self._protocol.telemetry if each.t_ns < now_ns)
        self._protocol.telemetry.clear()
        sightings, heard, self.post = tuple(self._eyes.drain()), tuple(self.post), []
        outputs = self.agent.step(Inputs(telemetry=telemetry, sightings=sightings, heard=heard), now_ns)
        if outputs.sweep is not None:
            self._eyes.plan(outputs.sweep)
        if outputs.lens is not UNSET:
            self._eyes.rest(outputs.lens)
        if outputs.state is not None:
            self.history.states.append(outputs.state)
        self._count(sightings, outputs)
        return outputs

    def _count(self, sightings: tuple[Sighting, ...], outputs: Outputs) -> None:
        known = self.sweeps
        if known.first_s is None and any(sighting.found for sighting in sightings):
            known = known._replace(first_s=(self._dive.now_ns - START_NS) * 1e-9)
        if outputs.outcome:
            kept = outputs.outcome.x_m is not None
            lent = kept and set(outputs.outcome.lamps or ()) != {self.name}
            known = known._replace(
                kept=known.kept + kept, by_lent=known.by_lent + lent, rejected=known.rejected + (not kept)
            )
        self.sweeps = known

    def row(self, truth_m: Vector) -> Row:
        """How it knows the ball, and how it came to. None: it has no estimate; nis: of its sweeps against those before,
        3 where they scatter as they say; epochs: that its estimate went through, of a ball at rest none."""
        estimator = self.agent.measuring.current.estimator
        off_m, nees = None, None
        if (believed := estimator.posterior) is not None:
            off = difference(believed.x_m, truth_m)
            weight = inverse(believed.cov_m2)
            off_m, nees = math.hypot(*off), None if weight is None else quadratic(weight, off)
        nis = {state.t: state.explain.nis for state in self.history.states if state.explain}
        found = [value for value in nis.values() if value is not None]
        return {
            "error_mm": None if off_m is None else 1e3 * off_m,
            "nees": nees,
            "nis": sum(found) / len(found) if found else None,
            "epochs": estimator.epoch.counter,
            **self.sweeps._asdict(),
        }


def night(
    fleet: Fleet, calibrations: Mapping[str, Calibration], seconds: float, loss: float, whole: bool
) -> tuple[float | None, list[Row]]:
    """When all had settled, s, or None; and a row a robot. whole: it goes on after that."""
    truth_m, settled_s = scene_of(fleet).solid[0].position_m, None
    for dive, divers in under_way(fleet, calibrations, loss):
        histories = [diver.history for diver in divers]
        waits = settled_s is None and dive.ticks % 100 == 0
        if waits and settled(histories, SETTLE_ITERATIONS, SETTLE_WINDOW, SETTLE_M):
            settled_s = (dive.now_ns - START_NS) * 1e-9
        if (settled_s is not None and not whole) or dive.now_ns - START_NS >= seconds * 1e9:
            break
    return settled_s, [diver.row(truth_m) for diver in divers]


def under_way(fleet: Fleet, calibrations: Mapping[str, Calibration], loss: float) -> Iterator[tuple[Dive, list[Diver]]]:
    """The dive after each of its ticks, for as long as somebody asks."""
    scene, names, random = scene_of(fleet), list(fleet.robot), Random(fleet.twin.seed)
    dive = Dive(fleet, names, START_NS, scene=scene)
    with contextlib.ExitStack() as stack:
        stack.enter_context(patch("agent.perception.vision.Part", LockstepPart))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        divers = {}
        for me, name in enumerate(names):
            divers[name] = diver = Diver(fleet, name, me, dive, folder, calibrations[name])
            stack.callback(diver.close)
        while True:
            said = [(name, diver.tick()) for name, diver in divers.items()]
            run_in_lock_step(dive, 1)
            for name, outputs in said:
                for heard, to in () if outputs is None else letters(name, outputs, dive.now_ns):
                    if random.random() >= loss:
                        divers[to].post.append(heard)
            yield dive, list(divers.values())


def letters(src: str, outputs: Outputs, now_ns: int) -> list[tuple[Heard, str]]:
    """What a robot says, and to whom."""
    topics = (UNSET, outputs.says), ("light", outputs.said(LIGHT)), ("near", outputs.said(NEAR))
    return [
        (Heard(arrived_ns=now_ns, src=src, topic=topic, payload=encode(said)), said.dst)
        for topic, letters_of in topics
        for said in letters_of
    ]


def calibrated(fleet: Fleet, name: str) -> Calibration:
    """By the bench's procedure, in daylight and without the fleet's scene."""
    scene = in_daylight(replace(scene_of(fleet), solid=(), creature=()))
    robot = PosedRobot(fleet, name, scene.camera)
    robot._bench = robot._with(scene, 0)
    return robot.calibrate()
