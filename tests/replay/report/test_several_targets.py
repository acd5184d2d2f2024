"""A run about two targets: each has its own timeline, explanation, viewer channels and sections of the report."""

import math
import shutil
from pathlib import Path

from replay.check.explain import explain
from replay.check.reexecute import open_boxes
from replay.files.channels import STEP_OUT, Entry
from replay.files.log import read
from replay.report.report import report
from replay.report.timeline import timelines
from replay.viewers.viewer_channels import ViewerChannels
from tests.places import GOLDEN

TWO = GOLDEN / "two"
WHERE_M = {"ball": (0.55, 0.66, 0.07), "buoy": (0.92, 0.45, 0.05)}


def test_a_timeline_is_about_one_target() -> None:
    found = timelines(open_boxes([TWO]))
    assert [(timeline.robot, timeline.target) for timeline in found] == [
        (r, t) for r in ("r1", "r2", "r3") for t in WHERE_M
    ]
    for timeline in found:
        where_m = WHERE_M[timeline.target]
        assert {state.target for _, state in timeline.states} == {timeline.target}
        assert math.dist(timeline.estimate[0], where_m) < 0.002
        assert all(math.dist(x_m, where_m) < 0.05 for _, x_m in timeline.priors)
        assert timeline.sweeps


def test_an_explanation_names_both_and_mixes_neither() -> None:
    ball, buoy = explain(TWO / "r2.mcap", "16s").split("\n\n")[1:]
    assert (ball.splitlines()[0], buoy.splitlines()[0]) == ("target ball", "target buoy")
    assert "Estimate: (549.9" in ball
    assert "Estimate: (919." in buoy
    assert "buoy:" not in ball


def test_viewers_get_a_channel_for_each_target() -> None:
    box = open_boxes([TWO / "r1.mcap"])[0]
    derive = ViewerChannels(box.fleet, "r1")
    channels = {
        made.channel for record in read(box.path) if record.channel == STEP_OUT.name for made in derive(entry(record))
    }
    for target in WHERE_M:
        for name in (f"/r1/target/{target}/estimate", f"/r1/plot/protocol/{target}", f"/r1/plot/hears/r2/{target}"):
            assert name in channels
    assert "/r1/target/estimate" not in channels


def entry(record):
    return Entry(
        record.channel, record.log_time_ns, record.publish_time_ns, record.sequence, record.data, "msgpack", {}
    )


def test_the_report_shows_each_target(tmp_path: Path) -> None:
    page = report(Path(shutil.copy(TWO / "r3.mcap", tmp_path))).read_text()
    for target in WHERE_M:
        assert f"r3, {target}" in page
