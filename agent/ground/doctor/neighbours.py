"""Who hears whom: what robots say of their neighbours, and whether those are linked at all. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from agent.core.config import Fleet
from agent.core.messages import NeighbourState
from agent.ground.doctor.listening import Facts
from agent.ground.finding import Finding

QUIET_S = 2.0  # without a word: as long as a link keeps without its other end
FEW = 50  # messages, below which a share of them says nothing
LOSSY = 0.05  # share of messages that did not arrive


def neighbour_findings(fleet: Fleet, facts: Facts, robots: Collection[str]) -> Iterator[Finding]:
    """About each two neighbours of which both were heard by us, for of others something worse has been said."""
    for a in robots:
        for b in fleet.robot[a].neighbours:
            if a < b and b in robots:
                yield from _pair(fleet, facts, a, b)


def _pair(fleet: Fleet, facts: Facts, a: str, b: str) -> Iterator[Finding]:
    deaf = [(one, other) for one, other in ((a, b), (b, a)) if _deaf(fleet, facts, one, other)]
    if deaf:
        one, other = deaf[0]
        who = f"{a} and {b} do not hear each other" if len(deaf) == 2 else f"{one} does not hear {other}"
        yield Finding("wrong", a, f"{who}: {_why(fleet, facts, a, b)}")
        return
    for one, other in ((a, b), (b, a)):
        heard = _of(facts, one, other)
        if heard is None or not facts.missed.get((one, other)) or heard.heard < FEW:
            continue  # what was missed once is history
        share = heard.gaps / (heard.heard + heard.gaps)
        if share > LOSSY:
            text = f"misses messages of {other}, {share:.0%} since both run: a thin or bad link, or [link] loss"
            yield Finding("warning", one, f"{text}; look at the network between them")


def _deaf(fleet: Fleet, facts: Facts, one: str, other: str) -> bool:
    heard = _of(facts, one, other)
    longest_s = max(QUIET_S, 3.0 / fleet.link.send_hz)
    return heard is None or heard.age_s is None or heard.age_s > longest_s


def _of(facts: Facts, one: str, other: str) -> NeighbourState | None:
    return next((found for found in facts.states[one].neighbours if found.robot == other), None)


def _why(fleet: Fleet, facts: Facts, a: str, b: str) -> str:
    """Of the two the later name dials the other."""
    if any(_of(facts, one, other) is None for one, other in ((a, b), (b, a))):
        return "one of them does not have the other as a neighbour; give both the same fleet file"
    ends = [facts.shown[facts.links[name].session] for name in (a, b) if _is_shown(facts, name)]
    sessions = {facts.links[name].session for name in (a, b) if name in facts.links}
    if not ends:
        return f"they have no link, or other rules; look from {b}'s computer: aucamp doctor FLEET --as {b}"
    if any(end.linked & sessions for end in ends):
        return "they are linked, so their rules or fleet files differ; give both the same, and start them again"
    where = fleet.robot[a].listen
    return f"no link: {b} dials {a} at {where}; look from {b}'s computer: aucamp doctor FLEET --as {b}"


def _is_shown(facts: Facts, name: str) -> bool:
    return name in facts.links and facts.links[name].session in facts.shown
