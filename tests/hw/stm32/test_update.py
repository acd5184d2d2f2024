"""`aucamp board update`: onto a board that resets, with MicroPython's own prompt at the tether."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, dump
from agent.ground import board_update
from agent.process.command import Failed
from tests.hw.desk import MICROPYTHON
from tests.hw.firmware.diving_robot import FLEET
from tests.hw.stm32.resetting_board import ResettingBoard, sources

pytest.importorskip("mpremote")
if MICROPYTHON is None:
    pytest.skip("the MicroPython Unix port is not installed", allow_module_level=True)


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ResettingBoard]:
    monkeypatch.setattr(board_update, "BOOT_S", 6.0)
    monkeypatch.setattr(board_update, "TRIAL_S", 8.0)
    monkeypatch.setattr(board_update, "LOOKED_AT_S", 0.5)
    with ResettingBoard(tmp_path / "board", trial_s=8.0) as found:
        yield found


@pytest.fixture
def fleet(board: ResettingBoard, tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    robots = {"r1": replace(FLEET.robot["r1"], serial=board.path, camera="v4l2:/dev/video0")}
    path.write_text(dump(replace(FLEET, robot=robots)))
    return path


def made(folder: Path, **changed: bytes) -> Path:
    """A folder as `make firmware` leaves it, of sources that a computer runs."""
    (folder / "a").mkdir(parents=True)
    for name, content in {**sources(), **{f"{stem}.py": text for stem, text in changed.items()}}.items():
        (folder / "a" / name).write_bytes(content)
    return folder


def update(fleet: Path, files: Path | None) -> list[str]:
    said: list[str] = []
    board_update.update(fleet, "r1", files, said.append, lambda done, total: None, 10.0)
    return said


def test_new_firmware_goes_into_the_set_that_rests_and_is_kept_once_it_has_answered(board, fleet, tmp_path):
    newer = sources()["tether.py"].replace(b'b"aucamp06"', b'b"aucampXX"')
    table = (board.flash / "table.json").read_bytes()
    said = update(fleet, made(tmp_path / "new", tether=newer))
    assert "r1: updated from aucamp06 to aucampXX" in said[-2] + said[-1]
    assert board.boots == ["a/main.py", "prompt", "b/main.py", "prompt", "b/main.py"]
    assert (board.flash / "b" / "tether.py").read_bytes() == newer and (board.flash / "second").exists()
    assert (board.flash / "table.json").read_bytes() == table
    update(fleet, made(tmp_path / "again"))
    assert board.boots[-1] == "a/main.py" and not (board.flash / "second").exists()


DEAF = sources()["hal_unix.py"].replace(b"n = self._serial.readinto(buf) or 0", b"n = 0")


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        ({"main": b"import nothing_of_the_kind\n"}, "the new firmware broke off in its trial; aucamp06 runs again"),
        ({"hal_unix": DEAF}, "the new firmware did not answer .*; the old one, aucamp06, runs again"),
    ],
    ids=["breaks off", "is deaf"],
)
def test_a_set_that_does_not_answer_gives_way_to_the_old_one(board, fleet, tmp_path, broken, says):
    with pytest.raises(Failed, match=says):
        update(fleet, made(tmp_path / "new", **broken))
    assert board.boots[2] == "b/main.py" and board.boots[-1] == "a/main.py"
    assert not (board.flash / "second").exists() and not (board.flash / "trial").exists()


def test_what_the_board_cannot_run_is_refused_before_it_is_tried(board, fleet, tmp_path):
    folder = made(tmp_path / "new")
    (folder / "a" / "law.mpy").write_bytes(b"M\x05\x00\x1f")
    with pytest.raises(Failed, match=r"nothing has changed.* compiled for another MicroPython"):
        update(fleet, folder)
    assert not (board.flash / "trial").exists()


def test_a_folder_of_something_else_and_a_twin_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="make it with: make firmware"):
        board_update.read_files(tmp_path)
    path = tmp_path / "fleet.toml"
    path.write_text(dump(FLEET))
    with pytest.raises(ConfigError, match="the twin runs the firmware of this release"):
        update(path, None)
