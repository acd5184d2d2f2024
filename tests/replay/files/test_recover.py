"""Mending torn files: whatever is sound is kept, a black box ends with a whole step, and the loss is named."""

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from agent.core.config import ConfigError
from replay.files.channels import CUT, STEP_IN, STEP_OUT, Entry
from replay.files.info import describe, info
from replay.files.log import LogWriter, Record, read, unused
from replay.files.mcap_file import Part, active, hold, is_held, recovered
from replay.files.recover import auto_recovered, black_boxes, recover, recover_all, recovering, sound, torn_files
from tests.places import GOLDEN, ROOT
from tests.replay.small_box import STEPS, write_box
from tests.waiting import until


def torn(folder: Path, data: bytes, name: str = "r1.mcap.active") -> Path:
    """A file whose writer was killed just now."""
    path = folder / name
    path.write_bytes(data)
    return path


def write(path: Path, records: list[tuple[str, int]], run: dict[str, object] | None = None) -> bytes:
    with LogWriter(path, run or {"kind": "black box"}, {"fleet.toml": "fleet = 'tank'\n"}) as log:
        for n, (channel, sequence) in enumerate(records):
            log.put(Entry(channel, n, n, sequence, b"%d" % n, "msgpack", {}))
    return path.read_bytes()


def steps(count: int) -> list[tuple[str, int]]:
    return [(channel.name, n) for n in range(count) for channel in (STEP_IN, STEP_OUT)]


def test_a_whole_file_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    write(path, steps(3))
    result = recover(path)
    assert (result.out, result.lossy) == (None, False)
    assert [file.name for file in tmp_path.iterdir()] == ["r1.mcap"]


def test_every_cut_is_mended(tmp_path: Path) -> None:
    """80 cuts: no exception, all whole steps before the cut kept, a summary, and nothing invented."""
    whole = write_box(tmp_path, views=False)
    data, place = whole.read_bytes(), {record: n for n, record in enumerate(read(whole))}
    lengths = set()
    anywhere, tail = random.Random(1).sample(range(12, len(data)), 40), range(len(data) - 4000, len(data), 100)
    for number, cut in enumerate([*anywhere, *tail]):  # indexes, summary and footer are in the tail
        folder = tmp_path / str(number)
        folder.mkdir()
        result = recover(torn(folder, data[:cut]))
        if result.out is None:
            assert not result.messages
            assert "nothing to save" in result.summary
            continue
        kept = [record for record in read(result.out) if record.channel != CUT.name]
        places = [place[record] for record in kept]
        assert places == sorted(places)
        about = info(result.out)
        assert about.torn_bytes == 0
        assert about.attachments == info(torn(folder, data[:cut])).attachments
        paired = [record.sequence for record in kept if record.channel == STEP_IN.name]
        assert paired == [record.sequence for record in kept if record.channel == STEP_OUT.name]
        assert paired == list(range(len(paired)))
        assert result.last_step == (paired[-1] if paired else None)
        lengths.add(len(paired))
    assert max(lengths) == STEPS


def test_inputs_without_outputs_are_kept_aside(tmp_path: Path) -> None:
    records = [*steps(3), (STEP_IN.name, 3), ("/raw/vision", 9)]
    data = write(tmp_path / "x.mcap", records)
    path = torn(tmp_path, data[:-20])
    result = recover(path)
    assert (result.last_step, result.cut_step, result.lossy) == (2, 3, True)
    assert "step 3 has no outputs" in result.summary
    assert result.out == tmp_path / "r1.recovered.mcap"
    assert [(record.channel, record.sequence) for record in read(result.out)] == [
        *steps(3),
        (CUT.name, 3),
        ("/raw/vision", 9),
    ]
    assert path.read_bytes() == data[:-20]


def test_a_broken_chunk_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "fleet.mcap"
    with LogWriter(path, {"kind": "fleet"}) as log:
        log.put(Entry("/a", 0, 0, 0, b"", "msgpack", {}))
        until(lambda: list(read(path)))  # the channel is in a chunk of its own
        for n in range(1, 4000):
            log.put(Entry("/a", n, n, n, random.Random(n).randbytes(200), "msgpack", {}))
    data = bytearray(path.read_bytes())
    data[data.index(random.Random(1000).randbytes(200)[50:58])] ^= 0xFF  # random bytes are not compressed
    path.unlink()
    result = recover(torn(tmp_path, bytes(data), "fleet.mcap"))
    assert (result.tears, result.lossy) == (1, True)
    assert result.out is not None
    kept = [record.sequence for record in read(result.out)]
    assert 1000 not in kept
    assert kept[-1] == 3999
    assert len(kept) > 2000
    assert 200_000 < result.bytes_lost < 300_000
    assert info(result.out).channels["/a"].gaps == 3999 - len(kept) + 1


def test_a_file_with_a_writer_is_not_touched_however_long_it_is_silent(tmp_path: Path) -> None:
    path = torn(tmp_path, write(tmp_path / "x.mcap", steps(3))[:-20])
    os.utime(path, (0, 0))
    with path.open("rb") as writer:
        hold(writer)
        assert torn_files(tmp_path / "r1.mcap") == []
        with pytest.raises(ConfigError, match="still being written"):
            recover(path)
        lines: list[str] = []
        assert sound(path, lines.append) == path
        assert lines == [f"{path}: still being written; what is in it by now is read"]
        with pytest.raises(ConfigError, match="is being written by another process; give another name"):
            Part(tmp_path / "r1.mcap")
    assert torn_files(tmp_path / "r1.mcap") == [path]
    assert recover(path).last_step == 2


def test_a_part_claims_its_file_until_it_is_finished_or_given_up(tmp_path: Path) -> None:
    for number, end in enumerate((lambda part: part.finish("aucamp.end", {}), lambda part: part.abandon())):
        part = Part(tmp_path / f"{number}.mcap")
        part.start({}, {})
        assert is_held(active(part.path))
        end(part)
        assert not any(is_held(file) for file in tmp_path.iterdir())


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"\x89MCA"])
def test_a_file_with_nothing_in_it_is_said_to_be_so(tmp_path: Path, content: bytes) -> None:
    path, lines = torn(tmp_path, content, "r1.mcap"), []
    assert sound(path, lines.append) == path
    assert lines == [f"{path}: holds no message, nothing to save"]
    assert "nothing in it" in describe(path, info(path))


def test_a_mended_copy_is_never_overwritten(tmp_path: Path) -> None:
    path = torn(tmp_path, write(tmp_path / "x.mcap", steps(3))[:-20])
    recover(path)
    with pytest.raises(ConfigError, match="exists already"):
        recover(path)


def test_opening_mends_once_and_says_so(tmp_path: Path) -> None:
    path = torn(tmp_path, write(tmp_path / "x.mcap", steps(3))[:-20])
    lines: list[str] = []
    assert sound(tmp_path / "r1.mcap", lines.append) == tmp_path / "r1.recovered.mcap"
    assert lines == [f"{path} was torn, mended as {tmp_path / 'r1.recovered.mcap'}: {recovered_summary(tmp_path)}"]
    assert sound(path, lines.append) == tmp_path / "r1.recovered.mcap"
    assert len(lines) == 2
    assert sound(tmp_path / "x.mcap", lines.append) == tmp_path / "x.mcap"
    assert len(lines) == 2


def recovered_summary(folder: Path) -> str:
    return info(folder / "r1.recovered.mcap").recovered["summary"]


def test_reading_a_recording_finds_its_mended_copy(tmp_path: Path) -> None:
    recover(torn(tmp_path, write(tmp_path / "x.mcap", steps(3))[:-20]))
    (tmp_path / "r1.mcap.active").unlink()
    assert len(list(read(tmp_path / "r1.mcap"))) == 6


@pytest.mark.parametrize(("length", "code"), [(0, 1), (300, 1), (-20, 0)])
def test_the_exit_code_says_whether_there_was_anything(tmp_path: Path, length: int, code: int) -> None:
    path = torn(tmp_path, write(tmp_path / "x.mcap", steps(3))[:length])
    lines: list[str] = []
    assert recover_all([tmp_path / "x.mcap", path], False, lines.append) == code
    assert lines[0].endswith("x.mcap: whole, nothing to mend")
    assert lines[1].startswith(str(path))


def test_what_is_read_is_a_record(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    write(path, [(STEP_IN.name, 7)])
    assert list(read(path)) == [Record(STEP_IN.name, 0, 0, 7, b"0")]


# --- auto recover ---
# A killed writer's file is mended by whoever comes next, and neither too early nor twice.


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A black box cut in its last quarter."""
    whole = write_box(tmp_path_factory.mktemp("whole"), views=False).read_bytes()
    return whole[: 3 * len(whole) // 4]


def auto_recover_torn(folder: Path, data: bytes, name: str = "r1.mcap") -> Path:
    path = active(folder / name)
    path.write_bytes(data)
    return path


def test_torn_files_are_those_of_one_name_and_not_yet_mended(tmp_path: Path) -> None:
    names = ("r1.mcap", "r1.2.mcap", "r1.part002.mcap", "r1.2.part003.mcap")
    for name in (*names, "r10.mcap", "r1.recovered.mcap", "r2.mcap"):
        active(tmp_path / name).write_bytes(b"")
    (tmp_path / "r1.3.mcap").write_bytes(b"")
    assert [file.name for file in torn_files(tmp_path / "r1.mcap")] == sorted(f"{name}.active" for name in names)
    recovered(tmp_path / "r1.2.mcap").write_bytes(b"")
    assert active(tmp_path / "r1.2.mcap") not in torn_files(tmp_path / "r1.mcap")
    assert torn_files(tmp_path / "nowhere" / "r1.mcap") == []


def test_they_are_mended_beside_the_work_and_told_in_a_line(
    tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(shutil, "which", lambda name: None)  # no `nice`: beside busy tests it would get no time
    lines: list[str] = []
    file = auto_recover_torn(tmp_path, data)
    with recovering([file], lines.append, pause_s=0.0):
        until(lambda: lines)
    (line,) = lines
    assert line.startswith(f"{file} -> {tmp_path / 'r1.recovered.mcap'}: ")
    assert "kept up to step" in line
    assert info(tmp_path / "r1.recovered.mcap").recovered
    assert torn_files(tmp_path / "r1.mcap") == []


def test_a_short_life_leaves_them_for_the_next(tmp_path: Path, data: bytes) -> None:
    file = auto_recover_torn(tmp_path, data)
    began = time.monotonic()
    with recovering([file], pause_s=60.0):
        pass
    assert time.monotonic() - began < 10
    assert torn_files(tmp_path / "r1.mcap") == [file]


def test_a_mending_that_was_broken_off_is_begun_again(tmp_path: Path, data: bytes) -> None:
    file = auto_recover_torn(tmp_path, data)
    auto_recover_torn(tmp_path, b"half", "r1.recovered.mcap")
    assert recover(file).out == tmp_path / "r1.recovered.mcap"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r1.mcap.active", "r1.recovered.mcap"]


def test_who_opens_a_folder_or_a_file_gets_what_is_mended(tmp_path: Path, data: bytes) -> None:
    lines: list[str] = []
    file, other = auto_recover_torn(tmp_path, data), auto_recover_torn(tmp_path, data, "r2.mcap")
    assert auto_recovered([file, tmp_path], lines.append) == [tmp_path / "r1.recovered.mcap", tmp_path]
    assert recovered(tmp_path / "r2.mcap").exists()
    assert f"{file} was torn, mended as" in lines[0]
    assert any(f"{other} was torn, mended as" in line for line in lines[1:])


def test_what_is_torn_under_its_finished_name_is_read_mended(tmp_path: Path, data: bytes) -> None:
    """A copy that broke off, or a bit that flipped on a disk."""
    lines: list[str] = []
    file = auto_recover_torn(tmp_path, data, "r1.mcap")
    file.rename(tmp_path / "r1.mcap")
    assert auto_recovered([tmp_path], lines.append) == [tmp_path]
    assert black_boxes(tmp_path) == [recovered(tmp_path / "r1.mcap")]
    assert f"{tmp_path / 'r1.mcap'} was torn, mended as" in lines[0] and len(lines) == 1
    assert recover_all([tmp_path / "r1.mcap"], False, lines.append) == 0
    assert "mended already; " in lines[1]


@pytest.mark.parametrize(
    ("cut", "what"),
    [(20, "is not of {0} as it is now, and is left out"), (0, "is read in place of {0}, which is whole")],
)
def test_a_mended_copy_beside_a_whole_file_is_told(tmp_path: Path, cut: int, what: str) -> None:
    data, file = write(tmp_path / "x.mcap", steps(3)), tmp_path / "r1.mcap"
    recover(torn(tmp_path, data[: len(data) - cut][:-9] + bytes(9)))
    (tmp_path / "r1.mcap.active").unlink()
    (tmp_path / "x.mcap").rename(file)
    lines: list[str] = []
    auto_recovered([tmp_path], lines.append)
    assert lines[-1] == f"{recovered(file)} {what.format(file)}; move it away"
    assert black_boxes(tmp_path) == [file if cut else recovered(file)]


def test_a_mended_copy_of_less_is_made_anew(tmp_path: Path, data: bytes) -> None:
    """The writer went on, or the copy of the file was broken off."""
    file, lines = auto_recover_torn(tmp_path, data[: len(data) // 2]), list[str]()
    auto_recovered([tmp_path], lines.append)
    less = len(list(read(tmp_path / "r1.mcap")))
    file.write_bytes(data)
    assert auto_recovered([file, tmp_path], lines.append) == [recovered(file), tmp_path]
    assert f"{file} was torn, mended as" in lines[1]
    assert len(list(read(recovered(file)))) == len(list(read(tmp_path / "r1.mcap"))) > less


def test_a_mended_copy_of_more_or_of_another_start_is_kept(tmp_path: Path, data: bytes) -> None:
    file = auto_recover_torn(tmp_path, data)
    (copy,) = auto_recovered([file], lambda line: None)
    kept = copy.read_bytes()
    (tmp_path / "x").mkdir()
    for other in (data[: len(data) // 2], write_box(tmp_path / "x", views=True).read_bytes()[:-30]):
        file.write_bytes(other)
        lines: list[str] = []
        assert auto_recovered([file], lines.append) == [file]
        assert f"{copy}: exists already; give another name or move it away" in lines
        assert copy.read_bytes() == kept
    file.unlink()
    assert unused(tmp_path / "r1.mcap") == tmp_path / "r1.2.mcap"  # or the next one would be where it is mended


def test_a_lost_header_is_not_found_in_the_copy(tmp_path: Path) -> None:
    data = bytearray(write_box(tmp_path, views=False).read_bytes())
    data[200:260] = bytes(60)
    (tmp_path / "r1.mcap").write_bytes(data)
    copy = tmp_path / "r1.recovered.mcap"
    for read_it in (lambda folder: auto_recovered([folder], lambda line: None), black_boxes):
        with pytest.raises(ConfigError, match=f"{copy}: damaged: its header cannot be read; move it away"):
            read_it(tmp_path)
    assert [each.what for each in info(copy).damage] == ["before it was mended its header could not be read"]


def test_bytes_behind_the_end_are_counted_as_lost(tmp_path: Path) -> None:
    first, second = write(tmp_path / "r1.mcap", steps(3)), write(tmp_path / "x.mcap", steps(4))
    (tmp_path / "r1.mcap").write_bytes(first + second)
    result = recover(tmp_path / "r1.mcap")
    assert (result.bytes_lost, result.lossy) == (len(second), True)
    assert f"{len(second)} of {len(first + second)} bytes lost at 1 places" in result.summary
    (tmp_path / "x.mcap").unlink()
    lines: list[str] = []
    auto_recovered([tmp_path], lines.append)
    assert lines == [f"{result.out} is read in place of {tmp_path / 'r1.mcap'}, which is damaged"]


def test_a_mending_that_was_killed_is_no_recording(tmp_path: Path, data: bytes) -> None:
    file, lines = auto_recover_torn(tmp_path, data, "r2.mcap"), list[str]()
    active(recovered(file)).write_bytes(data[:2000])
    auto_recovered([tmp_path], lines.append)
    assert len(lines) == 1 and f"{file} was torn, mended as" in lines[0]
    assert black_boxes(tmp_path) == [recovered(file)]


def test_steps_behind_a_hole_are_left_out_and_told(tmp_path: Path) -> None:
    write(
        tmp_path / "r1.mcap", [*steps(5), *((channel.name, n) for n in range(7, 10) for channel in (STEP_IN, STEP_OUT))]
    )
    lines: list[str] = []
    auto_recovered([tmp_path], lines.append)
    assert lines == [
        f"{tmp_path / 'r1.mcap'}: steps are missing after step 4: what is made of steps leaves out the 3 later ones"
    ]


def test_a_robot_that_was_recorded_apart_from_the_others_is_told(tmp_path: Path) -> None:
    lines: list[str] = []
    for name, dive in (("r1", "three"), ("r2", "three"), ("r3", "survey")):
        source = GOLDEN / dive / ("r1.mcap" if name == "r3" else f"{name}.mcap")
        shutil.copy(source, tmp_path / f"{name}.mcap")
    auto_recovered([tmp_path], lines.append)
    assert lines == []  # the third calls itself r1
    shutil.copy(GOLDEN / "survey" / "r2.mcap", tmp_path / "r3.mcap")
    (tmp_path / "r2.mcap").unlink()
    auto_recovered([tmp_path], lines.append)
    assert len(lines) == 2 and "r1 was recorded from 2026-01-01 00:00:00 UTC, while no other robot was" in lines[0]


def test_of_copies_of_one_start_the_largest_is_read(tmp_path: Path) -> None:
    start = {"kind": "black box", "fleet": "tank", "robot": "r1", "incarnation": "7"}
    write(tmp_path / "r1.mcap", steps(40), start)
    write(tmp_path / "half.mcap", steps(20), start)
    write(tmp_path / "r1.2.mcap", steps(10), {**start, "incarnation": "8"})
    assert black_boxes(tmp_path) == [tmp_path / "r1.2.mcap", tmp_path / "r1.mcap"]
    lines: list[str] = []
    auto_recovered([tmp_path], lines.append)
    assert len(lines) == 1 and f"{tmp_path / 'half.mcap'} is of the same start" in lines[0]


def test_replay_check_mends_first_and_says_so_where_no_program_reads(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "torn", tmp_path / "torn")
    command = [sys.executable, "-m", "agent", "replay", "check", str(tmp_path / "torn"), "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert '"identical": true' in done.stdout
    assert "was torn, mended as" in done.stderr
    assert (tmp_path / "torn" / "r1.recovered.mcap").exists()
