"""`aucamp replay ...`: what a newcomer types wrong is one line that says what to give, and nothing is overwritten."""

import math
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError
from replay.check.explain import sigma_parts
from tests.places import GOLDEN, ROOT
from tests.replay.rewritten import rewritten

TANK = str(ROOT / "agent" / "fleets" / "tank.toml")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A fleet file alone, an empty folder, and a file that is none of ours."""
    (tmp_path / "alone").mkdir()
    (tmp_path / "empty").mkdir()
    rewritten(GOLDEN / "two" / "r1.mcap", tmp_path / "alone" / "fleet.mcap", run={"kind": "fleet"})
    (tmp_path / "x.txt").write_text("x")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["check", "alone"], "alone: has only the recording of a fleet in it; give the black box of a robot"),
        (["check", "--vision", "alone"], "alone: has only the recording of a fleet in it"),
        (
            ["check", "alone/fleet.mcap"],
            "is no black box, but the recording of a fleet, which holds no inputs of a robot; give",
        ),
        (["check", "empty"], r"empty: has no recording \(.mcap\) in it; give the black box of a robot"),
        (["explain", "alone"], "alone: is a folder; give a recording in it, such as alone/r1.mcap"),
        (["explain", "alone/fleet.mcap"], "is no black box, but the recording of a fleet"),
        (["recover", "empty"], "empty: is a folder; give a recording in it"),
        (["report", "empty"], "empty: no recording and no summary.json; give the folder of a run"),
        (["info", "empty"], r"empty: has no recording \(.mcap\) in it"),
        (["info", "x.txt"], "x.txt: is no recording: its first bytes are not those of MCAP; give a recording"),
        (["layout", TANK, "--out", "x.txt"], "x.txt: is there already, and nothing is overwritten"),
        (["report", "alone", "--out", "x.txt"], "x.txt: is there already, and nothing is overwritten"),
    ],
)
def test_what_is_typed_wrong_is_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], says: str
) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(ConfigError, match=says) as error:
        CliRunner().invoke(app, ["replay", *words], catch_exceptions=False)
    assert "\n" not in str(error.value)
    assert (folder / "x.txt").read_text() == "x"


def test_of_what_sigma_is_made(tmp_path: Path) -> None:
    """The parts add up as squares; a protocol without parts leaves them open."""
    for name in ("three_evidence", "three"):
        (whole, *parts), *_ = [row[2:] for row in sigma_parts(GOLDEN / name)]
        if name == "three":
            assert parts == ["", "", "", ""]
            continue
        assert math.hypot(*map(float, parts)) == pytest.approx(float(whole), abs=0.02)
        assert float(parts[-1]) == pytest.approx(1e3 * math.hypot(0.0015, 0.001, 0.001), abs=0.01)
    done = CliRunner().invoke(app, ["explain", "sigma", str(GOLDEN / "three_evidence")])
    assert done.exit_code == 0 and "level and survey" in done.output
    with pytest.raises(ConfigError, match="of which run"):
        CliRunner().invoke(app, ["explain", "sigma"], catch_exceptions=False)


@pytest.mark.usefixtures("undrawn")
def test_a_second_report_stands_beside_the_first(tmp_path: Path) -> None:
    shutil.copy(GOLDEN / "two" / "r1.mcap", tmp_path)
    (tmp_path / "report.html").write_text("the first")
    done = CliRunner().invoke(app, ["replay", "report", str(tmp_path)])
    assert done.exit_code == 0
    assert f"written to {tmp_path / 'report.2.html'}" in done.output
    assert (tmp_path / "report.html").read_text() == "the first"
    assert "<svg" in (tmp_path / "report.2.html").read_text()
