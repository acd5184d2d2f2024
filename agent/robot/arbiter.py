"""The table of capabilities, a row for each, and the table of priorities: who has camera, body and lamp in a step.

A row of the priorities is asked where its columns allow it; the first that takes a resource has it. A holder that is
asked may decline. Each row is asked anew in every step, so each holder may lose its resource in the next, but in sweeps
that a column leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import reduce
from typing import Any, get_args

import msgspec
from msgspec import UNSET, UnsetType

from agent.capabilities.light.lights import Light
from agent.capabilities.survey.survey import Survey
from agent.capabilities.swim.swim import Swim
from agent.core.capability import (
    ANY,
    Capability,
    Context,
    Illumination,
    Outgoing,
    PoseSource,
    Proposal,
    Resource,
    Row,
    Situation,
)
from agent.core.codec import Refusal, encode
from agent.core.config import ConfigError, Fleet, mistake
from agent.core.estimation.interface import Bearing, Posterior
from agent.core.step_io import Grant, Heard, Inputs, Said
from agent.core.step_transaction import Revertible
from agent.core.verbs import Args

# --- capabilities ---

# In the order in which they are asked: a later one may go by what an earlier one adds to the situation.
CAPABILITIES: tuple[type[Capability], ...] = (Swim, Light, Survey)
EXTEND = "extend."  # begins the name of a table of a capability that is not built in


def table_of(fleet: Fleet, kind: type[Capability]) -> Any:
    """Its table of a fleet file; None where it has none."""
    if not kind.table.startswith(EXTEND):
        return getattr(fleet, kind.table)
    return (fleet.extend or {}).get(kind.table.removeprefix(EXTEND))


def _settings(table: Any, kind: type[Capability]) -> Any:
    """Its table as it wants it. Raises msgspec.ValidationError."""
    return table if kind.settings is None else msgspec.convert(table, kind.settings)


def broken_extend_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake in [extend] as (key, what to change)."""
    known = {kind.table: kind for kind in CAPABILITIES}
    for name, table in (fleet.extend or {}).items():
        key = EXTEND + name
        if (kind := known.get(key)) is None:
            yield key, "no capability has this table; correct its name, or add the row in agent/robot/arbiter.py"
            continue
        try:
            _settings(table, kind)
        except msgspec.ValidationError as error:
            where, remedy = mistake(error, table, kind.settings)
            yield f"{key}.{where}".rstrip("."), remedy
        else:
            yield from kind.broken_rules(fleet)


def refuse_broken(fleet: Fleet) -> None:
    """Raises ConfigError for a capability that cannot be, and for a mistake in [extend]."""
    priorities()
    for key, remedy in broken_extend_rules(fleet):
        raise ConfigError(f"fleet file: key '{key}': {remedy}")


def _refuse_sweeps(context: Context) -> None:
    """Raises ConfigError for what a fleet file asks of a camera of fixed focus in vain."""
    fleet = context.fleet
    if context.calibration.focus is not None:
        return
    swept = [f"[{kind.table}]" for kind in CAPABILITIES if kind.sweeps and table_of(fleet, kind) is not None]
    swept += ["ranging.cues = 'focus'"] if fleet.ranging.cues == "focus" else []
    unsized = [name for name, of in fleet.target.items() if of.radius_m is None and of.length_m is None]
    means = fleet.estimation.protocol != "evidence"
    swept += (
        [f"protocol '{fleet.estimation.protocol}' with '{unsized[0]}' of unknown size"] if means and unsized else []
    )
    if swept:
        raise ConfigError(
            f"fleet file: {swept[0]} needs a lens that sweeps, and the camera of {context.name} has a fixed focus; "
            "take it out, or calibrate a camera whose focus can be set"
        )


class Equipment(Capability):
    """All capabilities of one robot as one."""

    def __init__(self, context: Context) -> None:
        """Those whose table stands in the fleet file. The last that says where the robot was, or lights, counts, for
        targets and for the capabilities after it. Raises ConfigError as refuse_broken does, and for a table that
        sweeps a lens that cannot be."""
        refuse_broken(context.fleet)
        _refuse_sweeps(context)
        self.by_name: dict[str, Capability] = {}
        self._neighbours = frozenset(context.fleet.robot[context.name].neighbours)
        for kind in CAPABILITIES:
            if (table := table_of(context.fleet, kind)) is None:
                continue
            one = self.by_name[kind.name] = kind(context._replace(settings=_settings(table, kind)))
            if isinstance(one, PoseSource):
                context = context._replace(source=one)
            if isinstance(one, Illumination):
                context = context._replace(light=one)
        self.source, self.light = context.source, context.light

    def take(self, heard: Heard, accepted: frozenset[int]) -> None:
        """Give a payload to the capability that it is for. Raises Refusal where it is not believed."""
        for kind in CAPABILITIES:
            if all(topic.name != heard.topic for topic in kind.topics):
                continue
            if (one := self.by_name.get(kind.name)) is None:
                text = f"it {kind.does}, and our file has no [{kind.table}]; give all robots the same file"
                raise Refusal("fleet file", text)
            one.receive(heard, accepted)
            return
        raise Refusal("address", f"no capability listens to the topic '{heard.topic}'")

    def update(self, inputs: Inputs, situation: Situation) -> Situation:
        return reduce(lambda now, one: one.update(inputs, now), self.by_name.values(), situation)

    def decide(self, situation: Situation) -> Situation:
        return reduce(lambda now, one: one.decide(now), self.by_name.values(), situation)

    def settle(self, situation: Situation) -> Situation:
        return reduce(lambda now, one: one.settle(now), self.by_name.values(), situation)

    def bearing(self, target: str, believed: Callable[[], Posterior | None], now_ns: int) -> Bearing | None:
        found = (one.bearing(target, believed, now_ns) for one in self.by_name.values())
        return next((bearing for bearing in found if bearing is not None), None)

    def propose(self, situation: Situation) -> Iterable[Proposal[Any]]:
        return (each for one in self.by_name.values() for each in one.propose(situation))

    def carry_out(self, command: Args) -> bool:
        return any([one.carry_out(command) for one in self.by_name.values()])

    def said(self, situation: Situation) -> tuple[Said, ...]:
        """What neighbours are told in this step, as it is sent. Raises LookupError for what nobody could receive."""
        return tuple(self._sent(kind, each) for kind, one in self.by_name.items() for each in one.outgoing(situation))

    def _sent(self, kind: str, word: Outgoing) -> Said:
        if word.topic not in self.by_name[kind].topics or word.to not in self._neighbours:
            raise LookupError(
                f"capability '{kind}' tells {word.to} on {word.topic.name}: no topic, or neighbour, of it"
            )
        return Said(topic=word.topic.name, to=word.to, payload=encode(word.message))

    def telemetry(self, now_ns: int) -> Mapping[str, Any]:
        return {name: part for one in self.by_name.values() for name, part in one.telemetry(now_ns).items()}

    def faults(self, now_ns: int) -> tuple[str, ...]:
        return tuple(fault for one in self.by_name.values() for fault in one.faults(now_ns))

    def lens(self) -> int | UnsetType | None:
        lenses = (one.lens() for one in self.by_name.values())
        return next((lens for lens in lenses if lens is not UNSET), UNSET)


# --- priorities ---

# Of each resource the highest first. The last row of a resource always takes it.
PRIORITIES = (
    Row("camera", "landmarks", "it knows too little of where it is", ("none",), lent=False),
    Row("camera", "operator", "a look is ordered", ("none",)),
    Row("camera", "survey", "a view is chosen, looked at or swept", ("none", "view")),
    Row("camera", "pursuit", "its behaviour is about a target that swims", ("none",)),
    Row("camera", "target", "nothing else takes it: targets have their turns", ("none", "target")),
    Row("camera", "hold", "a view's sweep runs: the gimbal stays as long as that counts"),
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


def priorities() -> tuple[Row, ...]:
    """The table, with the rows that capabilities bring. Raises ConfigError for one that has no place in it, and for a
    name that another has."""
    rows, names = list(PRIORITIES), set[str]()
    for kind in CAPABILITIES:
        for name in (f"name = '{kind.name}'", f"table = '{kind.table}'"):
            if name in names:
                raise ConfigError(f"capability {kind.__name__}: another one has {name}; write one of its own")
            names.add(name)
        for row in kind.rows:
            holders = [each.holder if each.resource == row.resource else None for each in rows]
            if row.above not in holders or row.above in FIRST:
                known = ", ".join(holder for holder in holders if holder is not None and holder not in FIRST)
                why = f"its row of the {row.resource} is to stand above '{row.above}'; write one of {known}"
                raise ConfigError(f"capability '{kind.name}': {why}")
            if row.holder in holders:
                why = f"the {row.resource} has a row '{row.holder}' already; write another name"
                raise ConfigError(f"capability '{kind.name}': {why}")
            rows.insert(holders.index(row.above), row)
    return tuple(rows)


FIRST = ("off", "safe")  # what protects the robot: no row of a capability stands above it
NOBODY = "nobody"  # has a resource that one row has had, and that none takes now


class Arbiter(Revertible):
    """Of one robot, between steps."""

    def __init__(self) -> None:
        rows = priorities()
        self._rows = {kind: tuple(row for row in rows if row.resource == kind) for kind in get_args(Resource)}
        self.held: dict[Resource, str] = {}  # by which row, in the newest step
        self._told: dict[Resource, str] = {}  # likewise, as it was told last

    def changes(self) -> tuple[Grant, ...]:
        """Resources that have another holder than when this was asked last."""
        new = {resource: holder for resource, holder in self.held.items() if self._told.get(resource) != holder}
        self._told.update(new)
        return tuple(Grant(resource=resource, holder=holder) for resource, holder in new.items())

    def grant(self, resource: Resource, proposals: Iterable[Proposal[Any]], situation: Situation) -> Any:
        """The command of the first row that takes the resource; None where nobody proposes anything. Raises LookupError
        for a proposal of no row, and for two of one row."""
        asked: dict[str, Callable[[Situation], Any]] = {}
        for each in proposals:
            if each.resource == resource:
                if each.holder in asked:
                    raise LookupError(f"two proposals of the row '{each.holder}' of the {resource}")
                asked[each.holder] = each.act
        sweep, lent = situation.camera.sweep, situation.light.phase == "obeys"
        rows = self._rows[resource]
        for holder in sorted(asked.keys() - {row.holder for row in rows}):
            raise LookupError(f"no row '{holder}' of the {resource} in the table of priorities")
        for row in rows if asked else ():
            if row.holder not in asked or sweep not in row.sweeps or (lent and not row.lent):
                continue
            if (command := asked[row.holder](situation)) is not None:
                self.held[resource] = row.holder
                return command
        if resource in self.held:
            self.held[resource] = NOBODY
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
        for row in priorities()
    )
