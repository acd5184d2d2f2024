"""The recording: what is written is read, in order, whatever happens to the writer."""

import json
import random
import signal
import subprocess
import sys
import threading
from hashlib import sha256
from pathlib import Path

import msgpack
import pytest

import replay.files.log
from agent.core.config import ConfigError
from replay.files.channels import DROPS, Backlog, Entry
from replay.files.log import LogWriter, info, read, unused
from replay.files.mcap_file import Part
from tests.places import ROOT
from tests.waiting import until

RUN = {"robot": "r1", "seed": 7}


def write(writer: LogWriter, count: int, first: int = 0) -> None:
    for n in range(first, first + count):
        channel, data = f"/raw/{'in' if n % 2 else 'out'}", bytes([n % 251]) * (n % 40)
        writer.put(Entry(channel, 1000 + n, 900 + n, n, data, "msgpack", {}))


def test_what_is_written_is_read_in_order(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, RUN, {"fleet.toml": "fleet = 'tank'\n"}) as writer:
        write(writer, 500)
        writer.put(Entry("/text", 5000, 5000, 2**32 + 3, b"{}", "json", {"unit": "m"}))
    records = list(read(path))
    assert [record.sequence for record in records] == [*range(500), 3]
    assert records[7] == ("/raw/in", 1007, 907, 7, bytes([7]) * 7)
    about = info(path)
    assert about.complete
    text = sha256(b"fleet = 'tank'\n").hexdigest()
    assert about.run == {"robot": "r1", "seed": "7", "part": "1", "sha256.fleet.toml": text}
    assert {when: set(sample) for when, sample in about.clock.items()} == {
        "start": {"unix_ns", "monotonic_ns"},
        "end": {"unix_ns", "monotonic_ns"},
    }
    assert about.end["cause"] == "clean"
    assert about.attachments == {"fleet.toml": "fleet = 'tank'\n"}
    assert about.channels["/text"] == ("json", {"unit": "m"}, 1, 2, 5000, 5000, 0, "", 3, 1)
    assert about.channels["/raw/in"].messages == 250
    assert not path.with_name("r1.mcap.active").exists()


def test_the_file_says_that_an_exception_ended_it(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with pytest.raises(ZeroDivisionError), LogWriter(path, RUN) as writer:
        write(writer, 3)
        raise ZeroDivisionError
    assert info(path).end["cause"] == "exception:ZeroDivisionError"
    assert len(list(read(path))) == 3


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, RUN):
        pass
    with pytest.raises(ConfigError, match=r"r1\.mcap: exists already"), LogWriter(path, RUN):
        pass
    path.rename(tmp_path / "r1.mcap.active")
    with pytest.raises(ConfigError, match=r"r1\.mcap\.active: exists already"), LogWriter(path, RUN):
        pass


def test_who_starts_again_gets_another_name(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    assert unused(path) == path
    path.with_name("r1.mcap.active").write_bytes(b"")
    assert unused(path).name == "r1.2.mcap"
    unused(path).write_bytes(b"")
    assert unused(path).name == "r1.3.mcap"


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"), LogWriter(tmp_path / "file" / "r1.mcap", RUN):
        pass


@pytest.mark.parametrize(
    ("content", "message"), [(b"hello, no recording", "is no recording"), (None, "cannot be read")]
)
def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        list(read(path))


def test_what_the_backlog_lost_stands_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay.files.log, "BACKLOG_MESSAGES", 10)
    path = tmp_path / "r1.mcap"
    writer = LogWriter(path, RUN)
    write(writer, 35)  # before the thread runs, as if the disk stalled
    with writer:
        pass
    records = list(read(path))
    notes = [msgpack.unpackb(record.data) for record in records if record.channel == DROPS.name]
    assert [(note["channel"], note["messages"], note["first"], note["last"]) for note in notes] == [
        ("/raw/out", 13, 0, 24),
        ("/raw/in", 12, 1, 23),
    ]
    assert [record.sequence for record in records if record.channel != DROPS.name] == list(range(25, 35))
    assert json.loads(info(path).end["dropped"]) == {"/raw/in": 12, "/raw/out": 13}


def test_a_backlog_is_bounded_in_bytes_too() -> None:
    backlog = Backlog(max_messages=100, max_bytes=1000)
    wake = [backlog.put(Entry("/raw/frame", n, n, n, bytes(100), "msgpack", {})) for n in range(30)]
    assert wake.index(True) == 5
    entries, drops = backlog.take()
    assert [entry.sequence for entry in entries] == list(range(20, 30))
    assert drops == {"/raw/frame": (20, 2000, 0, 19, 19)}
    assert backlog.take() == ([], {})


def test_a_failing_disk_stops_the_recording_and_not_the_caller(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, RUN) as writer:
        writer._part._file.close()  # every further write fails, as on a disk that went away

        def failed() -> bool:
            write(writer, 2000)
            return writer.failed is not None

        until(failed)
        write(writer, 10)
    assert not path.exists()  # the final name promises a finished file


def test_every_cut_of_a_file_is_readable_up_to_the_tear(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, RUN, {"fleet.toml": "x" * 100}) as writer:
        for part in range(4):
            write(writer, 50, 50 * part)
            until(lambda written=50 * (part + 1): len(list(read(path))) == written)  # one chunk each
    whole = path.read_bytes()
    expected = list(read(path))
    torn = tmp_path / "torn.mcap.active"
    lengths = set()
    cuts = random.Random(1).sample(range(5, len(whole)), 200)
    for cut in [0, 1, *cuts, len(whole) - 1]:
        torn.write_bytes(whole[:cut])
        records = list(read(torn))
        assert records == expected[: len(records)]
        assert not info(torn).complete or cut > len(whole) - 9  # all but the closing magic is there
        lengths.add(len(records))
    assert len(lengths) >= 4  # the cuts fell into different chunks


def test_a_corrupted_chunk_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with LogWriter(path, RUN) as writer:
        for n in range(2000):
            writer.put(Entry("/raw/in", n, n, n, random.Random(n).randbytes(100), "msgpack", {}))
    data = bytearray(path.read_bytes())
    data[data.index(random.Random(1000).randbytes(100)[40:48])] ^= 0xFF  # random bytes are not compressed
    path.write_bytes(data)
    believed = list(read(path))
    assert len(believed) <= 1000
    assert all(record.data == random.Random(record.sequence).randbytes(100) for record in believed)


WRITE_FOR_EVER = """
import itertools, pathlib, sys, time
from replay.files.channels import Entry
from replay.files.log import LogWriter
with LogWriter(pathlib.Path(sys.argv[1]), {}) as writer:
    for n in itertools.count():
        writer.put(Entry("/raw/in", time.time_ns(), time.time_ns(), n, bytes(200), "msgpack", {}))
        print(n, flush=True)
        time.sleep(0.005)
"""


def test_a_killed_writer_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", WRITE_FOR_EVER, path], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        try:
            while int(process.stdout.readline()) < 300:
                pass
        finally:
            process.send_signal(signal.SIGKILL)
        written = [int(line) for line in process.stdout]  # until the pipe broke
    records = list(read(path.with_name("r1.mcap.active")))
    assert [record.sequence for record in records] == list(range(len(records)))
    assert len(records) >= 300 - 200  # 5 ms each: one second is 200 at most
    assert len(records) <= max(written, default=300) + 2
    assert not info(path.with_name("r1.mcap.active")).complete


def test_a_disk_that_does_not_answer_is_a_fault_until_it_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay.files.log, "STUCK_S", 0.05)
    answers, flush = threading.Event(), Part.flush

    def slow(part: Part) -> None:
        answers.wait(60)
        flush(part)

    with LogWriter(tmp_path / "r1.mcap", RUN) as writer:
        until(lambda: writer.fault is None)
        monkeypatch.setattr(Part, "flush", slow)
        write(writer, 3)
        until(lambda: writer.fault)
        assert "the disk has taken nothing for more than" in str(writer.fault)
        assert writer.failed is None
        answers.set()
        until(lambda: writer.fault is None)
    assert len(list(read(tmp_path / "r1.mcap"))) == 3


@pytest.mark.parametrize("what", ["removed", "moved", "folder"])
def test_a_file_that_is_taken_away_is_said_and_begun_anew(tmp_path: Path, what: str) -> None:
    path = tmp_path / "dive" / "r1.mcap"
    file = path.with_name("r1.mcap.active")
    with LogWriter(path, RUN) as writer:
        write(writer, 10)
        until(lambda: len(list(read(path))) == 10)
        if what == "removed":
            file.unlink()
        elif what == "moved":
            file.rename(tmp_path / "elsewhere.mcap")
        else:
            path.parent.rename(tmp_path / "away")
        until(lambda: writer.fault)
        assert str(writer.fault).startswith(f"{file} was removed or moved away; from then on")
        write(writer, 5, first=10)
    assert writer.fault and writer.failed is None
    assert [record.sequence for record in read(path)] == [10, 11, 12, 13, 14]
    assert info(path).complete


def test_what_is_not_needed_goes_on_without_its_file(tmp_path: Path) -> None:
    (tmp_path / "dive").write_text("a file")
    path = tmp_path / "dive" / "r1.mcap"
    with LogWriter(path, RUN, needed=False) as writer:
        write(writer, 10)
        assert writer.fault == f"{path}.active: cannot be written: File exists; give another place"
    with pytest.raises(ConfigError, match="cannot be written"), LogWriter(path, RUN):
        pass


def test_a_folder_that_cannot_be_made_again_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "dive").symlink_to(tmp_path / "disk")
    (tmp_path / "file").write_text("a file")
    path = tmp_path / "dive" / "r1.mcap"
    with LogWriter(path, RUN) as writer:
        until(lambda: path.with_name("r1.mcap.active").exists())
        (tmp_path / "file").replace(path.parent)  # in one step: the writer finds no moment to make the folder in
        until(lambda: writer.failed)
    assert writer.failed == f"{path}.active: cannot be written: File exists; give another place"
