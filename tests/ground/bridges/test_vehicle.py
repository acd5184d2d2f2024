"""A State as a vehicle: directions, modes, and what nobody knows."""

import math

import pytest
from msgspec.structs import replace

from agent.core.config import Pose, Robot
from agent.core.messages import Whereabouts
from agent.ground.bridges.outward import (
    ACTIVE,
    ALT_HOLD,
    CRITICAL,
    EMERGENCY,
    GUIDED,
    POWEROFF,
    STANDBY,
    SURFACING,
    vehicle,
)
from tests.ground.bridges.states import state

MOORED = Robot(
    neighbours=(),
    listen="tcp/127.0.0.1:17401",
    serial="/dev/a",
    camera="v4l2:/dev/b",
    pose=Pose(x_m=1.0, y_m=0.25, yaw_deg=0.0),
    calibration="r1.toml",
)


def facing(yaw_deg: float) -> Robot:
    return replace(MOORED, pose=Pose(x_m=1.0, y_m=0.25, yaw_deg=yaw_deg))


def test_y_is_north_and_x_is_east() -> None:
    told = vehicle(MOORED, state())
    assert (told.north_m, told.east_m, told.depth_m, told.place_sigma_m) == (0.25, 1.0, 0.4, None)


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-45.0, 135.0), (-135.0, -135.0)]
)
def test_it_looks_where_it_looked(yaw_deg: float, heading_deg: float) -> None:
    """By the directions themselves: along x is east."""
    told = vehicle(facing(yaw_deg), state())
    assert math.degrees(told.yaw_rad) == pytest.approx(heading_deg)
    ahead = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    assert (math.sin(told.yaw_rad), math.cos(told.yaw_rad)) == pytest.approx(ahead)


def test_bow_down_is_a_negative_pitch_and_left_side_up_a_positive_roll() -> None:
    told = vehicle(MOORED, state(roll_deg=2.0, pitch_deg=5.0))
    assert math.degrees(told.roll_rad) == pytest.approx(2.0)
    assert math.degrees(told.pitch_rad) == pytest.approx(-5.0)


def test_one_that_swims_is_where_it_says_and_not_where_its_fleet_file_puts_it() -> None:
    where = Whereabouts(x_m=0.5, y_m=0.75, yaw_deg=90.0, place_sigma_m=0.02, yaw_sigma_deg=1.0)
    told = vehicle(MOORED, state(whereabouts=where, behaviour="survey"))
    assert (told.north_m, told.east_m, told.place_sigma_m, told.mode) == (0.75, 0.5, 0.02, GUIDED)
    lost = vehicle(MOORED, state(whereabouts=None, behaviour="hold"))
    assert (lost.north_m, lost.east_m, lost.yaw_rad, lost.mode) == (None, None, None, ALT_HOLD)


@pytest.mark.parametrize(
    ("about", "armed", "mode", "status"),
    [
        ({}, True, ALT_HOLD, ACTIVE),
        ({"armed": False}, False, ALT_HOLD, STANDBY),
        ({"armed": None, "depth_m": None}, True, ALT_HOLD, CRITICAL),  # nobody knows: keep your hands off
        ({"faults": ("failsafe level 2",)}, True, SURFACING, CRITICAL),
        ({"ordered": ("ann: surface",)}, True, SURFACING, CRITICAL),
        ({"ordered": ("ann: hold depth_m=0.25",)}, True, ALT_HOLD, ACTIVE),
        ({"mode": "degraded"}, True, ALT_HOLD, CRITICAL),
        ({"mode": "failed"}, True, ALT_HOLD, EMERGENCY),
        ({"mode": "stopped", "armed": False}, False, ALT_HOLD, POWEROFF),
    ],
    ids=str,
)
def test_what_it_does(about: dict, armed: bool, mode: int, status: int) -> None:
    told = vehicle(MOORED, state(**about))
    assert (told.armed, told.mode, told.status) == (armed, mode, status)
