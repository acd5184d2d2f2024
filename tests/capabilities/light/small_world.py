"""Two robots that both want light, in steps so few that all that can happen to their words can be gone through.

The state machine and the proof are the kernel's. All else is as bad as it may be: a robot that is free changes its lamp
in each step, words come or do not, late or in their turn, one robot may start anew or be switched off.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

from agent.capabilities.light.lease import (
    Baseline,
    Party,
    ack_to,
    acquainted,
    ask,
    baseline,
    hear,
    lit_by,
    release,
    said_lease,
    tick,
    verdict,
)
from agent.core.capability_messages import LampNow, Lease, Light, Why

STEP_NS, GUARD_NS = 50_000_000, 100_000_000
HOLDS_S = 0.6  # twelve steps: some runs are still sweeping when it is over
SWEEP = 2  # steps
WAITS = 4  # steps, for words after a sweep


class Sweep(NamedTuple):
    before: Baseline
    begun: int  # step
    ended: int | None = None
    after_seq: int = 0


class Mind(NamedTuple):
    """One robot."""

    party: Party
    seq: int = 0
    power: float = 0.0
    changes: int = 0
    changed: int = -9  # steps ago, at most -9; the truth, which nobody is told
    sweep: Sweep | None = None
    off: bool = False  # switched off: dark for good


class World(NamedTuple):
    minds: tuple[Mind, ...]
    said: tuple[tuple[Light, ...], ...]  # the last two of each, not older than the newest that arrived
    events: int  # that may still happen
    kept: int = 0


WAYS = ("nothing", "oldest", "newest")
EVENTS = (None, "restart", "off")


def start(events: int = 1) -> World:
    minds = tuple(Mind(Party(name, 1, (other,))) for name, other in ("ab", "ba"))
    return World(minds, ((), ()), events)


def after(world: World, now: int) -> Iterator[World]:
    """All worlds that can be one step later. Raises AssertionError for a sweep that counts and should not."""
    events = EVENTS if world.events else (None,)
    for ways in product(WAYS, repeat=2):
        if any(way != "nothing" and not world.said[1 - k] for k, way in enumerate(ways)):
            continue
        for event in events:
            yield _stepped(world, ways, event, now)


def straight(world: World, now: int) -> World:
    """The one a step later in which nothing goes wrong."""
    ways = tuple("newest" if world.said[1 - k] else "nothing" for k in (0, 1))
    return _stepped(world, ways, None, now)


def _stepped(world: World, ways: tuple[str, ...], event: str | None, now: int) -> World:
    minds, said, kept = list(world.minds), list(world.said), world.kept
    if event == "restart":
        minds[1] = Mind(Party("b", minds[1].party.incarnation + 1, ("a",), now * STEP_NS), changed=now)
        said[1] = ()
    elif event == "off":
        minds[1] = _lit(minds[1]._replace(off=True), 0.0, now)
    for k, way in enumerate(ways):
        queue = said[1 - k]
        if way != "nothing" and queue:
            word = queue[0] if way == "oldest" else queue[-1]
            minds[k] = minds[k]._replace(party=hear(minds[k].party, word, now * STEP_NS))
            said[1 - k] = tuple(each for each in queue if each.seq > word.seq)
    for k in (0, 1):
        minds[k], counts = _thinks(minds[k], now)
        if counts is not None:
            kept += 1
            for mind in minds:
                assert not counts.begun < mind.changed <= (counts.ended or 0), (minds, counts)
        minds[k] = minds[k]._replace(seq=minds[k].seq + 1)
        said[k] = (*said[k], _word(minds[k], "ab"[1 - k], now))[-2:]
    return World(tuple(minds), tuple(said), world.events - (event is not None), kept)


def _thinks(mind: Mind, now: int) -> tuple[Mind, Sweep | None]:
    """One step of a robot, and the sweep that it took to count."""
    now_ns, counts = now * STEP_NS, None
    party = tick(mind.party, GUARD_NS, now_ns)
    sweep = mind.sweep
    if sweep is not None and sweep.ended is None and now - sweep.begun >= SWEEP:
        sweep = sweep._replace(ended=now - 1, after_seq=mind.seq + 1)
    if sweep is not None and sweep.ended is not None:
        found = verdict(party, sweep.before, _lamp(mind, now), sweep.after_seq)
        if found == "kept":
            counts = sweep
        if found != "pending" or now - sweep.ended > WAITS:
            sweep, party = None, release(party, now_ns)
    idle = party.phase == "free" and sweep is None and not mind.off and counts is None
    if idle and acquainted(party, now_ns):
        party = ask(party, Lease(0, 5, HOLDS_S, False, (0.0, 0.0, 0.0), (("a", 1.0), ("b", 1.0))), now_ns)
    mind = mind._replace(party=party, sweep=sweep)
    if mind.off or sweep is not None:
        return mind, counts
    before = mind
    mind = _lit(mind, _power(mind, now), now)
    if party.phase == "holds" and mind == before:  # its own lamp is as the lease says already, and at rest
        found = baseline(party, _lamp(mind, now), now_ns)
        if not isinstance(found, str):
            mind = mind._replace(sweep=Sweep(found, now))
    return mind, counts


def _power(mind: Mind, now: int) -> float:
    party = mind.party
    if party.bound is not None:
        return dict(party.bound.lease.lamps).get(party.me, 0.0)
    if party.phase == "holds":
        return 1.0 if party.me in lit_by(party) else 0.0
    return 0.25 if mind.power == 0.5 else 0.5  # free: it moves about


def _lit(mind: Mind, power: float, now: int) -> Mind:
    return mind if power == mind.power else mind._replace(power=power, changes=mind.changes + 1, changed=now)


def _lamp(mind: Mind, now: int) -> LampNow:
    return LampNow(mind.power, 0.0, 0.0, mind.changes, now > mind.changed)


def _word(mind: Mind, to: str, now: int) -> Light:
    return word(mind.party, to, mind.seq, now * STEP_NS, _lamp(mind, now), "off" if mind.off else "")


def word(party: Party, to: str, seq: int, now_ns: int, lamp: LampNow, dark: Why = "") -> Light:
    """What a robot tells a neighbour of its lease, and of the neighbour's."""
    heard = party.word(to)
    fields = {}
    if (lease := said_lease(party, now_ns)) is not None:
        fields["lease"] = lease
    if (ack := ack_to(party, to, dark)) is not None:
        fields["ack"] = ack
    return Light(
        fleet="tank",
        src=party.me,
        dst=to,
        incarnation=party.incarnation,
        seq=seq,
        sent_ns=0,
        lamp=lamp,
        heard=None if heard is None else (heard.said.incarnation, heard.said.seq),
        **fields,
    )
