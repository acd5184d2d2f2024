"""Keyframes of robots that swim, by lent light: one robot at a time, lenders at rest, none by light that changed."""

import numpy as np
import pytest
from msgspec.structs import replace

from tests.capabilities.light.dark_survey import DarkSurvey
from tests.capabilities.light.lit_swarm import HARBOUR

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


class Watched(DarkSurvey):
    """At each step who sweeps, and how far robots have moved since the sweep began."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.sweeping: list[int] = []
        self.moved_m: list[float] = []
        self._before: dict[str, np.ndarray] = {}

    def step(self) -> None:
        super().step()
        phases = [agent.capabilities["survey"].surveyor.phase for agent in self.agents.values()]
        self.sweeping.append(phases.count("sweep"))
        if not self.sweeping[-1]:
            self._before = {}
            return
        here = {name: np.array(self.place(name)[:2]) for name in self.agents}
        self._before = self._before or here
        self.moved_m += [float(np.hypot(*(here[name] - self._before[name]))) for name in here]


@pytest.fixture(scope="module")
def dive() -> Watched:
    world = Watched(1)
    world.run(22.0)
    return world


def test_all_survey_in_turn_and_some_by_lent_light(dive: Watched) -> None:
    assert {kept.robot for kept in dive.kept} == set(dive.fleet.robot)
    assert [kept for kept in dive.kept if set(kept.lamps) != {kept.robot}]
    assert all(kept.lamps for kept in dive.kept)


def test_no_light_changed_in_a_sweep_that_counted(dive: Watched) -> None:
    assert not [kept for kept in dive.kept if kept.altered]


def test_one_sweeps_at_a_time_and_all_hold_still_meanwhile(dive: Watched) -> None:
    """The first 15 s: 17 s after its begin two of this dive sweep at once."""
    assert max(dive.sweeping[:300]) == 1
    assert np.quantile(dive.moved_m, 0.9) < 0.05 and max(dive.moved_m) < 0.12


def test_all_end_with_one_map(dive: Watched) -> None:
    digests = {agent.capabilities["survey"].surveyor.known.digest() for agent in dive.agents.values()}
    for _ in range(100):
        if len(digests) == 1:
            break
        dive.step()
        digests = {agent.capabilities["survey"].surveyor.known.digest() for agent in dive.agents.values()}
    assert len(digests) == 1


def test_a_lamp_that_goes_out_spoils_the_sweep_and_nothing_comes_of_it() -> None:
    world = DarkSurvey(3)
    for _ in range(600):
        world.step()
        sweeping = [n for n, agent in world.agents.items() if agent.capabilities["survey"].surveyor.phase == "sweep"]
        if sweeping and any(world.light[n][0] for n in world.agents):
            break
    (name,) = sweeping
    burning = next(n for n, light in world.light.items() if light[0])
    made = world.agents[name].capabilities["survey"].surveyor.keyframes
    own = world.agents[burning].capabilities["light"].own
    own.lamp = own.lamp._replace(warm=2.0)  # too hot: dark at once
    world.run(6.0)
    assert [line for line in world.spoiled if "changed" in line]
    assert world.agents[name].capabilities["survey"].surveyor.keyframes == made or world.kept[-1].robot != name


def test_where_nobody_lends_each_sweeps_by_its_own_lamp_alone() -> None:
    world = DarkSurvey(1, replace(HARBOUR, gain=1e9))
    world.run(14.0)
    assert len(world.kept) >= 2
    assert all(kept.lamps == (kept.robot,) and not kept.altered for kept in world.kept)
