"""A fleet with lamps in the dark, moored or not: rendered, with real firmware, vision and kernels, all in one process
and on the dive's own clock, which waits for each of them. Messages go from one step to the next; some are lost if so
asked.

What `aucamp demo` does with processes and sockets, for machines that have no cores to spare.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from random import Random
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Heard, Inputs, Outputs, Sighting
from agent.core.topics import LIGHT, NEAR
from agent.demo.demo import SETTLE_ITERATIONS, SETTLE_M, SETTLE_WINDOW
from agent.demo.summary import History, settled
from agent.experiments.ball_measurements import PosedRobot
from agent.perception.detection.detectors import load_detectors
from agent.perception.flow import LandmarkWatch
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
from tests.replay.step_box import StepBox


class Ended(NamedTuple):
    """One robot at the end."""

    error_mm: float | None  # of its estimate; None: it has none
    first_s: float | None  # when the ball was in one of its frames for the first time
    kept: int  # sweeps that gave a place
    by_lent: int  # of them by another's lamp
    rejected: int
    nis: float | None  # of its sweeps against those before, mean; of three where they scatter as they say
    epochs: int  # that its estimate went through after the first: a ball at rest has none


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
        dive.boards.append(self.board)
        self.board.start()
        self._port = os.open(self.board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        detectors = load_detectors(fleet, calibration.camera)
        self._watch = None
        if fleet.navigation is not None:
            self._watch = LandmarkWatch(calibration.camera, calibration.focus, fleet.navigation.follow_hz)
        eyes = lambda: camera, fleet, calibration.camera, detectors, self.clock, name
        self._eyes = Vision(*eyes, landmarks=self._watch)
        self._eyes.start()  # its thread ends with the process: it sleeps on a clock that stands
        self.clock.begin()
        self._protocol = HostProtocol(1)
        self._protocol.connected()
        self._protocol.arm()
        self.agent = Agent(fleet, name, calibration, START_NS)
        self.post: list[Heard] = []
        self.box: StepBox | None = None  # where its steps are written, if anywhere
        self.sightings: tuple[Sighting, ...] = ()  # of the newest step
        self.history = History([])
        self.ended = Ended(None, None, 0, 0, 0, None, 0)

    def tick(self) -> Outputs | None:
        """10 ms; in every fifth a step, whose outputs are returned."""
        self.clock.run_who_is_due()
        with contextlib.suppress(BlockingIOError):
            self._protocol.receive(os.read(self._port, 4096), self._dive.now_ns)
        out, outputs = self._protocol.due(self._dive.now_ns), None
        if self._dive.ticks % STEP_TICKS == 0:
            outputs = self._step()
            out += self._protocol.set_point(outputs.set_point, self._dive.now_ns)
        if out:
            os.write(self._port, out)
        return outputs

    def close(self) -> None:
        os.close(self._port)
        self.board.close()

    def _step(self) -> Outputs:
        now_ns = self._dive.now_ns
        telemetry = tuple(each for each in self._protocol.telemetry if each.t_ns < now_ns)
        self._protocol.telemetry.clear()
        self.sightings, heard, self.post = tuple(self._eyes.drain()), tuple(self.post), []
        sightings = self.sightings
        tags, flow = ((), ()) if self._watch is None else self._watch.drain()
        inputs = Inputs(
            telemetry=telemetry, sightings=sightings, heard=heard, landmarks=tags or UNSET, flow=flow or UNSET
        )
        outputs = self.agent.step(inputs, now_ns)
        if self.box is not None:
            self.box.add(now_ns, encode(inputs), encode(outputs))
        if outputs.sweep is not None:
            self._eyes.plan(outputs.sweep)
        if outputs.lens is not UNSET:
            self._eyes.rest(outputs.lens)
        if outputs.state is not None:
            self.history.states.append(outputs.state)
        was = self.ended
        if was.first_s is None and any(sighting.found for sighting in sightings):
            was = was._replace(first_s=(now_ns - START_NS) * 1e-9)
        if outputs.outcome:
            kept = outputs.outcome.x_m is not None
            lent = kept and set(outputs.outcome.lamps or ()) != {self.name}
            was = was._replace(kept=was.kept + kept, by_lent=was.by_lent + lent, rejected=was.rejected + (not kept))
        self.ended = was
        return outputs


def night(
    fleet: Fleet, calibrations: Mapping[str, Calibration], seconds: float, loss: float = 0.0, whole: bool = False
) -> tuple[float | None, dict[str, Ended]]:
    """When all had settled, s, or None; and each robot. whole: it goes on after that."""
    truth_m, settled_s = np.array(scene_of(fleet).solid[0].position_m), None
    for dive, divers in under_way(fleet, calibrations, loss):
        histories = [diver.history for diver in divers.values()]
        waits = settled_s is None and dive.ticks % 100 == 0
        if waits and settled(histories, SETTLE_ITERATIONS, SETTLE_WINDOW, SETTLE_M):
            settled_s = (dive.now_ns - START_NS) * 1e-9
        if (settled_s is not None and not whole) or dive.now_ns - START_NS >= seconds * 1e9:
            break
    return settled_s, {
        name: diver.ended._replace(
            error_mm=off_mm(diver, truth_m),
            nis=mean_nis(diver.history),
            epochs=diver.agent.measuring.current.estimator.epoch.counter,
        )
        for name, diver in divers.items()
    }


def under_way(
    fleet: Fleet, calibrations: Mapping[str, Calibration], loss: float = 0.0, into: Path | None = None
) -> Iterator[tuple[Dive, dict[str, Diver]]]:
    """The dive after each of its ticks, for as long as somebody asks. into: a folder for each robot's steps."""
    scene, names, random = scene_of(fleet), list(fleet.robot), Random(fleet.twin.seed)
    dive = Dive(fleet, names, START_NS, scene=scene)
    with contextlib.ExitStack() as stack:
        stack.enter_context(patch("agent.perception.vision.Part", LockstepPart))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        divers = {}
        for me, name in enumerate(names):
            divers[name] = diver = Diver(fleet, name, me, dive, folder, calibrations[name])
            stack.callback(diver.close)
            if into is not None:
                diver.box = stack.enter_context(
                    StepBox(into / f"{name}.mcap", fleet, name, calibrations[name], START_NS)
                )
        while True:
            said = [(name, diver.tick()) for name, diver in divers.items()]
            run_in_lock_step(dive, 1)
            for name, outputs in said:
                for heard, to in () if outputs is None else letters(name, outputs, dive.now_ns):
                    if random.random() >= loss:
                        divers[to].post.append(heard)
            yield dive, divers


def letters(src: str, outputs: Outputs, now_ns: int) -> list[tuple[Heard, str]]:
    """What a robot says, and to whom."""
    topics = (UNSET, outputs.says), ("light", outputs.said(LIGHT)), ("near", outputs.said(NEAR))
    return [
        (Heard(arrived_ns=now_ns, src=src, topic=topic, payload=encode(said)), said.dst)
        for topic, letters_of in topics
        for said in letters_of
    ]


def off_mm(diver: Diver, truth_m: np.ndarray) -> float | None:
    believed = diver.agent.measuring.current.estimator.posterior
    return None if believed is None else 1000.0 * float(np.linalg.norm(np.array(believed.x_m) - truth_m))


def mean_nis(history: History) -> float | None:
    """Of all iterations that had a sample of the robot's own."""
    found = {state.t: state.explain.nis for state in history.states if state.explain and state.explain.nis is not None}
    return sum(found.values()) / len(found) if found else None


def calibrated(fleet: Fleet, name: str) -> Calibration:
    """By the bench's procedure, in daylight and without the fleet's scene."""
    scene = in_daylight(replace(scene_of(fleet), solid=(), creature=()))
    robot = PosedRobot(fleet, name, scene.camera)
    robot._bench = robot._with(scene, 0)
    return robot.calibrate()
