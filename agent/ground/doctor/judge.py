"""What a look at a running fleet means: one line for each thing that is not as it should be. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from msgspec import UNSET

from agent.core.config import Fleet
from agent.ground.battery import NEAR_V, SURFACES_V
from agent.ground.doctor.listening import LISTEN_S, Facts, Shown
from agent.ground.finding import Finding

Said = Mapping[str, str]  # by what robots of this fleet file would call themselves: metadata

SAME = "give all the same file, and start again those that had another"


def robot_findings(fleet: Fleet, facts: Facts, robots: Collection[str], expected: Mapping[str, Said]) -> list[Finding]:
    """About each robot that could be dialled. `expected`: what it would say of itself by our file and version."""
    found = [finding for name in robots for finding in _robot(fleet, facts, name, expected[name])]
    return [*found, *_strangers(fleet, facts)]


def _robot(fleet: Fleet, facts: Facts, name: str, expected: Said) -> Iterator[Finding]:
    link, state = facts.links.get(name), facts.states.get(name)
    if link is None and state is None:
        text = f"its port answers, but no link came about in {LISTEN_S:.0f} s: its agent hangs, or it is no agent"
        yield Finding("wrong", name, f"{text}; start it again, and look what listens there: ss -ltnp")
        return
    shown = facts.shown.get(link.session) if link is not None else None
    reasons = [
        *(_who(fleet, facts, name, link.session) if link is not None else ()),
        *(_differences(name, shown, expected) if shown is not None else ()),
    ]
    yield from reasons
    if state is None:
        if not any(reason.level == "wrong" for reason in reasons):  # else that is to be mended first
            yield _mute(fleet, facts, name, shown)
        return
    if lost := facts.lost.get(name):
        times = "" if lost == 1 else f" {lost} times"
        text = f"its link to us went{times} while we looked"
        yield Finding("warning", name, f"{text}: a bad cable or radio, or two agents of one name; look there")
    if state.mode != "running":
        yield Finding("warning", name, f"says that it is {state.mode}; its log says why")
    if state.battery_v is not UNSET and state.battery_v < NEAR_V:
        text = f"its battery is at {state.battery_v:.1f} V, and at {SURFACES_V:.1f} V its module surfaces; charge it"
        yield Finding("warning", name, text)
    yield from (Finding("warning", name, f"says of itself: {fault}") for fault in state.faults)


def _who(fleet: Fleet, facts: Facts, name: str, session: str) -> Iterator[Finding]:
    """Whether who listens where a robot should is that robot, and alone."""
    for agent in sorted(facts.agents):
        if agent.session != session:
            continue
        listen = fleet.robot[name].listen
        if agent.fleet != fleet.fleet:
            text = f"{agent.robot} of fleet '{agent.fleet}' listens at {listen}; write one name in both fleet files"
            yield Finding("wrong", name, text)
        elif agent.robot != name:
            text = f"{agent.robot} listens at {listen}; give each robot the address of its own computer, in all files"
            yield Finding("wrong", name, text)
    ours = [agent for agent in facts.agents if (agent.fleet, agent.robot) == (fleet.fleet, name)]
    if len(ours) > 1:
        yield Finding("wrong", name, f"{len(ours)} agents are called so; end all but one")


def _differences(name: str, shown: Shown, expected: Said) -> Iterator[Finding]:
    """What the robot goes by and we do not."""
    said = shown.metadata
    if "file" in said and said["file"] != expected["file"]:
        text = f"has another fleet file (its digest is {said['file']}, ours {expected['file']}): tank, targets, robots"
        yield Finding("wrong", name, f"{text} or estimation differ; {SAME}")
    if "rules" in said and said["rules"] != expected["rules"]:
        text = f"has other access rules (their digest is {said['rules']}, by our file {expected['rules']}): [access],"
        yield Finding("wrong", name, f"{text} neighbours or targets differ; {SAME}")
    if said.get("version") != expected["version"]:
        theirs = f"version {said['version']}" if "version" in said else "an older version"
        yield Finding("warning", name, f"runs {theirs}, and this is {expected['version']}; install one everywhere")


def _mute(fleet: Fleet, facts: Facts, name: str, shown: Shown | None) -> Finding:
    """Linked, and nothing comes."""
    if name in facts.unreadable:
        text = f"its states cannot be read ({facts.unreadable[name]}); use one version of aucamp everywhere"
        return Finding("wrong", name, text)
    nothing = f"is linked, but showed nothing in {LISTEN_S:.0f} s"
    announced = any(agent.session == facts.links[name].session for agent in facts.agents)
    if shown is not None or not fleet.secured:
        what = "its loop hangs, or is about to begin" if announced else "it is no agent, or is about to begin"
        return Finding("wrong", name, f"{nothing}: {what}; look again, then start it again")
    text = "its rules do not know us, or its loop hangs; give it this fleet file's [access], and start it again"
    return Finding("wrong", name, f"{nothing}: {text}")


def _strangers(fleet: Fleet, facts: Facts) -> Iterator[Finding]:
    """Agents that announce themselves through our links and are in no fleet file of ours."""
    known = {link.session for link in facts.links.values()}
    for agent in sorted(facts.agents):
        if agent.session not in known and agent.robot not in fleet.robot and agent.fleet == fleet.fleet:
            text = f"an agent calls itself {agent.robot}, and the file has no such robot; end it, or add it"
            yield Finding("warning", "fleet", text)
