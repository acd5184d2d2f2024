"""The report of a survey: how much each robot knew, and the map that all keyframes give."""

from pathlib import Path

import pytest

from replay.check.reexecute import open_boxes
from replay.report.figures import floor_above, known_over_time
from replay.report.report import report
from replay.report.tables import survey_table
from replay.report.timeline import surveyed
from tests.replay.small_box import write_box

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.mark.usefixtures("undrawn")
def test_it_has_what_the_robots_said_and_the_map_of_their_keyframes(tmp_path: Path) -> None:
    boxes = open_boxes(sorted((GOLDEN / "survey").glob("*.mcap")))
    found = surveyed(boxes[0].fleet, boxes)
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
    known_over_time(boxes[0].fleet, found, 0)
    panel = floor_above(boxes[0].fleet, found).axes[0]
    shown = panel.images[0].get_array()
    grid = found.all.grid
    known = sum(found.all.cells.get(n, 0) >= grid.goal for n in range(grid.shape[0] * grid.shape[1]))
    assert 0 < (shown == 2).sum() <= known
    page = report(GOLDEN / "survey", tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The survey" in page and last.digest in page


def test_a_fleet_that_surveys_nothing_has_no_such_section(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    (box,) = open_boxes([path])
    assert surveyed(box.fleet, [box]) is None
    assert surveyed(box.fleet, []) is None
