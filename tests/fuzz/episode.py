"""One robot among lies for some seconds: it is woken from a recording, lied to, and watched after every step."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from typing import NamedTuple

from agent.kernel.codec import encode
from agent.kernel.step_io import Heard, Inputs, Outputs
from tests.fuzz.invariants import Broken, Watch
from tests.fuzz.swarm import START_NS, STEP_NS, Robot, Scene, record, wake

SLOW_S = 0.25  # of the processor, for one step
PASSED = 2  # messages of a neighbour about a target that the transport gives to a step
QUIET_STEPS = 240  # after the last lie: by then every neighbour is heard again
FRESH_NS = 1_000_000_000

Lie = tuple[str, bytes]  # from whom it seems to come, what it says
Tell = Callable[[int, int], list[Lie]]  # (step, now_ns) -> the lies of that step


class Plan(NamedTuple):
    """All but the lies."""

    scene: Scene
    victim: str
    start: int  # step of the recording
    steps: int  # with lies
    mouths: tuple[str, ...]  # whose words the lies seem to be
    silent: bool  # those robots say nothing else meanwhile
    quiet: bool  # afterwards there are no lies, and all neighbours must be heard again
    net: bool = False  # the net is under the step, as on a robot; without it an exception shows where it came from

    @property
    def alone(self) -> bool:
        return len(self.mouths) == 1


def play(plan: Plan, tell: Tell, told: list[tuple[int, str, bytes]] | None = None) -> Iterator[tuple[int, Broken]]:
    """Step through the plan; what was broken, with its step. Ends at an exception. `told` takes down the lies."""
    recording = record(plan.scene)
    robot = wake(recording, plan.start, plan.victim)
    if not plan.net:
        robot.agent.net.step = bare  # type: ignore[method-assign]
    watch = Watch(recording, robot, plan.alone)
    lying = min(plan.start + plan.steps, plan.scene.steps)
    end = min(lying + QUIET_STEPS, plan.scene.steps) if plan.quiet else lying
    for step in range(plan.start, end):
        robot.clock.now_ns = now_ns = START_NS + (step + 1) * STEP_NS
        lies = tell(step, now_ns) if step < lying else []
        if told is not None:
            told += ((step, *lie) for lie in lies)
        honest = recording.said[plan.victim][step]
        if plan.silent and step < lying:
            honest = tuple(heard for heard in honest if heard.src not in plan.mouths)
        heard = (*honest, *(Heard(arrived_ns=now_ns, src=src, payload=payload) for src, payload in lies))
        started_s = time.process_time()
        try:
            outputs = robot.step(heard)
        except Exception as error:  # noqa: BLE001 - whatever it is, it would have ended the robot
            yield step, crash(error)
            return
        taken_s = time.process_time() - started_s
        if taken_s > SLOW_S and len(lies) <= PASSED * len(plan.mouths) * plan.scene.targets:
            yield step, Broken("slow", f"{taken_s:.2f} s for a step that heard {len(heard)} messages")
        if (fault := robot.agent.net.fault(now_ns)) is not None:
            yield step, Broken("net", fault)
            return
        for broken in watch.check(outputs, step):
            yield step, broken
    if plan.quiet and end - lying == QUIET_STEPS:
        yield from ((end, broken) for broken in deaf(robot))


def bare(state: object, work: Callable[[Inputs, int], Outputs], inputs: Inputs, now_ns: int) -> Outputs:
    """A step without a net."""
    return work(inputs, now_ns)


def deaf(robot: Robot) -> Iterator[Broken]:
    """Neighbours that speak, and are not heard."""
    now_ns = robot.clock.now_ns
    validity_ns = robot.agent._fleet.estimation.validity_s * 1e9
    for target in robot.agent.targets.values():
        for name, sender in target.mailbox.senders.items():
            age_ns = target.mailbox.age_ns(name, now_ns)
            if sender.newest is None or now_ns - sender.newest.arrived_ns > FRESH_NS:
                yield Broken("silenced", f"{name} speaks of {target.name}, and nothing of it is taken")
            elif age_ns is None or age_ns > validity_ns:
                yield Broken("aged", f"what {name} says of {target.name} is taken for {age_ns} ns old")


def crash(error: Exception) -> Broken:
    """An exception by its kind and place: the innermost line of ours."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/tests/" not in f.filename]
    ours = [f for f in frames if "/agent/" in f.filename or "/hw/" in f.filename or "/replay/" in f.filename] or frames
    if not ours:
        raise error  # a fault of these tests
    where = ours[-1]
    module = where.filename.rpartition("/")[2]
    return Broken(f"{type(error).__name__} in {module}:{where.name}", f"line {where.lineno}: {error!s:.200}")


def outcome(plan: Plan, tell: Tell) -> list[bytes]:
    """The bytes of every step's outputs: equal inputs give equal ones."""
    recording, said = record(plan.scene), []
    robot = wake(recording, plan.start, plan.victim)
    for step in range(plan.start, min(plan.start + plan.steps, plan.scene.steps)):
        robot.clock.now_ns = now_ns = START_NS + (step + 1) * STEP_NS
        lies = tuple(Heard(arrived_ns=now_ns, src=src, payload=payload) for src, payload in tell(step, now_ns))
        outputs: Outputs = robot.step((*recording.said[plan.victim][step], *lies))
        said.append(encode(outputs))
    return said


