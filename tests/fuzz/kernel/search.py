"""Lies into the kernel of each protocol: many short episodes, each from a seed of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from random import Random

from agent.core.config import Protocol
from tests.fuzz import cases
from tests.fuzz.kernel.episode import QUIET_STEPS, Lie, Plan, Tell, outcome, play
from tests.fuzz.kernel.invariants import Broken
from tests.fuzz.kernel.swarm import ROBOTS, SAVED_S, STEP_NS, Scene, record
from tests.fuzz.kernel.tellers import teller
from tests.fuzz.shrink import shrink

PROTOCOLS: tuple[Protocol, ...] = ("paper", "metropolis", "evidence")
DIVE_S = 28.0  # all see the target, and know if it moves, for its second half
STEPS = (20, 60, 160, 300)  # with lies
AGAIN = 40  # episodes from one that is made twice, to see the same bytes, to the next
AFTERWARDS = ("silenced", "aged")  # faults that show when all is over
TRIES = 80  # of leaving lies out, for a case

Told = list[tuple[int, str, bytes]]  # step, from whom, what


def scenes(protocol: Protocol, seconds: float = DIVE_S) -> list[Scene]:
    """What robots of this protocol do meanwhile."""
    if protocol != "evidence":
        return [Scene(protocol, seconds=seconds), Scene(protocol, targets=2, seconds=seconds)]
    still = [Scene(protocol, targets=n, keys=keys, seconds=seconds) for n, keys in ((1, False), (1, True), (2, True))]
    return [*still, *(Scene(protocol, moving=True, keys=keys, seconds=seconds) for keys in (True, False))]


def planned(scene: Scene, rng: Random) -> Plan:
    """Somebody is lied to, by one neighbour or by all."""
    victim = rng.choice(ROBOTS)
    others = tuple(name for name in ROBOTS if name != victim)
    mouths = (rng.choice(others),) if rng.random() < 0.6 else others
    starts = [step for second in SAVED_S if (step := round(second * 1e9) // STEP_NS) < scene.steps]
    silent, quiet, transaction = rng.random() < 0.5, rng.random() < 0.3, rng.random() < 0.1
    return Plan(scene, victim, rng.choice(starts), rng.choice(STEPS), mouths, silent, quiet, transaction)


class Fuzzer:
    """Goes through episodes and keeps what was broken, each fault once."""

    def __init__(self, seed: int, say: Callable[[str], object], keep: bool = True) -> None:
        """keep: whether new faults become files among the cases."""
        self.found: dict[str, Broken] = {}
        self.messages = self.episodes = self.steps = 0
        self._seed, self._say, self._keep = seed, say, keep
        self._began_s = time.process_time()

    def run(self, chosen: list[Scene], count: int, until_s: float | None = None) -> None:
        """Tell at least `count` messages, over these scenes in turn, or as many as fit before a moment of
        time.monotonic."""
        last = self.messages + count
        while self.messages < last and (until_s is None or time.monotonic() < until_s):
            self.episode(chosen[self.episodes % len(chosen)], self.episodes)
            self.episodes += 1

    def episode(self, scene: Scene, number: int) -> None:
        name = f"{self._seed}/{scene.named()}/{number}"
        rng = Random(name)
        plan, told = planned(scene, rng), Told()
        broken = list(play(plan, teller(plan, record(scene), rng), told))
        self.messages += len(told)
        self.steps += plan.steps
        for step, fault in broken:
            if f"{scene.protocol}: {fault.name}" not in self.found:
                self._keep_fault(plan, told, step, fault, name)
        if number % AGAIN == 0 and not broken and outcome(plan, again(told)) != outcome(plan, again(told)):
            self._keep_fault(plan, told, plan.start + plan.steps, Broken("twice", "other bytes the second time"), name)

    def _keep_fault(self, plan: Plan, told: Told, step: int, fault: Broken, seed: str) -> None:
        took_s = time.process_time() - self._began_s
        self.found[f"{plan.scene.protocol}: {fault.name}"] = fault
        self._say(
            f"{plan.scene.named()}: {fault.name}: {fault.detail} [{seed}, {self.messages} messages, {took_s:.1f} s]"
        )
        if self._keep:
            plan = trimmed(plan, step, fault)
            small = shrink([lie for lie in told if lie[0] <= step], lambda part: breaks(plan, part, fault.name), TRIES)
            path = cases.write(plan, small, fault, seed)
            self._say(f"  {len(small)} messages are enough: {path.name}")
        self._began_s += time.process_time() - self._began_s - took_s  # making a case is not searching


def trimmed(plan: Plan, step: int, fault: Broken) -> Plan:
    """The plan up to where the fault was seen: what comes after it need not be played again."""
    if fault.name not in AFTERWARDS:
        plan = plan._replace(steps=step - plan.start + 1, quiet=False)
    last = plan.start + plan.steps + (QUIET_STEPS if plan.quiet else 0)
    return plan._replace(scene=plan.scene._replace(seconds=min(plan.scene.seconds, last * STEP_NS * 1e-9)))


def again(told: Told) -> Tell:
    """The same lies at the same steps."""
    by_step: dict[int, list[Lie]] = {}
    for step, src, payload in told:
        by_step.setdefault(step, []).append((src, payload))
    return lambda step, now_ns: by_step.get(step, [])


def breaks(plan: Plan, told: Told, name: str) -> bool:
    """Whether these lies still break what `name` says."""
    return any(fault.name == name for _, fault in play(plan, again(told)))


def replay(plan: Plan, told: Told) -> Iterator[Broken]:
    """What a case breaks today."""
    return (fault for _, fault in play(plan, again(told)))
