"""The only loop: drain what arrived, step, log both, act. Everything with a thread or a clock is handed in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Event
from typing import Protocol, TypeVar

import msgspec
from msgspec import UNSET

from agent.clock.clock import Clock, Part
from agent.clock.part_names import LOOP, part_name
from agent.core.codec import encode
from agent.core.messages import MAX_TEXT, Estimate, Level, LogLine, Mode
from agent.core.step_io import (
    BlockPeaks,
    Flow,
    Inputs,
    Outputs,
    SeenTags,
    SetPoint,
    Sighting,
    SweepPlan,
    TargetBox,
    Telemetry,
)
from agent.core.step_io import Motors as MotorOrder
from agent.process.console_log import Network
from agent.robot.core import Agent

STEP_NS = 50_000_000  # 20 Hz: set-points reach the control module often enough to be its heartbeat
SLACK_S = 0.025  # how late a step may come before a dive's clock waits for it

T = TypeVar("T")
Around = tuple[tuple[SeenTags, ...], tuple[Flow, ...]]  # what frames showed of what stays where it is
Record = Callable[[int, int, bytes, bytes | None], None]  # step, now_ns, inputs, outputs; None: the step raised


class Eyes(Protocol):
    """Vision, as the loop sees it; nothing waits."""

    def drain(self) -> Sequence[Sighting]: ...
    def plan(self, plan: SweepPlan) -> None: ...
    def rest(self, lens_position: int | None) -> None: ...
    def views(self) -> Sequence[BlockPeaks]: ...


class ControlModule(Protocol):
    """The board at the end of the tether, as the loop sees it; nothing waits."""

    def drain(self) -> tuple[Sequence[Telemetry], Sequence[tuple[Level, str]]]: ...
    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


class MotorSwitch(Protocol):
    """Whether motors shall turn, and seeing to it; nothing waits."""

    def feel(self, told: Sequence[Telemetry], now_ns: int) -> None: ...
    def obey(self, ordered: MotorOrder, now_ns: int) -> None: ...


class Runtime:
    """One robot's agent between its devices, its network and its recording."""

    def __init__(
        self,
        name: str,
        agent: Agent,
        eyes: Eyes,
        module: ControlModule,
        network: Network,
        record: Record,
        clock: Clock,
        *,
        faults: Callable[[], tuple[str, ...]] = tuple,
        motors: MotorSwitch | None = None,
        sign: Callable[[Estimate], Estimate] = lambda estimate: estimate,
        keys: Callable[[int], dict[str, bytes] | None] = lambda now_ns: None,
        landmarks: Callable[[], Around] = lambda: ((), ()),
        draw: Callable[[TargetBox], str | None] = lambda box: "nobody looks",
        preview_hz: Callable[[float], None] = lambda hz: None,
    ) -> None:
        """`faults`: what is wrong now with what the agent does not see, each as "kind: what"; it goes into the step,
        and from there into State and the log. `motors`: who switches them as is ordered; None: nobody. `sign`: what it
        says as it shall leave; the recording has it as the kernel gave it. `keys`: the robots' public keys at the first
        call and when they have changed, else None. `landmarks`: what frames showed of tags, and how points of key
        frames moved, since the last call. `draw`: a box around a target, as somebody drew it; returns why not.
        `preview_hz`: how often pictures are shown from now on.
        """
        self._name, self._agent, self._eyes, self._module = name, agent, eyes, module
        self._network, self._record, self._clock = network, record, clock
        self._faults, self._motors, self._sign, self._keys = faults, motors, sign, keys
        self._landmarks, self._draw, self._preview_hz = landmarks, draw, preview_hz
        self._broken: dict[str, str] = {}  # parts that raised when they were last asked

    def run(self, stop: Event) -> None:
        """Step at 20 Hz of the clock until `stop` is set."""
        part = Part(self._clock, part_name(self._name, LOOP), SLACK_S)
        number, due_ns = 0, self._clock.now_ns()
        try:
            while not stop.is_set():
                self.step(number)
                number += 1
                due_ns = max(due_ns + STEP_NS, self._clock.now_ns() - STEP_NS)  # after a stall: no burst of late steps
                part.wait(stop, due_ns)
        finally:
            part.leave()

    def step(self, number: int) -> None:
        """Once around the loop."""
        telemetry, lines = self._part("control module", self._module.drain) or ((), ())
        if (motors := self._motors) is not None:
            self._part("motors", lambda: motors.feel(telemetry, self._clock.now_ns()))
        heard, refused = self._part("links", self._network.drain) or ((), ())
        sightings = tuple(self._part("vision", self._eyes.drain) or ())
        blocks = tuple(self._part("views", self._eyes.views) or ())
        tags, flow = self._part("landmarks", self._landmarks) or ((), ())
        orders = self._part("orders", self._network.orders) or ()
        now_ns = self._clock.now_ns()
        keys = self._part("keys", lambda: self._keys(now_ns))
        told = self._part("faults", self._faults) or ()
        faults = (*told, *(f"{name}: {what}" for name, what in self._broken.items()))
        inputs = Inputs(
            telemetry=tuple(telemetry),
            sightings=sightings,
            heard=heard,
            refused=refused,
            landmarks=tags or UNSET,
            flow=flow or UNSET,
            blocks=blocks or UNSET,
            faults=faults or UNSET,
            keys=UNSET if keys is None else keys,
            orders=orders or UNSET,
        )
        try:
            outputs = self._agent.step(inputs, now_ns)
        except Exception:
            self._record(number, now_ns, encode(inputs), None)  # inputs that break a step are what a black box is for
            raise
        self._part("recording", lambda: self._record(number, now_ns, encode(inputs), encode(outputs)))
        self._act(outputs, now_ns)
        for level, text in lines:
            self._log(level, text, now_ns)

    def _act(self, outputs: Outputs, now_ns: int) -> None:
        """Hand the outputs of a step to the devices and the network; nothing here waits. What a part is told has a name
        of its own: that it still answers does not mean that it takes orders."""
        if (ordered := outputs.motors) is not UNSET and (motors := self._motors) is not None:
            self._part("motors off or on", lambda: motors.obey(ordered, now_ns))
        self._part("set-points", lambda: self._module.send(outputs.set_point, now_ns))
        if (sweep := outputs.sweep) is not None:
            self._part("sweeps", lambda: self._eyes.plan(sweep))
        if (lens := outputs.lens) is not UNSET:
            self._part("lens", lambda: self._eyes.rest(lens))
        if (drawn := outputs.box) is not UNSET:
            why = self._part("box", lambda: self._draw(drawn))
            if why is not None:
                self._log("warning", f"box of '{drawn.target}': {why}", now_ns)
        if (hz := outputs.preview_hz) is not UNSET:
            self._part("previews", lambda: self._preview_hz(hz))
        if (answers := outputs.answers) is not UNSET:
            self._part("answers", lambda: self._network.answer(answers))
        self._part("words", lambda: self._say(outputs))

    def _say(self, outputs: Outputs) -> None:
        for estimate in outputs.says:
            self._network.say(self._sign(estimate))
        for presence in outputs.near or ():
            self._network.say(presence)
        for claim in outputs.claims or ():
            self._network.say(claim)
        for keyframe in outputs.keyframes or ():
            self._network.say(keyframe)
        for light in outputs.light or ():
            self._network.say(light)
        for message in (*(() if outputs.state is None else (outputs.state,)), *outputs.log):
            self._network.show(message)

    def _part(self, name: str, work: Callable[[], T]) -> T | None:
        """What a part answers; one that raises is told as a fault until it works again, and the loop goes on."""
        try:
            done = work()
        except Exception as error:  # noqa: BLE001 - the robot is under water
            self._broken[name] = f"{type(error).__name__}: {error}"[: MAX_TEXT // 2]
            return None
        self._broken.pop(name, None)
        return done

    def _log(self, level: Level, text: str, now_ns: int) -> None:
        self._network.show(LogLine(robot=self._name, sent_ns=now_ns, level=level, text=text[:MAX_TEXT]))


def say_goodbye(agent: Agent, network: Network, clock: Clock, mode: Mode = "stopped") -> None:
    """Show the last state of each target: it tells a planned end from one by a fault, and both from a crash."""
    for target in agent.targets.values():
        if (state := target.last_state) is not None:
            network.show(msgspec.structs.replace(state, mode=mode, seq=state.seq + 1, sent_ns=clock.now_ns()))
