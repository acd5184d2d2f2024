"""The golden log of vision: a robot before a painted ball, every frame that it saw, and what vision and kernel made of
them.

Its frames are JPEG, as a robot records them; vision saw them before they were compressed. The ball stays where it is in
the picture, wherever the gimbal points.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.config import Fleet, dump
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Inputs, Sighting, SweepPlan
from agent.perception.vision import rerun_vision
from agent.process.agent_process import run_facts
from agent.robot.step import Agent
from replay.files.channels import STEP_IN, STEP_OUT, VISION, Entry
from replay.files.frames import frame_entries
from replay.files.mcap_file import Part
from tests.known_lens import FITTED
from tests.network.scripted_agent import CALIBRATION
from tests.perception.painted import PX_PER_POSITION, ball_frame
from tests.sample_messages import telemetry

CENTRE_M = (0.012, -0.010, 0.90)
SHARP = lens_position(FITTED, CENTRE_M[2] - 0.07)  # at the ball's skin
PART = (216, 112, 240, 232)  # x, y, width, height: what a robot reads while it sweeps
SWEEP_STEPS = 14  # of a full sweep: few frames for a file that is kept
SWEEPS = 2  # a full one, and one that tracks
IDLE_STEPS = 5  # from one frame between sweeps to the next


class PaintedCamera:
    """Carries out plans, one frame each step; between them a frame each IDLE_STEPS, as vision's worker does."""

    def __init__(self, fleet: Fleet, box: Part) -> None:
        self._see = rerun_vision(fleet, CALIBRATION.camera)
        self._target, self._box = next(iter(fleet.target)), box
        self._waiting: deque[tuple[int, int, int]] = deque()  # sweep, index, lens position
        self._first: Sighting | None = None  # of the sweep, with the ball in it
        self._frames = 1  # frame 0 is kept losslessly; without it this is as recordings from before there were such

    def plan(self, plan: SweepPlan) -> None:
        self._waiting.extend((plan.sweep, index, at) for index, at in enumerate(plan.focus[1:], start=1))
        self._first = None

    def look(self, step: int, now_ns: int) -> tuple[Sighting, ...]:
        """What this step's frame shows, if there is one; both are recorded."""
        if not self._waiting and step % IDLE_STEPS:
            return ()
        sweep, index, at = self._waiting.popleft() if self._waiting else (0, -1, round(SHARP))
        x, y, width, height = PART
        image = ball_frame(CENTRE_M, abs(at - SHARP) * PX_PER_POSITION)[y : y + height, x : x + width]
        then = Sighting(
            t_ns=now_ns, frame=self._frames, sweep=sweep, index=index, focus=at, target=self._target, found=False
        )
        then = self._see(image, PART, then, self._first)
        if sweep and then.found:
            self._first = self._first or then
        for entry in frame_entries("r1", self._frames, now_ns, image, PART, then, False):
            self._box.add(entry)
        self._box.add(Entry(VISION.name, now_ns, now_ns, self._frames, encode(then), "msgpack", {}))
        self._frames += 1
        return (then,)


def paint(fleet: Fleet, out: Path, start_ns: int, step_ns: int) -> None:
    """Write r1.mcap into the folder `out`: until SWEEPS sweeps have ended."""
    fleet = replace(fleet, camera=replace(fleet.camera, sweep_steps=SWEEP_STEPS))
    calibration = replace(CALIBRATION, robot="r1", focus=FITTED)
    agent = Agent(fleet, "r1", calibration, start_ns)
    box = Part(out / "r1.mcap")
    box.start(run_facts(fleet, "r1", start_ns), {"fleet.toml": dump(fleet), "calibration.toml": dump(calibration)})
    camera, step, ended = PaintedCamera(fleet, box), 0, 0
    while ended < SWEEPS:
        now_ns = start_ns + (step + 1) * step_ns
        inputs = encode(Inputs(telemetry=(telemetry(now_ns),), sightings=camera.look(step, now_ns)))
        outputs = agent.step(decode(inputs, Inputs, limit=10**6), now_ns)
        for channel, data in ((STEP_IN.name, inputs), (STEP_OUT.name, encode(outputs))):
            box.add(Entry(channel, now_ns, now_ns, step, data, "msgpack", {}))
        if outputs.sweep is not None:
            camera.plan(outputs.sweep)
        ended += bool(outputs.outcome)
        step += 1
    box.finish("aucamp.end", {"cause": "clean"})
