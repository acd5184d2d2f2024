"""All that a robot of any kind of fleet remembers between steps either never changes or is in the savepoint."""

import functools
import itertools
from collections import deque
from collections.abc import Callable, Collection, Iterator
from enum import Enum
from functools import partial
from types import FunctionType, MethodType, NoneType
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.survey.candidates import Ahead
from agent.capabilities.swim.tag_fix import Map
from agent.core.attitude import AttitudeLog
from agent.core.config import Fleet, Navigation, Search
from agent.core.messages import Explain, Order, State
from agent.core.step_transaction import Revertible, Savepoint, StepTransaction
from agent.experiments.reconstruction.coverage import SIZE_M, SURFACE_M, World, draw_scene, fleet_of
from agent.robot.step import Agent
from tests.capabilities.light.dark_fish import DarkFish
from tests.capabilities.light.dark_survey import DarkSurvey
from tests.capabilities.light.lit_swarm import LitSwarm
from tests.capabilities.swim.swimming_agent import CALIBRATION, InTank, fleet
from tests.core.swarm_on_hand import Swarm
from tests.robot.ordering import Ordering

NUMBERS = (bool, int, float, str, bytes, NoneType, Enum, type, msgspec.UnsetType)
WRITTEN_ONCE = (Fleet, Map, Order, State, Explain, Ahead)  # whose dicts are made with them, and never written again
APART = (StepTransaction,)  # counts the steps that broke, so that it outlasts them
LOOKS = 4  # at each robot, a second apart


def moored(protocol: str) -> Callable[[], Iterator[Agent]]:
    def run() -> Iterator[Agent]:
        swarm = Swarm(protocol)
        swarm.run(4.0)
        for _ in range(LOOKS):
            swarm.run(1.0)
            yield swarm.agents["r1"]

    return run


def swims() -> Iterator[Agent]:
    searches = replace(fleet(behaviour=Search(target="ball")), navigation=Navigation(gyro=True))
    one = InTank(searches, seed=3)
    for _ in range(LOOKS):
        one.run(1.0)
        yield one.agent


def stepped(world: Any) -> Iterator[Agent]:
    for _ in range(LOOKS):
        for _ in range(20):
            world.step()
        yield world.agents["r1"]


def surveys() -> Iterator[Agent]:
    scene = draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 4)
    return stepped(World(fleet_of(count=2), scene, 4, True, 0.3))


def lights() -> Iterator[Agent]:
    swarm = LitSwarm()
    for _ in range(LOOKS):
        swarm.run(2.0)
        yield swarm.robots["r1"].agent


def ordered() -> Iterator[Agent]:
    robot = Ordering()
    robot.give("look", {"pan_deg": 10.0})
    yield robot.agent


def of_fixed_focus() -> Iterator[Agent]:
    yield Agent(fleet(), "r1", replace(CALIBRATION, focus=None), 7)


KINDS = {
    "ordered": ordered,
    "fixed focus": of_fixed_focus,
    "paper": moored("paper"),
    "metropolis": moored("metropolis"),
    "evidence": moored("evidence"),
    "swim": swims,
    "survey": surveys,
    "lighting": lights,
    "dark survey": lambda: stepped(DarkSurvey(1)),
    "fish": lambda: stepped(DarkFish(1, 0.2, 20.0)),
}


def contents(of: Any) -> Collection[Any] | None:
    """What it holds; None: whether it changes, nobody knows. An array of numpy does, and no object holds one."""
    if isinstance(of, NUMBERS) or type(of).__name__ == "_GenericAlias":
        return ()
    if isinstance(of, WRITTEN_ONCE):
        fields = of if isinstance(of, tuple) else msgspec.structs.astuple(of)
        return [one for each in fields for one in (each.values() if isinstance(each, dict) else (each,))]
    if isinstance(of, dict):
        return (*of.keys(), *of.values())
    if isinstance(of, tuple | frozenset | list | deque | set):
        return of
    if isinstance(of, msgspec.Struct):
        return msgspec.structs.astuple(of) if of.__struct_config__.frozen else None
    if isinstance(of, partial):
        return (of.func, *of.args, *of.keywords.values())
    if isinstance(of, FunctionType | MethodType):
        return (*(cell.cell_contents for cell in of.__closure__ or ()), getattr(of, "__self__", None))
    return tuple(vars(of).values()) if isinstance(of, Revertible) else None


def reached(root: Agent) -> Iterator[tuple[str, Any]]:
    """Each thing that the agent holds, through whatever holds it, and the way there."""
    seen, found = set(), [("agent", root)]
    while found:
        way, each = found.pop()
        if id(each) in seen or isinstance(each, APART):
            continue
        seen.add(id(each))
        yield way, each
        found += [(f"{way} > {type(one).__name__}", one) for one in contents(each) or ()]


def lost(root: Agent) -> list[str]:
    """Ways to what may change and would not be put back."""
    point = Savepoint(root)
    kept = {id(now) for now, _ in (*point._objects, *point._dicts, *point._rows)}
    return [
        way
        for way, each in reached(root)
        if contents(each) is None
        or (isinstance(each, Revertible) and id(vars(each)) not in kept)
        or (isinstance(each, dict | list | deque | set) and id(each) not in kept)
    ]


@functools.cache
def looked(kind: str) -> tuple[list[str], set[type]]:
    """What would not be put back, and which classes were met."""
    ways, met = [], set()
    for agent in KINDS[kind]():
        ways += lost(agent)
        met |= {type(each) for _, each in reached(agent)}
    return ways, met


@pytest.mark.parametrize("kind", KINDS)
def test_what_changes_is_put_back(kind: str) -> None:
    assert not looked(kind)[0]


def test_these_robots_have_objects_of_each_class_that_changes() -> None:
    met = set().union(*(looked(kind)[1] for kind in KINDS))
    # tests have such classes, too
    kernel = [kind for kind in below(Revertible) if kind.__module__.startswith("agent.")]
    assert not [kind for kind in kernel if not any(issubclass(each, kind) for each in met)]


def below(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield each
        yield from below(each)


class Plain:
    """An object with state, of a class that says nothing of it."""

    def hear(self) -> None: ...


class Phase(Enum):
    REST = 0


@pytest.mark.parametrize("held", [Plain(), np.zeros(3), (AttitudeLog(),), (1, [2]), Plain().hear, partial(max, [1])])
def test_a_robot_that_holds_state_elsewhere_is_refused(held: Any) -> None:
    (agent,) = itertools.islice(swims(), 1)
    agent.target_search.held = held
    assert lost(agent)
    agent.target_search.held = Phase.REST
    assert not lost(agent)
