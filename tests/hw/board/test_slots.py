"""What the board remembers: a save that is cut short leaves the one before, and files of older releases are read."""

from __future__ import annotations

import binascii
import json
from pathlib import Path

import pytest

from hw.firmware import slots


@pytest.fixture(autouse=True)
def flash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.sync", lambda: None)
    return tmp_path


def two_lines(content: object) -> str:
    text = json.dumps(content)
    return f"{text}\n{binascii.crc32(text.encode()):08x}\n"


def test_a_fresh_board_remembers_nothing():
    assert slots.newest() == (0, {})


def test_saves_go_into_two_files_in_turn(flash):
    for i in range(1, 6):
        slots.save({"heave_kg": i})
        assert slots.newest()[1] == {"heave_kg": i}
    assert sorted(path.name for path in flash.iterdir()) == ["flash0.json", "flash1.json"]
    held = {json.loads(path.read_text().splitlines()[0])[1]["heave_kg"] for path in flash.iterdir()}
    assert held == {4, 5}


@pytest.mark.parametrize("saves", [1, 2, 3])
def test_a_save_that_is_cut_short_anywhere_leaves_the_one_before(flash, saves):
    for i in range(saves):
        slots.save({"tare_pa": [101325.0 + i] * 4})
    before = {path: path.read_text() for path in flash.iterdir()}
    slots.save({"tare_pa": [99999.0] * 4})
    (written,) = (path for path in flash.iterdir() if before.get(path) != path.read_text())
    whole = written.read_text()
    for n in range(len(whole) - 1):
        written.write_text(whole[:n])
        assert slots.newest()[1] == {"tare_pa": [101325.0 + saves - 1] * 4}
    slots.save({"law": "pi"})
    assert slots.newest()[1] == {"law": "pi"}, "and the next one replaces what is broken"


def test_the_single_file_of_before_is_read_until_something_is_saved(flash):
    (flash / "flash.json").write_text(two_lines({"law": "pid"}))
    assert slots.newest() == (0, {"law": "pid"})
    slots.save({"law": "pi"})
    assert slots.newest()[1] == {"law": "pi"}
    assert (flash / "flash.json").read_text() == two_lines({"law": "pid"})


@pytest.mark.parametrize("name", slots.FILES)
@pytest.mark.parametrize("content", ["", "{}", "{}\n00000000\n", two_lines("no table"), two_lines([1]), two_lines(1)])
def test_where_no_file_is_sound_it_is_told(flash, name, content):
    (flash / name).write_text(content)
    with pytest.raises(ValueError, match="flash: checksum is wrong; set and save anew"):
        slots.newest()
    slots.save({"law": "pi"})
    assert slots.newest()[1] == {"law": "pi"}
