"""Where robots listen: which of them belong to this computer, and whether their ports are free."""

from __future__ import annotations

import errno
import ipaddress
import os
from collections.abc import Iterator
from pathlib import Path

from agent.core.config import Fleet
from agent.ground.finding import Finding
from agent.process.ports import addresses_of, bind_error


def is_here(listen: str) -> bool | None:
    """Whether an endpoint of a fleet file is an address of this computer; None: there is no such host."""
    found = addresses_of(listen)
    if not found:
        return None
    family, (host, _, *rest) = found[0]
    return bind_error((family, (host, 0, *rest))) is None  # port 0: any that is free


def address_finding(fleet: Fleet, name: str, path: Path, asked: bool) -> Finding:
    """About one robot's endpoint. `asked`: for this robot alone, so that it should be here."""
    listen = fleet.robot[name].listen
    here = is_here(listen)
    if here is None:
        return Finding("wrong", name, f"{listen}: no such host; write the computer's address as a number")
    if not here and asked:
        text = f"{listen} is no address of this computer; check {name} on its own, or write one of this computer's"
        return Finding("wrong", name, text)
    if not here:
        return Finding("ok", name, f"{listen} is another computer's; see there: aucamp check {path} --robot {name}")
    return port_finding(name, listen)


def port_finding(name: str, listen: str) -> Finding:
    """Whether a port of this computer is free. Nothing listens there meanwhile, so that nobody dials us."""
    found = addresses_of(listen)
    refused = bind_error(found[0]) if found else None
    if refused is None:
        return Finding("ok", name, f"{listen} is this computer's, and free")
    if refused == errno.EADDRINUSE:
        text = f"{listen} is in use: {name}'s agent runs already, or another program; end it, or take another port"
        return Finding("warning", name, text)
    return Finding("wrong", name, f"{listen}: {os.strerror(refused)}; take another port")


def loopback_findings(fleet: Fleet) -> Iterator[Finding]:
    """Robots of several computers of which one listens where every computer finds itself."""
    alone = {name: _is_loopback(robot.listen) for name, robot in fleet.robot.items()}
    if any(alone.values()) and not all(alone.values()):
        for name in (name for name, at_home in alone.items() if at_home):
            text = f"{fleet.robot[name].listen} is every computer's own; write the address that others reach it by"
            yield Finding("warning", name, f"{text}, for not all robots are there")


def _is_loopback(listen: str) -> bool:
    found = addresses_of(listen)
    return bool(found) and all(ipaddress.ip_address(str(address[0])).is_loopback for _, address in found)


def links(fleet: Fleet) -> Iterator[Finding]:
    """Whether a word of any robot can come to all others."""
    names = list(fleet.robot)
    reached, new = {names[0]}, {names[0]}
    while new:
        new = {other for name in new for other in fleet.robot[name].neighbours} - reached
        reached |= new
    apart = [name for name in names if name not in reached]
    if apart:
        text = f"no word comes from {names[0]} to {', '.join(apart)}; give somebody a neighbour there"
        yield Finding("warning", "fleet", text)
    else:
        count = sum(len(robot.neighbours) for robot in fleet.robot.values()) // 2
        links_ = "one link" if count == 1 else f"{count} links"
        text = f"{links_}, and a word of any robot comes to all others" if count else "one robot, on its own"
        yield Finding("ok", "fleet", text)
