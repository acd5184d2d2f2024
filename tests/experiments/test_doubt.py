"""What is wrong is noticed: the kernel's own targets, over links that delay."""

import pytest

from agent.experiments import doubt
from agent.experiments.doubt import ROWS, Settings, run, summary


@pytest.mark.parametrize(("case", "seconds"), [("moved-60", 56.0), ("removed", 56.0), ("long-2", 27.0)])
def test_no_fleet_is_wrong_in_silence(case, seconds) -> None:
    (row,) = run(11, case, Settings(seconds=seconds))
    assert row["silent"] == 0.0
    assert row["nees"] is None or row["nees"] < 9.0 or row["said_s"] is not None


def test_a_delay_from_the_first_message_on_is_in_sigma(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doubt, "NOTICED_S", 1.0)
    (row,) = run(12, "late-0.3", Settings(seconds=18.0))
    assert row["nees"] < 6.0


def test_each_row_has_its_figures() -> None:
    row = {"error_mm": 1.0, "sigma_mm": 1.0, "nees": 3.0, "silent": 0.0, "said_s": None, "word": "", "cause": ""}
    found = summary({case: [row, row] for case in ROWS})
    assert all(found[f"{case}.heard"].of == 2 for case in ROWS)
