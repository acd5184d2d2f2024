"""The page of a run of which only the fleet file is left, and of one in which some robots left a black box."""

import json
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, dump
from agent.core.messages import LogLine, Message
from replay.check.reexecute import open_boxes
from replay.files.channels import Entry
from replay.files.info import info
from replay.files.log import read
from replay.files.mcap_file import Part
from replay.files.recover import auto_recovered
from replay.report.lead import lead
from replay.report.report import report
from replay.report.timeline import open_fleet_file, open_run, overheard, timelines
from replay.story import said_in
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
        return LogLine(robot="r9", sent_ns=1, level="info", text="not what this key is for")

    nothing = overheard(open_fleet_file(overheard_run(GOLDEN / "empty", tmp_path / "bad.mcap", garbled)))
    assert nothing.timelines == []


@pytest.mark.usefixtures("undrawn")
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


@pytest.mark.usefixtures("undrawn")
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


SPLIT_NS = 1_767_225_600_000_000_000 + 8 * 10**9


def half(out: Path, first: bool) -> Path:
    return overheard_run(
        GOLDEN / "three", out, lambda message: message if (message.sent_ns < SPLIT_NS) is first else None
    )


def test_a_recorder_that_was_started_again_is_read_as_one(file: Path, tmp_path: Path) -> None:
    half(tmp_path / "fleet.mcap", True), half(tmp_path / "fleet.2.mcap", False)
    both = open_fleet_file(tmp_path)
    assert [path.name for path in both.paths] == ["fleet.mcap", "fleet.2.mcap"]
    assert [said[2:] for said in said_in(both.paths)] == [said[2:] for said in said_in([file])]
    for halves, whole in zip(open_run(tmp_path).timelines, open_run(file).timelines, strict=True):
        assert halves.states == whole.states
    assert open_fleet_file(tmp_path / "fleet.2.mcap").paths == (tmp_path / "fleet.2.mcap",)


def test_another_recording_of_the_fleet_is_named(file: Path, tmp_path: Path) -> None:
    half(tmp_path / "dive1.mcap", True)
    shutil.copy(file, tmp_path)
    lines: list[str] = []
    auto_recovered([tmp_path], lines.append)
    assert lines == [
        f"{tmp_path / 'dive1.mcap'} is another recording of the fleet than {tmp_path / 'fleet.mcap'}, which is larger; "
        "give it alone to see it"
    ]
    assert open_fleet_file(tmp_path).path == tmp_path / "fleet.mcap"


def with_fleet(source: Path, out: Path, name: str, wide_m: float) -> None:
    """A black box again, with another name of its fleet, or another tank."""
    box = open_boxes([source])[0]
    tank = replace(box.fleet.tank, size_m=(wide_m, *box.fleet.tank.size_m[1:]))
    part, about = Part(out), info(source)
    fleet = dump(replace(box.fleet, fleet=name, tank=tank))
    part.start({**about.run, "fleet": name}, {**about.attachments, "fleet.toml": fleet})
    for record in read(source):
        part.add(Entry(*record, "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})


def test_recordings_of_two_fleets_are_no_run(tmp_path: Path) -> None:
    shutil.copy(GOLDEN / "three" / "r1.mcap", tmp_path)
    wide_m = open_boxes([tmp_path])[0].fleet.tank.size_m[0]
    for fleet, wider_m, why in (
        ("lake", 0.0, "is of the fleet 'lake', not 'tank' as"),
        ("tank", 1.0, "was made with another fleet file as"),
    ):
        with_fleet(GOLDEN / "three" / "r2.mcap", tmp_path / "r2.mcap", fleet, wide_m + wider_m)
        with pytest.raises(ConfigError, match=f"r2.mcap: {why} .*r1.mcap; move one away, or give one of them alone"):
            open_run(tmp_path)
        (tmp_path / "r2.mcap").unlink()


def test_a_summary_of_another_dive_is_refused(tmp_path: Path) -> None:
    shutil.copy(GOLDEN / "three" / "r1.mcap", tmp_path)
    start = open_boxes([tmp_path])[0].incarnation
    for heard, fits in (({"r1": [start], "r2": [7]}, True), ({"r1": [7]}, False), ({"r1": []}, True), (None, True)):
        summary = {"verdict": "pass", "truth_m": [0.7, 0.5, 0.1], "agents": {}, "incarnations": heard}
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        if fits:
            assert open_run(tmp_path).truths_m
            continue
        with pytest.raises(ConfigError, match="is of another dive than the recordings of r1 beside it; move it away"):
            open_run(tmp_path)


def test_what_is_not_read_leads_the_report(tmp_path: Path) -> None:
    source = GOLDEN / "three" / "r1.mcap"
    about, part = info(source), Part(tmp_path / "r1.mcap")
    part.start(about.run, about.attachments)
    for record in read(source):
        if not 100 <= record.sequence < 110:
            part.add(Entry(*record, "msgpack", {}))
    part.finish("aucamp.end", {"cause": "rotated"})
    run = open_run(tmp_path)
    found = "".join(said.text for said in lead(run, None).said if said.kind == "bad")
    goes_on = f"{tmp_path / 'r1.mcap'} goes on in r1.part002.mcap, which is not here; put it back there"
    assert goes_on in found
    assert "r1.mcap: steps are missing after step 99: what is made of steps leaves out the 210 later ones" in found
