"""The report of a survey: how much each robot knew, and the map that all keyframes give."""

import shutil
from pathlib import Path

import pytest

from replay.report.figures import floor_above, known_over_time
from replay.report.lead import lead
from replay.report.report import report
from replay.report.tables import survey_table
from replay.report.timeline import open_run, surveyed
from tests.replay.overheard_run import overheard_run
from tests.replay.small_box import write_box

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.mark.usefixtures("undrawn")
def test_it_has_what_the_robots_said_and_the_map_of_their_keyframes(tmp_path: Path) -> None:
    run = open_run(GOLDEN / "survey")
    found = surveyed(run)
    assert found is not None
    assert {frame.origin for _, frame in found.frames} == {"r1", "r2"}
    for name, rows in found.known.items():
        assert len(rows) == 30  # twice a second, of 15 s
        assert [row.held for row in rows] == sorted(row.held for row in rows)
        assert found.paths[name] == []  # moored
    last = found.known["r1"][-1]
    assert found.all.share() == pytest.approx(last.share, abs=0.02)
    table = survey_table(found)
    assert [row[0] for row in table.rows] == ["robot", "r1", "r2"]
    assert table.rows[1][2:4] == [str(last.held), f"{100 * last.share:.1f} %"]
    known_over_time(run.fleet, found, 0)
    panel = floor_above(run.fleet, found).axes[0]
    shown = panel.images[0].get_array()
    grid = found.all.grid
    known = sum(found.all.cells.get(n, 0) >= grid.goal for n in range(grid.shape[0] * grid.shape[1]))
    assert 0 < (shown == 2).sum() <= known
    page = report(GOLDEN / "survey", tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The survey" in page and last.digest in page


def test_a_fleet_that_surveys_nothing_has_no_such_section(tmp_path: Path) -> None:
    assert surveyed(open_run(write_box(tmp_path))) is None


def test_a_robot_without_a_black_box_counts_by_the_fleet_file_or_by_what_another_heard_of_it(tmp_path: Path) -> None:
    whole = surveyed(open_run(GOLDEN / "survey"))
    shutil.copy(GOLDEN / "survey" / "r1.mcap", tmp_path)
    alone = surveyed(open_run(tmp_path))
    fleet = surveyed(open_run(overheard_run(GOLDEN / "survey", tmp_path / "fleet.mcap")))
    for found in (alone, fleet, surveyed(open_run(tmp_path))):
        assert found.all.digest() == whole.all.digest() and len(found.frames) == len(whole.frames)
    assert fleet.known == whole.known and set(alone.known) == {"r1"}
    assert surveyed(open_run(tmp_path)).known == whole.known, "what a black box has is not told again"
    assert "% of what is wanted is known" in "".join(lead(open_run(tmp_path / "fleet.mcap"), fleet).said[0])


def test_who_left_has_no_say_in_what_is_known_at_the_end() -> None:
    run = open_run(GOLDEN / "survey")
    found = surveyed(run)
    early = found.known["r2"][:5]
    gone = lead(run, found._replace(known={**found.known, "r2": early})).said[0].text
    assert gone == lead(run, found._replace(known={"r1": found.known["r1"]})).said[0].text
    assert f"{100 * early[-1].share:.0f} %" not in gone


def test_keyframes_that_no_robot_believed_are_not_in_the_map() -> None:
    """Forged ones, some with depths and sigmas of different grids: the map is the robot's own."""
    found = surveyed(open_run(GOLDEN / "dark_survey"))
    assert found.all.digest() == found.known["r1"][-1].digest
