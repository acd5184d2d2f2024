"""What bridges believe: a robot's word in its own name, of any size that its row allows."""

import math
from typing import Any

import pytest
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Pose
from agent.core.messages import MAX_JPEG, Estimate, Image, LogLine, Message, Whereabouts
from agent.core.robot_view import RobotView, robot_view
from agent.core.topics import IMAGE, LINK, LOG, STATE, Topic
from agent.ground.bridges.outward import (
    ACTIVE,
    ALT_HOLD,
    CRITICAL,
    EMERGENCY,
    GUIDED,
    POWEROFF,
    STANDBY,
    SURFACING,
    Newest,
    own_word,
    vehicle,
)
from agent.process.transport import Received
from tests.ground.bridges.states import START_NS, S, state
from tests.replay.small_box import FLEET
from tests.sample_messages import estimate

PICTURE = Image(
    robot="r1", seq=1, sent_ns=9, t_ns=1, frame=1, width_px=4, height_px=3, enhanced=False, jpeg=bytes(MAX_JPEG)
)
LINE = LogLine(robot="r1", sent_ns=1, level="info", text="well")


def heard(row: Topic, message: Message, **chunks: str) -> Message | None:
    return own_word(Received(row, {"fleet": "tank", **chunks}, encode(message), START_NS))


def test_each_row_is_read_and_a_large_picture_too() -> None:
    said: Estimate = estimate("r1", "r2")
    for row, message, chunks in (
        (STATE, state("r1"), {"robot": "r1"}),
        (LINK, said, {"src": "r1", "dst": "r2"}),
        (IMAGE, PICTURE, {"robot": "r1"}),
        (LOG, LINE, {"robot": "r1"}),
    ):
        assert heard(row, message, **chunks) == message


def test_who_speaks_in_anothers_name_is_nobody() -> None:
    assert heard(STATE, state("r1"), robot="r2") is None
    assert heard(LINK, estimate("r1", "r2"), src="r3", dst="r2") is None
    assert heard(IMAGE, PICTURE, robot="r2") is None
    assert heard(LOG, LINE, robot="r2") is None


def test_what_cannot_be_read_is_nothing() -> None:
    assert own_word(Received(STATE, {"fleet": "tank", "robot": "r1"}, b"\xc1", START_NS)) is None
    assert heard(STATE, LINE, robot="r1") is None


# --- newest ---
# What is passed on as what is so now, and what is too old for that.

AHEAD_NS = 3600 * S  # the robot's clock, of ours


def told(newest: Newest, sent_ns: int, arrived_ns: int, wall_ns: int | None = None, **about: int) -> None:
    newest.take(state(sent_ns=sent_ns, **about), arrived_ns, arrived_ns if wall_ns is None else wall_ns)


def test_one_that_was_never_heard_says_nothing() -> None:
    assert Newest().fresh("r1", START_NS, START_NS) is None


def test_it_is_fresh_for_three_seconds_whatever_its_clock_says() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    assert newest.fresh("r1", START_NS + 3 * S, START_NS + 3 * S) is not None
    assert newest.fresh("r1", START_NS + 3 * S + 1, START_NS) is None
    assert newest.fresh("r1", START_NS, START_NS + 3 * S + 1) is None  # the fleet's clock stands


def test_a_burst_after_an_outage_is_old_when_it_comes() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    late_ns = START_NS + 10 * S
    told(newest, START_NS + AHEAD_NS + 5 * S, late_ns)
    assert newest.fresh("r1", late_ns, late_ns) is None
    told(newest, START_NS + AHEAD_NS + 10 * S, late_ns)
    assert newest.fresh("r1", late_ns, late_ns) is not None


def test_clocks_that_go_apart_make_nobody_old() -> None:
    """20 hours of a clock that is 50 millionths slow: 3.6 s."""
    newest = Newest()
    for second in range(0, 20 * 3600, 10):
        arrived_ns = START_NS + second * S
        told(newest, START_NS + round(second * S * (1 - 50e-6)), arrived_ns)
        assert newest.fresh("r1", arrived_ns, arrived_ns) is not None


def test_a_new_start_has_a_clock_of_its_own() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    told(newest, START_NS, START_NS + S, incarnation=START_NS)
    assert newest.fresh("r1", START_NS + S, START_NS + S) is not None


# --- vehicle ---
# A State as a vehicle: directions, modes, and what nobody knows.


def seen(at: Pose | None = None, **about: Any) -> RobotView:
    """Of a robot that the fleet file hangs at (1, 0.25) looking along x, or elsewhere."""
    pose = at or Pose(x_m=1.0, y_m=0.25, yaw_deg=0.0)
    fleet = replace(FLEET, robot={"r1": replace(FLEET.robot["r1"], pose=pose)})
    return robot_view(state(**about), fleet)


def test_y_is_north_and_x_is_east() -> None:
    told = vehicle(seen())
    assert (told.north_m, told.east_m, told.depth_m, told.place_sigma_m) == (0.25, 1.0, 0.4, None)


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-45.0, 135.0), (-135.0, -135.0)]
)
def test_it_looks_where_it_looked(yaw_deg: float, heading_deg: float) -> None:
    """By the directions themselves: along x is east."""
    told = vehicle(seen(Pose(x_m=1.0, y_m=0.25, yaw_deg=yaw_deg)))
    assert math.degrees(told.yaw_rad) == pytest.approx(heading_deg)
    ahead = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    assert (math.sin(told.yaw_rad), math.cos(told.yaw_rad)) == pytest.approx(ahead)


def test_bow_down_is_a_negative_pitch_and_left_side_up_a_positive_roll() -> None:
    told = vehicle(seen(roll_deg=2.0, pitch_deg=5.0))
    assert math.degrees(told.roll_rad) == pytest.approx(2.0)
    assert math.degrees(told.pitch_rad) == pytest.approx(-5.0)


def test_one_that_swims_is_where_it_says_and_not_where_its_fleet_file_puts_it() -> None:
    where = Whereabouts(x_m=0.5, y_m=0.75, yaw_deg=90.0, place_sigma_m=0.02, yaw_sigma_deg=1.0)
    told = vehicle(seen(whereabouts=where, behaviour="survey"))
    assert (told.north_m, told.east_m, told.place_sigma_m, told.mode) == (0.75, 0.5, 0.02, GUIDED)
    lost = vehicle(seen(whereabouts=None, behaviour="hold"))
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
    told = vehicle(seen(**about))
    assert (told.armed, told.mode, told.status) == (armed, mode, status)
