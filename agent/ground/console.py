"""Orders of a person at a terminal to the robots of a fleet that runs.

A console has a link to each robot, and counts which robots answered.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import msgspec
from msgspec.structs import replace

from agent.capabilities.light.allocate import EMPTY_V
from agent.clock import machine
from agent.core import topics
from agent.core.codec import Refusal, decode, encode, printable
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Answer, Arg, Order, State
from agent.core.robot_view import in_own_name
from agent.core.topics import STATE
from agent.core.verbs import CLOCK, URGENT, VERBS, arguments, prepare_all
from agent.process.certificates import credentials
from agent.process.command import meant
from agent.process.links import called_twice, unlisted
from agent.robot.fleet_reader import load_robot
from agent.robot.operator import why_closed
from hw.firmware.parameters import NAMES, TABLE
from router_config.session import Reply, Sample, Session, unusable
from router_config.settings import observer_config

ANSWER_S = 1.0  # a robot answers with its next step: 50 ms
HEARD_S = 2.0  # a link is there in less than one, and states come five times a second
AGAIN_S = 0.05  # nobody was there to ask: the link has just come, or has just gone

Basis = tuple[int, int]  # incarnation and sent_ns of the State by which a person decided


class Outcome(NamedTuple):
    """What became of an order at one robot."""

    answer: Answer | None  # none: it did not answer
    why: str = ""  # then: what is known of that
    took_s: float = 0.0  # from the order to the answer, or to giving up

    @property
    def ok(self) -> bool:
        return self.answer is not None and self.answer.ok


class OrderConsole:
    """Context manager. Entering raises ConfigError, one line, where this console may not order, or has no keys."""

    def __init__(self, fleet: Fleet, name: str, keys: Path | None = None) -> None:
        """keys: folder of a secured fleet's certificates."""
        self._fleet, self._name, self._keys = fleet, name, keys
        self._session_ns = machine.unix_ns()
        self._ids = itertools.count(self._session_ns)
        self._changed = threading.Condition()  # guards all below
        self._states: dict[str, State] = {}  # the newest of each robot
        self._there: set[str] = set()  # robots whose token is there
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        if why := why_closed(self._fleet, self._name):
            raise ConfigError(why)
        prepare_all()
        with contextlib.ExitStack() as stack:
            config = observer_config(self._fleet, self._name, self._keys)
            self._session = stack.enter_context(Session(config, f"console '{self._name}'"))
            anyone = {**topics.ANYBODY, "fleet": self._fleet.fleet}
            self._session.subscribe(topics.key(STATE, **anyone), self._heard)
            self._session.watch_tokens(topics.ALIVE.format(**anyone), self._token)
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._open.close()

    @property
    def robots(self) -> frozenset[str]:
        """Of the fleet file."""
        return frozenset(self._fleet.robot)

    def states(self) -> dict[str, State]:
        """The newest State of each robot that was heard, whichever target it is about."""
        with self._changed:
            return dict(self._states)

    def order(
        self,
        robots: Collection[str],
        verb: str,
        args: Mapping[str, Arg] | None = None,
        answer_s: float = ANSWER_S,
        heard_s: float = HEARD_S,
    ) -> dict[str, Outcome]:
        """Order these robots, and wait for all, as `orders` does."""
        return dict(self.orders(robots, verb, args, answer_s, heard_s))

    def orders(
        self,
        robots: Collection[str],
        verb: str,
        args: Mapping[str, Arg] | None = None,
        answer_s: float = ANSWER_S,
        heard_s: float = HEARD_S,
        everybody: bool = False,
        seen: Mapping[str, Basis] | None = None,
    ) -> Iterator[tuple[str, Outcome]]:
        """Order these robots, each as soon as it is heard; what became of it at each, as it comes: until `heard_s` for
        the first sign of a robot, and then `answer_s` for its answer. Raises Refusal for an order that cannot be.

        everybody: robots of this fleet that its file lacks are accounted for as well, and told to stop if this console
        is linked to them. seen: by which State of a robot the person decided; else by its newest when it is asked
        first. However often it is asked, the order goes by that one: what was held up on its way is refused.
        """
        arguments(verb, args or {})
        order = Order(id=next(self._ids), session=self._session_ns, verb=verb, args=args or {})
        start_s = machine.since_boot_s()
        asked = {robot: _Asked((seen or {}).get(robot)) for robot in robots}
        named = set(asked)
        while asked or (everybody and self._shows_nothing(named) and machine.since_boot_s() - start_s < heard_s):
            for robot in self._linked() - named if everybody and verb in URGENT else ():
                named.add(robot)
                asked[robot] = _Asked()
            for robot, one in asked.items():
                now_s = machine.since_boot_s()
                if verb not in URGENT and one.is_over(now_s, start_s, heard_s, answer_s):
                    continue
                if (sign := self._sign_of(robot, verb)) is not None and one.begin(now_s, sign):
                    self._ask(robot, replace(order, seen=one.seen), one, answer_s)
            now_s = machine.since_boot_s()
            with self._changed:
                for one in asked.values():
                    one.give_up(now_s, start_s, heard_s, answer_s)
                over = {robot: one.outcome for robot, one in asked.items() if one.outcome is not None}
                if not over:
                    self._changed.wait(AGAIN_S)
            for robot, outcome in over.items():
                del asked[robot]
                yield robot, outcome
        for robot in sorted(named & called_twice(fault for state in self.states().values() for fault in state.faults)):
            yield f"another {robot}", Outcome(None, f"two agents are called {robot}, and one was told nothing; end one")
        for robot, why in self._lacking().items() if everybody else ():
            if robot not in named:
                what = "it was told nothing; order by the file that it was started with"
                yield robot, Outcome(None, f"{why}, and this fleet file lacks it: {what}")

    def _linked(self) -> set[str]:
        """All that are heard, of the fleet file or not."""
        with self._changed:
            return self._there | self._states.keys()

    def _shows_nothing(self, robots: Collection[str]) -> bool:
        """Whether one of them is there and has not shown yet whom it hears."""
        with self._changed:
            return any(robot in self._there and robot not in self._states for robot in robots)

    def _lacking(self) -> dict[str, str]:
        """Robots of this fleet that its file lacks, and how that is known."""
        with self._changed:
            states = dict(self._states)
        heard = {
            one.robot: f"{name} hears it" for name, state in states.items() for one in state.neighbours if one.heard
        }
        linked = {
            robot: f"{name} is linked to it" for name, state in states.items() for robot in unlisted(state.faults)
        }
        found = {**linked, **heard, **dict.fromkeys(self._linked(), "it is heard")}
        return {robot: why for robot, why in found.items() if robot not in self._fleet.robot}

    def _sign_of(self, robot: str, verb: str) -> Basis | tuple[()] | None:
        """What an order to it says that was seen; None: nothing was, and it cannot be asked yet. What may come late
        needs nothing but that it is there."""
        with self._changed:
            if (state := self._states.get(robot)) is not None:
                return state.incarnation, state.sent_ns
            return () if robot in self._there and verb in (*URGENT, CLOCK) else None

    def _ask(self, robot: str, order: Order, asked: _Asked, answer_s: float) -> None:
        key = topics.ORDER.format(fleet=self._fleet.fleet, robot=robot, console=self._name)

        def replied(reply: Reply) -> None:
            with self._changed:
                if reply.key in ("", key):  # anybody may answer: believed is an answer of this robot, to this order
                    asked.hear(reply, robot, order, machine.since_boot_s())
                self._changed.notify()

        def over() -> None:
            with self._changed:
                asked.over(machine.since_boot_s())
                self._changed.notify()

        self._session.ask(Order, key, encode(order), answer_s, replied, over)

    def _heard(self, sample: Sample) -> None:
        row = topics.match(sample.key)
        if row is None or row[0] is not STATE or unusable(sample, STATE):
            return
        with contextlib.suppress(Refusal):
            state = in_own_name(*row, sample.payload())
            with self._changed:
                self._states[state.robot] = state
                self._changed.notify()

    def _token(self, sample: Sample) -> None:
        chunks = topics.chunks(topics.ALIVE, sample.key)
        if chunks is not None:
            with self._changed:
                (self._there.add if sample.is_put else self._there.discard)(chunks["robot"])
                self._changed.notify()


class _Asked:
    """One robot, while an order is under way."""

    def __init__(self, seen: Basis | None = None) -> None:
        self.seen = seen  # by which State it is ordered; once it was asked, for good
        self.outcome: Outcome | None = None
        self._first_s: float | None = None  # when it was asked first
        self._again_s = 0.0
        self._open = False  # a question is under way
        self._error = ""

    def begin(self, now_s: float, sign: Basis | tuple[()]) -> bool:
        """Whether it is to be asked now, and then it is. sign: what is seen of it now."""
        if self.outcome is not None or self._open or now_s < self._again_s:
            return False
        self._first_s, self._open = self._first_s or now_s, True
        self.seen = self.seen or sign or None
        return True

    def is_over(self, now_s: float, start_s: float, heard_s: float, answer_s: float) -> bool:
        """Whether it is too late for a question: this computer may have slept."""
        return now_s - start_s > heard_s if self._first_s is None else now_s - self._first_s >= answer_s

    def hear(self, reply: Reply, robot: str, order: Order, now_s: float) -> None:
        try:
            answer = decode(reply.payload, Answer) if reply.key else None
        except Refusal as refusal:
            answer, self._error = None, f"its answer cannot be read ({refusal}); use the same version of aucamp"
        if answer is not None and (answer.robot, answer.id) != (robot, order.id):
            self._error = f"{answer.robot} answered in its place; look who is linked: aucamp doctor"
        elif answer is not None and self.outcome is None:
            self.outcome = Outcome(answer, took_s=now_s - (self._first_s or now_s))
        elif reply.error:
            self._error = reply.error

    def over(self, now_s: float) -> None:
        """All answers have come; perhaps there was nobody to ask."""
        self._open, self._again_s = False, now_s + AGAIN_S

    def give_up(self, now_s: float, start_s: float, heard_s: float, answer_s: float) -> None:
        """Say so where nothing is to be expected any more."""
        if self.outcome is not None:
            return
        if not self.is_over(now_s, start_s, heard_s, answer_s):
            return
        if self._first_s is None:
            text = f"was not heard in {heard_s:g} s, and was told nothing: order again"
            self.outcome = Outcome(None, text, now_s - start_s)
        else:
            why = "" if self._error in ("", "Timeout") else f": {self._error}"
            text = f"did not answer within {answer_s:g} s{why}; the order may still act"
            self.outcome = Outcome(None, text, now_s - self._first_s)


# --- `aucamp order` ---
# `aucamp order`: what a person types becomes an order, and what robots answered becomes lines.

ALL = "all"


class Typed(NamedTuple):
    """An order, and whom it is for."""

    robots: tuple[str, ...]
    verb: str
    args: dict[str, Arg]
    everybody: bool = False  # not these by their names, but all that there are


NO_NUMBER = re.compile(r"expected `float[^`]*`, got `str`")


def typed(fleet: Fleet, fleet_path: Path, verb: str, words: Sequence[str]) -> Typed:
    """What stands behind the verb: names of robots, and NAME=VALUE. Raises ConfigError for what cannot be ordered."""
    names = [word for word in words if "=" not in word]
    pairs = [word.split("=", 1) for word in words if "=" in word]
    given = dict(pairs)
    for name, times in Counter(name for name, _ in pairs).items():
        if times > 1:
            raise ConfigError(f"{verb}: {printable(name)[:40]} is given {times} times; write it once")
    if not names and verb not in (*URGENT, CLOCK):
        raise ConfigError(f"{verb}: which robot? Write one of {', '.join(fleet.robot)}, or {ALL}")
    everybody = not names or ALL in names
    for name in names:
        if name != ALL:
            load_robot(fleet, name, fleet_path)
    fields = VERBS[verb].__struct_fields__ if verb in VERBS else ()
    for name in given.keys() - set(fields):
        takes = f"it takes {', '.join(fields)}" if fields else "it takes none"
        alike = next((field for field in fields if field.partition("_")[0] == name), None) or meant(name, fields)
        hint = f"did you mean {alike}? " if alike else ""
        raise ConfigError(f"{verb}: there is no argument '{printable(name)[:40]}'; {hint}{takes}")
    try:
        what = arguments(verb, given, strict=False)
    except Refusal as refusal:
        raise ConfigError(NO_NUMBER.sub("is no number; write one, such as 0.3", str(refusal))) from None
    whole = msgspec.to_builtins(what)
    args: dict[str, Arg] = {name: whole[name] for name in given}
    return Typed(tuple(fleet.robot) if everybody else tuple(dict.fromkeys(names)), verb, args, everybody)


def give(fleet: Fleet, fleet_path: Path, console: str, order: Typed) -> Iterator[tuple[str, Outcome]]:
    """Order, and say what became of it at each robot, as it comes. Raises ConfigError where this console may not."""
    if why := why_closed(fleet, console):
        raise ConfigError(f"{fleet_path}: {why}")
    with OrderConsole(fleet, console, credentials(fleet, console, fleet_path)) as link:
        yield from link.orders(order.robots, order.verb, order.args, everybody=order.everybody)


def line(robot: str, outcome: Outcome) -> str:
    """What became of it at one robot. The words are a stranger's, perhaps, and must not steer a terminal."""
    if outcome.answer is None:
        text = f"{robot}: {outcome.why}"
    else:
        what = f"does: {outcome.answer.order}" if outcome.ok else f"refuses: {outcome.answer.why}"
        text = f"{robot}: {what} ({1e3 * outcome.took_s:.0f} ms)"
    return printable(text)


def verdict(outcomes: Mapping[str, Outcome]) -> str:
    return f"{sum(outcome.ok for outcome in outcomes.values())} of {len(outcomes)}"


# --- battery limits ---
# When a robot's battery is called low, in volts at its control module.
#
# Both limits are others' own, those of four cells: below the one lamps stay dark, below the other the module
# surfaces. A module whose parameter `battery_min_mV` was changed surfaces by that one, which nobody here is told.

NEAR_V = EMPTY_V
SURFACES_V = TABLE[NAMES.index("battery_min_mV")][1] * 1e-3
