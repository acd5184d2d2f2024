"""What can be fuzzed, each part with a turn, a count and a rate, so that all get their share of the time."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Literal

from agent.core.config import Protocol
from tests.fuzz import decoding
from tests.fuzz.decoders import decoders
from tests.fuzz.kernel.search import PROTOCOLS, Fuzzer, scenes
from tests.fuzz.kernel.whole_steps import STAGES, Watched
from tests.fuzz.readers import FUZZED

Name = Literal["kernel", "steps", "decoders", "wire", "firmware", "recordings", "all"]
Say = Callable[[str], object]
ELSEWHERE = {
    "wire": "tests.fuzz.host_bytes",
    "firmware": "tests.fuzz.firmware_bytes",
    "recordings": "tests.fuzz.recordings",
}
AT_ONCE = {"wire": 1000, "firmware": 1000, "recordings": 20}  # inputs of one call
SOCKETS = ("request", "reply", "frames")  # decoders that belong to the wire


class Part:
    """One part under way. `turn` goes on where the last turn ended."""

    of = "payloads for each decoder"

    def __init__(self, name: str, seed: int, say: Say) -> None:
        self.name, self.seed, self.say = name, seed, say
        self.done = self.faults = self.turns = 0
        self._taken_s = 0.0

    def turn(self, count: int, end_s: float) -> None:
        started_s = time.monotonic()
        self.turns += 1
        self.work(count, end_s)
        self._taken_s += time.monotonic() - started_s

    def work(self, count: int, end_s: float) -> None:
        raise NotImplementedError

    def rate(self) -> float:
        """Of what is counted, a second."""
        return self.done / max(self._taken_s, 1e-9)


class Kernel(Part):
    """Messages into the kernel of one protocol."""

    of = "messages"

    def __init__(self, protocol: Protocol, seed: int, say: Say, keep: bool) -> None:
        super().__init__(f"kernel {protocol}", seed, say)
        self._fuzzer, self._scenes = Fuzzer(seed, say, keep), scenes(protocol)

    def work(self, count: int, end_s: float) -> None:
        self._fuzzer.run(self._scenes, count, end_s)
        self.done, self.faults = self._fuzzer.messages, len(self._fuzzer.found)


class Steps(Part):
    """Messages into whole steps of five fleets, in turn, and the processor time that these take."""

    of = "messages"

    def __init__(self, seed: int, say: Say, keep: bool) -> None:
        super().__init__("steps", seed, say)
        self._fleets = [Watched(name, seed) for name in STAGES]
        self._told: set[str] = set()

    def work(self, count: int, end_s: float) -> None:
        for one in self._fleets:
            before = one.worst
            for broken in one.run(max(count // len(self._fleets), 1), end_s):
                self.faults += 1
                if broken.name not in self._told or "slow" in broken.name:
                    self._told.add(broken.name)
                    self.say(f"{broken.name}: {broken.detail} [seed {self.seed}]")
            if one.worst != before:
                self.say(f"  {one.told()}")
        self.done = sum(one.messages for one in self._fleets)


class Decoders(Part):
    """Payloads into each decoder of some names."""

    def __init__(self, names: tuple[str, ...], seed: int, say: Say, keep: bool) -> None:
        super().__init__("decoders", seed, say)
        self._names, self._keep, self._found = names, keep, set[str]()

    def work(self, count: int, end_s: float) -> None:
        found, done = decoding.run(count, self.seed * 1000 + self.turns, self.say, self._keep, end_s, self._names)
        self._found |= set(found)
        self.done, self.faults = self.done + done, len(self._found)


class Elsewhere(Part):
    """A file beside this one with `run(count, seed)`, which raises at the first fault."""

    of = "inputs"

    def __init__(self, name: str, seed: int, say: Say, keep: bool) -> None:
        super().__init__(name, seed, say)
        self._module = importlib.import_module(ELSEWHERE[name])

    def work(self, count: int, end_s: float) -> None:
        last, most = self.done + count, AT_ONCE[self.name]
        while self.done < last and time.monotonic() < end_s:
            step = min(most, last - self.done)
            seed = self.seed * 10**6 + self.done
            try:
                self._module.run(step, seed)
            except Exception as error:  # noqa: BLE001 - it is told with its seed, and the others go on
                self.faults += 1
                self.say(f"{self.name}: {type(error).__name__}: {error!s:.2000} [run({step}, {seed})]")
            self.done += step


def told() -> Iterator[str]:
    """Each decoder and part that reads bytes, and the functions of the product that it enters."""
    for name in (*(each.name for each in decoders()), *ELSEWHERE):
        yield f"{name}: {', '.join(FUZZED[name])}" if name in FUZZED else name


def refused(name: Name, only: Sequence[str]) -> str:
    """What is wrong with the beginnings of names that are asked for: they would fuzz nothing. Empty: nothing is."""
    if only and name not in ("decoders", "all"):
        return f"{name} takes no --only; leave it out"
    known = [each.name for each in decoders()]
    for beginning in only:
        if not any(one.startswith(beginning) for one in known):
            return f"--only {beginning}: no decoder begins so; choose from {', '.join(known)}"
    return ""


def chosen(name: Name, protocol: Protocol | None, only: tuple[str, ...] = ()) -> list[Callable[[int, Say, bool], Part]]:
    """How to begin each part of a name; those whose file is not there are left out of "all". `only`: beginnings of the
    names of decoders."""
    found: list[Callable[[int, Say, bool], Part]] = []
    if name in ("kernel", "all"):
        found += [partial(Kernel, each) for each in ([protocol] if protocol else PROTOCOLS)]
    if name in ("steps", "all"):
        found.append(Steps)
    if name in ("decoders", "all"):
        found.append(partial(Decoders, only))
    if name == "wire":
        found.append(partial(Decoders, SOCKETS))
    for other, module in ELSEWHERE.items():
        if name == other or (name == "all" and importlib.util.find_spec(module)):
            found.append(partial(Elsewhere, other))
    return found
