"""What a State comes to, for all who show it: whose word it is, where the body is, who is heard, what is wrong."""

import math
from typing import Any

import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from agent.core.codec import Refusal, encode
from agent.core.messages import NeighbourState, State, Whereabouts
from agent.core.robot_view import LATELY_S, camera_tilt_rad, in_own_name, robot_view, turn
from agent.core.topics import STATE
from tests.replay.small_box import FLEET

AT = Whereabouts(x_m=0.5, y_m=0.75, yaw_deg=90.0, place_sigma_m=0.02, yaw_sigma_deg=1.0)


def state(**about: Any) -> State:
    said = {"seq": 1, "sent_ns": 1, "target": "ball", "knows": "told", "t": 3, "depth_m": 0.1}
    return State(fleet="tank", robot="r1", incarnation=1, **{**said, "roll_deg": 0.0, "pitch_deg": 0.0, **about})


def test_who_speaks_in_anothers_name_is_not_believed() -> None:
    assert in_own_name(STATE, {"robot": "r1"}, encode(state())) == state()
    with pytest.raises(Refusal, match="on the key of r2"):
        in_own_name(STATE, {"robot": "r2"}, encode(state()))


def test_a_moored_robot_hangs_where_its_fleet_file_says_and_one_that_swims_is_where_it_says() -> None:
    moored, swims = robot_view(state(), FLEET), robot_view(state(whereabouts=AT), FLEET)
    lost = robot_view(state(whereabouts=None), FLEET)
    assert moored.body == FLEET.robot["r1"].pose
    assert swims.place_m == (0.5, 0.75, FLEET.tank.surface_m - 0.1)
    assert swims.turned == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert (lost.body, lost.place_m, lost.turned) == (None, None, None)
    assert robot_view(state()).body is None  # nobody knows where it hangs
    assert robot_view(replace(state(), robot="r99"), FLEET).body is None  # a stranger


def test_half_of_what_is_known_is_half_known() -> None:
    silent = robot_view(state(depth_m=None, roll_deg=None), FLEET)
    assert silent.body is not None
    assert (silent.place_m, silent.turned) == (None, None)


def test_a_turn_is_by_yaw_then_pitch_then_roll() -> None:
    x, y, z, w = turn(90.0, 90.0, 0.0)
    ahead = (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))
    assert ahead == pytest.approx((0.0, 0.0, -1.0))  # bow down, whichever way it looked


def test_how_far_a_camera_looks_up_is_its_gimbal_s_and_its_body_s() -> None:
    said = state(pan_deg=70.0, tilt_deg=-25.0, roll_deg=12.0, pitch_deg=-7.0)
    body, gimbal = (Rotation.from_quat(turn(*angles)) for angles in ((33.0, -7.0, 12.0), (70.0, 25.0, 0.0)))
    up = (body * gimbal).apply([1.0, 0.0, 0.0])[2]
    assert math.sin(camera_tilt_rad(said)) == pytest.approx(up)
    unknown = state(pan_deg=70.0, tilt_deg=-25.0, roll_deg=None, pitch_deg=None)
    assert camera_tilt_rad(unknown) == pytest.approx(math.radians(-25.0))


def near(name: str, age_s: float | None, valid: bool = False) -> NeighbourState:
    return NeighbourState(robot=name, age_s=age_s, valid=valid)


def test_heard_is_whose_word_is_fresh_by_the_rate_of_the_fleet() -> None:
    said = state(neighbours=(near("r2", LATELY_S - 0.01), near("r3", LATELY_S), near("r4", None)))
    assert robot_view(said, FLEET).hears == robot_view(said).hears == ("r2",)
    slow = replace(FLEET, link=replace(FLEET.link, send_hz=1.0))
    assert robot_view(said, slow).hears == ("r2", "r3")


def test_all_who_see_count_and_so_does_the_robot_itself() -> None:
    said = state(knows="sees", neighbours=(near("r2", 0.1, valid=True), near("r3", 0.1)))
    assert robot_view(said).seeing == robot_view(said).row["valid_robots"] == 2


@pytest.mark.parametrize(
    ("about", "motors", "remarks", "blind"),
    [
        ({"armed": True}, "motors on", (), ()),
        ({"armed": False}, "motors off", ("motors off",), ()),
        ({"armed": None}, "", (), ()),
        ({"armed": False, "ordered": ("ann: stop",)}, "motors off", ("ann: stop",), ()),
        ({"faults": ("no camera: gone", "slow")}, "", ("no camera", "slow"), ("no camera: gone",)),
        ({"faults": ("no frames",)}, "", ("no frames",), ("no frames",)),
    ],
    ids=str,
)
def test_what_is_wrong_and_what_was_ordered(about: dict, motors: str, remarks: tuple, blind: tuple) -> None:
    view = robot_view(state(**about))
    assert (view.motors, view.remarks, view.blind) == (motors, remarks, blind)


def test_what_is_not_known_is_in_no_column() -> None:
    row = robot_view(state(posterior_m=(1.0, 2.0, 3.0))).row
    assert [row[f"prior_{axis}_m"] for axis in "xyz"] == [None, None, None]
    assert [row[f"posterior_{axis}_m"] for axis in "xyz"] == [1.0, 2.0, 3.0]
