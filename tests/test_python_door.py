"""`import aucamp`: a recording as tables, its steps once more, a fleet as it speaks; and the notebook that shows it."""

import json

import pytest

import aucamp
from agent.core.config import ConfigError
from tests.places import GOLDEN, ROOT

RUN = GOLDEN / "three"


@pytest.fixture(scope="module")
def run() -> aucamp.Recording:
    return aucamp.replay(RUN)


def test_tables_have_numbers(run) -> None:
    rows = run.table("r1")
    assert len(rows) > 5 and all(isinstance(row["time_s"], float) for row in rows)
    assert rows[-1]["target"] in run.fleet.target and rows[-1]["iteration"] > rows[0]["iteration"]
    assert len(run.table("r2", "telemetry")) > len(run.table("r2"))


def test_steps_are_decoded_and_run_again(run) -> None:
    first = next(run.steps("r1"))
    assert first.outputs is not None and first.outputs.set_point is not None
    assert run.rerun("r1").passed


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda run: run.table("r9"), "nothing of a robot 'r9'"),
        (lambda run: run.table("r1", "weather"), "take one of state, telemetry"),
        (lambda run: run.errors("r1", "whale"), "no target 'whale'; there is ball"),
        (lambda run: aucamp.replay("nowhere"), "nowhere"),
    ],
)
def test_what_is_not_there_is_said_in_one_line(run, ask, says) -> None:
    with pytest.raises(ConfigError, match=says) as error:
        ask(run)
    assert "\n" not in str(error.value)


def test_what_is_torn_is_mended_with_a_warning(tmp_path) -> None:
    for name in ("r1", "r2", "r3"):
        whole = (RUN / f"{name}.mcap").read_bytes()
        (tmp_path / f"{name}.mcap").write_bytes(whole[: len(whole) // 2] if name == "r2" else whole)
    with pytest.warns(UserWarning, match=r"r2\.mcap was torn, mended as"):
        run = aucamp.replay(tmp_path)
    assert 0 < len(run.table("r2")) < len(run.table("r1"))


def test_the_notebook_runs(monkeypatch) -> None:
    """Its cells in order, on a recording that is there."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    book = json.loads((ROOT / "examples" / "first_dive.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    names: dict = {}
    for cell in cells:
        exec(cell.replace("../runs/20260101T120000Z", str(RUN)), names)
    assert names["again"].passed and len(names["rows"]) > 5
