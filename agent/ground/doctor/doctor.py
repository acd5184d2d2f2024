"""`aucamp doctor`: a running fleet looked at from outside, from the ports inwards. What a port shows to be wrong is not
asked any further."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from msgspec import UNSET

from agent.core.config import Fleet
from agent.ground.addresses import is_here, loopback_findings
from agent.ground.certificates import certificate_findings
from agent.ground.check import OPEN, computer_findings, running_findings
from agent.ground.doctor.clocks import Offset, best, clock_finding
from agent.ground.doctor.diagnosis import Diagnosis
from agent.ground.doctor.judge import robot_findings
from agent.ground.doctor.listening import Facts, Looker, listen
from agent.ground.doctor.neighbours import neighbour_findings
from agent.ground.doctor.ports import is_open, port_findings, probe_all
from agent.ground.doctor.who import Who, who_looks
from agent.ground.finding import Finding
from agent.process.fleet_clock import fleet_clock
from agent.robot.fleet_reader import load_fleet
from agent.robot.rights import why_closed
from router_config.metadata import metadata
from router_config.session import observer_config


def examine(path: Path, name: str | None, folder: Path) -> Diagnosis:
    """Look at a running fleet as `name`, or as who_looks chooses. `folder`: where agents of this computer record.

    Raises ConfigError for a file that cannot be used and for a name that is not in it.
    """
    fleet = load_fleet(path)
    who = who_looks(fleet, path, name)
    found = (*_from_here(fleet, path, who, folder), *_from_outside(fleet, who))
    return Diagnosis(tuple(dict.fromkeys(found)), who.name)


def _from_here(fleet: Fleet, path: Path, who: Who, folder: Path) -> Iterator[Finding]:
    """What this computer has, as `aucamp check` sees it. Its ports are not asked for: an agent has them by now."""
    if not fleet.secured:
        yield Finding("ok", "fleet", OPEN)
    yield from loopback_findings(fleet)
    here = [robot for robot in fleet.robot if is_here(fleet.robot[robot].listen)]
    for robot in here:
        yield from running_findings(fleet, robot, path)
    if here:
        yield from computer_findings(here, folder)
    if who.name not in here:
        yield from certificate_findings(fleet, who.name, path)


def _from_outside(fleet: Fleet, who: Who) -> Iterator[Finding]:
    """What the network shows: ports and handshakes, then links and what comes over them."""
    probed = probe_all(fleet, who)
    for name in fleet.robot:
        yield from port_findings(fleet, name, probed[name])
    there = [name for name in fleet.robot if is_open(name, probed[name])]
    if not there:
        return
    if fleet.secured and (who.name in fleet.robot or not who.has_pair or who.trust is None):
        text = "ports and certificates alone were tried; the rest is shown to observers and consoles: --as NAME"
        yield Finding("ok", who.name, text)
        return
    asks = not fleet.secured or who.name in fleet.access.consoles
    looker = Looker(observer_config(fleet, who.name, who.keys), who.name, asks, not why_closed(fleet, who.name))
    facts = listen(fleet, looker, there, fleet_clock(fleet).now_ns)
    found = [
        *robot_findings(fleet, facts, there, {name: metadata(fleet, name) for name in there}),
        *neighbour_findings(fleet, facts, [name for name in there if name in facts.states]),
    ]
    offsets = {name: best(stamps) for name, stamps in facts.stamps.items()}
    for name, late_ns in facts.late_ns.items():
        if (finding := clock_finding(name, offsets.get(name), late_ns)) is not None:
            found.append(finding)
    yield from found
    ill = {finding.about for finding in found if finding.level == "wrong"}
    yield from (_in_order(facts, name, offsets.get(name)) for name in there if name in facts.states and name not in ill)


def _measured(offset: Offset, late_ns: int) -> Iterator[str]:
    yield f"there and back {offset.way_s * 1e3:.1f} ms, a state takes {late_ns * 1e-6 + offset.ahead_s * 1e3:.1f} ms"
    yield f"clock {offset.ahead_s * 1e3:+.1f} ms"


def _in_order(facts: Facts, name: str, offset: Offset | None) -> Finding:
    """What there is to say of a robot that is heard."""
    state = facts.states[name]
    hears = [found.robot for found in state.neighbours if found.age_s is not None]
    said: Sequence[str] = (
        "is linked and heard",
        f"hears {', '.join(hears)}" if hears else "hears nobody",
        *((f"motors {'on' if state.armed else 'off'}",) if state.armed is not None else ()),
        *((f"battery {state.battery_v:.1f} V",) if state.battery_v is not UNSET else ()),
        *(_measured(offset, facts.late_ns[name]) if offset else ()),
        *((f"believed not: {', '.join(f'{n} {kind}' for kind, n in state.refused.items())}",) if state.refused else ()),
    )
    return Finding("ok", name, "; ".join(said))
