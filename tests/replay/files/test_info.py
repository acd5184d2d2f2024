"""What `aucamp replay info` says of a recording."""

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from agent.core.config import ConfigError
from replay.files.channels import Entry
from replay.files.info import describe, info
from replay.files.log import LogWriter
from replay.story import info_all
from tests.replay.small_box import STEPS, write_box


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
