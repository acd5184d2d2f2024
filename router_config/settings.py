"""Fleet file -> Zenoh configuration, access rules and metadata of one process. Pure: text in, text out.

The base files in router_config/ are JSON5 whose only liberty over JSON is whole lines of // comment. What differs from
process to process is laid over them here: endpoints, and in a secured fleet certificates and access rules. The graph of
the swarm is the set of `connect` endpoints.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from agent.core import topics
from agent.core.config import Fleet
from agent.core.trust import common

# --- access rules ---
# Who may do what to whom in a secured fleet: Zenoh's access rules of one process. Pure.
#
# They follow from the table of keys and from `[access]`.
#
# What comes in is allowed by name, as certificates say it, and all else is denied; what goes out is a process's own,
# and one rule. Zenoh applies a rule to what somebody declares only if the rule's key holds the whole of it: who may
# look, may look at `aucamp/**`, since that is what people type, and gets this fleet's messages alone.

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


# --- metadata of a process ---
# What a process says of itself to who looks at its links: its name, its version, and digests of what it goes by.
#
# Two that are linked and do not understand each other have different files or versions, and these show which.

OPEN = "none"  # the rules of an open fleet
UNKNOWN = "unknown"  # the version of a tree that is not installed


def metadata(fleet: Fleet, name: str) -> dict[str, str]:
    """Of the process `name`, by this fleet file: what a process with another copy of the file compares."""
    robot = fleet.robot.get(name)
    pose = None if robot is None or robot.behaviour is not None else robot.pose
    return {
        "fleet": fleet.fleet,
        "name": name,
        "version": version(),
        "file": common(fleet),
        "rules": rules(fleet, name),
        **({} if pose is None else {"pose": f"{pose.x_m:g} {pose.y_m:g} {pose.yaw_deg:g}"}),
    }


def rules(fleet: Fleet, name: str) -> str:
    """Digest of the access rules of `name`: 16 hexadecimal digits of SHA-256."""
    if not fleet.secured:
        return OPEN
    text = json.dumps(access_control(fleet, name), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def version() -> str:
    """Of this package."""
    try:
        return importlib.metadata.version("aucamp")
    except importlib.metadata.PackageNotFoundError:
        return UNKNOWN


# --- settings of a session ---

# Where consoles find the router. Below 32768, as every port of ours: those above are ephemeral source ports.
ROUTER_LISTEN = "tcp/127.0.0.1:17447"
ROUTER_LISTEN_SECURED = "tls/127.0.0.1:17447"
ROUTER = "router"  # its name in a secured fleet


def peer_config(fleet: Fleet, robot: str, keys: Path | None = None) -> str:
    """Configuration of `robot`: listens on its own endpoint and dials neighbours, nobody else.

    Of two neighbours the one whose name comes later dials; it goes on trying, so the order of starting does not
    matter. Two that dial each other after an outage turn down each other's link, for seconds or for good.

    `keys`, here and below: the folder of a secured fleet's certificates on this computer.
    """
    own = fleet.robot[robot]
    return _config(
        "peer.json5",
        fleet,
        robot,
        keys,
        listen=[own.listen],
        connect=[fleet.robot[name].listen for name in own.neighbours if name < robot],
    )


def observer_config(fleet: Fleet, name: str = "observer", keys: Path | None = None) -> str:
    """Configuration of a process that looks at every robot, or orders about every robot, and that no robot dials."""
    return _config("observer.json5", fleet, name, keys, connect=_every_robot(fleet))


def router_config(fleet: Fleet, listen: str = ROUTER_LISTEN, keys: Path | None = None) -> str:
    """Configuration of the router, which dials every robot and listens for clients."""
    return _config("router.json5", fleet, ROUTER, keys, listen=[listen], connect=_every_robot(fleet))


def client_config(router: str) -> str:
    """Configuration of a session in somebody else's network, by their router; it must be there, and is dialled again
    when it was away."""
    return json.dumps(
        {
            "mode": "client",
            "connect": {"endpoints": [router], "timeout_ms": 2000, "exit_on_failure": True},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"shared_memory": {"enabled": False}},
        }
    )


def tls(keys: Path, name: str) -> dict[str, Any]:
    """Who a process is on its links, and whom it lets in: the files of `name`, which are both server's and client's."""
    own = {"certificate": str(keys / f"{name}.pem"), "private_key": str(keys / f"{name}.key")}
    return {
        "root_ca_certificate": str(keys / "ca.pem"),
        "enable_mtls": True,
        **{f"{end}_{part}": file for end in ("listen", "connect") for part, file in own.items()},
        "verify_name_on_connect": True,
        # A certificate that expires in the middle of a dive must not end it; `aucamp check` says it in time.
        "close_link_on_expiration": False,
    }


def _config(
    base: str,
    fleet: Fleet,
    name: str,
    keys: Path | None,
    listen: Sequence[str] | None = None,
    connect: Sequence[str] = (),
) -> str:
    differences: dict[str, Any] = {"connect": {"endpoints": list(connect)}, "metadata": metadata(fleet, name)}
    if listen is not None:
        differences["listen"] = {"endpoints": list(listen)}
    if fleet.secured:
        if keys is None or not keys.is_absolute():
            raise ValueError(f"{name} of a secured fleet needs the full path of its folder of keys, not {keys}")
        differences["transport"] = {"link": {"tls": tls(keys, name)}}
        differences["access_control"] = access_control(fleet, name)
    return _over(base, differences)


def _every_robot(fleet: Fleet) -> list[str]:
    return [robot.listen for robot in fleet.robot.values()]


def _over(base: str, differences: dict[str, Any]) -> str:
    """The base file with the differences laid over it, as JSON text."""
    text = resources.files("router_config").joinpath(base).read_text(encoding="utf-8")
    lines = (line for line in text.splitlines() if not line.lstrip().startswith("//"))
    return json.dumps(_merge(json.loads("\n".join(lines)), differences))


def _merge(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(under)
    for name, value in over.items():
        below = merged.get(name)
        merged[name] = _merge(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged
