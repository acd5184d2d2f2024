"""The table of capabilities, a row for each, and the table of priorities: who has camera, body and lamp in a step.

A row of the priorities is asked where its columns allow it; the first that takes a resource has it. A holder that is
asked may decline. Each row is asked anew in every step, so each holder may lose its resource in the next, but in sweeps
that a column leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, NamedTuple

from agent.capabilities.light.lights import Light
from agent.capabilities.survey.survey import Survey
from agent.capabilities.swim.swim import Swim
from agent.core.capability import Capability, Context, Illumination, PoseSource, Proposal, Resource, Situation
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.step_io import Grant, Heard
from agent.core.step_transaction import Revertible

# --- capabilities ---

# In the order in which they are asked: a later one may go by what an earlier one adds to the situation.
CAPABILITIES: tuple[type[Capability], ...] = (Swim, Light, Survey)


class Equipment(Revertible):
    """The capabilities of one robot, by name."""

    def __init__(self, context: Context) -> None:
        """Those whose table stands in the fleet file. The first that says where the robot was, or lights, counts."""
        self.by_name: dict[str, Capability] = {}
        for kind in CAPABILITIES:
            if getattr(context.fleet, kind.table) is None:
                continue
            one = self.by_name[kind.name] = kind(context)
            if isinstance(one, PoseSource):
                context = context._replace(source=one)
            if isinstance(one, Illumination):
                context = context._replace(light=one)
        self.source, self.light = context.source, context.light

    def receive(self, heard: Heard, accepted: frozenset[int]) -> bool:
        """Whether a payload was for a capability. Raises Refusal where it is not believed."""
        for kind in CAPABILITIES:
            if all(topic.name != heard.topic for topic in kind.topics):
                continue
            if (one := self.by_name.get(kind.name)) is None:
                text = f"it {kind.does}, and our file has no [{kind.table}]; give all robots the same file"
                raise Refusal("fleet file", text)
            one.receive(heard, accepted)
            return True
        return False


def tables(fleet: Fleet) -> tuple[str, ...]:
    """Names of the capabilities that a fleet file gives its robots."""
    return tuple(kind.name for kind in CAPABILITIES if getattr(fleet, kind.table) is not None)


# --- priorities ---

Sweep = Literal["none", "target", "view"]
ANY: tuple[Sweep, ...] = ("none", "target", "view")


class Row(NamedTuple):
    """Who may ask for a resource."""

    resource: Resource
    holder: str
    why: str  # it takes the resource
    sweeps: tuple[Sweep, ...] = ANY  # sweeps in which it is asked
    lent: bool = True  # also while a neighbour has the light


# Of each resource the highest first. The last row of a resource always takes it.
PRIORITIES = (
    Row("camera", "landmarks", "it knows too little of where it is", ("none",), lent=False),
    Row("camera", "operator", "a look is ordered", ("none",)),
    Row("camera", "survey", "a view is chosen, looked at or swept", ("none", "view")),
    Row("camera", "pursuit", "its behaviour is about a target that swims", ("none",)),
    Row("camera", "target", "nothing else takes it: targets have their turns"),
    Row("body", "off", "the control module does not obey, or it is not known where the robot is"),
    Row("body", "behaviour", "it is under way, and no light is lent"),
    Row("body", "stay", "it knows where it is"),
    Row("body", "brake", "it has been lost for less than a second"),
    Row("body", "drift", "it is lost"),
    Row("lamp", "safe", "the module is silent or disarmed, the battery empty or the lamp too warm"),
    Row("lamp", "operator", "a light is ordered"),
    Row("lamp", "sweep", "an own sweep is under way or judged: its light does not change"),
    Row("lamp", "lent", "a neighbour has the light"),
    Row("lamp", "lease", "the robot has the light itself"),
    Row("lamp", "camera", "no robot has the light: the lamp goes with its own camera"),
)


class Arbiter(Revertible):
    """Of one robot, between steps."""

    def __init__(self) -> None:
        self.held: dict[Resource, str] = {}  # by which row, in the newest step
        self._told: dict[Resource, str] = {}  # likewise, as it was told last

    def changes(self) -> tuple[Grant, ...]:
        """Resources that have another holder than when this was asked last."""
        new = {resource: holder for resource, holder in self.held.items() if self._told.get(resource) != holder}
        self._told.update(new)
        return tuple(Grant(resource=resource, holder=holder) for resource, holder in new.items())

    def grant(self, resource: Resource, proposals: Iterable[Proposal[Any]], situation: Situation) -> Any:
        """The command of the first row that takes the resource; None where nobody proposes anything."""
        asked: Mapping[str, Callable[[Situation], Any]] = {
            each.holder: each.act for each in proposals if each.resource == resource
        }
        sweep, lent = situation.camera.sweep, situation.light.phase == "obeys"
        for row in PRIORITIES:
            if row.resource != resource or row.holder not in asked:
                continue
            if sweep not in row.sweeps or (lent and not row.lent):
                continue
            if (command := asked[row.holder](situation)) is not None:
                self.held[resource] = row.holder
                return command
        return None


def table() -> tuple[tuple[str, str, str, str, str], ...]:
    """The table of priorities for people: resource, holder, sweeps, while a neighbour has the light, when it takes."""
    return tuple(
        (
            row.resource,
            row.holder,
            "any" if row.sweeps == ANY else ", ".join(row.sweeps),
            "yes" if row.lent else "no",
            row.why,
        )
        for row in PRIORITIES
    )
