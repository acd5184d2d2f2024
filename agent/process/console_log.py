"""What an agent says to the person who started it: its log as it grows, and every ten seconds where it stands."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Sequence
from datetime import datetime
from threading import Thread
from types import TracebackType
from typing import Protocol, Self

from agent.core.capability_messages import Claim, Keyframe, Light
from agent.core.messages import Answer, Estimate, Image, LogLine, Presence, State
from agent.core.status import fault_kind
from agent.core.step_io import DroppedPayloads, Heard, Ordered

LATELY_S = 1.0  # ten messages at the default rate: younger than that is "hears"
AGAIN_NS = 10_000_000_000  # between two lines about where it stands
MOTORS = {True: "motors on", False: "motors off"}
WAITING = 256  # lines that a terminal has not taken; later ones are left out, the network has them all
LAST_S = 0.5  # how long the end waits for a terminal


class Network(Protocol):
    def drain(self) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]: ...
    def say(self, message: Estimate | Presence | Claim | Keyframe | Light) -> None: ...
    def show(self, message: State | LogLine | Image) -> None: ...
    def orders(self) -> tuple[Ordered, ...]: ...
    def answer(self, answers: Sequence[Answer]) -> None: ...


class ConsoleLog:
    """A network whose shown messages a person can follow as well. Context manager.

    `write` gets whole lines in a thread of its own: a terminal held with Ctrl-S may block it for ever, and a loop that
    waited for a terminal would let the control module believe that its host has died.
    """

    def __init__(self, network: Network, write: Callable[[str], object]) -> None:
        self.drain, self.say, self.orders, self.answer = network.drain, network.say, network.orders, network.answer
        self._network, self._write = network, write
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING)
        self._stood_ns: dict[str, int] = {}  # target -> when it was last said where we stand
        self._heard: dict[str, set[str]] = {}  # target -> neighbours whose word about it is fresh
        self._thread = Thread(target=self._run, name="console log", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._put(None)
        self._thread.join(LAST_S)

    def show(self, message: State | LogLine | Image) -> None:
        """Publish, and say it if a person wants to know."""
        self._network.show(message)
        if isinstance(message, Image):
            return
        if isinstance(message, LogLine):
            self._put(line(message.sent_ns, message.robot, message.level, message.text))
            return
        before: set[str] = set().union(*self._heard.values())
        self._heard[message.target] = set(hears(message))
        now: set[str] = set().union(*self._heard.values())
        for name in sorted(now ^ before):
            news = f"hears {name}" if name in now else f"hears {name} no more"
            self._put(line(message.sent_ns, message.robot, "info" if name in now else "warning", news))
        stood_ns = self._stood_ns.setdefault(message.target, message.sent_ns)
        if message.sent_ns - stood_ns >= AGAIN_NS:
            self._stood_ns[message.target] = message.sent_ns
            self._put(line(message.sent_ns, message.robot, "info", standing(message)))

    def _put(self, text: str | None) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(text)

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # nobody reads any more: `| head` has had enough
            while (text := self._lines.get()) is not None:
                self._write(text)


def line(at_ns: int, robot: str, level: str, text: str) -> str:
    """One line, time of day first, as whoever stands at the tank reads it."""
    return f"{datetime.fromtimestamp(at_ns * 1e-9):%H:%M:%S} {robot} {level:7} {text}\n"


def standing(state: State) -> str:
    """What a robot knows of a target, whom it hears, and what is wrong."""
    place = "no estimate"
    if state.posterior_m is not None:
        place = " ".join(f"{1e3 * x:.1f}" for x in state.posterior_m) + " mm"
        place += f", sigma {1e3 * state.posterior_sigma_m:.1f} mm" if state.posterior_sigma_m is not None else ""
    wrong = [fault_kind(fault) for fault in state.faults]  # the log has their words
    motors = [MOTORS[state.armed]] if state.armed is not None else []
    rest = dict.fromkeys([f"hears {', '.join(hears(state)) or 'nobody'}", *motors, *wrong, *(state.ordered or ())])
    return f"{state.target}: {state.knows} at iteration {state.t}, {place}; {'; '.join(rest)}"


def hears(state: State) -> list[str]:
    """The neighbours whose word is fresh."""
    return [n.robot for n in state.neighbours if n.age_s is not None and n.age_s < LATELY_S]
