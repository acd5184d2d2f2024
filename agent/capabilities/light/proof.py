"""Whether any lamp changed while a sweep ran: by numbers that go up alone, never by a clock.

Before the sweep: of each neighbour that was heard of late the newest word, which says that its lamp is steady, and how
often it had changed. After it: a word of the same start, with the same count, of somebody who had heard what this robot
said after the last frame. What lies between has then seen no change. A lamp that was told to change and did not yet is
not steady, and one that will change has counted it before it does.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from agent.capabilities.light.lease import GONE_NS, Party, acquainted
from agent.core.capability_messages import LampNow

Verdict = Literal["pending", "kept"]


class Mark(NamedTuple):
    """A neighbour's lamp as it was before the sweep."""

    incarnation: int
    changes: int
    power: float


class Baseline(NamedTuple):
    """All lamps as a sweep begins."""

    since_ns: int
    own_changes: int
    marks: tuple[tuple[str, Mark], ...]  # by name


class Spoiled(NamedTuple):
    """Why a sweep does not count."""

    reason: str


def baseline(party: Party, own: LampNow, now_ns: int) -> Baseline | str:
    """What a sweep that begins now starts from; or whose lamp is still to come to rest."""
    if not own.steady:
        return party.me
    if not acquainted(party, now_ns):
        return next(name for name in party.neighbours if party.word(name) is None)
    marks = []
    for name, word in party.words:
        if now_ns - word.arrived_ns > GONE_NS:
            continue
        lamp = word.said.lamp
        if not lamp.steady:
            return name
        marks.append((name, Mark(word.said.incarnation, lamp.changes, lamp.power)))
    return Baseline(now_ns, own.changes, tuple(marks))


def verdict(party: Party, before: Baseline, own: LampNow, after_seq: int) -> Verdict | Spoiled:
    """Whether a sweep counts that ended before this robot said its word number `after_seq`."""
    if own.changes != before.own_changes:
        return Spoiled("its own lamp changed")
    marks, pending = dict(before.marks), False
    for name, word in party.words:
        mark, said = marks.get(name), word.said
        if said.lamp.cannot == "no lamp":
            continue
        if mark is None:
            if word.arrived_ns > before.since_ns:
                return Spoiled(f"{name} was not heard of before, and its lamp may have changed")
            continue
        if said.incarnation != mark.incarnation:
            return Spoiled(f"{name} was started anew")
        if said.lamp.changes != mark.changes:
            whose = said.lamp.burns_for
            return Spoiled(f"the lamp of {name} changed" + (f", for {whose}" if whose not in (None, party.me) else ""))
        heard = said.heard
        pending = pending or heard is None or heard[0] != party.incarnation or heard[1] < after_seq
    return "pending" if pending else "kept"
