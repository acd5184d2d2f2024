"""Fleet files that go together have one digest, and files that do not have another."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Fleet, Pose, Tank, Target, Twin, common
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

SHIPPED = ("tank", "two_balls")


@pytest.fixture
def fleet() -> Fleet:
    return load_fleet(ROOT / "agent" / "fleets" / "tank.toml")


def test_sixteen_digits_the_same_from_every_start_of_python() -> None:
    digests = [common(load_fleet(ROOT / "agent" / "fleets" / f"{name}.toml")) for name in SHIPPED]
    assert digests == ["90c09ac11a9f1aa0", "3e1f9844c7b76196"]


@pytest.mark.parametrize(
    "part",
    [
        {"fleet": "lake"},
        {"tank": Tank(size_m=(1.5, 1.2, 0.9))},
        {"tank": Tank(surface_m=0.6)},
        {"target": {"ball": Target(radius_m=0.08)}},
        {"target": {"ball": Target(radius_m=0.07, colour="green")}},
        {"target": {"buoy": Target(radius_m=0.07)}},
        {"target": {"ball": Target(radius_m=0.07), "buoy": Target(radius_m=0.07)}},
        {"target": {"ball": Target(radius_m=0.07, speed_m_s=0.2, turn_s=2.0)}},
        {"target": {"ball": Target(detector="box", picture="ball.png", box=(1.0, 2.0, 30.0, 40.0))}},
    ],
)
def test_what_is_shared_counts(fleet: Fleet, part: dict) -> None:
    assert common(replace(fleet, **part)) != common(fleet)


@pytest.mark.parametrize(
    ("table", "part"),
    [
        ("estimation", {"protocol": "paper"}),
        ("estimation", {"iteration_s": 0.5}),
        ("estimation", {"validity_s": 0.6}),
        ("estimation", {"liars": 2}),
        ("estimation", {"clip": True}),
        ("water", {"refractive_index": 1.34}),
    ],
)
def test_so_does_each_setting_of_the_protocol_and_of_the_light(fleet: Fleet, table: str, part: dict) -> None:
    assert common(replace(fleet, **{table: replace(getattr(fleet, table), **part)})) != common(fleet)


def test_who_takes_part_counts_and_who_hears_whom(fleet: Fleet) -> None:
    robots = dict(fleet.robot)
    fewer = {name: robot for name, robot in robots.items() if name != "r5"}
    deaf = {**robots, "r1": replace(robots["r1"], neighbours=("r2", "r3", "r4"))}
    assert len({common(fleet), common(replace(fleet, robot=fewer)), common(replace(fleet, robot=deaf))}) == 3


@pytest.mark.parametrize(
    "part",
    [
        {"depth_m": 0.2},
        {"pose": Pose(x_m=0.1, y_m=0.2, yaw_deg=3.0)},
        {"serial": "/dev/ttyACM0", "camera": "/dev/video0"},
        {"listen": "tcp/10.0.0.7:17401"},
        {"calibration": "elsewhere.toml"},
        {"neighbours": ("r5", "r4", "r3", "r2")},
    ],
)
def test_what_is_a_robots_own_does_not(fleet: Fleet, part: dict) -> None:
    robot = {**fleet.robot, "r1": replace(fleet.robot["r1"], **part)}
    assert common(replace(fleet, robot=robot)) == common(fleet)


def test_nor_do_orders_of_tables_ways_to_write_a_number_and_places_of_files(fleet: Fleet, tmp_path: Path) -> None:
    turned = replace(fleet, robot=dict(reversed(fleet.robot.items())), twin=Twin(seed=9, dir=str(tmp_path)))
    assert common(turned) == common(fleet)
    assert common(replace(fleet, tank=Tank(size_m=(1, 2, 3)))) == common(
        replace(fleet, tank=Tank(size_m=(1.0, 2.0, 3.0)))
    )
    red, unsaid = Target(radius_m=0.07, colour="red"), Target(radius_m=0.07)
    assert common(replace(fleet, target={"ball": red})) == common(replace(fleet, target={"ball": unsaid}))
    boxes = [
        Target(detector="box", picture=str(tmp_path / name), box=(k, k, 30.0, 40.0), models=str(tmp_path / name))
        for k, name in ((1.0, "a"), (2.0, "b"))
    ]
    assert len({common(replace(fleet, target={"thing": box})) for box in boxes}) == 1
