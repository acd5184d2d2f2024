"""A chain of three robots, observers and consoles with certificates made for this run, and sessions that keep no rule.

What a session here may do is decided by whom it is linked to: its own configuration has a certificate and nothing else.
"""

import contextlib
import json
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.config import Access, Fleet
from agent.ground.new_fleet import make_all
from agent.process.certificates import authority, issue, write
from router_config.settings import tls

CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
CONSOLES = ("ann", "bob")
STRANGER = "eve"  # has a certificate by our authority, and stands in no fleet file
HERE = ("127.0.0.1",)
B = "aucamp/test"


def secure(fleet: Fleet, folder: Path) -> Fleet:
    """The same fleet on tls/, with its keys in `folder`."""
    robots = {name: replace(robot, listen=robot.listen.replace("tcp/", "tls/")) for name, robot in fleet.robot.items()}
    fleet = replace(fleet, robot=robots, access=Access(keys=str(folder), consoles=CONSOLES))
    make_all(fleet, folder)
    write(folder, STRANGER, issue(authority(folder), STRANGER, HERE))
    return fleet


def client(endpoint: str, keys: Path | None, name: str = "") -> zenoh.Config:
    """Whoever has a certificate, attached to one process; no `keys`: whoever has none."""
    config: dict[str, Any] = {"mode": "client", "connect": {"endpoints": [endpoint], "timeout_ms": 1500}}
    return _config(config, keys, name)


def peer(endpoint: str, keys: Path | None, name: str = "") -> zenoh.Config:
    """The same as a peer, as robots and observers are."""
    connect = {"endpoints": [endpoint], "timeout_ms": -1, "exit_on_failure": False, "retry": {"period_init_ms": 100}}
    return _config({"mode": "peer", "listen": {"endpoints": []}, "connect": connect}, keys, name)


def listener(endpoint: str, keys: Path | None, name: str) -> zenoh.Config:
    """Whoever has a certificate, where a robot would listen."""
    return _config({"mode": "peer", "listen": {"endpoints": [endpoint]}}, keys, name)


def _config(config: dict[str, Any], keys: Path | None, name: str) -> zenoh.Config:
    config["scouting"] = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    if keys is not None:
        config["transport"] = {"link": {"tls": tls(keys, name)}}
    return zenoh.Config.from_json5(json.dumps(config))


@contextlib.contextmanager
def opened(config: zenoh.Config | str) -> Iterator[zenoh.Session]:
    """A session of this configuration."""
    with zenoh.open(zenoh.Config.from_json5(config) if isinstance(config, str) else config) as session:
        yield session


class Ear:
    """All that comes through to a session: puts, tokens and orders, as (key, whose word it is)."""

    def __init__(self, session: zenoh.Session, keys: Sequence[str] = (topics.EVERY_FLEET,), orders: str = "") -> None:
        """`orders`: the key on which it answers them."""
        self.heard: set[tuple[str, str]] = set()
        self._lock = threading.Lock()
        remote = zenoh.Locality.REMOTE
        self._kept = [session.declare_subscriber(key, _direct(self._put), allowed_origin=remote) for key in keys]
        tokens = session.liveliness().declare_subscriber(topics.EVERY_FLEET, _direct(self._token), history=True)
        self._kept.append(tokens)
        if orders:
            self._kept.append(session.declare_queryable(orders, _direct(self._query)))

    def _put(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.heard.add((str(sample.key_expr), sample.payload.to_string()))

    def _token(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.heard.add((str(sample.key_expr), "token"))

    def _query(self, query: zenoh.Query) -> None:
        with self._lock:
            self.heard.add((str(query.key_expr), query.payload.to_string() if query.payload else ""))
        query.drop()


def _direct(call: Callable[[Any], None]) -> Any:
    return zenoh.handlers.Callback(call, indirect=False)


def message_keys() -> list[str]:
    """Every key on which the chain's robots say something, and some on which nobody should."""
    pairs = [("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2"), ("r1", "r3")]
    keys = []
    for row in topics.TOPICS:
        if row.writer == "src":
            keys += [topics.key(row, fleet="test", src=src, dst=dst) for src, dst in pairs]
        else:
            keys += [topics.key(row, fleet="test", robot=robot, console="ann") for robot in CHAIN]
    return keys


def token_keys(by: str) -> list[str]:
    """That each robot is up, and sees another twice; `by` in the chunk that is free, for tokens say nothing else."""
    up = [topics.ALIVE.format(fleet="test", robot=robot, session=f"0{by}") for robot in CHAIN]
    return up + [topics.TWICE.format(fleet="test", robot=f"0{by}", witness=robot) for robot in CHAIN]


def order_keys() -> list[str]:
    """Orders to each robot, and to all, by each console."""
    return [topics.ORDER.format(fleet="test", robot=robot, console=c) for robot in (*CHAIN, "*") for c in CONSOLES]


def say_everything(session: zenoh.Session, who: str) -> list[Any]:
    """Everything on every key, as `who`; what is returned is to be kept until it has arrived."""
    for key in message_keys():
        session.put(key, who, congestion_control=zenoh.CongestionControl.BLOCK)
    kept: list[Any] = [session.liveliness().declare_token(key) for key in token_keys(who)]
    return kept + [session.get(key, payload=who, timeout=1.0) for key in order_keys()]
