"""Whole kernels in the dark, by what their lamps truly did and not by what they say of it."""

from collections import Counter

import pytest

from agent.core.codec import encode
from agent.core.messages import State
from tests.capabilities.light.lit_swarm import LitSwarm, Weather, lit_fleet

STORM = Weather(loss=0.3, late=0.1, twice=0.1, restarts_hz=0.02, disarmed_hz=0.02)


@pytest.fixture(scope="module")
def calm() -> LitSwarm:
    swarm = LitSwarm()
    swarm.run(20.0)
    return swarm


def test_robots_sweep_in_turn_by_each_others_light(calm: LitSwarm) -> None:
    turns = Counter(sweep.robot for sweep in calm.kept)
    assert set(turns) == {"r1", "r2", "r3"}
    assert max(turns.values()) <= len(calm.kept) // 2
    lent = [sweep for sweep in calm.kept if sweep.robot not in sweep.lamps]
    assert len(lent) >= len(calm.kept) - 1  # but for the first, of which nobody knew where it was
    assert all(sweep.lamps == sweep.burned and not sweep.altered for sweep in calm.kept)
    assert not calm.rejected


def test_all_see_the_ball_and_say_whose_light_it_was(calm: LitSwarm) -> None:
    for name, robot in calm.robots.items():
        assert robot.agent is not None
        state = robot.agent.measuring.current.last_state
        assert state is not None and state.acquired_t is not None and state.lamp
        assert state.lamp.holder in (None, *calm.robots)
        assert state.robot == name


@pytest.mark.parametrize("seed", range(2))
def test_no_sweep_counts_in_which_a_lamp_changed_whatever_the_weather(seed: int) -> None:
    swarm = LitSwarm(STORM, seed)
    swarm.run(16.0)
    assert len(swarm.kept) >= 3
    assert not [sweep for sweep in swarm.kept if sweep.altered]


def test_who_is_disarmed_is_dark_at_once_and_the_sweep_by_its_light_does_not_count() -> None:
    swarm = LitSwarm()
    swarm.run(6.0)
    lender, sweeper = swarm.robots["r2"], swarm.robots["r1"]
    while not (sweeper.script.waiting and lender.light[0]):
        swarm.run(0.05)
    before = len(swarm.kept)
    lender.off_until_ns = swarm.now_ns + 10**9
    swarm.run(0.1)
    assert lender.light[0] == 0.0
    while sweeper.script.waiting:
        swarm.run(0.05)
    swarm.run(0.5)
    assert [why for why in swarm.rejected if why == "spoiled: the lamp of r2 changed"]
    assert all(sweep.robot != "r1" for sweep in swarm.kept[before:])


def test_nobody_answers_and_the_own_lamp_is_what_there_is() -> None:
    swarm = LitSwarm(robots=3)
    for name in ("r2", "r3"):
        swarm.robots[name].agent, swarm.robots[name].down_until_ns = None, swarm.now_ns + 10**12
    swarm.run(18.0)
    assert swarm.kept
    assert all(sweep.lamps == sweep.burned == ("r1",) for sweep in swarm.kept)


def test_a_fleet_without_lighting_says_nothing_of_light() -> None:
    swarm = LitSwarm(fleet=lit_fleet(2, lighting=None))
    swarm.run(2.0)
    for robot in swarm.robots.values():
        assert robot.agent is not None and robot.outputs is not None
        state = robot.agent.measuring.current.last_state
        assert isinstance(state, State) and b"lamp" not in encode(state)
        assert b"light\x00" not in encode(robot.outputs)
        assert not robot.outputs.outgoing and robot.light == (0.0, (1500, 1500))
        assert not swarm.kept or swarm.kept[0].lamps == ()
