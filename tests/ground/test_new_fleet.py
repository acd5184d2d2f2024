"""Fleet files that `aucamp init` writes: they are read, their robots have room and see the ball or are told."""

import math
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import Fleet
from agent.demo.demo import demo_fleet
from agent.ground.check import MARKS, mistakes_in
from agent.ground.new_fleet import MOST, fleet_name, write_fleet
from agent.process.command import shipped_fleet, shipped_names
from agent.robot.fleet_reader import load_fleet
from hw.twin.physics.body import HULL_M
from hw.twin.scene import Scene, scene_of, target_solids

SEES_DEG = 12.0  # to the side, of a camera of 640 pixels with 1170 px of focal length: 15
REACH_M = 0.10  # from the body's centre to its camera


@pytest.mark.parametrize("count", range(1, MOST + 1))
def test_robots_of_the_twin_have_room_and_r1_sees_the_ball(count: int, tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, count, twin=True)
    fleet = load_fleet(path)
    assert not list(mistakes_in(path)) and len(fleet.robot) == count
    scene = scene_of(fleet)
    solid = target_solids(fleet, scene, path)["ball"]
    for name, robot in fleet.robot.items():
        x_m, y_m = robot.pose.x_m, robot.pose.y_m
        assert HULL_M[0] < x_m < fleet.tank.size_m[0] - HULL_M[0] and HULL_M[1] < y_m < fleet.tank.size_m[1] - HULL_M[1]
        assert clear_m(fleet, scene, name) > 0.0, name
        ahead = math.radians(robot.pose.yaw_deg)
        bearing = math.degrees(math.atan2(solid.position_m[1] - y_m, solid.position_m[0] - x_m) - ahead)
        off_deg = abs((bearing - robot.look.pan_deg + 180.0) % 360.0 - 180.0)
        assert off_deg < SEES_DEG if name == "r1" else off_deg > 2.0 * SEES_DEG, name
        assert abs((bearing + 180.0) % 360.0 - 180.0) < 80.0, "it can turn its camera there"
        away_m = math.dist((x_m, y_m), solid.position_m[:2]) - REACH_M
        assert 0.35 < away_m < 1.0, name
        for other in scene.solid:
            if other is not solid:
                room_m = beside_m((x_m, y_m), solid.position_m[:2], other.position_m[:2]) - max(other.radii_m)
                assert room_m > max(solid.radii_m), f"a {other.kind} stands between {name} and the ball"
    assert demo_fleet(None, "evidence", 0.0, 0, False, tmp_path, path).robot.keys() == fleet.robot.keys()


def beside_m(start: tuple[float, ...], end: tuple[float, ...], point: tuple[float, ...]) -> float:
    """From a point to the way between two others."""
    way, there = [e - s for e, s in zip(end, start, strict=True)], [p - s for p, s in zip(point, start, strict=True)]
    share = sum(w * t for w, t in zip(way, there, strict=True)) / sum(w * w for w in way)
    share = min(max(share, 0.0), 1.0)
    return math.dist(there, [share * w for w in way])


def clear_m(fleet: Fleet, scene: Scene, name: str) -> float:
    """From a robot's hull to whatever is nearest at its height: another hull, a solid."""
    robot = fleet.robot[name]
    here, bottom_m = (robot.pose.x_m, robot.pose.y_m), fleet.tank.surface_m - robot.depth_m - HULL_M[2]
    hulls = [
        math.dist(here, (other.pose.x_m, other.pose.y_m)) - 2.0 * HULL_M[0]
        for other in fleet.robot.values()
        if other is not robot
    ]
    solids = [
        math.dist(here, solid.position_m[:2]) - HULL_M[0] - max(solid.radii_m[:2])
        for solid in scene.solid
        if solid.position_m[2] + solid.radii_m[2] > bottom_m
    ]
    return min(*hulls, *solids, math.inf)


@pytest.mark.parametrize("count", [1, 2, 7, MOST])
def test_a_file_of_real_robots_is_read_and_says_what_to_put_in(count: int, tmp_path: Path) -> None:
    path = tmp_path / "pool.toml"
    lines = write_fleet(path, count, twin=False)
    fleet = load_fleet(path)
    assert fleet.fleet == "pool" and len(fleet.robot) == count
    assert not any("twin:" in robot.serial + robot.camera for robot in fleet.robot.values())
    assert len({robot.listen for robot in fleet.robot.values()}) == count
    assert all(mark in path.read_text() for mark in MARKS)
    assert lines[1:] == [f"  aucamp check {path}", f"  aucamp calibrate run {path} --robot r1"]


@pytest.mark.parametrize(("file", "name"), [("Pool 2.toml", "pool_2"), ("2nd.toml", "fleet"), ("a" * 20, "a" * 16)])
def test_a_fleet_is_called_what_its_file_is_called(file: str, name: str) -> None:
    assert fleet_name(Path(file)) == name


def test_nothing_is_overwritten_and_the_next_two_commands_are_said(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    done = CliRunner().invoke(app, ["init", "--twin", "--robots", "2", "--out", str(path)])
    assert done.exit_code == 0
    assert done.output.splitlines()[1:] == [f"  aucamp check {path}", f"  aucamp demo --fleet {path}"]
    written = path.read_text()
    again = CliRunner().invoke(app, ["init", "--out", str(path)])
    assert "is there already" in str(again.exception) and path.read_text() == written
    other = CliRunner().invoke(app, ["init", "--out", str(tmp_path / "fleet.txt")])
    assert "ends in .toml" in str(other.exception) and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", shipped_names())
def test_a_fleet_that_ships_can_be_given_to_the_demo(name: str, tmp_path: Path) -> None:
    fleet = demo_fleet(None, "evidence", 0.0, 0, False, tmp_path, shipped_fleet(name))
    assert all(clear_m(fleet, scene_of(fleet), robot) > 0.0 for robot in fleet.robot)


def test_what_is_to_be_typed_next_is_quoted(tmp_path: Path) -> None:
    path = tmp_path / "my tank's" / "fleet.toml"
    path.parent.mkdir()
    for twin, next_word in ((True, "--fleet"), (False, "run")):
        for line in write_fleet(path, 1, twin)[1:]:
            assert str(path) in shlex.split(line)
        assert next_word in line
