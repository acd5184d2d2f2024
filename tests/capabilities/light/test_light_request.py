"""A search by light for what swims: a gaze that never rests stays for a lit look, and the light ends with a frame."""

import math
from itertools import pairwise
from unittest.mock import patch

import pytest
from msgspec.structs import replace

from agent.capabilities.light.allocate import Choice
from agent.capabilities.light.lease import Bound, Mine, Party
from agent.capabilities.light.light_request import (
    OWN_ROUNDS,
    OWN_SCAN_NS,
    RANGES_M,
    SHOWN_NS,
    SHOWS,
    SHOWS_SIDE,
    SWIMS_NS,
    LightSearch,
    SwimSearch,
)
from agent.core.attitude import Attitude
from agent.core.capability_messages import Lease
from agent.core.codec import encode
from agent.core.config import Target
from agent.core.control.pointing import SEARCH_DEG
from agent.core.control.search_pattern import Roam
from agent.core.control.target_search import Seek
from agent.core.step_io import Sighting
from agent.experiments.navigation.basin import START_NS
from agent.robot.step import Agent
from tests.capabilities.light.dark_fish import DarkFish
from tests.capabilities.light.dark_search import DarkSearch
from tests.capabilities.light.lit_swarm import STEP_NS, LitScript, LitSwarm, lit_fleet
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


# --- search ---
# A search by light: robots that their own lamps show nothing have places lit, and look where light is.

FAR = Choice(("r2",), 12.0, 8.0, 20.0, True, 0.4, 0.05)
NEAR = Choice(("r1",), 8.0, 8.0, 90.0, False, 0.05, 0.05)


def seek() -> Seek:
    return Seek(FLEET, R1, CALIBRATION)


def test_places_are_ahead_and_beside_that_then_farther_out_and_none_outside_the_tank() -> None:
    fleet = replace(FLEET, tank=replace(FLEET.tank, size_m=(1.7, 1.7, 1.0)))
    search, here = LightSearch(fleet, "r1"), seek()
    found = []
    for _ in range(len(RANGES_M) * len(SEARCH_DEG)):
        found.append(search.place(here, LEVEL))
        search.advance()
    assert search.place(here, LEVEL) == found[0]  # and from the beginning again
    at_all = [at for at in found if at is not None]
    assert len(at_all) > len(SEARCH_DEG)
    walls_m = (1.7, 1.7, fleet.tank.surface_m)
    assert all(-1e-9 < at < most_m + 1e-9 for place in at_all for at, most_m in zip(place, walls_m, strict=True))
    far_m = [at and math.dist(at, here.eye(LEVEL).position_m) for at in found]
    assert far_m[0] == pytest.approx(RANGES_M[0], abs=1e-6)
    assert all(far is None or far <= RANGES_M[k // len(SEARCH_DEG)] + 1e-6 for k, far in enumerate(far_m))


@pytest.mark.parametrize(
    ("choice", "counts"),
    [
        (None, False),
        (FAR, True),
        (FAR._replace(contrast=0.9 * SHOWS), False),  # nobody's lamp shows a target there
        (FAR._replace(own_contrast=1.1 * SHOWS), False),  # the own lamp does
        (FAR._replace(lamps=("r1",)), False),
    ],
)
def test_a_place_counts_that_others_lamps_show_and_the_own_does_not(choice: Choice | None, counts: bool) -> None:
    assert LightSearch(FLEET, "r1").worth(choice, FLEET.target["ball"]) is counts


def test_what_was_glimpsed_by_anothers_light_is_the_next_place_once() -> None:
    search, here = LightSearch(FLEET, "r1"), seek()
    first, now_ns = search.place(here, LEVEL), sees_ball(here)
    lease = Lease(1, 0, 5.0, True, (0.6, 0.5, 0.1), (("r2", 1.0),))
    party = Party("r1", 1, bound=Bound("r2", 1, lease, now_ns + 10**9))
    assert search.follows(party, here, "ball", LEVEL, now_ns) == lease.at_m
    assert search.follows(party, here, "ball", LEVEL, now_ns + 10**9) == lease.at_m  # it is out of view again
    assert search.place(here, LEVEL) == here.glimpsed_m("ball", LEVEL, None, now_ns) != first
    search.advance()
    assert search.place(here, LEVEL) == first
    assert search.follows(Party("r1", 1), here, "ball", LEVEL, now_ns) is None


def test_a_ball_in_view_is_as_far_away_as_it_looks() -> None:
    here = seek()
    now_ns = sees_ball(here)
    at_m = here.glimpsed_m("ball", LEVEL, None, now_ns)
    far_m = 0.07 * CALIBRATION.camera.f_px / 70.0
    assert at_m is not None and math.dist(at_m, here.eye(LEVEL).position_m) == pytest.approx(far_m, rel=0.02)
    assert here.glimpsed_m("ball", LEVEL, None, now_ns + 10**9) is None


def sees_ball(here: Seek) -> int:
    """Now, ns: a ball of 70 px is in the middle of the picture."""
    here.act(0, "ball", LEVEL, None, False)
    now_ns = here.pointing.steady_from_ns + STEP_NS
    seen = Sighting(
        t_ns=now_ns, frame=1, sweep=0, index=-1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=70.0
    )
    here.add_sighting(seen)
    return now_ns


class FromAside(LitScript):
    """Its own lamp blinds it: it sees the ball while another's burns and its own does not."""

    def look(self, now_ns, focus, sweep, index, target=None) -> Sighting:
        seen = super().look(now_ns, focus, sweep, index, target)
        burn = {name for name, robot in self.swarm.robots.items() if robot.light[0]}
        me = next(name for name, robot in self.fleet.robot.items() if robot == self.robot)
        if burn and me not in burn:
            return seen
        return Sighting(t_ns=now_ns, frame=self.frame, sweep=sweep, index=index, target=seen.target, found=False)


def others(own, scene, lamps, lighting) -> Choice:
    """In the place of the rule: all that are free, but the own one."""
    free = tuple(name for name, lamp in sorted(lamps.items()) if lamp.free and name != own)
    return FAR._replace(lamps=free) if free else NEAR._replace(lamps=(own,))


def dark_swarm(rule) -> LitSwarm:
    with patch("tests.capabilities.light.lit_swarm.LitScript", FromAside):
        swarm = LitSwarm()
    with patch("tests.capabilities.light.lit_swarm.lend_all", rule):
        swarm.run(30.0)
    return swarm


def test_what_no_own_lamp_shows_is_found_by_lent_light_and_measured_by_all() -> None:
    swarm = dark_swarm(others)
    assert {sweep.robot for sweep in swarm.kept} == {"r1", "r2", "r3"}
    assert all(sweep.robot not in sweep.lamps and not sweep.altered for sweep in swarm.kept)


class Blind(LitScript):
    def look(self, now_ns, focus, sweep, index, target=None) -> Sighting:
        seen = super().look(now_ns, focus, sweep, index, target)
        return Sighting(t_ns=now_ns, frame=self.frame, sweep=sweep, index=index, target=seen.target, found=False)


def test_robots_have_places_lit_in_turn_each_for_as_long_as_a_look_takes() -> None:
    with patch("tests.capabilities.light.lit_swarm.LitScript", Blind):
        swarm = LitSwarm()
    looks: list[tuple[str, int, int]] = []  # robot, number of its lease, steps for which it held it
    with patch("tests.capabilities.light.lit_swarm.lend_all", others):
        for _ in range(600):
            swarm.run(0.05)
            for name, robot in swarm.robots.items():
                assert robot.agent is not None
                party = robot.agent.lights._talk.party
                if party.phase == "holds" and looks and looks[-1][:2] == (name, party.number):
                    looks[-1] = (name, party.number, looks[-1][2] + 1)
                elif party.phase == "holds":
                    looks.append((name, party.number, 1))
    assert {name for name, _, _ in looks} == {"r1", "r2", "r3"} and len(looks) >= 9
    assert min(steps * STEP_NS for _, _, steps in looks[:-1]) > SHOWN_NS
    assert all(one[0] != other[0] for one, other in pairwise(looks))


def test_where_nobody_lends_it_is_not_found() -> None:
    swarm = dark_swarm(lambda own, scene, lamps, lighting: NEAR._replace(lamps=(own,)))
    assert not swarm.kept


def swimming(round_done: bool = True) -> tuple[SwimSearch, Seek]:
    """A robot whose search has a gaze of its own, after two empty frames of its newest look."""
    here = seek()
    here.roam = Roam("ball", (), ((0.0, 0.0), (40.0, -10.0), (80.0, 0.0)))
    here.act(0, "ball", LEVEL, None, False)
    for _ in range(3 * OWN_ROUNDS + 1 if round_done else 3 * OWN_ROUNDS - 1):
        here.roam.advance()
    for _ in range(2):
        here.roam.add_frame(False)
    return SwimSearch(FLEET, "r1"), here


def test_who_swims_wants_light_where_its_gaze_is_once_for_each_look() -> None:
    search, here = swimming()
    assert here.roam is not None and search.look(here, 10**10)
    place = search.place(here, LEVEL)
    assert place is not None and not search.look(here, 10**10)
    eye = here.eye(LEVEL)
    far_m = math.dist(place, eye.position_m)
    ahead = [at + far_m * row[2] for at, row in zip(eye.position_m, eye.rotation, strict=True)]
    assert far_m <= RANGES_M[0] + 1e-6 and place == pytest.approx(ahead)
    here.roam.advance()
    assert not search.look(here, 10**10)  # nothing was looked at by its own lamp there
    for _ in range(2):
        here.roam.add_frame(False)
    assert search.look(here, 10**10)
    bound = Bound("r2", 1, Lease(1, 0, 5.0, True, None), 10**11)
    search.follows(Party("r1", 1, bound=bound), here, "ball", LEVEL, 10**10)
    assert not search.look(here, 10**10 + SWIMS_NS)  # first it swims on
    assert search.look(here, 10**10 + SWIMS_NS + 1)


def test_who_swims_looks_all_around_by_its_own_lamp_first() -> None:
    search, here = swimming(round_done=False)
    assert not search.look(here, 10**10)


def test_a_look_is_not_over_while_light_for_it_is_asked_for_and_is_when_that_showed_nothing() -> None:
    search, here = swimming()
    assert here.roam is not None and here.roam.over
    search.at_m = search.place(here, LEVEL)
    lease = Lease(1, 0, 5.0, False, search.at_m, (("r2", 1.0),))
    party = Party("r1", 1, mine=Mine(lease, 0, 10**10))
    search.follows(party, here, "ball", LEVEL, STEP_NS)
    assert not here.roam.over
    search.advance()
    search.follows(party._replace(mine=None), here, "ball", LEVEL, STEP_NS)
    assert here.roam.over


def test_after_a_look_where_light_was_anothers_its_own_is_due_again() -> None:
    search, here = swimming()
    roam = here.roam
    assert roam is not None
    roam.advance()
    before = roam.way_deg
    lease = Lease(1, 0, 5.0, True, (0.6, 0.5, 0.1), (("r2", 1.0),))
    party = Party("r1", 1, bound=Bound("r2", 1, lease, 10**10))
    assert search.follows(party, here, "ball", LEVEL, STEP_NS) == lease.at_m and not roam.over
    search.follows(Party("r1", 1), here, "ball", LEVEL, STEP_NS)
    assert roam.over
    roam.advance()
    assert roam.way_deg == before


def test_what_one_that_swims_glimpsed_by_anothers_light_is_its_next_place_at_once() -> None:
    search, here = swimming()
    now_ns = sees_ball(here)
    lease = Lease(1, 0, 5.0, True, (0.6, 0.5, 0.1), (("r2", 1.0),))
    party = Party("r1", 1, bound=Bound("r2", 1, lease, now_ns + 10**9))
    search.follows(party, here, "ball", LEVEL, now_ns)
    assert search.look(here, now_ns + STEP_NS)
    assert search.place(here, LEVEL) == here.glimpsed_m("ball", LEVEL, None, now_ns)
    search.advance()
    assert not search.look(here, now_ns + STEP_NS)


@pytest.mark.slow
def test_three_that_swim_have_looks_lit_and_hold_still_meanwhile() -> None:
    with patch("agent.capabilities.light.light_request.OWN_ROUNDS", 0):
        world, moved = DarkSearch(0), []
        for _ in range(240):
            world.step()
            phases = [agent.lights._talk.party.phase for agent in world.agents.values()]
            here = [world.place(name)[:2] for name in world.agents]
            if "holds" not in phases:
                before = here
            moved += [math.dist(one, other) for one, other in zip(before, here, strict=True)]
    assert world.looks >= 1 and max(moved) < 0.15
