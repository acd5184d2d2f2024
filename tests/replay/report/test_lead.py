"""What a report leads with, from recordings: each robot at the end, what came of it, and the pictures."""

import math
import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import pytest

from agent.core.config import Fleet
from agent.core.messages import LogLine
from replay.check.reexecute import open_boxes
from replay.files.channels import Entry
from replay.files.info import info
from replay.files.log import read
from replay.files.mcap_file import Part
from replay.report.lead import ends, lead, outcome, plain
from replay.report.page import Floor, Held, Robot, Thing, close_up, from_above
from replay.report.timeline import Run, open_run, surveyed
from tests.places import GOLDEN

R1 = Robot("r1", 0, (0.5, 0.25), yaw=0.0, looks=math.pi / 2, sees=True)
COV_M2 = (4e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)  # twice as wide in x as in y
BALL = Thing("ball", 0.07, [Held(0, (0.7, 0.5, 0.07), COV_M2), Held(1, (0.701, 0.5, 0.07), None)])


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return open_boxes([GOLDEN / "three"])[0].fleet


def said(run: Run) -> str:
    return plain(lead(run, surveyed(run)).said)


def test_nobody_knows_of_it_before_the_first_has_seen_it_but_those_who_are_told() -> None:
    found = {end.robot: end for end in ends(open_run(GOLDEN / "three"))}
    first = found["r1"]
    assert first.known_s == first.seen_s and first.seen_s is not None
    for name in ("r2", "r3"):
        end = found[name]
        assert end.known_s is not None and end.seen_s is not None
        assert first.seen_s < end.known_s < end.seen_s
    assert first.truth_m is None and first.off_m is None


def test_what_came_of_golden_runs() -> None:
    three = open_run(GOLDEN / "three")
    assert said(three).startswith(
        "All three robots saw the ball (r1 first, after 4.6 s); at the end all knew its place"
    )
    about = outcome(three, ends(three), None)
    assert about.verdict == "" and about.missing == about.torn == ()
    assert {robot.starts for robot in about.robots.values()} == {1}
    assert said(open_run(GOLDEN / "outage")).endswith("; r3 started again.")
    assert said(open_run(GOLDEN / "torn")).endswith(
        "; nothing was heard of r2 and r3; not finished by its writer: r1.mcap."
    )
    survey = said(open_run(GOLDEN / "survey"))
    assert re.match(r"\d+ % of what is wanted is known after 15 s, from 4 keyframes", survey)
    assert survey.endswith("; both robots ended with “no frames”.")
    assert "ball" not in survey


def test_of_one_robot_s_recording_others_are_not_missing(tmp_path: Path) -> None:
    alone = open_run(Path(shutil.copy(GOLDEN / "three" / "r2.mcap", tmp_path)))
    assert "nothing was heard" not in said(alone)
    tank = lead(alone, None).looks[0].svg
    assert tank.count(" gone") == 2 and "r1 (not heard)" in tank and ">r2<" in tank


def test_a_robot_that_ended_early_and_one_that_failed_are_named() -> None:
    run = open_run(GOLDEN / "three")
    early, other, last = run.timelines
    t_s, state = last.states[-1]
    failed = last._replace(states=(*last.states, (t_s, msgspec.structs.replace(state, mode="failed"))))
    text = said(run._replace(timelines=[early._replace(ends_s=9.0), other, failed]))
    assert "; r1 ended after 9.0 s of 16 s; r3 failed after 16 s." in text
    overheard = early._replace(ends_s=9.0, boxes=())
    assert "; r1 fell silent after 9.0 s of 16 s." in said(run._replace(timelines=[overheard, other, last]))


def test_what_a_robot_is_built_without_is_in_its_log_alone() -> None:
    run = open_run(GOLDEN / "three")
    for text, told in (("no IMU: sensors may drift", False), ("battery low: 10.1 V", True)):
        line = LogLine(robot="r1", sent_ns=1, level="warning", text=text)
        first, *others = run.timelines
        assert ("warned of" in said(run._replace(timelines=[first._replace(log=((1.0, line),)), *others]))) == told


def test_a_survey_has_its_own_rows_and_its_floor() -> None:
    run = open_run(GOLDEN / "survey")
    found = surveyed(run)
    shown = lead(run, found)
    assert shown.ends.rows[0][:2] == ["robot", "keyframes of its own"]
    assert 'class="known"' in shown.looks[0].svg or 'class="some"' in shown.looks[0].svg
    assert "Of the floor" in shown.looks[0].caption


def test_the_tank_is_to_scale_with_y_upwards(fleet: Fleet) -> None:
    svg = from_above(fleet, [R1._replace(way=[(0.1, 0.1), (0.5, 0.25)])], [BALL])
    ET.fromstring(svg)
    (x, y) = re.search(r'class="ring" cx="([\d.]+)" cy="([\d.]+)"', svg).groups()
    (wide, high) = (float(side) for side in re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
    length_m, _, _ = fleet.tank.size_m
    scale = (wide - 38 - 16) / length_m
    assert float(x) == pytest.approx(38 + 0.5 * scale, abs=1.0)
    assert float(y) == pytest.approx(high - 30 - 0.25 * scale, abs=1.0)
    assert 'class="truth"' not in svg and 'class="way"' in svg and "blind" not in svg
    assert 'class="truth"' in from_above(fleet, [], [BALL._replace(truth_m=(0.7, 0.5, 0.07))])
    assert "look blind" in from_above(fleet, [R1._replace(sees=False)], [])


def test_names_are_text_and_nothing_else(fleet: Fleet) -> None:
    svg = from_above(fleet, [R1._replace(name="<b>&")], [BALL._replace(name='"><script>')])
    ET.fromstring(svg)
    assert "<b>" not in svg and "<script>" not in svg


def test_close_up_an_ellipse_is_three_standard_deviations_and_turned_as_it_lies() -> None:
    svg = close_up(BALL)
    assert svg is not None
    (rx, ry, turn) = (float(n) for n in re.search(r'rx="([\d.]+)" ry="([\d.]+)".*?rotate\((-?[\d.]+)\)', svg).groups())
    (bar,) = (float(n) for n in re.search(r'class="bar" d="M12 [\d.]+h([\d.]+)"', svg).groups())
    (mm,) = (float(n) for n in re.search(r">([\d.]+) mm<", svg).groups())
    assert rx / (bar / mm) == pytest.approx(3 * 2.0, rel=0.01)
    assert ry / rx == pytest.approx(0.5, rel=0.01) and turn == pytest.approx(0.0, abs=0.1)
    leaning = BALL._replace(held=[Held(0, (0.0, 0.0, 0.0), (1e-6, 0.9e-6, 0.0, 1e-6, 0.0, 1e-6))])
    (turn,) = (float(n) for n in re.search(r"rotate\((-?[\d.]+)\)", close_up(leaning)).groups())
    assert turn == pytest.approx(-45.0), "up to the right, where y runs down"
    assert close_up(BALL._replace(held=[])) is None


def test_a_floor_is_squares(fleet: Fleet) -> None:
    svg = from_above(fleet, [], [], Floor(0.05, {"known": [(0.0, 0.0), (0.05, 0.0)], "some": []}))
    (path,) = re.findall(r'class="known" d="(.*?)"', svg)
    assert path.count("M") == path.count("z") == 2 and 'class="some"' not in svg


def test_clocks_that_differ_are_told_and_nobody_ended_early(tmp_path: Path) -> None:
    ahead_ns = 20_000_000_000
    for robot in ("r1", "r3"):
        shutil.copy(GOLDEN / "three" / f"{robot}.mcap", tmp_path)
    source = GOLDEN / "three" / "r2.mcap"
    about, part = info(source), Part(tmp_path / "r2.mcap")
    part.start(about.run, about.attachments)
    for record in read(source):
        later_ns = record.log_time_ns + ahead_ns, record.publish_time_ns + ahead_ns
        part.add(Entry(record.channel, *later_ns, record.sequence, record.data, "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    told = "".join(said.text for said in lead(open_run(tmp_path), None).said)
    assert "r2's clock is 20.0 s ahead of r1's: their times do not compare" in told.replace("\u00a0", " ")
    assert "ended after" not in told
    assert "clock" not in "".join(said.text for said in lead(open_run(GOLDEN / "three"), None).said)
