"""What is counted of the dives of `aucamp demo`: each by its worst robot."""

from pathlib import Path
from typing import Any

import pytest

from agent.demo.summary import BARS
from agent.experiments import demo
from agent.experiments.claim import Quantile, Share, measure, verdict
from agent.experiments.demo import CLAIM, DIVES, Settings, of_ball, run, summary


def ball(*errors: float | None) -> dict:
    """The target of a summary.json, as far as it is read."""
    row = {"relative_error_percent": None, "below_0_4_percent_from": 12, "prior_rmse_mm": 3.0, "error_mm": 2.0}
    row["sigma_m"] = 0.002
    return {"agents": {f"r{k}": {**row, "relative_error_percent": error} for k, error in enumerate(errors)}}


def dive(*errors: float | None, passed: bool = True) -> dict:
    return {"passed": passed, "doubted": not passed, **of_ball(ball(*errors))}


def test_a_dive_is_as_good_as_its_worst_robot() -> None:
    figures = {"error_percent": 0.3, "from_iteration": 12.0, "prior_mm": 3.0, "sigma_mm": 2.0, "nees": 3.0}
    assert of_ball(ball(0.1, 0.3)) == pytest.approx(figures)
    assert of_ball(ball(0.1, None))["error_percent"] is None
    found = summary({"tank": [dive(0.1, 0.2), dive(0.1, 0.5, passed=False), dive(None, 0.1, passed=False)]})
    assert found["tank_within"] == found["tank_passed"] == Share(1, 3)
    assert found["tank_doubted"] == Share(2, 3)
    assert found["tank_error_percent"] == Quantile([0.2, 0.5, None], 50.0)


def test_sixty_dives_show_the_share_that_is_asked_for() -> None:
    rows = {"tank": {seed: [dive(0.1, 0.2)] for seed in range(60)}}
    found = measure(CLAIM, rows)
    judged = {figure.key: verdict(figure, found[figure.key]) for figure in CLAIM.figures if figure.key in found}
    assert set(judged.values()) == {"met", ""} and judged["tank_within"] == "met"


def test_every_case_tells_all_its_figures() -> None:
    of_case = {"box": {"outside_mm": 1.0}, "fish": dict.fromkeys(BARS, 1.0)}
    of_case["stale"] = {"told": 1}
    rows = {case: [{**dive(0.1), **of_case.get(case, {})}] for case in DIVES}
    assert set(summary(rows)) == {figure.key for figure in CLAIM.figures}


@pytest.mark.parametrize("verdict", ["pass", "fail"])
def test_what_a_failed_dive_recorded_is_kept_where_asked(
    verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {"r0": {**ball(0.1)["agents"]["r0"], "verdict": "consistent", "faults": []}}

    def dived(*asked: Any, **_: Any) -> tuple[None, dict[str, Any]]:
        folder = asked[5]
        folder.mkdir()
        (folder / "r0.mcap").write_bytes(b"recorded")
        return None, {"targets": {"ball": {"agents": rows}}, "verdict": verdict}

    monkeypatch.setattr(demo, "demo", dived)
    (row,) = run(7, "tank", Settings(keep=str(tmp_path / "kept")))
    assert row["passed"] == (verdict == "pass")
    assert (tmp_path / "kept" / "tank-7" / "r0.mcap").exists() == (verdict == "fail")
