"""What a fleet file may say of lamps."""

import pytest
from msgspec.structs import replace

from agent.capabilities.light.allocate import LampControl, cannot, command, warmed
from agent.capabilities.light.model import whole
from agent.core.config import Fleet
from agent.core.ranging.camera_model import Eye
from agent.core.ranging.fix import Outline
from agent.core.ranging.focus import lens_position
from agent.robot.fleet_reader import broken_light_rules
from tests.capabilities.light.lit_swarm import HARBOUR, lit_fleet
from tests.network.scripted_agent import CALIBRATION
from tests.sample_messages import telemetry

LIT = lit_fleet(3)


def with_robot(fleet: Fleet, name: str, **about: object) -> Fleet:
    return replace(fleet, robot={**fleet.robot, name: replace(fleet.robot[name], **about)})


@pytest.mark.parametrize(
    ("fleet", "key"),
    [
        (replace(LIT, lighting=None), "robot.r1.lamp"),
        (replace(LIT, robot={n: replace(r, lamp=False) for n, r in LIT.robot.items()}), "lighting"),
        (replace(LIT, lighting=replace(HARBOUR, guard_s=0.05)), "lighting.guard_s"),
        (with_robot(LIT, "r1", neighbours=("r2",)), "robot.r1.neighbours"),
    ],
)
def test_a_mistake_is_named_by_its_key(fleet: Fleet, key: str) -> None:
    found = dict(broken_light_rules(fleet))
    assert key in found
    assert "\n" not in found[key]


def test_a_fleet_with_lamps_and_one_without_have_none() -> None:
    assert not list(broken_light_rules(LIT))
    assert not list(broken_light_rules(lit_fleet(3, lighting=None)))


def test_a_turn_in_the_dark_is_no_change_of_light_and_takes_its_time() -> None:
    lamp = command(LampControl((1500, 1500)), 0.0, (1900, 1500), 0)
    assert lamp.changes == 0 and lamp.steady(0)
    lit = command(lamp, 1.0, (1900, 1500), 0)
    assert lit.changes == 1 and not lit.steady(200_000_000) and lit.steady(500_000_000)
    assert command(lit, 1.0, (1900, 1500), 10) == lit


def test_a_lamp_warms_until_it_may_not_burn_and_cools_again() -> None:
    lamp, now_ns = LampControl((1500, 1500), power=1.0), 0
    while not cannot(True, lamp, telemetry(0), False):
        now_ns += 10**9
        lamp = warmed(lamp, now_ns)
    assert 100 < now_ns * 1e-9 < 400
    assert cannot(True, lamp, telemetry(0), False) == "heat"
    for _ in range(60):
        now_ns += 10**9
        lamp = warmed(lamp._replace(power=0.0), now_ns)
    assert cannot(True, lamp, telemetry(0), False) == ""


@pytest.mark.parametrize(
    ("about", "silent", "why"),
    [
        ({"armed": False}, False, "off"),
        ({"ladder": 1}, False, "off"),
        ({"battery_v": 13.0}, False, "battery"),
        ({}, True, "off"),
        ({}, False, ""),
    ],
)
def test_what_forbids_a_lamp_to_burn(about: dict, silent: bool, why: str) -> None:
    assert cannot(True, LampControl((1500, 1500)), telemetry(0, **about), silent) == why
    assert cannot(False, LampControl((1500, 1500)), telemetry(0, **about), silent) == "no lamp"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_outline_of_the_lit_part_is_moved_to_where_the_whole_ball_is(side: float) -> None:
    eye = Eye((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))
    camera, ball = CALIBRATION.camera, LIT.target["ball"]
    whole_px = camera.f_px * 0.07  # at 1 m, a little less than its asin
    lit = Outline((camera.cx_px + side * 8.0, camera.cy_px), whole_px - 8.0, 1.0, None, None, None)
    rho = lens_position(CALIBRATION.focus, 0.93)
    found = whole(CALIBRATION, eye, lit, rho, 0.5, ball, [(side * 0.8, 0.0, 0.9)])
    assert found.centre_px[0] == pytest.approx(camera.cx_px, abs=1.0)
    both = whole(CALIBRATION, eye, lit, rho, 0.5, ball, [(0.8, 0.0, 0.9), (-0.8, 0.0, 0.9)])
    assert both == lit
    full = lit._replace(radius_px=whole_px)
    assert whole(CALIBRATION, eye, full, rho, 0.5, ball, [(side * 0.8, 0.0, 0.9)]) == full
