"""One robot among lies for some seconds: it is woken from a recording, lied to, and watched after every step."""

from __future__ import annotations

import gc
import time
import traceback
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

from agent.core.codec import encode
from agent.core.step_io import Heard, Inputs, Outputs
from tests.fuzz.kernel.invariants import Broken, Watch
from tests.fuzz.kernel.swarm import START_NS, STEP_NS, Known, Robot, Scene, known, record, wake

SLOW_S = 0.25  # of the processor, for one step
USUAL_S = 0.01  # of the processor, for a step that is not slow
LOOKS = 20  # steps from one look at the processor's time to the next
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
    transaction: bool = (
        False  # the net is under the step, as on a robot; without it an exception shows where it came from
    )

    @property
    def alone(self) -> bool:
        return len(self.mouths) == 1


class Stopwatch:
    """Tells of steps that take long. The processor's time is asked for seldom: asking takes as long as a step."""

    def __init__(self) -> None:
        self._steps, self._cpu_s = 0, time.process_time()

    def slow_s(self, wall_s: float) -> float | None:
        """How long the step took that took `wall_s` by the wall, if that was the processor's fault and too long."""
        self._steps += 1
        if wall_s <= SLOW_S and self._steps < LOOKS:
            return None
        cpu_s, before_s = time.process_time(), self._cpu_s
        usual_s, self._steps, self._cpu_s = USUAL_S * self._steps, 0, cpu_s
        return wall_s if wall_s > SLOW_S and cpu_s - before_s > SLOW_S + usual_s else None


def play(plan: Plan, tell: Tell, told: list[tuple[int, str, bytes]] | None = None) -> Iterator[tuple[int, Broken]]:
    """Step through the plan; what was broken, with its step. Ends at an exception. `told` takes down the lies."""
    recording = record(plan.scene)
    robot = woken(plan)
    watch = Watch(recording, robot, plan.alone, lambda step, target: unlied(plan)[step - plan.start][target].x_m)
    lying = min(plan.start + plan.steps, plan.scene.steps)
    end = min(lying + QUIET_STEPS, plan.scene.steps) if plan.quiet else lying
    gc.freeze()  # what is there by now is no step's: to go through all that other tests left takes as long as SLOW_S
    stopwatch = Stopwatch()
    for step in range(plan.start, end):
        robot.clock.now_ns = now_ns = START_NS + (step + 1) * STEP_NS
        lies = tell(step, now_ns) if step < lying else []
        if told is not None:
            told += ((step, *lie) for lie in lies)
        heard = heard_at(plan, step, lies)
        started_s = time.perf_counter()
        try:
            outputs = robot.step(heard)
        except Exception as error:  # noqa: BLE001 - whatever it is, it would have ended the robot
            yield step, crash(error)
            return
        slow_s = stopwatch.slow_s(time.perf_counter() - started_s)
        if slow_s is not None and len(lies) <= PASSED * len(plan.mouths) * plan.scene.targets:
            yield step, Broken("slow", f"{slow_s:.2f} s for a step that heard {len(heard)} messages")
        if (fault := robot.agent.transaction.fault(now_ns)) is not None:
            yield step, Broken("net", fault)
            return
        for broken in watch.check(outputs, step):
            yield step, broken
    if plan.quiet and end - lying == QUIET_STEPS:
        yield from ((end, broken) for broken in deaf(robot))


def woken(plan: Plan) -> Robot:
    """The robot of a plan as it begins."""
    robot = wake(record(plan.scene), plan.start, plan.victim)
    if not plan.transaction:
        robot.agent.transaction.step = bare  # type: ignore[method-assign]
    return robot


def heard_at(plan: Plan, step: int, lies: list[Lie]) -> tuple[Heard, ...]:
    """What the robot hears at a step: the truth, as far as it is not silenced, then the lies."""
    now_ns = START_NS + (step + 1) * STEP_NS
    honest = record(plan.scene).said[plan.victim][step]
    if plan.silent and step < plan.start + plan.steps:
        honest = tuple(heard for heard in honest if heard.src not in plan.mouths)
    return (*honest, *(Heard(arrived_ns=now_ns, src=src, payload=payload) for src, payload in lies))


@lru_cache(maxsize=4)
def unlied(plan: Plan) -> list[dict[str, Known]]:
    """What the robot would know after each step, had it heard the same without the lies."""
    robot, last, found = woken(plan), record(plan.scene).known[plan.victim][max(0, plan.start - 1)], []
    for step in range(plan.start, plan.scene.steps):
        robot.clock.now_ns = START_NS + (step + 1) * STEP_NS
        last = known(robot, robot.step(heard_at(plan, step, [])), last)
        found.append(last)
    return found


def bare(state: object, work: Callable[[Inputs, int], Outputs], inputs: Inputs, now_ns: int) -> Outputs:
    """A step without a net."""
    return work(inputs, now_ns)


def deaf(robot: Robot) -> Iterator[Broken]:
    """Neighbours that speak, and are not heard."""
    now_ns = robot.clock.now_ns
    validity_ns = robot.agent._fleet.estimation.validity_s * 1e9
    for target in robot.agent.targets.values():
        for name, sender in target.cache.senders.items():
            age_ns = target.cache.age_ns(name, now_ns)
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
    robot, said = woken(plan), []
    for step in range(plan.start, min(plan.start + plan.steps, plan.scene.steps)):
        robot.clock.now_ns = now_ns = START_NS + (step + 1) * STEP_NS
        said.append(encode(robot.step(heard_at(plan, step, tell(step, now_ns)))))
    return said
