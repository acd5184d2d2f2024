"""A long recording is a chain of files; a disk that fills up ends it with a sound file."""

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import replay.files.log
from agent.core.config import ConfigError
from replay.check.check import check
from replay.files.channels import FRAME, STEP_IN, STEP_OUT, Backlog, Entry, entry_on
from replay.files.info import describe, info
from replay.files.log import Limits, LogWriter, parts, read, unused
from replay.files.recover import auto_recovered
from replay.story import info_all
from tests.places import GOLDEN, ROOT
from tests.waiting import until


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay.files.log, "WRITE_S", 0.01)


def write_steps(log: LogWriter, numbers: range, wait_every: int = 10**6) -> None:
    """Three messages a step; now and then it is waited until the writer's thread has taken them."""
    for n in numbers:
        log.put(entry_on(STEP_IN, n, n, n, os.urandom(300)))
        log.put(entry_on(FRAME, n, n, n, os.urandom(300)))  # comes from another thread, at any moment
        log.put(entry_on(STEP_OUT, n, n, n, os.urandom(300)))
        if n % wait_every == wait_every - 1:
            until(lambda: not len(log._backlog))


def test_parts_begin_with_a_step_and_are_read_as_one(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    limits = Limits(part_bytes=20_000, floor_bytes=0)
    with LogWriter(path, {"robot": "r1"}, {"fleet.toml": "x"}, limits, splits_at=STEP_IN.name) as log:
        write_steps(log, range(200), wait_every=10)
    files = parts(path)
    assert [file.name for file in files[:3]] == ["r1.mcap", "r1.part002.mcap", "r1.part003.mcap"]
    assert len(files) == len(list(tmp_path.iterdir()))
    for number, file in enumerate(files, start=1):
        about = info(file)
        assert about.complete
        assert (about.run["part"], about.run["robot"], about.attachments) == (str(number), "r1", {"fleet.toml": "x"})
        assert about.end["cause"] == ("clean" if number == len(files) else "rotated")
        assert next(read(file)).channel == STEP_IN.name
        assert set(about.clock) == {"start", "end"}
    records = list(read(path))
    assert [record.sequence for record in records] == [n for n in range(200) for _ in range(3)]


def test_parts_are_replayed_as_a_chain_and_not_alone(tmp_path: Path) -> None:
    about = info(GOLDEN / "three" / "r1.mcap")
    limits = Limits(part_bytes=10_000, floor_bytes=0)
    with LogWriter(tmp_path / "r1.mcap", about.run, about.attachments, limits, splits_at=STEP_IN.name) as log:
        for n, record in enumerate(read(GOLDEN / "three" / "r1.mcap")):
            log.put(Entry(*record, "msgpack", {}))
            if n % 20 == 0:
                until(lambda: not len(log._backlog))
    names = [file.name for file in parts(tmp_path / "r1.mcap")]
    assert len(names) > 4
    (result,) = check([tmp_path]).results
    assert (result.verdict, result.steps, result.notes[1:]) == ("identical", 320, ())
    with pytest.raises(ConfigError, match="is part 2, and its steps build on those before"):
        check([tmp_path / "r1.part002.mcap"])

    (tmp_path / names[2]).unlink()
    missing = f"{tmp_path / names[2]} is missing: {names[3]} to {names[-1]} are left out; put it back there"
    assert told(tmp_path) == told(tmp_path / "r1.mcap") == [missing]
    (result,) = check([tmp_path]).results
    assert result.verdict == "identical" and result.steps < 320
    assert missing in result.notes

    for name in names[3:]:
        (tmp_path / name).unlink()
    goes_on = f"{tmp_path / names[1]} goes on in {names[2]}, which is not here; put it back there"
    assert told(tmp_path) == told(tmp_path / "r1.mcap") == [goes_on]
    assert goes_on in check([tmp_path]).results[0].notes

    (tmp_path / "r1.mcap").unlink()
    assert told(tmp_path) == [f"{tmp_path / 'r1.mcap'} is missing: {names[1]} is left out; put it back there"]
    assert unused(tmp_path / "r1.mcap").name == "r1.2.mcap"  # its parts would be in the way of those there
    lines: list[str] = []
    info_all([tmp_path], False, lines.append)
    assert lines[0].splitlines()[:2] == [str(tmp_path / names[1]), f"  {told(tmp_path)[0]}"]


def told(path: Path) -> list[str]:
    lines: list[str] = []
    auto_recovered([path], lines.append)
    return lines


def test_a_part_ends_by_its_age_too(tmp_path: Path) -> None:
    path = tmp_path / "fleet.mcap"
    numbers = itertools.count()
    with LogWriter(path, {}, limits=Limits(part_s=0.1, floor_bytes=0)) as log:

        def third_part() -> bool:
            number = next(numbers)
            write_steps(log, range(number, number + 1))
            return len(parts(path)) >= 3

        until(third_part)
    assert len(list(read(path))) == 3 * next(numbers)


def test_a_killed_recording_is_read_with_its_torn_last_part(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, {}, limits=Limits(part_bytes=20_000, floor_bytes=0), splits_at=STEP_IN.name) as log:
        write_steps(log, range(100), wait_every=10)
    whole = list(read(path))
    last = parts(path)[-1]
    last.with_name(last.name + ".active").write_bytes(last.read_bytes()[:-30])
    last.unlink()
    assert parts(path)[-1].name.endswith(".mcap.active")
    assert list(read(path)) == whole  # the tear is in the summary


def test_frames_are_lost_before_state() -> None:
    backlog = Backlog(max_messages=1000, max_bytes=1000)
    for n in range(8):
        backlog.put(Entry("/raw/frame", n, n, n, bytes(100), "msgpack", {}, expendable=True))
        backlog.put(Entry("/raw/step_in", n, n, n, bytes(100), "msgpack", {}))
    entries, drops = backlog.take()
    assert [entry.sequence for entry in entries if entry.channel == "/raw/step_in"] == list(range(8))
    assert [entry.sequence for entry in entries if entry.channel == "/raw/frame"] == [6, 7]
    assert [entry.channel for entry in entries[-4:]] == ["/raw/frame", "/raw/step_in"] * 2  # in order of arrival
    assert drops == {"/raw/frame": (6, 600, 0, 5, 5)}


def test_below_the_floor_the_file_is_finished_and_the_caller_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, {}, limits=Limits(floor_bytes=2**62, floor_share=1.0)) as log:

        def failed() -> bool:
            write_steps(log, range(10))
            return log.failed is not None

        until(failed)
        assert log.failed is not None
        assert "make room there" in log.failed
    about = info(path)
    assert about.complete
    assert about.end["cause"] == "disk_floor"


def test_recording_goes_on_when_there_is_room_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, free, first = tmp_path / "r1.mcap", [5_000], itertools.count()
    monkeypatch.setattr(replay.files.log.shutil, "disk_usage", lambda _: (10_000, 0, free[0]))

    def put(found: bool) -> bool:
        write_steps(log, range(n := next(first), n + 1))
        return found

    with LogWriter(path, {}, limits=Limits(floor_bytes=2_000, floor_share=1.0)) as log:
        until(lambda: put(path.with_name("r1.mcap.active").exists()))
        free[0] = 1_000
        until(lambda: put(log.failed is not None))
        assert "make room there" in log.failed and log.fault == log.failed
        free[0] = 3_999
        assert info(path).end["cause"] == "disk_floor"
        for _ in range(3000):  # more than is kept meanwhile
            put(True)
        free[0] = 4_000
        until(lambda: put(log.fault is None))
    assert [file.name for file in parts(path)] == ["r1.mcap", "r1.part002.mcap"]
    assert json.loads(info(parts(path)[1]).end["dropped"])
    *_, last = read(path)
    assert last.sequence == next(first) - 1


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of a few megabytes; needs the right to mount."""
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if done.returncode != 0:
        pytest.skip("a small disk cannot be mounted here: " + done.stderr.decode(errors="replace").strip())
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize(("floor_bytes", "whole"), [(2_000_000, True), (0, False)])
def test_a_disk_that_fills_up(tmp_path: Path, floor_bytes: int, whole: bool) -> None:
    """A floor leaves a finished file; without one the file is torn, and read up to the last flush."""
    with small_disk(tmp_path / "disk", "4m") as disk:
        path = disk / "r1.mcap"
        with LogWriter(path, {}, limits=Limits(floor_bytes=floor_bytes, floor_share=1.0)) as log:
            first = itertools.count(step=20)

            def failed() -> bool:
                number = next(first)
                write_steps(log, range(number, number + 20))
                return log.failed is not None

            until(failed)
        there = path if whole else path.with_name("r1.mcap.active")
        assert [file.name for file in disk.iterdir()] == [there.name]
        about = info(there)
        assert about.complete is whole
        assert about.end.get("cause") == ("disk_floor" if whole else None)
        sequences = [record.sequence for record in read(there) if record.channel == STEP_OUT.name]
        assert sequences == list(range(len(sequences)))
        assert len(sequences) * 900 > 1_500_000


def test_a_disk_without_a_byte_is_recorded_on_once_there_is_room(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "4m") as disk:
        (disk / "full").write_bytes(bytes(shutil.disk_usage(disk).free))
        path = disk / "r1.mcap"
        with LogWriter(path, {}, limits=Limits(floor_bytes=1_000_000, floor_share=1.0)) as log:
            until(lambda: log.failed)
            assert "make room there" in (log.fault or "") and [file.name for file in disk.iterdir()] == ["full"]
            (disk / "full").unlink()
            until(lambda: log.fault is None)
            write_steps(log, range(20))
        assert info(path).complete
        assert [record.sequence for record in read(path) if record.channel == STEP_OUT.name] == list(range(20))


def test_viewer_channels_that_fail_do_not_end_the_recording(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def derive(entry: Entry) -> list[Entry]:
        return [entry._replace(channel="/view", data=bytes(1 // abs(20 - entry.sequence)))]

    path = tmp_path / "r1.mcap"
    with LogWriter(path, {}, derive=derive) as log:
        write_steps(log, range(40))
    channels = [record.channel for record in read(path)]
    assert channels.count("/view") == 117  # of 120 messages those of one step have none
    assert channels.count(STEP_IN.name) == 40
    assert caplog.text.count("not all for viewers of a message on") == 1
    about = info(path)
    assert about.complete
    assert about.end["not_derived"] == '{"ZeroDivisionError": 3}'
    assert "not shown to viewers: ZeroDivisionError 3" in describe(path, about)


FIRST = """
import sys, typing
from pathlib import Path
from agent.core.codec import decode, encode
from agent.core.step_io import Inputs
from replay.files.log import LogWriter

def look(*_):
    raise RuntimeError("msgspec looks into it only now")

payload = encode(Inputs())
with LogWriter(Path(sys.argv[1]), {}):
    typing._eval_type = look
    decode(payload, Inputs)
"""


def test_messages_are_known_before_a_second_thread_reads_them(tmp_path: Path) -> None:
    """In a fresh process, for what msgspec has seen once it never looks into again."""
    subprocess.run([sys.executable, "-c", FIRST, str(tmp_path / "r1.mcap")], check=True, cwd=ROOT, timeout=60)
