"""A search by light for what swims: a gaze that never rests stays for a lit look, and the light ends with a frame."""

import math
from unittest.mock import patch

import pytest

from agent.capabilities.light.allocate import Choice
from agent.capabilities.light.lease import Bound, Party
from agent.capabilities.light.light_request import OWN_SCAN_NS, SHOWS, SHOWS_SIDE, SWIMS_NS, SwimSearch
from agent.core.attitude import Attitude
from agent.core.capability_messages import Lease
from agent.core.codec import encode
from agent.core.config import Target
from agent.core.control.search_pattern import Roam
from agent.core.control.target_search import Seek
from agent.experiments.navigation.basin import START_NS
from agent.robot.step import Agent
from tests.capabilities.light.dark_fish import DarkFish
from tests.capabilities.light.lit_swarm import STEP_NS, lit_fleet
from tests.network.scripted_agent import CALIBRATION

FLEET = lit_fleet(3)
R1 = FLEET.robot["r1"]
LEVEL = Attitude(R1.depth_m, 0.0, 0.0)
REACH_DEG = 89.0  # of pan: beyond, it is at its stop


def scanning() -> tuple[SwimSearch, Seek]:
    """A robot whose gaze goes round without rest, since 0 ns."""
    here = Seek(FLEET, R1, CALIBRATION)
    here.roam = Roam("ball", (), ((0.0, 0.0),))
    here.track("ball", 20.0, 0.0, STEP_NS)
    return SwimSearch(FLEET, "r1"), here


def test_a_gaze_without_rests_is_lit_after_a_while_in_vain_where_it_is_then() -> None:
    search, here = scanning()
    assert not search.look(here, OWN_SCAN_NS) and search.look(here, OWN_SCAN_NS + 1)
    place, eye = search.place(here, LEVEL), here.eye(LEVEL)
    assert place is not None
    far_m = math.dist(place, eye.position_m)
    assert place == pytest.approx([at + far_m * row[2] for at, row in zip(eye.position_m, eye.rotation, strict=True)])
    bound = Bound("r2", 1, Lease(1, 0, 5.0, True, place), 10**12)
    search.follows(Party("r1", 1, bound=bound), here, "ball", LEVEL, 2 * OWN_SCAN_NS)
    assert not search.look(here, 2 * OWN_SCAN_NS + SWIMS_NS) and search.look(here, 2 * OWN_SCAN_NS + SWIMS_NS + 1)


def test_a_creature_has_to_show_by_more_light_than_a_ball() -> None:
    fish, search = Target(detector="creature", length_m=0.15), SwimSearch(FLEET, "r1")
    faint = Choice(("r2",), 12.0, 8.0, 20.0, True, 0.5 * (SHOWS + SHOWS_SIDE), 0.05)
    assert search.worth(faint, FLEET.target["ball"]) and not search.worth(faint, fish)
    assert search.worth(faint._replace(contrast=1.1 * SHOWS_SIDE), fish)


def test_a_fish_is_searched_by_all_where_it_is_lit_and_the_light_is_over_when_it_is_seen() -> None:
    """In this world r1 has the light, by r3's lamp, when the fish comes into view 4.3 s after the start."""
    with patch("agent.capabilities.light.light_request.OWN_SCAN_NS", 0):
        world = DarkFish(123, 0.15, 10.0)
        again = Agent(world.fleet, "r1", world.calibrations["r1"], START_NS)
        holds, off_deg = [False], list[float]()
        while not (world.saw and any(world.saw[-1])) and world.seconds < 10.0:
            world.step()
            assert encode(again.step(world.inputs["r1"], world.now_ns)) == encode(world.outputs["r1"])
            mine = world.agents["r1"].lights._talk.party.mine
            holds.append(mine is not None and mine.granted)
            if all(holds[-20:]):  # for a second: gimbals that reach it have turned to it
                there = [name for name, agent in world.agents.items() if abs(agent.seek.gimbal_deg()[0]) < REACH_DEG]
                off_deg += [world.off_deg(name, mine.lease.at_m) for name in there]
    assert holds[-2] and not holds[-1]
    assert len(off_deg) > 30 and max(off_deg) < 5.0
    assert world.agents["r1"].targets["ball"].believed_m is not None
