"""What the recorder makes of what reaches it, without a network."""

import json
from pathlib import Path
from typing import NamedTuple

import msgpack
import pytest
from msgspec.structs import replace

import replay.files.log
import replay.recorder
from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.messages import MAX_PAYLOAD, NeighbourState, State
from agent.core.topics import STATE
from replay.files.channels import DROPS, NETWORK, PRESENCE, Entry, name
from replay.files.info import describe, info
from replay.files.log import LogWriter, read
from replay.recorder import Arrivals, show_all_of
from replay.viewers.viewer_channels import ViewerChannels
from tests.replay.small_box import FLEET, START_NS, state

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


def test_a_message_that_makes_trouble_is_recorded_counted_by_kind_and_told_once(
    arrivals: Arrivals, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def falls(*_: object) -> None:
        raise RecursionError("too deep")

    monkeypatch.setattr(replay.recorder, "decode", falls)
    for _ in range(3):
        arrivals.message(STATE, Arriving())
    assert [entry.data for entry in arrivals.drain()] == [DATA] * 3
    assert arrivals.counts["not decoded"] == 3
    assert arrivals.raised == {"raised RecursionError": 3}
    assert caplog.text.count("raised RecursionError: too deep") == 1
    assert json.loads(arrivals.not_recorded()) == {"overrun": 0, "raised RecursionError": 3}


def test_a_stranger_who_invents_keys_does_not_fill_the_file_with_channels(
    arrivals: Arrivals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay.recorder, "CHANNELS", 2)
    for number in range(5):
        arrivals.message(STATE, Arriving(key=KEY.replace("r1", f"r{number}")))
        arrivals.token(Arriving(key=ALIVE.replace("r1", f"r{number}"), data=b""))
    assert len(list(arrivals.drain())) == 2
    assert arrivals.refused == {"too many keys": 8}
    arrivals.message(STATE, Arriving(key=KEY.replace("r1", "r0")))
    assert len(list(arrivals.drain())) == 1


def test_a_flood_is_held_within_bounds_and_what_is_lost_is_in_the_file(
    arrivals: Arrivals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(3 * replay.recorder.BACKLOG_MESSAGES):
        arrivals.message(STATE, Arriving())
    assert len(arrivals._backlog) == replay.recorder.BACKLOG_MESSAGES
    monkeypatch.setattr(replay.files.log, "BACKLOG_MESSAGES", 10**6)
    path = tmp_path / "fleet.mcap"
    with LogWriter(path, {"kind": "fleet"}) as log:
        for entry in arrivals.drain():
            log.put(entry)
        log.at_end["not_recorded"] = arrivals.not_recorded()
    lost = 2 * replay.recorder.BACKLOG_MESSAGES
    notes = [msgpack.unpackb(record.data) for record in read(path) if record.channel == DROPS.name]
    assert [note["messages"] for note in notes] == [lost]
    assert f"of what came, not recorded or no message: overrun {lost}" in describe(path, info(path))


def test_the_view_goes_on_behind_a_message_that_makes_trouble(arrivals: Arrivals) -> None:
    shown: list[Entry] = []

    def derive(entry: Entry) -> list[Entry]:
        if entry.sequence == 1:
            raise RecursionError("odd")
        return [entry]

    entries = [_entry(state(START_NS, n))._replace(sequence=n) for n in range(3)]
    for entry in entries:
        show_all_of(entry, derive, shown.append, arrivals.trouble)
    assert shown == [entries[0], entries[2]]
    assert arrivals.raised == {"raised RecursionError": 1}


def test_names_that_a_robot_invents_make_no_channels_for_viewers() -> None:
    derive = ViewerChannels(FLEET)
    shown = state(START_NS, 7)
    invented = tuple(NeighbourState(robot=f"x{number}") for number in range(9))
    for said in (replace(shown, neighbours=(*shown.neighbours, *invented)), replace(shown, target="ghost")):
        made = {entry.channel for entry in derive(_entry(said))}
        assert made <= {entry.channel for entry in derive(_entry(shown))}


def _entry(said: State) -> Entry:
    return Entry(name(NETWORK, key=KEY), 0, 0, 0, encode(said), "msgpack", {})
