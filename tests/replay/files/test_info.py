"""What `aucamp replay info` says of a recording."""

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from agent.clock.clock import SystemClock
from agent.core.codec import decode, encode
from agent.core.config import ConfigError
from agent.core.messages import LogLine
from replay.files.channels import CLOCK, Entry
from replay.files.info import ClockRate, Moment, Pace, RateNotes, describe, in_dive, info, moment, pace
from replay.files.log import LogWriter, read
from replay.files.recover import recover
from replay.story import info_all
from tests.replay.paced_clock import PacedClock
from tests.replay.small_box import START_NS, STEPS, write_box


def test_one_screen_says_what_is_in_a_black_box(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    text = describe(path, info(path))
    assert text.splitlines()[0] == str(path)
    assert "finished, clean" in text
    assert "attached fleet.toml, calibration.toml" in text
    assert f"{STEPS:>9}    20.0" in text  # steps, at their rate: not remarked upon
    assert "expected" not in text
    assert "(foxglove.CompressedImage)" in text
    assert len(text.splitlines()) < 30


def test_missing_messages_and_wrong_rates_are_told(tmp_path: Path) -> None:
    path = tmp_path / "fleet.mcap"
    key = "/zenoh/aucamp/tank/robot/r1/state"
    with LogWriter(path, {"kind": "fleet", "fleet": "tank"}) as log:
        for n in range(20):
            if n not in (4, 5, 9):
                log.put(Entry(key, n * 1_000_000_000, 0, n, b"x", "msgpack", {}))
    about = info(path)
    assert about.channels[key].gaps == 3
    row = next(line for line in describe(path, about).splitlines() if key in line)
    assert row.split() == ["17", "0.8", "0.0", "3", key, "expected", "5", "Hz"]


def test_a_torn_file_is_called_so(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    path.write_bytes(path.read_bytes()[:-40])
    about = info(path)
    assert not about.complete
    assert about.torn_bytes > 0
    assert f"but {about.torn_bytes} bytes in it cannot be read" in describe(path, about)
    path.write_bytes(path.read_bytes()[:200_000])
    assert "`aucamp replay recover` mends it" in describe(path, info(path))


def test_programs_get_the_same(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    lines: list[str] = []
    info_all([path], True, lines.append)
    (facts,) = map(json.loads, lines)
    assert facts["complete"] is True
    assert facts["channels"]["/raw/step_in"]["messages"] == STEPS
    assert facts["channels"]["/raw/step_in"]["hz"] == pytest.approx(20.0)
    assert facts["run"]["sha256.fleet.toml"]


def test_a_recording_of_somebody_else_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/chatter", "json", 0), 1, b"{}", 1)
        writer.finish()
    assert "written by something else" in describe(path, info(path))
    assert "/chatter" in describe(path, info(path))
    with pytest.raises(ConfigError, match="cannot be read"):
        info(tmp_path / "none.mcap")


# --- clock rate ---
# Notes of how fast a clock goes, as they are made and as they are read.

WALL_NS = START_NS - 10**12


def noted(dive_s: float, rate: float = 1.0, wall_s: float | None = None) -> Moment:
    """A moment so long after the twin's clock began; on the wall as well, if not said otherwise."""
    wall_ns = WALL_NS + round((dive_s if wall_s is None else wall_s) * 1e9)
    return Moment(START_NS + round(dive_s * 1e9), ClockRate(rate=rate, dive_s=dive_s, wall_ns=wall_ns))


@pytest.mark.parametrize("rate", [0.25, 1.0, 2.3])
def test_there_are_two_notes_a_second_of_the_clock_and_each_ties_it_to_the_wall(rate: float) -> None:
    clock = PacedClock(START_NS, rate)
    notes, entries = RateNotes(clock, clock.unix_ns), []
    for _ in range(200):
        entries += notes.due()
        clock.go_on(0.05)
    assert [entry.sequence for entry in entries] == list(range(20))
    for entry in entries:
        assert (entry.channel, entry.metadata) == (CLOCK.name, {"schema": CLOCK.schema})
        told = decode(entry.data, ClockRate)
        dive_s = (entry.log_time_ns - START_NS) * 1e-9
        assert (told.rate, told.dive_s) == (rate, pytest.approx(dive_s))
        assert (told.wall_ns - clock.started_unix_ns) * 1e-9 == pytest.approx(dive_s / rate, abs=1e-6)


def test_who_asks_seldom_gets_one_note_and_no_arrears() -> None:
    clock = PacedClock(START_NS, 5.0)
    notes = RateNotes(clock, clock.unix_ns)
    assert len(notes.due()) == 1
    clock.go_on(3.0)
    assert [len(notes.due()) for _ in range(3)] == [1, 0, 0]


def test_by_the_systems_clock_the_wall_is_what_it_says_and_there_is_no_dive() -> None:
    (entry,) = RateNotes(SystemClock()).due()
    told = decode(entry.data, ClockRate)
    assert (told.rate, told.dive_s) == (1.0, None)
    assert abs(told.wall_ns - entry.log_time_ns) < 1e9
    assert pace([Moment(entry.log_time_ns, told), Moment(entry.log_time_ns + 10**9, told)]) is None


def test_a_pace_goes_from_the_first_to_the_last_moment_of_the_dive() -> None:
    before = Moment(START_NS - 10**9, ClockRate(rate=1.0, dive_s=None, wall_ns=0))
    moments = [noted(45.0, 2.2, 30.0), before, noted(0.0, 1.0), noted(20.0, 0.9)]
    assert [each.noted.dive_s for each in in_dive(moments)] == [0.0, 20.0, 45.0]
    went = pace(moments)
    assert went == pytest.approx((45.0, 30.0, 0.9, 2.2))
    assert str(went) == "45.0 s of dive in 30.0 s, 1.50 times real time (0.90 to 2.20)"
    assert str(Pace(8.0, 8.0, 0.999, 1.001)) == "8.0 s of dive in 8.0 s, 1.00 times real time"


def test_a_wall_that_was_set_back_gives_no_pace() -> None:
    assert pace([]) is None
    assert pace([noted(1.0)]) is None
    assert pace([noted(1.0), noted(2.0, wall_s=-5.0)]) is None


def test_what_does_not_decode_is_no_moment() -> None:
    line = encode(LogLine(robot="r1", sent_ns=1, level="info", text="not what this channel is for"))
    assert moment(1, b"\xc1") is moment(1, line) is None


def test_info_says_how_the_clock_went(tmp_path: Path) -> None:
    path = write_box(tmp_path, pace=2.0)
    went = info(path).pace
    assert went is not None
    assert (went.dive_s, went.wall_s, went.slowest, went.fastest) == pytest.approx((1.95, 0.975, 2.0, 2.0), abs=1e-6)
    assert f"  {went}\n" in describe(path, info(path))
    printed: list[str] = []
    info_all([path], True, printed.append)
    assert json.loads(printed[0])["pace"] == went._asdict()
    with LogWriter(tmp_path / "fleet.mcap", {"kind": "fleet"}) as log:
        log.put(RateNotes(SystemClock()).due()[0])
    assert info(log.path).pace is None
    assert "real time" not in describe(log.path, info(log.path))


def test_a_torn_recording_keeps_its_notes(tmp_path: Path) -> None:
    whole = write_box(tmp_path, pace=2.0)
    notes = [record for record in read(whole) if record.channel == CLOCK.name]
    assert len(notes) == 5
    torn = tmp_path / "torn.mcap.active"
    torn.write_bytes(whole.read_bytes()[:-100])
    result = recover(torn)
    assert result.out is not None
    assert [record for record in read(result.out) if record.channel == CLOCK.name] == notes
