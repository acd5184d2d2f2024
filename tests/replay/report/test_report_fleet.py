"""The page of a run of which only the fleet file is left, and of one in which some robots left a black box."""

import shutil
from pathlib import Path

import pytest

from agent.core.config import ConfigError
from agent.core.messages import LogLine, Message
from replay.check.reexecute import open_boxes
from replay.report.report import report
from replay.report.timeline import open_fleet_file, overheard, timelines
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.page_tables import table


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return overheard_run(GOLDEN / "three", tmp_path_factory.mktemp("overheard") / "fleet.mcap")


def test_the_network_tells_the_same_of_beliefs_as_the_black_boxes(file: Path) -> None:
    inside = timelines(open_boxes([GOLDEN / "three"]))
    outside = overheard(open_fleet_file(file)).timelines
    assert [timeline.robot for timeline in outside] == ["r1", "r2", "r3"]
    for a, b in zip(inside, outside, strict=True):
        assert [state for _, state in a.states] == [state for _, state in b.states]
        assert [(x.t, x.cov_m2) for x in a.beliefs] == [(x.t, x.cov_m2) for x in b.beliefs]
        assert (a.priors, a.estimate) == (b.priors, b.estimate)
        assert [line for _, line in a.log] == [line for _, line in b.log]
        assert not b.sweeps


def test_links_are_counted_by_those_who_heard(file: Path) -> None:
    links = overheard(open_fleet_file(file)).links
    assert len(links) == 6
    assert all(150 < link.heard <= (link.said or 0) for link in links)


def test_a_restart_is_seen_and_strangers_are_passed_over(tmp_path: Path) -> None:
    file = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap")
    found = {timeline.robot: timeline for timeline in overheard(open_fleet_file(file)).timelines}
    assert [len(found[name].starts_s) for name in ("r1", "r2", "r3")] == [1, 1, 2]

    def garbled(message: Message) -> Message:
        return LogLine(robot="r1", sent_ns=1, level="info", text="not what this key is for")

    nothing = overheard(open_fleet_file(overheard_run(GOLDEN / "empty", tmp_path / "bad.mcap", garbled)))
    assert nothing.timelines == []


def test_the_page_draws_what_the_network_tells_and_says_what_it_does_not(file: Path) -> None:
    shown = report(file).read_text()
    for section in ("ends", "errors", "iterations", "valid", "agreement", "near", "posture", "links"):
        assert f'<section id="{section}">' in shown
    for section in ("clarity", "calibration", "depth"):
        assert f'<section id="{section}">' not in shown
    assert "From the fleet file alone: r1, r2, r3." in shown
    assert "bytes are in black boxes alone" in shown
    assert "byte for byte" not in shown
    assert [row[0] for row in table(shown, "errors")] == ["robot", "r1", "r2", "r3"]
    assert shown.count("<svg") == 2 + 3 + 3 + 1 + 1 + 3


def test_a_robot_without_a_black_box_is_drawn_from_the_fleet_file(file: Path, tmp_path: Path) -> None:
    for name in ("r1", "r3"):
        shutil.copy(GOLDEN / "three" / f"{name}.mcap", tmp_path)
    shutil.copy(file, tmp_path)
    shown = report(tmp_path).read_text()
    assert "black boxes of 2 of 3 robots" in shown
    assert "From the fleet file alone: r2." in shown
    assert [row[0] for row in table(shown, "errors")] == ["robot", "r1", "r2", "r3"]
    cells = table(shown, "links")
    assert all("/" in cell for j, row in enumerate(cells[1:]) for k, cell in enumerate(row[1:]) if j != k)


def test_another_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no recording of a fleet"):
        open_fleet_file(GOLDEN / "three" / "r1.mcap")
