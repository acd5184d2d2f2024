"""A killed writer's file is mended by whoever comes next, and neither too early nor twice."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from replay.files.info import info
from replay.files.mcap_file import active, recovered
from replay.files.recover import auto_recovered, recover, recovering, torn_files
from tests.places import GOLDEN, ROOT
from tests.replay.small_box import write_box
from tests.waiting import until


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A black box cut in its last quarter."""
    whole = write_box(tmp_path_factory.mktemp("whole"), views=False).read_bytes()
    return whole[: 3 * len(whole) // 4]


def torn(folder: Path, data: bytes, name: str = "r1.mcap") -> Path:
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
    lines: list[str] = []
    file = torn(tmp_path, data)
    with recovering([file], lines.append, pause_s=0.0):
        until(lambda: lines, timeout_s=30)
    (line,) = lines
    assert line.startswith(f"{file} -> {tmp_path / 'r1.recovered.mcap'}: ")
    assert "kept up to step" in line
    assert info(tmp_path / "r1.recovered.mcap").recovered
    assert torn_files(tmp_path / "r1.mcap") == []


def test_a_short_life_leaves_them_for_the_next(tmp_path: Path, data: bytes) -> None:
    file = torn(tmp_path, data)
    began = time.monotonic()
    with recovering([file], pause_s=60.0):
        pass
    assert time.monotonic() - began < 10
    assert torn_files(tmp_path / "r1.mcap") == [file]


def test_a_mending_that_was_broken_off_is_begun_again(tmp_path: Path, data: bytes) -> None:
    file = torn(tmp_path, data)
    torn(tmp_path, b"half", "r1.recovered.mcap")
    assert recover(file).out == tmp_path / "r1.recovered.mcap"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r1.mcap.active", "r1.recovered.mcap"]


def test_who_opens_a_folder_or_a_file_gets_what_is_mended(tmp_path: Path, data: bytes) -> None:
    lines: list[str] = []
    file, other = torn(tmp_path, data), torn(tmp_path, data, "r2.mcap")
    assert auto_recovered([file, tmp_path], lines.append) == [tmp_path / "r1.recovered.mcap", tmp_path]
    assert recovered(tmp_path / "r2.mcap").exists()
    assert f"{file} was torn, mended as" in lines[0]
    assert any(f"{other} was torn, mended as" in line for line in lines[1:])


def test_replay_check_mends_first_and_says_so_where_no_program_reads(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "torn", tmp_path / "torn")
    command = [sys.executable, "-m", "agent", "replay", "check", str(tmp_path / "torn"), "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert '"identical": true' in done.stdout
    assert "was torn, mended as" in done.stderr
    assert (tmp_path / "torn" / "r1.recovered.mcap").exists()
