"""Bytes into every decoder, one after the other, and what came out that should not."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random

from tests.fuzz import cases
from tests.fuzz.decoder import Decoder, bytes_for
from tests.fuzz.decoders import decoders
from tests.fuzz.kernel.episode import crash
from tests.fuzz.kernel.invariants import Broken
from tests.fuzz.shrink import shrink

SLICE = 500  # payloads for one decoder, then it is the next one's turn
HANGS_S = 5  # of the processor, for one payload
TRIES = 400


def run(
    count: int,
    seed: int,
    say: Callable[[str], object],
    keep: bool = True,
    until_s: float | None = None,
    names: tuple[str, ...] = (),
) -> tuple[dict[str, Broken], int]:
    """`count` payloads into each decoder, or as many as fit before a moment of time.monotonic: (what was broken, how
    many payloads each decoder got).

    names: beginnings of the names of decoders; none: all.
    """
    found: dict[str, Broken] = {}
    chosen = [each for each in decoders() if not names or each.name.startswith(names)]
    pools: dict[str, list[bytes]] = {each.name: [] for each in chosen}
    done = 0
    while done < count and (until_s is None or time.monotonic() < until_s):
        for one in chosen:
            name = f"{seed}/{one.name}/{done}"
            with mute():
                broken = list(
                    _slice(one, pools[one.name], Random(name), max(round(min(SLICE, count - done) * one.share), 1))
                )
            for payload, fault in broken:
                if f"{one.name}: {fault.name}" not in found:
                    found[f"{one.name}: {fault.name}"] = fault
                    say(f"{one.name}: {fault.name}: {fault.detail} [{name}]")
                    if keep:
                        say(f"  {_kept(one, payload, fault, name)}")
        done += min(SLICE, count - done)
    return found, done


def _slice(one: Decoder, pool: list[bytes], rng: Random, count: int) -> Iterator[tuple[bytes, Broken]]:
    for _ in range(count):
        payload = bytes_for(one, pool, rng)
        started_s = time.perf_counter()
        fault = broken(one, payload)
        if (taken_s := time.perf_counter() - started_s) > one.slow_s:  # perhaps something else was busy
            started_s = time.process_time()
            broken(one, payload)
            taken_s = time.process_time() - started_s
        if fault is not None:
            yield payload, fault
        elif taken_s > one.slow_s:
            yield payload, Broken("slow", f"{taken_s:.2f} s for {len(payload)} bytes")


def broken(one: Decoder, payload: bytes) -> Broken | None:
    """What a payload does to a decoder that it should not."""
    try:
        with within(HANGS_S):
            one.take(payload)
    except Late as error:
        return Broken("hangs", f"{error}, {len(payload)} bytes")
    except AssertionError as error:
        return Broken(str(error).partition("\n")[0], f"{len(payload)} bytes")
    except Exception as error:  # noqa: BLE001 - whatever it is, it would have ended somebody
        return crash(error)
    return None


def _kept(one: Decoder, payload: bytes, fault: Broken, seed: str) -> str:
    def fails(part: list[int]) -> bool:
        again = broken(one, bytes(part))
        return again is not None and again.name == fault.name

    with mute():
        small = bytes(shrink(list(payload), fails, TRIES))
    return f"{len(small)} bytes are enough: {cases.write_bytes(one.name, small, fault, seed).name}"


class Late(BaseException):
    """Not to be caught by what is judged."""


@contextmanager
def within(seconds: int) -> Iterator[None]:
    """Raise Late in a block that computes for longer, however busy the machine is."""

    def late(*_: object) -> None:
        raise Late(f"longer than {seconds} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@contextmanager
def mute() -> Iterator[None]:
    """Keep libjpeg's own remarks, which go past Python, off the screen."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
