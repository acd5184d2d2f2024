"""Foxglove's layout for any fleet."""

import json
import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import pytest

from agent.core.config import Fleet
from agent.robot.fleet_reader import load_fleet
from replay.recorder import where_the_layout_is
from replay.viewers.layout import foxglove_layout, shipped, write


def fleet_of(file: str, *robots: str) -> Fleet:
    fleet = load_fleet(Path(str(resources.files("agent") / "fleets" / file)))
    return msgspec.structs.replace(fleet, robot={name: fleet.robot[name] for name in robots or fleet.robot})


def leaves(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        yield from (*leaves(tree["first"]), *leaves(tree["second"]))


def test_the_shipped_layout_is_that_of_three_robots_in_the_tank() -> None:
    fleet = fleet_of("tank.toml", "r1", "r2", "r3")
    assert foxglove_layout(fleet) == json.loads(shipped("foxglove.json").read_text(encoding="utf-8"))
    assert where_the_layout_is(fleet) == f"the layout is {shipped('foxglove.json')}"
    assert "aucamp replay layout" in where_the_layout_is(fleet_of("tank.toml"))


@pytest.mark.parametrize("robots", [("r4",), ("r2", "r5"), ("r1", "r2", "r3", "r4", "r5")])
def test_every_robot_is_shown_and_no_other(robots: tuple[str, ...]) -> None:
    layout = foxglove_layout(fleet_of("tank.toml", *robots))
    text = json.dumps(layout)
    assert set(re.findall(r'"/(\w+)/', text)) == {*robots, "plot"}
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    assert [panels[f"Image!{name}_preview"]["imageMode"]["imageTopic"] for name in robots] == [
        f"/{name}/preview" for name in robots
    ]
    assert panels["Log!lines"]["topicToRender"] == f"/{robots[0]}/log"
    assert [path["label"] for path in panels["Plot!rate"]["paths"]] == ["clock"]  # all follow the same
    for name in (name for name in panels if name.startswith("Plot!") and name != "Plot!rate"):
        assert [path["label"] for path in panels[name]["paths"]] == list(robots)
        assert len({path["color"] for path in panels[name]["paths"]}) == len(robots)


def test_of_several_targets_each_has_its_channels() -> None:
    panels = foxglove_layout(fleet_of("two_balls.toml", "r1", "r2"))["configById"]
    assert [(path["label"], path["value"]) for path in panels["Plot!x"]["paths"]] == [
        ("r1 ball", "/r1/plot/protocol/ball.posterior_x_m"),
        ("r1 buoy", "/r1/plot/protocol/buoy.posterior_x_m"),
        ("r2 ball", "/r2/plot/protocol/ball.posterior_x_m"),
        ("r2 buoy", "/r2/plot/protocol/buoy.posterior_x_m"),
    ]
    assert [path["value"] for path in panels["Plot!depth"]["paths"]] == [f"/r{n}/plot/attitude.depth_m" for n in (1, 2)]
    topics = panels["3D!world"]["topics"]
    assert {"/r1/target/buoy/prior", "/r2/target/ball/estimate", "/r2/camera/calibration"} <= topics.keys()
    assert not any(topic.endswith("/target/prior") for topic in topics)


def test_a_larger_tank_is_seen_from_farther_away() -> None:
    small = fleet_of("tank.toml", "r1")
    large = msgspec.structs.replace(small, tank=msgspec.structs.replace(small.tank, size_m=(6.0, 4.0, 2.0)))
    near, far = (foxglove_layout(fleet)["configById"]["3D!world"] for fleet in (small, large))
    assert far["cameraState"]["distance"] == 4.0 * near["cameraState"]["distance"]
    assert far["cameraState"]["targetOffset"] == [3.0, 2.0, 0.2]
    assert (far["layers"]["grid"]["position"], far["layers"]["grid"]["size"]) == ([3.0, 2.0, 0], 12.0)


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    out = tmp_path / "layout.json"
    write(fleet_of("tank.toml"), out)
    assert json.loads(out.read_text()) == foxglove_layout(fleet_of("tank.toml"))
    with pytest.raises(OSError, match=r"nowhere/layout\.json"):
        write(fleet_of("tank.toml"), tmp_path / "nowhere" / "layout.json")
