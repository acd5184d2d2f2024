"""The only loop: drain what arrived, step, log both, act. Everything with a thread or a clock is handed in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from threading import Event
from typing import Protocol

import msgspec
from msgspec import UNSET

from agent.clock.clock import Clock, Part
from agent.clock.part_names import LOOP, part_name
from agent.console_log import Network
from agent.kernel.codec import encode
from agent.kernel.core import Agent
from agent.kernel.messages import MAX_TEXT, Estimate, Level, LogLine
from agent.kernel.step_io import Inputs, Outputs, SetPoint, Sighting, SweepPlan, Telemetry
from hw.firmware import wire
from hw.firmware.failsafe import SURFACE

STEP_NS = 50_000_000  # 20 Hz: set-points reach the control module often enough to be its heartbeat
SLACK_S = 0.025  # how late a step may come before a dive's clock waits for it

Record = Callable[[int, int, bytes, bytes | None], None]  # step, now_ns, inputs, outputs; None: the step raised


class Eyes(Protocol):
    """Vision, as the loop sees it; nothing waits."""

    def drain(self) -> Sequence[Sighting]: ...
    def plan(self, plan: SweepPlan) -> None: ...


class ControlModule(Protocol):
    """The board at the end of the tether, as the loop sees it; nothing waits."""

    def drain(self) -> tuple[Sequence[Telemetry], Sequence[tuple[Level, str]]]: ...
    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


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
        faults: Callable[[], Mapping[str, str | None]] = dict,
        resume: Callable[[], None] = lambda: None,
        sign: Callable[[Estimate], Estimate] = lambda estimate: estimate,
        keys: Callable[[int], dict[str, bytes] | None] = lambda now_ns: None,
    ) -> None:
        """`faults`: what is wrong now with what the agent does not see, by kind; None: nothing. `resume` is called when
        a robot rises for no other reason than our silence. `sign`: what it says as it shall leave; the recording has it
        as the kernel gave it. `keys`: the robots' public keys at the first call and when they have changed, else None.
        """
        self._name, self._agent, self._eyes, self._module = name, agent, eyes, module
        self._network, self._record, self._clock = network, record, clock
        self._faults, self._resume, self._sign, self._keys = faults, resume, sign, keys
        self._told: dict[str, str | None] = {}  # faults, as they were last told

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
        telemetry, lines = self._module.drain()
        if telemetry and surfacing_for_silence(telemetry[-1]):
            self._resume()
        heard, refused = self._network.drain()
        sightings = tuple(self._eyes.drain())
        now_ns = self._clock.now_ns()
        keys = self._keys(now_ns)
        inputs = Inputs(
            telemetry=tuple(telemetry),
            sightings=sightings,
            heard=heard,
            refused=refused,
            keys=UNSET if keys is None else keys,
        )
        try:
            outputs = self._agent.step(inputs, now_ns)
        except Exception:
            self._record(number, now_ns, encode(inputs), None)  # inputs that break a step are what a black box is for
            raise
        self._tell_faults(now_ns)
        self._record(number, now_ns, encode(inputs), encode(outputs))
        self._act(outputs, now_ns)
        for level, text in lines:
            self._log(level, text, now_ns)

    def _act(self, outputs: Outputs, now_ns: int) -> None:
        """Hand the outputs of a step to the devices and the network; nothing here waits."""
        self._module.send(outputs.set_point, now_ns)
        if outputs.sweep is not None:
            self._eyes.plan(outputs.sweep)
        for estimate in outputs.says:
            self._network.say(self._sign(estimate))
        if outputs.state is not None:
            self._network.show(outputs.state)
        for line in outputs.log:
            self._network.show(line)

    def _tell_faults(self, now_ns: int) -> None:
        for kind, fault in self._faults().items():
            if fault != self._told.get(kind):
                self._told[kind] = fault
                self._log("warning" if fault else "info", f"{kind}: {fault}" if fault else f"over: {kind}", now_ns)

    def _log(self, level: Level, text: str, now_ns: int) -> None:
        self._network.show(LogLine(robot=self._name, sent_ns=now_ns, level=level, text=text[:MAX_TEXT]))


def say_goodbye(agent: Agent, network: Network, clock: Clock) -> None:
    """Show the last state of each target: it tells a planned end from a crash."""
    for target in agent.targets.values():
        if (state := target.last_state) is not None:
            network.show(msgspec.structs.replace(state, mode="stopped", seq=state.seq + 1, sent_ns=clock.now_ns()))


def surfacing_for_silence(telemetry: Telemetry) -> bool:
    """Whether the module, still armed, rises only because the host was silent for 3 s. The host is back now, and who
    started it with --arm wants the dive to go on; a leak, a low battery or a bad sensor is for a person to judge."""
    own = wire.FLAG_LEAK | wire.FLAG_BATTERY | wire.FLAG_DEGRADED
    return telemetry.armed and telemetry.ladder == SURFACE and not telemetry.flags & own
