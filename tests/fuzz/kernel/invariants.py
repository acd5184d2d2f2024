"""What must hold after every step of a robot, whatever it was told. A check gives a name to count by and a figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from agent.core.codec import Refusal, decode, encode
from agent.core.linear_algebra import semidefinite, trace
from agent.core.messages import Estimate, State, Vector
from agent.core.step_io import Outputs
from tests.fuzz.kernel.sizes import largest
from tests.fuzz.kernel.swarm import STEP_NS, Known, Recording, Robot

MOVED_M = 0.06  # coarse: what one liar of three may move who sees the target; the experiment has the exact bars
AHEAD = 3  # iterations before what an honest swarm had reached
EPOCHS_PER_S = 0.1  # counters of epochs that time allows
UNSEEN_EPOCHS = 1000  # by which a robot follows one other where fewer than three see the target
SETTLED_STEPS = 60  # after a change of the epoch, until one robot can be compared with another
LEFT_STEPS = 400  # in which a robot finds into the epoch of the others
LAST_EPOCH = 10**8  # two that lie together may lead so far, and no farther
KINDS = 40  # of refusals
LONGEST = 3000  # entries of any container of an agent
LINES = 40  # of the log, of one step
PLACE_M = 10.0  # no tank is larger
SEEN = 4  # own samples of each robot from which on one liar of three is outvoted
SIZES_EVERY = 50  # steps: the walk through all of an agent costs as much as ten of them


class Broken(NamedTuple):
    """A promise that was not kept."""

    name: str  # the same for the same fault
    detail: str


class Watch:
    """Follows one robot of a recording from the step at which it was woken."""

    def __init__(
        self, recording: Recording, robot: Robot, alone: bool, unlied: Callable[[int, str], Vector | None]
    ) -> None:
        """alone: one neighbour lies and the other is honest, so that more can be promised. unlied: step and target ->
        where the robot would place it, had it heard the same without the lies."""
        self._unlied = unlied
        self._recording, self._robot, self._alone = recording, robot, alone
        self._last_epoch = {
            name: max(step[name].epoch for step in recording.known[robot.name]) for name in recording.fleet.target
        }
        self._epochs: dict[str, tuple[bool, int]] = {}  # target -> whether it is the others' one, and since which step
        self._own: dict[str, tuple[object, int]] = {}  # target -> which entry is our own, and its count

    def check(self, outputs: Outputs, step: int) -> Iterator[Broken]:
        """What the step broke that was the recording's `step`."""
        robot = self._robot
        if outputs.set_point.depth_m != self._recording.fleet.robot[robot.name].depth_m:
            yield Broken("depth", f"set-point {outputs.set_point.depth_m} m")
        if len(outputs.log) > LINES:
            yield Broken("babble", f"{len(outputs.log)} lines in one step")
        for said in outputs.says:
            yield from self._said(said, self._recording.known[robot.name][step][said.target], step)
        if outputs.state is not None:
            yield from _travels(outputs.state, State)
        if len(robot.agent.inbox.refused) > KINDS:
            yield Broken("kinds", f"{len(robot.agent.inbox.refused)} kinds of refusals")
        yield from self._own_entries()
        if step % SIZES_EVERY == 0:
            length, where = largest(robot.agent)
            if length > LONGEST:
                yield Broken("size", f"{where} has {length} parts")

    def _said(self, said: Estimate, honest: Known, step: int) -> Iterator[Broken]:
        yield from _travels(said, Estimate)
        if said.cov_m2 is not None and not semidefinite(said.cov_m2, 1e-9 * abs(trace(said.cov_m2))):
            yield Broken("covariance", f"{said.cov_m2}")
        if said.x_m is not None and max(map(abs, said.x_m)) > PLACE_M:
            yield Broken("place", f"{said.x_m} m")
        allowed = honest.t + AHEAD if self._alone else 10**8 + honest.t + AHEAD
        if said.t > allowed:
            yield Broken("iteration", f"{said.t}, where {allowed} would be the most")
        if self._alone and said.t < honest.t - AHEAD:
            yield Broken("held back", f"iteration {said.t}, where an honest swarm has {honest.t}")
        if said.gossip is None:
            return
        seen = self._all_see(said.target, step)
        may = self._last_epoch[said.target] + 2 + step * STEP_NS * 1e-9 * EPOCHS_PER_S + (0 if seen else UNSEEN_EPOCHS)
        if said.gossip.epoch.counter > (may if self._alone else LAST_EPOCH):
            yield Broken("epoch", f"{said.gossip.epoch}, where {may:.0f} would be the most")
        same, since = self._epochs.get(said.target, (True, step - SETTLED_STEPS))
        if same != (said.gossip.epoch.counter == honest.epoch):
            same, since = not same, step
        self._epochs[said.target] = (same, since)
        if not (self._alone and seen) or step - since < SETTLED_STEPS:
            return
        if not same and step - since > LEFT_STEPS:
            yield Broken(
                "left", f"in {said.gossip.epoch} for {LEFT_STEPS} steps, where all others are in {honest.epoch}"
            )
        if self._robot.scene.moving and not said.gossip.epoch.moving:
            return  # nobody has noticed yet: honest robots place it differently, each where it saw it
        if same and said.x_m is not None and honest.x_m is not None:
            moved_m = math.dist(said.x_m, honest.x_m)
            if moved_m > MOVED_M and math.dist(said.x_m, self._unlied(step, said.target) or said.x_m) > MOVED_M:
                yield Broken("moved", f"by {moved_m * 1e3:.0f} mm")

    def _all_see(self, target: str, step: int) -> bool:
        robot, known = self._robot, self._recording.known
        if robot.agent.targets[target].measurements < SEEN:
            return False
        return all(known[name][step][target].measurements >= SEEN for name in known)

    def _own_entries(self) -> Iterator[Broken]:
        """The entry that a robot adds to is never lost, and never becomes less, while its epoch lasts."""
        for name, target in self._robot.agent.targets.items():
            mode = getattr(target.estimator, "_mode", None)
            if (table := getattr(mode, "_table", None)) is None:
                continue
            key = target.estimator._me.key  # type: ignore[attr-defined]
            entry = table.entries.get(key)
            count = 0 if entry is None else entry.count
            before, had = self._own.get(name, (None, 0))
            if before == (id(mode), key) and count < had:
                yield Broken("own entry", f"{had} own samples became {count}")
            self._own[name] = ((id(mode), key), count)


def _travels(message: Estimate | State, kind: type[Estimate] | type[State]) -> Iterator[Broken]:
    """What is said can be read by others."""
    try:
        payload = encode(message)
        if decode(payload, kind) != message:
            yield Broken("encoding", f"{message} comes back as another")
    except (Refusal, ValueError, OverflowError) as error:
        yield Broken("unreadable", f"own {kind.__name__}: {error}")
