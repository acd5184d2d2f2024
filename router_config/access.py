"""Who may do what to whom in a secured fleet: Zenoh's access rules of one process. Pure.

They follow from the table of keys and from `[access]`.

What comes in is allowed by name, as certificates say it, and all else is denied; what goes out is a process's own, and
one rule. Zenoh applies a rule to what somebody declares only if the rule's key holds the whole of it: who may look, may
look at `aucamp/**`, since that is what people type, and gets this fleet's messages alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from agent.core import topics
from agent.core.config import Fleet

Rule = dict[str, Any]

EVERYTHING = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
ADMIN = "@/**"  # where Zenoh shows who is linked with whom
IN, OUT = "ingress", "egress"


class _Party(NamedTuple):
    name: str
    rules: Sequence[Rule]  # that hold for it beside those for everybody who is named at all


def access_control(fleet: Fleet, me: str) -> dict[str, Any]:
    """The rules of `me`: a robot, an observer or a console of the fleet file. Who is not named here is believed
    nothing and told nothing."""
    parties = list(_at_robot(fleet, me) if me in fleet.robot else _at_watcher(fleet, me))
    # Tokens have names in them and nothing else: who is up, and who is there twice.
    for_all = [
        _rule("out", OUT, EVERYTHING, topics.EVERY_FLEET),
        _rule("tokens", IN, ("declare_liveliness_subscriber", "liveliness_query"), topics.EVERY_FLEET),
    ]
    rules = {rule["id"]: rule for rule in (*for_all, *(rule for party in parties for rule in party.rules))}
    common = [rule["id"] for rule in for_all]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": list(rules.values()),
        "subjects": [{"id": party.name, "cert_common_names": [party.name]} for party in parties],
        "policies": [
            {"rules": [*common, *(rule["id"] for rule in party.rules)], "subjects": [party.name]} for party in parties
        ],
    }


def _at_robot(fleet: Fleet, me: str) -> Iterator[_Party]:
    """Neighbours tell a robot what is for it; observers look; consoles look and order."""
    spoken = [row for row in topics.TOPICS if row.writer == "src"]
    for name in fleet.robot[me].neighbours:
        said = [topics.key(row, fleet=fleet.fleet, src=name, dst=me, target="**") for row in spoken]
        asked = [topics.key(row, fleet=fleet.fleet, src="*", dst=name, target="**") for row in spoken]
        hears = _rule(f"hears:{name}", IN, ("declare_subscriber",), *asked)
        yield _Party(name, (_says(name, said), hears, _alive(fleet, name)))
    for name in fleet.access.observers:
        yield _Party(name, (_look(),))
    for name in fleet.access.consoles:
        ask = topics.ORDER.format(fleet=fleet.fleet, robot="*", console=name)
        shows = (
            _rule("admin:asked", IN, ("query",), ADMIN),
            _rule("admin:told", OUT, ("reply", "declare_queryable"), ADMIN),
        )
        yield _Party(name, (_look(), _rule(f"orders:{name}", IN, ("query",), ask), *shows))


def _at_watcher(fleet: Fleet, me: str) -> Iterator[_Party]:
    """A robot is believed on its own keys, a console has its orders answered; who looks through a router, looks."""
    for name in fleet.robot:
        said = [topics.key(row, **{**topics.ANYBODY, "fleet": fleet.fleet, row.writer: name}) for row in topics.TOPICS]
        yield _Party(name, (_says(name, said), _alive(fleet, name), *_answers(fleet, me, name)))
    if me not in fleet.access.consoles:
        for name in (*fleet.access.observers, *fleet.access.consoles):
            if name != me:
                yield _Party(name, (_look(),))


def _answers(fleet: Fleet, me: str, robot: str) -> Iterator[Rule]:
    """What a console takes from a robot that it orders about, or whose links it looks at."""
    if me in fleet.access.consoles:
        own = topics.ORDER.format(fleet=fleet.fleet, robot=robot, console=me)
        # A robot declares that it answers all consoles, in one word.
        everybody = topics.ORDER.format(fleet=fleet.fleet, robot=robot, console="*")
        yield _rule(f"answers:{robot}", IN, ("reply",), own)
        yield _rule(f"answering:{robot}", IN, ("declare_queryable",), everybody)
        yield _rule("admin:asks", OUT, ("query",), ADMIN)
        yield _rule("admin:hears", IN, ("reply", "declare_queryable"), ADMIN)


def _says(name: str, keys: Sequence[str]) -> Rule:
    return _rule(f"says:{name}", IN, ("put", "delete"), *keys)


def _alive(fleet: Fleet, name: str) -> Rule:
    """It may say that it is up, and that it sees another one twice."""
    up = topics.ALIVE.format(fleet=fleet.fleet, robot=name, session="*")
    twice = topics.TWICE.format(fleet=fleet.fleet, robot="*", witness=name)
    return _rule(f"alive:{name}", IN, ("liveliness_token",), up, twice)


def _look() -> Rule:
    return _rule("look", IN, ("declare_subscriber",), topics.EVERY_FLEET)


def _rule(name: str, flow: str, messages: Sequence[str], *keys: str) -> Rule:
    """Permission for these messages on these keys, as they come in or go out."""
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}
