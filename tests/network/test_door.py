"""The door to the network: what passes it, what is turned away, and that opening it fails in one line."""

from collections.abc import Callable

import pytest
import zenoh

from agent.core import topics
from agent.core.codec import encoding
from agent.core.config import ConfigError, Fleet
from agent.core.messages import MAX_PAYLOAD, State
from agent.core.topics import STATE
from router_config.session import Sample, Session, unusable
from router_config.settings import observer_config, peer_config
from tests.waiting import until


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
