"""What every verb of `aucamp experiment` does with its experiment: folder, bar, result.json, figures, table."""

import io
import json
from pathlib import Path
from typing import get_args

import pytest
from matplotlib.figure import Figure
from rich.console import Console
from typer.testing import CliRunner

from agent.cli.experiments import app
from agent.core.config import ConfigError
from agent.experiments.experiment import WATERS, ExperimentResult, Sensor, perform
from agent.process.command import Failed
from hw.twin.optics.lens import PRESETS
from hw.twin.optics.shade import KD_PER_M

VERBS = [command.name for command in app.registered_commands]


class Found(ExperimentResult, frozen=True, kw_only=True):
    schema: int = 1
    value: float
    shown: str


def find(settings, progress):
    progress(1, 1)
    return Found(value=settings, shown="beside")


def drawn(result):
    for suffix in ("svg", "png"):
        yield f"picture.{suffix}", Figure(figsize=(1, 1))


def test_result_and_figures_are_in_the_folder_and_the_table_is_shown(tmp_path: Path) -> None:
    console = Console(file=io.StringIO())
    found = perform(find, 0.5, lambda result: result.shown, tmp_path / "new", console, "parts", drawn)
    assert found == Found(value=0.5, shown="beside")
    assert json.loads((tmp_path / "new" / "result.json").read_text()) == {"schema": 1, "value": 0.5}
    assert list(json.loads((tmp_path / "new" / "result.json").read_text())) == ["schema", "value"]
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"result.json", "picture.svg", "picture.png"}
    said = console.file.getvalue()
    assert "parts" in said and "beside" in said and f"written to {tmp_path / 'new'}" in said.replace("\n", "")


class Missed(Found, frozen=True, kw_only=True):
    @property
    def failed(self):
        return True


def test_the_answer_no_is_said_when_all_is_written_and_is_exit_code_1(tmp_path: Path) -> None:
    console = Console(file=io.StringIO())
    with pytest.raises(Failed, match=r"a target is missed; the tables say which, and .*result\.json"):
        perform(lambda *_: Missed(value=1, shown="x"), 1, lambda result: "table", tmp_path, console, "parts", drawn)
    assert len(list(tmp_path.iterdir())) == 3 and "table" in console.file.getvalue()


@pytest.mark.parametrize("verb", VERBS)
def test_a_folder_with_a_result_is_left_alone(verb: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    done = CliRunner().invoke(app, [verb, "--out", str(tmp_path)])
    assert isinstance(done.exception, ConfigError)
    assert "not empty, and nothing is overwritten; give --out a new folder" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    assert (tmp_path / "result.json").read_text() == "{}"


def test_names_that_may_be_given_are_those_of_the_twin() -> None:
    assert get_args(Sensor) == tuple(PRESETS)
    assert tuple(KD_PER_M) == WATERS
