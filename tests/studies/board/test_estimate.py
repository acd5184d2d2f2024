"""The estimate's own arithmetic, and what it says of the firmware as it is."""

import numpy as np
import pytest

from agent.experiments.claim import NoSettings, measure
from agent.experiments.claim import verdict as verdict_of
from agent.process.command import Failed
from tests.studies.board import __main__ as command
from tests.studies.board import boots, claim, estimate, imposed, sources, tools
from tests.studies.board.counts import Count, Log, mean_of
from tests.studies.board.report import verdict
from tests.studies.board.timetable import Cycle, hearing_ms, timetable


def cycle(number, work, heard=False, sent=0.0):
    return Cycle(number, heard, work, gc=1.0, i2c=0.5, sent=sent, idle=0.0)


def test_a_cycle_of_13_ms_loses_a_quarter_of_the_ticks_and_one_of_9_none():
    slow = timetable([cycle(n, 13.333 - 1.5) for n in range(20)])
    assert slow.lost == pytest.approx(0.25, abs=0.001)
    assert slow.cycles_s == pytest.approx(75.0, abs=0.1)
    quick = timetable([cycle(n, 7.5) for n in range(20)])
    assert (quick.mean_ms, quick.lost, quick.cycles_s) == (9.0, 0.0, 100.0)
    assert set(quick.periods_ms) == {10.0}


def test_hearing_is_told_from_sending():
    """Set-points that come with telemetry only do not make telemetry look dear."""
    cycles = []
    for n in range(40):
        sends, hears = n % 2, n % 5 == 0
        cycles.append(cycle(n, 3.0 + 2.0 * sends + 1.5 * hears, hears, 0.78 * sends))
    assert hearing_ms(cycles) == pytest.approx(1.5)
    assert timetable(cycles).worst_ms == pytest.approx(5.0 + 1.5 + 1.5 + 0.78)


@pytest.mark.parametrize(
    ("mean_ms", "worst_ms", "says"),
    [
        (5.0, 9.3, "in every cycle"),
        (5.0, 10.5, "cannot be told"),
        (9.0, 12.0, "in the mean, not"),
        (9.5, 12.0, "does not keep"),
    ],
)
def test_a_verdict_knows_how_good_the_estimate_is(mean_ms, worst_ms, says):
    assert says in verdict(mean_ms, worst_ms)


def test_runs_that_met_other_places_have_one_mean():
    one = Log({1: (0, 7)}, [{1: Count(1, 2, 0, {"vm": 10})}])
    other = Log({1: (0, 8), 2: (0, 7)}, [{2: Count(1, 4, 0, {"vm": 30}), 1: Count(2, 0, 0, {})}])
    both = mean_of([one, other])
    assert {both.path(node): node for node in both.nodes} == {(7,): 1, (8,): 2}
    assert both.windows[0][1] == Count(1, 3, 0, {"vm": 20})
    assert both.windows[0][2].calls == 1


def test_no_part_of_a_cycle_takes_less_than_nothing():
    parts = np.array([[1, 0, 1, 78], [1, 0, 1, 34], [1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 1, 78]], float)
    found, worst = imposed._least_squares(parts, parts @ np.array([4000.0, 3000.0, 200.0, 15.0]))
    assert found == pytest.approx([4000, 3000, 200, 15]) and worst < 1e-6
    found, worst = imposed._least_squares(parts, parts @ np.array([4000.0, 3000.0, -200.0, 15.0]))
    assert found.min() >= 0 and found[2] == 0 and 10 < worst < 200


def test_what_is_missing_is_one_line_with_a_remedy(monkeypatch, capsys):
    monkeypatch.setattr(tools, "which", lambda name: None)
    assert command.main([]) == 1
    said = capsys.readouterr().err
    assert "apt-get install -y qemu-user gcc libc6-dev" in said
    with pytest.raises(Failed, match="apt-get install -y qemu-user"):
        claim.run(0, "all", NoSettings())


def test_only_what_the_board_may_import_is_part_of_the_digest(tmp_path):
    (tmp_path / "main.py").write_text("import a\nif 0:\n    import hal_unix\n")
    (tmp_path / "a.py").write_text("def f():\n    import b\n")
    for name in ("b", "hal_unix", "bus"):
        (tmp_path / f"{name}.py").write_text("import bus\n" if name == "hal_unix" else "x = 1\n")
    assert list(sources.candidates(tmp_path)) == ["main", "a", "b"]
    before = sources.digest(tmp_path)
    (tmp_path / "bus.py").write_text("x = 2\n")
    assert sources.digest(tmp_path) == before
    (tmp_path / "b.py").write_text("x = 2\n")
    assert sources.digest(tmp_path) != before


@pytest.mark.slow
def test_the_firmware_keeps_its_cycle(monkeypatch):
    """One numbering of six: within 1 % of what `python -m tests.studies.board` says."""
    try:
        tools.find_tools()
    except tools.MissingTool as missing:
        pytest.skip(str(missing))
    monkeypatch.setattr(boots, "NUMBERINGS", boots.NUMBERINGS[:1])
    options = boots.Options(tools.FIRMWARE)
    result = estimate.figures(estimate.measure(options), options)
    found = measure(claim.CLAIM, {"all": {0: [claim.row(result)]}})
    assert {figure.key: verdict_of(figure, found[figure.key]) for figure in claim.CLAIM.figures} == dict.fromkeys(
        found, "met"
    )
    assert not result["heap_was_full"] and not result["collector_overflows"]


def test_the_twin_s_times_are_those_of_today_s_firmware():
    """python -m tests.studies.board --write, on a computer with QEMU."""
    assert imposed.hint(tools.FIRMWARE) == ""
