"""The configurations, read back from Zenoh: it swallows keys it does not know, so writing them proves nothing."""

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.codec import encoding
from agent.core.config import Access, ConfigError, Fleet
from agent.core.messages import MAX_PAYLOAD, State
from agent.core.topics import STATE
from router_config import settings
from router_config.session import Sample, Session, unusable
from router_config.settings import metadata, observer_config, peer_config
from tests.waiting import until

CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {path: value}
    return {k: v for name, part in value.items() for k, v in leaves(part, f"{path}/{name}".lstrip("/")).items()}


def accepted(text: str, path: str) -> Any:
    """What Zenoh holds at a path after it has read the text."""
    value = json.loads(str(zenoh.Config.from_json5(text)))
    for name in path.split("/"):
        value = value[name]
    return value


@pytest.mark.parametrize("base", ["peer.json5", "observer.json5", "router.json5"])
def test_every_key_of_a_base_file_is_known_to_zenoh_and_differs_from_its_default(base: str) -> None:
    text = resources.files("router_config").joinpath(base).read_text()
    default = leaves(json.loads(str(zenoh.Config())))
    mine = leaves(json.loads(settings._over(base, {})))
    assert mine
    for path, value in mine.items():
        assert accepted(text, path) == value, path
        assert default.get(path) != value, path


def test_of_two_neighbours_the_later_named_dials(make_fleet: Callable[..., Fleet]) -> None:
    fleet = make_fleet(CHAIN)
    text = settings.peer_config(fleet, "r2")
    assert accepted(text, "mode") == "peer"
    assert accepted(text, "listen/endpoints") == [fleet.robot["r2"].listen]
    assert accepted(text, "connect/endpoints") == [fleet.robot["r1"].listen]
    assert accepted(text, "metadata") == metadata(fleet, "r2")
    assert accepted(settings.peer_config(fleet, "r1"), "connect/endpoints") == []
    assert accepted(settings.peer_config(fleet, "r3"), "connect/endpoints") == [fleet.robot["r2"].listen]


def test_what_keeps_a_swarm_alive(make_fleet: Callable[..., Fleet]) -> None:
    fleet = make_fleet(CHAIN)
    for text in (settings.peer_config(fleet, "r2"), settings.observer_config(fleet), settings.router_config(fleet)):
        assert accepted(text, "connect/timeout_ms") == -1
        assert accepted(text, "connect/exit_on_failure") is False
        assert accepted(text, "connect/retry/period_init_ms") == 100
        assert accepted(text, "scouting/multicast/enabled") is False
        assert accepted(text, "scouting/gossip/enabled") is False
        assert accepted(text, "scouting/delay") == 10
        assert accepted(text, "transport/link/tx/lease") == 2000
        assert accepted(text, "transport/link/rx/max_message_size") == 65536
        assert accepted(text, "transport/shared_memory/enabled") is False
    assert accepted(settings.peer_config(fleet, "r2"), "timestamping/enabled") is True


def test_who_looks_dials_every_robot(make_fleet: Callable[..., Fleet]) -> None:
    fleet = make_fleet(CHAIN)
    everyone = [robot.listen for robot in fleet.robot.values()]
    assert accepted(settings.observer_config(fleet), "connect/endpoints") == everyone
    assert accepted(settings.observer_config(fleet), "listen/endpoints") == []
    assert accepted(settings.router_config(fleet, "tcp/127.0.0.1:17448"), "connect/endpoints") == everyone
    assert accepted(settings.router_config(fleet, "tcp/127.0.0.1:17448"), "listen/endpoints") == ["tcp/127.0.0.1:17448"]
    assert accepted(settings.router_config(fleet), "mode") == "router"


def secured(fleet: Fleet) -> Fleet:
    robots = {name: replace(robot, listen=robot.listen.replace("tcp/", "tls/")) for name, robot in fleet.robot.items()}
    return replace(fleet, robot=robots, access=Access(keys="keys", consoles=("ann",)))


def test_certificates_and_rules_are_as_zenoh_has_them(make_fleet: Callable[..., Fleet]) -> None:
    fleet, keys = secured(make_fleet(CHAIN)), Path("/keys")
    for text, name in (
        (settings.peer_config(fleet, "r2", keys), "r2"),
        (settings.observer_config(fleet, "ann", keys), "ann"),
        (settings.observer_config(fleet, "recorder", keys), "recorder"),
        (settings.router_config(fleet, "tls/127.0.0.1:17448", keys), "router"),
    ):
        ours, theirs = json.loads(text), accepted(text, "transport/link/tls")
        assert {key: theirs[key] for key in ours["transport"]["link"]["tls"]} == ours["transport"]["link"]["tls"]
        assert theirs["enable_mtls"] is True and theirs["close_link_on_expiration"] is False
        assert theirs["connect_certificate"] == theirs["listen_certificate"] == f"/keys/{name}.pem"
        rules, taken = ours["access_control"], accepted(text, "access_control")
        assert (taken["enabled"], taken["default_permission"]) == (True, "deny")
        for part in ("rules", "subjects", "policies"):
            assert len(taken[part]) == len(rules[part]) > 0
            for mine, its in zip(rules[part], taken[part], strict=True):
                assert {key: its[key] for key in mine} == mine


def test_a_secured_fleet_has_no_configuration_without_its_keys(make_fleet: Callable[..., Fleet]) -> None:
    fleet = secured(make_fleet(CHAIN))
    for keys in (None, Path("keys")):
        with pytest.raises(ValueError, match="needs the full path of its folder of keys"):
            settings.peer_config(fleet, "r1", keys)


# --- door ---
# The door to the network: what passes it, what is turned away, and that opening it fails in one line.


class Arriving:
    """So much of a sample of Zenoh's as the door looks at."""

    key_expr = "a/key"

    def __init__(self, kind: object = zenoh.SampleKind.PUT, encoding: str = encoding(State), size: int = 1) -> None:
        self.kind, self.encoding, self.payload = kind, encoding, zenoh.ZBytes(bytes(size))


@pytest.mark.parametrize(
    ("sample", "reason", "of_any_encoding"),
    [
        (Arriving(), None, None),
        (Arriving(size=MAX_PAYLOAD), None, None),
        (Arriving(size=MAX_PAYLOAD + 1), "too large", "too large"),
        (Arriving(encoding="text/plain"), "wrong encoding", None),
        (Arriving(encoding="text/plain", size=MAX_PAYLOAD + 1), "wrong encoding", "too large"),
        (Arriving(kind=zenoh.SampleKind.DELETE), "not a put", "not a put"),
    ],
)
def test_what_cannot_be_a_message_is_told_by_its_outside(
    sample: Arriving, reason: str | None, of_any_encoding: str | None
) -> None:
    assert unusable(Sample(sample), STATE) == reason
    assert unusable(Sample(sample), STATE, any_encoding=True) == of_any_encoding


def test_a_payload_and_a_token_come_through(make_fleet: Callable[..., Fleet]) -> None:
    fleet = make_fleet({"r1": ()})
    key, alive = (
        topics.key(STATE, fleet="test", robot="r1"),
        topics.ALIVE.format(fleet="test", robot="r1", session="1a"),
    )
    seen: list[tuple[str, str, int, bytes]] = []
    tokens: list[tuple[str, bool]] = []
    with Session(observer_config(fleet), "a test") as watch:
        watch.subscribe(
            topics.ALL.format(fleet="test"), lambda s: seen.append((s.key, s.encoding, s.size, s.payload()))
        )
        watch.watch_tokens(
            topics.ALIVE.format(fleet="test", robot="*", session="*"), lambda s: tokens.append((s.key, s.is_put))
        )
        with Session(peer_config(fleet, "r1"), "a test") as r1:
            publish = r1.publisher(STATE, key)
            r1.announce(alive)

            def arrived() -> bool:
                publish(b"hello")
                return bool(seen)

            until(arrived)
            until(lambda: tokens == [(alive, True)])
        until(lambda: tokens == [(alive, True), (alive, False)])
    assert set(seen) == {(key, encoding(State), 5, b"hello")}


def test_who_comes_later_is_told_of_tokens_that_are_there(make_fleet: Callable[..., Fleet]) -> None:
    fleet, tokens = make_fleet({"r1": ()}), []
    alive = topics.ALIVE.format(fleet="test", robot="r1", session="1a")
    with Session(peer_config(fleet, "r1"), "a test") as r1:
        r1.announce(alive)
        with Session(observer_config(fleet), "a test") as watch:
            watch.watch_tokens(alive, lambda sample: tokens.append(sample.is_put))
            until(lambda: tokens == [True])


def test_a_session_that_cannot_be_opened_is_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^robot 'r1': zenoh cannot open it: ") as caught, Session("{", "robot 'r1'"):
        pass
    assert "\n" not in str(caught.value)
