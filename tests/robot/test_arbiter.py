"""Who has camera, body and lamp: the table, and what a robot does by it."""

from collections.abc import Callable

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Follow
from agent.core.messages import Order
from agent.core.step_io import Inputs, Ordered
from agent.experiments.reconstruction.coverage import SIZE_M, SURFACE_M, World, draw_scene, fleet_of
from agent.robot.arbiter import PRIORITIES
from agent.robot.step import Agent
from agent.robot.targets import Targets
from tests.capabilities.light.dark_fish import DarkFish
from tests.capabilities.light.dark_survey import DarkSurvey
from tests.capabilities.swim.swimming_agent import InTank, fleet
from tests.robot.ordering import Ordering


def test_a_row_is_named_once_and_the_last_of_each_resource_is_always_asked() -> None:
    assert len({(row.resource, row.holder) for row in PRIORITIES}) == len(PRIORITIES)
    last = {row.resource: row for row in PRIORITIES}
    assert all(row.sweeps == ("none", "target", "view") and row.lent for row in last.values())


def surveying() -> World:
    """Two moored robots, of which r1 sweeps a view."""
    scene = draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 4)
    world = World(fleet_of(count=2), scene, 4, True, 0.0)
    for _ in range(400):
        world.step()
        if world.agents["r1"].capabilities["survey"].surveyor.phase == "sweep":
            return world
    raise AssertionError("r1 never swept a view")


def order(agent: Agent, now_ns: int, verb: str, args: dict) -> Inputs:
    """With which a console's command comes."""
    said = Order(id=1, verb=verb, args=args, seen=(agent.operator._incarnation, now_ns))
    return Inputs(orders=(Ordered(arrived_ns=now_ns, console="ann", payload=encode(said)),))


@pytest.mark.parametrize(("verb", "args"), [("set", {"name": "sweeps", "value": 0.0}), ("look", {"pan_deg": 20.0})])
def test_a_views_sweep_keeps_the_gimbal_whatever_is_ordered_meanwhile(verb: str, args: dict) -> None:
    world = surveying()
    agent, steps = world.agents["r1"], 0
    goal_us = agent.target_search.pointing.goal_us
    answer = agent.step(order(agent, world.now_ns, verb, args), world.now_ns + 1).answers[0]
    assert answer.ok, answer.why
    while agent.capabilities["survey"].surveyor.sweeps and steps < 200:
        assert agent.target_search.pointing.goal_us == goal_us
        world.step()
        steps += 1
    assert steps > 10 and agent.capabilities["survey"].surveyor.keyframes == 1  # it counts


def test_a_look_that_is_ordered_has_the_camera_before_a_survey_until_that_is_over() -> None:
    world = surveying()
    agent = world.agents["r1"]
    agent.step(order(agent, world.now_ns, "look", {"pan_deg": 20.0}), world.now_ns + 1)
    for _ in range(120):
        world.step()
    assert agent.arbiter.held["camera"] == "operator"
    assert agent.target_search.gimbal_deg()[0] == pytest.approx(20.0, abs=0.5)


def test_a_look_that_is_ordered_has_the_camera_before_a_fish_that_is_followed() -> None:
    world = DarkFish(1, 0.15, 10.0)
    agent = world.agents["r1"]
    for _ in range(200):
        world.step()
        if agent.arbiter.held.get("camera") == "pursuit":
            break
    now_ns = world.now_ns + 1
    assert agent.step(order(agent, world.now_ns, "look", {"pan_deg": -30.0}), now_ns).answers[0].ok
    agent.step(Inputs(telemetry=world.inputs["r1"].telemetry), now_ns + 1)
    assert agent.arbiter.held["camera"] == "operator" and not agent.target_search.pointing.tracks


@pytest.mark.parametrize("of", ["target", "view"])
def test_a_sweep_is_a_targets_or_a_views_from_its_first_step_on(of: str) -> None:
    robot, world, begun = Ordering(), DarkSurvey(1), 0
    for _ in range(400):
        if begun == 2:
            break
        if of == "target":
            agent, plan = robot.agent, robot.step().sweep
        else:
            world.step()
            agent, plan = world.agents["r1"], world.outputs["r1"].sweep
        if plan is not None:
            begun += 1
            assert agent._situation.camera.sweep == of
    assert begun


WORLDS: dict[str, Callable] = {"fish": lambda: DarkFish(1, 0.15, 10.0), "dark survey": lambda: DarkSurvey(1)}


@pytest.mark.parametrize("kind", WORLDS)
def test_to_ask_for_proposals_changes_nothing(kind: str) -> None:
    """Two robots take in the same; one is asked for its proposals again and again between the steps."""
    world = WORLDS[kind]()
    twin = Agent(world.fleet, "r1", world.calibrations["r1"], world.agents["r1"].operator._incarnation)
    for _ in range(60):
        world.step()
        for _ in range(3):
            assert [
                each for one in (twin.operator, twin.equipment, twin.measuring) for each in one.propose(twin._situation)
            ]
        assert encode(twin.step(world.inputs["r1"], world.now_ns)) == encode(world.outputs["r1"])


def test_grants_are_told_where_they_change() -> None:
    one = InTank(fleet(behaviour=Follow(target="ball", standoff_m=0.6)))
    told = []
    for _ in range(200):
        grants = one.step().grants
        told.append(() if grants is UNSET else grants)
    assert {grant.resource for grant in told[0]} == {"camera", "body"}
    assert 1 < sum(map(len, told)) < 40
    held: dict[str, str] = {}
    for grants in told:
        assert all(held.get(grant.resource) != grant.holder for grant in grants)
        held |= {grant.resource: grant.holder for grant in grants}
    assert held == one.agent.arbiter.held


def test_who_has_what_goes_back_with_a_step_that_breaks(monkeypatch) -> None:
    one = InTank(replace(fleet()))
    one.run(2.0)
    held = dict(one.agent.arbiter.held)
    monkeypatch.setattr(Targets, "say", lambda *about: 1 / 0)
    one.step()
    assert one.agent.transaction.holds and one.agent.arbiter.held == held
