"""The fleet recorder: all of a fleet's traffic, bytes unchanged, also when it is killed. On the wall: nobody dives."""

import errno
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import zenoh

import replay.recorder
from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.config import ConfigError, Fleet, dump
from agent.core.messages import MAX_PAYLOAD, Estimate, LogLine, State
from agent.core.topics import LINK, STATE
from agent.process.transport import Transport
from replay.files.channels import ON_NETWORK, Entry
from replay.files.log import Limits, LogWriter, info, read
from replay.files.mcap_file import Part
from router_config.settings import peer_config
from tests.network.recorder_thread import StartRecorder, heard_everywhere
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}
MENDED_S = 240.0  # a recording is mended at the lowest priority: beside a load that took 33 s


def test_every_row_is_recorded_as_it_was_sent(
    make_fleet: Callable[..., Fleet],
    estimate: Callable[..., Estimate],
    state: Callable[..., State],
    start_recorder: StartRecorder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 60.0)  # both will be there, however busy this machine is
    fleet = make_fleet(PAIR)
    out = tmp_path / "fleet.mcap"
    recorder = start_recorder(fleet, out)
    said, shown = [], []
    line = LogLine(robot="r2", sent_ns=5, level="info", text="here")
    with Transport(fleet, "r1", time.time_ns) as r1, Transport(fleet, "r2", time.time_ns) as r2:
        for seq in range(60):
            said.append(estimate("r1", "r2", seq))
            shown.append(state("r2", seq))
            r1.say(said[-1])
            r2.show(shown[-1])
            r2.show(line)
            time.sleep(0.02)  # as robots do: a burst may be lost
    until(lambda: len(recorder.recorded("/alive/")) == 4)  # the last that is told: two came, two went
    counts = recorder.end()
    records = list(read(out))
    key = topics.key(LINK, fleet="test", src="r1", dst="r2")
    links = [item for item in records if item.channel == f"/zenoh/{key}"]
    states = [item for item in records if item.channel == f"/zenoh/{topics.key(STATE, fleet='test', robot='r2')}"]
    assert len(links) > 20
    assert [item.data for item in links] == [encode(message) for message in said[-len(links) :]]
    assert [item.publish_time_ns for item in links] == [message.sent_ns for message in said[-len(links) :]]
    assert [item.sequence for item in links] == [message.seq for message in said[-len(links) :]]
    assert all(item.log_time_ns >= item.publish_time_ns for item in links)
    assert [item.data for item in states] == [encode(message) for message in shown[-len(states) :]]
    assert counts["link"] == len(links)
    assert counts["state"] == len(states)
    assert counts["log"] > 20
    assert counts["alive"] == 4
    assert (counts["not decoded"], counts["overrun"]) == (0, 0)
    about = info(out)
    assert about.complete
    assert about.run["fleet"] == "test"
    assert about.attachments["fleet.toml"] == dump(fleet)
    assert about.channels[f"/zenoh/{key}"].metadata == {"encoding": encoding(Estimate), "schema": "aucamp.Estimate"}
    alive = [item.data for item in records if "/alive/" in item.channel]
    assert sorted(alive) == [b'{"alive":false}'] * 2 + [b'{"alive":true}'] * 2
    assert recorder.warnings == []


def test_a_robot_that_the_fleet_file_lacks_is_told_of(
    make_fleet: Callable[..., Fleet],
    estimate: Callable[..., Estimate],
    start_recorder: StartRecorder,
    tmp_path: Path,
) -> None:
    fleet = make_fleet(PAIR)
    alone = msgspec.structs.replace(fleet, robot={"r1": msgspec.structs.replace(fleet.robot["r1"], neighbours=())})
    recorder = start_recorder(alone, tmp_path / "fleet.mcap")
    with Transport(fleet, "r1", time.time_ns) as r1:

        def told() -> bool:
            r1.say(estimate("r1", "r2", 1))
            return bool(recorder.warnings)

        until(told)
    recorder.end()
    assert recorder.warnings == [
        "r2 is of this fleet, and its file lacks it; give the fleet file that the agents were started with"
    ]


def test_strangers_are_counted_and_bad_payloads_kept(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    fleet = make_fleet({"r1": ()})
    out = tmp_path / "fleet.mcap"
    recorder = start_recorder(fleet, out)
    key = topics.key(STATE, fleet="test", robot="r1")
    block = zenoh.CongestionControl.BLOCK
    with zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r1"))) as r1:
        heard_everywhere(r1, "test")
        r1.put(key, bytes(MAX_PAYLOAD + 1), encoding=encoding(State), congestion_control=block)
        r1.put(key.replace("state", "opinion"), b"x", congestion_control=block)
        r1.delete(key, congestion_control=block)
        r1.put(key, b"no msgpack \xc1", encoding=encoding(State), congestion_control=block)
        until(lambda: recorder.recorded("/state"))  # what was sent before it has come too
    counts = recorder.end()
    assert {name: count for name, count in counts.items() if count} == {
        "state": 1,
        "not decoded": 1,
        "too large": 1,
        "unknown key": 1,
        "not a put": 1,
    }
    assert [item.data for item in read(out) if item.channel.startswith(ON_NETWORK)] == [b"no msgpack \xc1"]


def test_viewer_channels_follow_what_robots_show(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    fleet = make_fleet({"r1": ()})
    out = tmp_path / "fleet.mcap"
    recorder = start_recorder(fleet, out)
    with Transport(fleet, "r1", time.time_ns) as r1:
        shown = msgspec.structs.replace(state("r1"), posterior_m=(0.1, 0.2, 0.3), knows="told")

        def recorded() -> bool:
            r1.show(shown)
            return len(recorder.recorded("/state")) > 5

        until(recorded)
    counts = recorder.end()
    channels = info(out).channels
    for name, schema in (("/r1/target/estimate", "foxglove.PoseInFrame"), ("/r1/plot/protocol", "aucamp.Protocol")):
        assert (channels[name].schema, channels[name].messages) == (schema, counts["state"])
    assert channels["/plot/clock"].messages == channels["/raw/clock"].messages > 0


def test_a_full_disk_ends_the_recording_and_not_the_swarm(
    make_fleet: Callable[..., Fleet], estimate: Callable[..., Estimate], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    fleet = make_fleet(PAIR)
    out = tmp_path / "fleet.mcap"
    with Transport(fleet, "r1", time.time_ns) as r1, Transport(fleet, "r2", time.time_ns) as r2:

        def hears() -> bool:
            r1.say(estimate("r1", "r2", time.monotonic_ns()))
            return bool(r2.drain()[0])

        until(hears)
        full = Limits(floor_bytes=2**62, floor_share=1.0)  # any disk is too full for this
        recorder = start_recorder(fleet, out, limits=full)
        with pytest.raises(ConfigError, match=r"recording stopped: .* make room there"):
            recorder.counts()
        r2.drain()
        until(hears)
    assert info(out).end["cause"] == "disk_floor"


def test_a_recording_that_cannot_be_finished_is_no_success(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder = start_recorder(make_fleet({"r1": ()}), tmp_path / "fleet.mcap")
    until((tmp_path / "fleet.mcap.active").exists)
    monkeypatch.setattr(Part, "finish", full)
    with pytest.raises(ConfigError, match="recording stopped: No space left on device"):
        recorder.end()


def test_silence_is_told_once_and_leaves_no_file(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 0.1)
    recorder = start_recorder(make_fleet(PAIR), tmp_path / "fleet.mcap")
    until(lambda: recorder.warnings)
    time.sleep(0.4)  # for a second one, which does not come
    assert not any(recorder.end().values())
    assert len(recorder.warnings) == 1
    assert "nobody of fleet 'test' is heard yet: r1 at tcp/127.0.0.1:" in recorder.warnings[0]
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_one_line(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    out = tmp_path / "fleet.mcap"
    out.write_text("precious")
    with pytest.raises(ConfigError, match="exists already"):
        start_recorder(make_fleet(PAIR), out).end()
    assert out.read_text() == "precious"


@pytest.mark.timeout(2 * MENDED_S + 60)
def test_a_recorder_that_was_killed_goes_on_under_the_next_name(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    out = tmp_path / "fleet.mcap"
    with LogWriter(out, {"kind": "fleet"}) as log:
        log.put(Entry("/zenoh/x", 1, 1, 1, b"x", "msgpack", {}))
    (tmp_path / "fleet.mcap.active").write_bytes(out.read_bytes()[:-100])
    out.unlink()
    fleet = make_fleet({"r1": ()})
    recorder = start_recorder(fleet, out)
    with Transport(fleet, "r1", time.time_ns):
        until((tmp_path / "fleet.recovered.mcap").exists, MENDED_S)
        until(lambda: any("1 messages kept" in line for line in recorder.warnings), MENDED_S)
        until(lambda: any("/alive/" in item.channel for item in read(tmp_path / "fleet.2.mcap.active")))
    recorder.end()
    assert f"this one is {tmp_path / 'fleet.2.mcap'}" in recorder.warnings[0]
    assert info(tmp_path / "fleet.2.mcap").complete
    assert [record.data for record in read(tmp_path / "fleet.recovered.mcap")] == [b"x"]


@pytest.mark.parametrize(
    "left", [("fleet.mcap.active", "fleet.recovered.mcap"), ("fleet.mcap", "fleet.part002.mcap.active")]
)
def test_so_does_one_whose_file_is_mended_already_and_one_that_was_killed_in_a_later_part(
    make_fleet: Callable[..., Fleet], start_recorder: StartRecorder, tmp_path: Path, left: tuple[str, str]
) -> None:
    for name in left:
        (tmp_path / name).touch()
    fleet = make_fleet({"r1": ()})
    recorder = start_recorder(fleet, tmp_path / "fleet.mcap")
    with Transport(fleet, "r1", time.time_ns):
        until(lambda: (file := tmp_path / "fleet.2.mcap.active").exists() and any(read(file)), MENDED_S)
    recorder.end()
    assert info(tmp_path / "fleet.2.mcap").complete
