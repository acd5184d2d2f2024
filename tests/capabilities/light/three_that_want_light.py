"""Three robots that want light again and again; their words come, but late, in the order in which they were said."""

import random
from typing import NamedTuple

from agent.capabilities.light.lease import (
    TENTH_NS,
    Party,
    acquainted,
    ask,
    hear,
    may_have,
    release,
    tick,
)
from agent.core.capability_messages import LampNow, Lease
from tests.capabilities.light.small_world import STEP_NS, word

GUARD_NS, RETRY_NS = 300_000_000, 200_000_000
NAMES = ("r1", "r2", "r3")
WANTS_S = 8.0


class Turns(NamedTuple):
    """What came of it."""

    held: dict[str, int]  # steps in which each had the light
    shared: int  # steps in which two had it


def turns(seed: int, seconds: int, latest_steps: int) -> Turns:
    """Each has the light for one to six seconds, and wants it again within three."""
    rng = random.Random(seed)
    parties = {name: Party(name, 1, tuple(other for other in NAMES if other != name)) for name in NAMES}
    on_the_way = {(src, dst): [] for src in NAMES for dst in NAMES if src != dst}
    waits_ns, ends_ns, retry_ns = (dict.fromkeys(NAMES, 0) for _ in range(3))
    held, shared = dict.fromkeys(NAMES, 0), 0
    for step in range(seconds * 1_000_000_000 // STEP_NS):
        now_ns = step * STEP_NS
        for (_, dst), words in on_the_way.items():
            while words and words[0][0] <= step:
                parties[dst] = hear(parties[dst], words.pop(0)[1], now_ns)
        for name in NAMES:
            before, party = parties[name].phase, tick(parties[name], GUARD_NS, now_ns)
            if party.phase == "holds" != before:
                ends_ns[name] = now_ns + rng.randrange(1_000_000_000, 6_000_000_000)
            if before == "asks" and party.phase == "free":
                retry_ns[name] = now_ns + RETRY_NS
            if party.phase == "holds" and now_ns >= ends_ns[name]:
                party, waits_ns[name] = release(party, now_ns), now_ns
                retry_ns[name] = now_ns + RETRY_NS + rng.randrange(3_000_000_000)
            if party.phase == "free" and now_ns >= retry_ns[name] and acquainted(party, now_ns):
                waited = min((now_ns - waits_ns[name]) // TENTH_NS, 600)
                if may_have(party, name, WANTS_S, now_ns):
                    party = ask(party, Lease(0, waited, WANTS_S, False, (1.0, 1.0, 0.1), (("r1", 1.0),)), now_ns)
            parties[name] = party
            held[name] += party.phase == "holds"
            for neighbour in party.neighbours:
                words = on_the_way[name, neighbour]
                arrives = max(step + rng.randint(1, latest_steps), words[-1][0] if words else 0)
                words.append((arrives, word(party, neighbour, step, now_ns, LampNow())))
        shared += sum(party.phase == "holds" for party in parties.values()) > 1
    return Turns(held, shared)
