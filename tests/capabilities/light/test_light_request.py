"""A search by light: robots that their own lamps show nothing have places lit, and look where light is."""

import math
from itertools import pairwise
from unittest.mock import patch

import pytest
from msgspec.structs import replace

from agent.capabilities.light.allocate import Choice
from agent.capabilities.light.lease import Bound, Party
from agent.capabilities.light.light_request import RANGES_M, SHOWN_NS, SHOWS, SHOWS_SIDE, LightSearch, glimpsed_m
from agent.core.attitude import Attitude
from agent.core.capability import LightView, Situation
from agent.core.capability_messages import Lease
from agent.core.config import Target
from agent.core.ranging.pointing import SEARCH_DEG, SearchPlan
from agent.core.step_io import Sighting
from agent.core.verbs import Burn
from agent.robot.target_search import TargetSearch
from tests.capabilities.light.lit_swarm import STEP_NS, LitScript, LitSwarm, lit_fleet
from tests.core.situations import situation
from tests.network.scripted_agent import CALIBRATION

FLEET = lit_fleet(3)
R1 = FLEET.robot["r1"]
LEVEL = Attitude(R1.depth_m, 0.0, 0.0)


FAR = Choice(("r2",), 12.0, 8.0, 20.0, True, 0.4, 0.05)
NEAR = Choice(("r1",), 8.0, 8.0, 90.0, False, 0.05, 0.05)


def target_search() -> TargetSearch:
    return TargetSearch(FLEET, R1, CALIBRATION)


def at(here: TargetSearch, now_ns: int) -> Situation:
    return situation(here, now_ns, level=LEVEL)


def test_places_are_ahead_and_beside_that_then_farther_out_and_none_outside_the_tank() -> None:
    fleet = replace(FLEET, tank=replace(FLEET.tank, size_m=(1.7, 1.7, 1.0)))
    search, here = LightSearch(fleet, "r1", CALIBRATION.camera), target_search()
    found = []
    for _ in range(len(RANGES_M) * len(SEARCH_DEG)):
        found.append(search.place(R1.pose, LEVEL))
        search.advance()
    assert search.place(R1.pose, LEVEL) == found[0]  # and from the beginning again
    at_all = [at for at in found if at is not None]
    assert len(at_all) > len(SEARCH_DEG)
    walls_m = (1.7, 1.7, fleet.tank.surface_m)
    assert all(-1e-9 < at < most_m + 1e-9 for place in at_all for at, most_m in zip(place, walls_m, strict=True))
    far_m = [at and math.dist(at, here.eye(LEVEL, R1.pose).position_m) for at in found]
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
    assert LightSearch(FLEET, "r1", CALIBRATION.camera).worth(choice, FLEET.target["ball"], True) is counts


def test_what_was_glimpsed_by_anothers_light_is_the_next_place_once() -> None:
    search, here = LightSearch(FLEET, "r1", CALIBRATION.camera), target_search()
    first, now_ns = search.place(R1.pose, LEVEL), sees_ball(here)
    lease = Lease(1, 0, 5.0, True, (0.6, 0.5, 0.1), (("r2", 1.0),))
    party = Party("r1", 1, bound=Bound("r2", 1, lease, now_ns, now_ns + 10**9))
    assert search.follows(party, at(here, now_ns)) == lease.at_m
    assert search.follows(party, at(here, now_ns + 10**9)) == lease.at_m  # it is out of view again
    assert search.place(R1.pose, LEVEL) == glimpsed_m(FLEET, CALIBRATION.camera, None, at(here, now_ns)) != first
    search.advance()
    assert search.place(R1.pose, LEVEL) == first
    assert search.follows(Party("r1", 1), at(here, now_ns)) is None


def test_a_ball_in_view_is_as_far_away_as_it_looks() -> None:
    here = target_search()
    now_ns = sees_ball(here)
    at_m = glimpsed_m(FLEET, CALIBRATION.camera, None, at(here, now_ns))
    far_m = 0.07 * CALIBRATION.camera.f_px / 70.0
    assert at_m is not None and math.dist(at_m, here.eye(LEVEL, R1.pose).position_m) == pytest.approx(far_m, rel=0.02)
    assert glimpsed_m(FLEET, CALIBRATION.camera, None, at(here, now_ns + 10**9)) is None


def sees_ball(here: TargetSearch) -> int:
    """Now, ns: a ball of 70 px is in the middle of the picture."""
    here.act(at(here, 0), False)
    now_ns = here.pointing.steady_from_ns + STEP_NS
    seen = Sighting(
        t_ns=now_ns, frame=1, sweep=0, index=-1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=70.0
    )
    here.add_sighting(seen, LightView())
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


def dark_swarm(rule, ordered_dark: str = "") -> LitSwarm:
    with patch("tests.capabilities.light.lit_swarm.LitScript", FromAside):
        swarm = LitSwarm()
    if ordered_dark:
        assert swarm.robots[ordered_dark].agent.capabilities["light"].carry_out(Burn(light=0.0))
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
                party = robot.agent.capabilities["light"]._talk.party
                if party.phase == "holds" and looks and looks[-1][:2] == (name, party.number):
                    looks[-1] = (name, party.number, looks[-1][2] + 1)
                elif party.phase == "holds":
                    looks.append((name, party.number, 1))
    assert {name for name, _, _ in looks} == {"r1", "r2", "r3"} and len(looks) >= 9
    assert min(steps * STEP_NS for _, _, steps in looks[:-1]) > SHOWN_NS
    assert all(one[0] != other[0] for one, other in pairwise(looks))


def test_a_robot_whose_lamp_is_ordered_dark_borrows_as_one_without() -> None:
    swarm = dark_swarm(others, "r1")
    own = [swept for swept in swarm.kept if swept.robot == "r1"]
    assert own and all("r1" not in swept.lamps and set(swept.burned) & {"r2", "r3"} for swept in own)


def test_where_nobody_lends_it_is_not_found() -> None:
    swarm = dark_swarm(lambda own, scene, lamps, lighting: NEAR._replace(lamps=(own,)))
    assert not swarm.kept


def test_a_creature_has_to_show_by_more_light_than_a_ball() -> None:
    fish, search = Target(detector="creature", length_m=0.15), LightSearch(FLEET, "r1", CALIBRATION.camera)
    faint = Choice(("r2",), 12.0, 8.0, 20.0, True, 0.5 * (SHOWS + SHOWS_SIDE), 0.05)
    assert search.worth(faint, FLEET.target["ball"], True) and not search.worth(faint, fish, True)
    assert search.worth(faint._replace(contrast=1.1 * SHOWS_SIDE), fish, True)


def test_a_robot_with_a_search_pattern_of_its_own_asks_for_no_light() -> None:
    search, here = LightSearch(FLEET, "r1", CALIBRATION.camera), target_search()
    here.act(at(here, 0), False)
    assert not search.look(at(here, 0), True) and search.look(at(here, 0), False)
    assert search.look(at(here, 10**10), True)
    assert not search.look(replace(at(here, 10**10), search=SearchPlan("ball", (), ((0.0, 0.0),))), True)
