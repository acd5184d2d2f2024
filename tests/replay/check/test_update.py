"""Accepting a change: deliberate, with a reason, and nothing but the outputs."""

import os
import shutil
from pathlib import Path

import pytest

from agent.core.config import ConfigError
from replay.check.check import check, update_recordings
from replay.files.log import info, read
from tests.places import GOLDEN
from tests.replay.rewritten import rewritten

BLIND_GIT = "#!/bin/sh\nexit 128\n"  # no checkout


@pytest.fixture
def git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program called git that says what a test wants."""
    stub = tmp_path / "bin" / "git"
    stub.parent.mkdir()
    stub.write_text(BLIND_GIT)
    stub.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stub.parent}:{os.environ['PATH']}")
    return stub


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOLDEN / "three", tmp_path / "run"))


def test_outputs_are_replaced_and_inputs_kept(run: Path, git: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.core.control.sweep.TRACK_SPAN", 1.6)
    assert check([run]).exit_code == 1
    accepted = [text] if (text := info(run / "r1.mcap").run.get("accepted")) else []
    before = {record.sequence: record.data for record in read(run / "r1.mcap") if record.channel == "/raw/step_in"}
    updated = update_recordings([run], "wider sweeps find the flanks")
    assert [each.box.robot for each in updated] == ["r1", "r2", "r3"]
    assert check([run]).exit_code == 0
    after = {record.sequence: record.data for record in read(run / "r1.mcap") if record.channel == "/raw/step_in"}
    assert after == before
    about = info(run / "r1.mcap")
    assert about.complete
    accepted.append("wider sweeps find the flanks")
    assert about.run["accepted"] == "; ".join(accepted)
    assert about.run["incarnation"] == info(GOLDEN / "three" / "r1.mcap").run["incarnation"]
    assert [file.name for file in sorted(run.iterdir())] == ["r1.mcap", "r2.mcap", "r3.mcap"]
    assert "estimate_m: (" in str(updated[0])
    assert f"{updated[0].steps} steps changed" in str(updated[0])
    monkeypatch.undo()
    monkeypatch.setenv("PATH", f"{git.parent}:{os.environ['PATH']}")
    update_recordings([run], "back again")
    assert info(run / "r1.mcap").run["accepted"] == "; ".join([*accepted, "back again"])
    assert [r.data for r in read(run / "r1.mcap")] == [r.data for r in read(GOLDEN / "three" / "r1.mcap")]


def test_nothing_is_written_where_nothing_changed(run: Path, git: Path) -> None:
    before = (run / "r1.mcap").read_bytes()
    assert update_recordings([run], "no reason needed, but one given") == []
    assert (run / "r1.mcap").read_bytes() == before


def test_it_needs_a_reason(run: Path, git: Path) -> None:
    with pytest.raises(ConfigError, match="needs --reason"):
        update_recordings([run], " ")


def test_it_refuses_a_dirty_checkout(run: Path, git: Path) -> None:
    git.write_text("#!/bin/sh\necho ' M agent/robot/step.py'\n")
    with pytest.raises(ConfigError, match="uncommitted changes"):
        update_recordings([run], "a reason")


def test_it_refuses_what_is_not_whole(run: Path, git: Path) -> None:
    rewritten(GOLDEN / "three" / "r1.mcap", run / "x.mcap", lambda r: None if r.sequence == 9 else r.data)
    with pytest.raises(ConfigError, match="lacks steps"):
        update_recordings([run / "x.mcap"], "a reason")
    with pytest.raises(ConfigError, match="is torn"):
        update_recordings([GOLDEN / "torn"], "a reason")
