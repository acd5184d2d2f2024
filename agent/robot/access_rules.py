"""What may not be in `[access]`, and what it needs where robots listen on tls/."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agent.core.config import Fleet

AUTHORITY = "ca"  # whose files lie in the same folder


def broken_access_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    if fleet.access.keys == "":
        yield "access.keys", "no folder; write its name, or remove the key: then nothing is signed"
    if fleet.secured and fleet.access.keys is None:
        remedy = 'write keys = "keys", and make them with aucamp keys'
        yield "access.keys", f"robots listen on tls/, and no folder has their certificates; {remedy}"
    plain = [name for name, robot in fleet.robot.items() if robot.listen.startswith("tcp/")]
    secret = [name for name, robot in fleet.robot.items() if robot.listen.startswith("tls/")]
    if plain and secret:
        yield f"robot.{plain[0]}.listen", f"open, while {secret[0]} listens on tls/; write all of them one way"
    for name in secret:
        if "[" in fleet.robot[name].listen:  # Zenoh 1.10.2: the link never comes about, and nothing says why
            yield f"robot.{name}.listen", "no address of IPv6 can be dialled by TLS; write a name, or one of IPv4"
    if fleet.secured or fleet.access.consoles:  # else nobody has a certificate
        yield from _name_rules(fleet)


def _name_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Each name is one party's: it is what a certificate says."""
    whose = dict.fromkeys(fleet.robot, "a robot")
    if AUTHORITY in whose:
        yield f"robot.{AUTHORITY}", "is the name of the authority's files among the keys; call the robot otherwise"
    for key, names, kind in (
        ("access.observers", fleet.access.observers, "an observer"),
        ("access.consoles", fleet.access.consoles, "a console"),
    ):
        for name in names:
            if name == AUTHORITY:
                yield key, f"'{name}' is the name of the authority's files among the keys; take another"
            elif name in whose:
                yield key, f"'{name}' is {whose[name]} already; give each robot, observer and console its own name"
            whose[name] = kind
