"""What the recorder makes of what reaches it, without a network."""

from typing import NamedTuple

import pytest

from agent.kernel import topics
from agent.kernel.codec import encode, encoding
from agent.kernel.messages import MAX_PAYLOAD
from agent.kernel.topics import STATE
from replay.files.channels import NETWORK, PRESENCE, name
from replay.recorder import Arrivals
from tests.replay.small_box import START_NS, state

KEY = topics.key(STATE, fleet="tank", robot="r1")
ALIVE = topics.ALIVE.format(fleet="tank", robot="r1", session="1a")
DATA = encode(state(START_NS, 7))


class Arriving(NamedTuple):
    """A sample as the door hands it over."""

    key: str = KEY
    is_put: bool = True
    encoding: str = encoding(STATE.message)
    data: bytes = DATA

    @property
    def size(self) -> int:
        return len(self.data)

    def payload(self) -> bytes:
        return self.data


@pytest.fixture
def arrivals() -> Arrivals:
    return Arrivals(lambda: START_NS + 5)


def test_a_message_has_its_senders_time_and_number_and_its_own_bytes(arrivals: Arrivals) -> None:
    arrivals.message(STATE, Arriving())
    (entry,) = arrivals.drain()
    assert entry[:5] == (name(NETWORK, key=KEY), START_NS + 5, START_NS, 7, DATA)
    assert (entry.encoding, entry.metadata) == (
        "msgpack",
        {"schema": "aucamp.State", "encoding": encoding(STATE.message)},
    )
    assert list(arrivals.drain()) == []


@pytest.mark.parametrize(("encoded", "data", "not_decoded"), [("text/plain", DATA, 0), ("x", b"no msgpack \xc1", 1)])
def test_what_says_another_encoding_is_kept_with_it(
    arrivals: Arrivals, encoded: str, data: bytes, not_decoded: int
) -> None:
    arrivals.message(STATE, Arriving(encoding=encoded, data=data))
    (entry,) = arrivals.drain()
    assert (entry.data, entry.metadata["encoding"]) == (data, encoded)
    assert (arrivals.counts["state"], arrivals.counts["not decoded"]) == (1, not_decoded)


def test_what_is_no_message_is_counted_and_not_kept(arrivals: Arrivals) -> None:
    arrivals.message(STATE, Arriving(is_put=False))
    arrivals.message(STATE, Arriving(data=bytes(MAX_PAYLOAD + 1)))
    arrivals.stranger(Arriving(key=KEY.replace("state", "opinion")))
    arrivals.stranger(Arriving())  # comes as a message as well
    assert list(arrivals.drain()) == []
    assert arrivals.refused == {"not a put": 1, "too large": 1, "unknown key": 1}


def test_who_comes_and_goes_stands_on_a_channel(arrivals: Arrivals) -> None:
    for is_put in (True, False):
        arrivals.token(Arriving(key=ALIVE, is_put=is_put, data=b""))
    entries = list(arrivals.drain())
    assert [entry.data for entry in entries] == [b'{"alive":true}', b'{"alive":false}']
    assert {(entry.channel, entry.encoding) for entry in entries} == {
        (name(PRESENCE, fleet="tank", robot="r1"), PRESENCE.encoding)
    }
    assert arrivals.counts["alive"] == 2
