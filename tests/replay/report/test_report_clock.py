"""How a dive's clock went, on the page of its run."""

import re
import shutil
from pathlib import Path

import pytest

from agent.clock.clock import SystemClock
from replay.check.reexecute import open_box
from replay.files.channels import Entry
from replay.files.info import RateNotes
from replay.files.log import info, read
from replay.files.mcap_file import Part
from replay.report.report import report
from replay.report.timeline import open_run
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.paced_clock import PacedClock


def noted(source: Path, out: Path) -> Path:
    """The recording with notes of a clock that goes at 2.4 times real time, and from the middle on at 1.6 times."""
    about, records = info(source), list(read(source))
    part = Part(out)
    part.start(about.run, about.attachments)
    clock = PacedClock(records[0].log_time_ns, 2.4)
    notes = RateNotes(clock, clock.unix_ns)
    for n, record in enumerate(records):
        if n == len(records) // 2:
            clock.change_rate(1.6)
        clock.go_on(max(0, record.log_time_ns - clock.now_ns()) * 1e-9)
        part.add(Entry(*record, "msgpack", {}))
        for note in notes.due():
            part.add(note)
    part.finish("aucamp.end", {"cause": "clean"})
    return out


def test_black_boxes_tell_how_it_went(tmp_path: Path) -> None:
    for name in ("r1", "r2", "r3"):
        noted(GOLDEN / "three" / f"{name}.mcap", tmp_path / f"{name}.mcap")
    page = report(tmp_path).read_text(encoding="utf-8")
    assert told(page) == told_of(tmp_path)
    assert page.index('id="links"') < page.index('id="clock"')
    assert page[page.index('<section id="clock">') :].count("<svg") == 1


def test_a_fleet_file_tells_it_too(tmp_path: Path) -> None:
    bare = overheard_run(GOLDEN / "three", tmp_path / "bare.mcap")
    page = report(noted(bare, tmp_path / "fleet.mcap")).read_text(encoding="utf-8")
    assert told(page) == told_of(tmp_path / "fleet.mcap")


def test_one_robots_notes_are_enough(tmp_path: Path) -> None:
    """As of a run of which one recording is older than notes."""
    noted(GOLDEN / "three" / "r1.mcap", tmp_path / "r1.mcap")
    shutil.copy(GOLDEN / "three" / "r2.mcap", tmp_path)
    assert 'id="clock"' in report(tmp_path).read_text(encoding="utf-8")


def test_recordings_without_notes_and_dives_by_the_systems_clock_say_nothing(tmp_path: Path) -> None:
    source = GOLDEN / "three" / "r1.mcap"
    about = info(source)
    part = Part(tmp_path / "real.mcap")
    part.start(about.run, about.attachments)
    notes = RateNotes(SystemClock())
    for record in read(source):
        part.add(Entry(*record, "msgpack", {}))
        for note in notes.due():
            part.add(note)
    part.finish("aucamp.end", {"cause": "clean"})
    for path in (source, part.path):
        page = report(path, tmp_path / "page.html").read_text(encoding="utf-8")
        assert "real time" not in page
        assert 'id="clock"' not in page
    assert open_box(part.path).complete


def told(page: str) -> str:
    (line,) = re.findall(r"[\d.]+ s of dive in [^.]*\.\d+ s, [\d.]+ times real time \([\d.]+ to [\d.]+\)", page)
    return line


def told_of(path: Path) -> str:
    moments = open_run(path).clock
    dive_s = (moments[-1].now_ns - moments[0].now_ns) * 1e-9
    wall_s = (moments[-1].noted.wall_ns - moments[0].noted.wall_ns) * 1e-9
    assert dive_s == pytest.approx(15.5, abs=0.6)
    assert 1.6 < dive_s / wall_s < 2.4
    return f"{dive_s:.1f} s of dive in {wall_s:.1f} s, {dive_s / wall_s:.2f} times real time (1.60 to 2.40)"
