"""What liars say at each step: made up, mutated, of wild types, broken bytes and bombs, in honest envelopes."""

from __future__ import annotations

from random import Random
from typing import Any

import msgpack

from agent.core.messages import MAX_PAYLOAD, Estimate
from tests.fuzz import mutate
from tests.fuzz.kernel.episode import Lie, Plan, Tell
from tests.fuzz.kernel.lies import Theme
from tests.fuzz.kernel.swarm import ROBOTS, Recording
from tests.fuzz.values import integer, of_type, text

HABITS = (  # shares of: made up, mutated, of wild types, broken bytes, bombs
    (1.0, 0.0, 0.0, 0.0, 0.0),
    (0.5, 0.3, 0.1, 0.07, 0.03),
    (0.2, 0.7, 0.1, 0.0, 0.0),
    (0.2, 0.2, 0.2, 0.2, 0.2),
)
RATES = (1, 2, 2, 4, 4, 8, 30)  # lies in a step; more than a robot would take are to be dropped by somebody
GAP = 0.2  # share of steps without a lie


class Liar:
    """One mouth: it knows what the robot really said last, and keeps to its numbering."""

    def __init__(self, plan: Plan, mouth: str, rng: Random) -> None:
        self.mouth, self.victim, self.rng = mouth, plan.victim, rng
        names = (mouth,) if plan.alone else rng.choice((ROBOTS, ROBOTS, plan.mouths))
        self.theme = Theme(rng, mouth, plan.victim, frozenset(names) if plan.scene.keys else frozenset())
        self.shares = rng.choice(HABITS)
        self._honest: dict[str, bytes] = {}  # target -> the newest true message
        self._seq = 0

    def overhear(self, target: str, payload: bytes) -> None:
        self._honest[target] = payload
        self._seq = max(self._seq, msgpack.unpackb(payload)["seq"])

    def lie(self, now_ns: int) -> bytes:
        """The next message; empty while nothing true was heard."""
        if not self._honest:
            return b""
        rng = self.rng
        honest = self._honest[rng.choice(sorted(self._honest))]
        match rng.choices(range(5), self.shares)[0]:
            case 0:
                return self._sent(self.theme.estimate(msgpack.unpackb(honest), now_ns), now_ns)
            case 1:
                message = self._headed(msgpack.unpackb(honest), now_ns)
                return packed(mutate.fields(message, rng, rng.choice((1, 1, 2, 5))), rng)
            case 2:
                message = of_type(Estimate, rng, rng.choice((0.0, 0.02, 0.2)))
                about = {key: msgpack.unpackb(honest)[key] for key in ("fleet", "src", "dst", "target", "schema")}
                return self._sent({**message, **about} if isinstance(message, dict) else message, now_ns)
            case 3:
                return mutate.raw(self._sent(msgpack.unpackb(honest), now_ns), rng)
            case _:
                return mutate.bomb(rng)

    def _sent(self, message: Any, now_ns: int) -> bytes:
        return packed(self._headed(message, now_ns), self.rng)

    def _headed(self, message: Any, now_ns: int) -> Any:
        """The next number and a time; now and then another start, or numbers that nobody can follow."""
        if not isinstance(message, dict):
            return message
        rng, wild = self.rng, self.theme.wild
        self._seq += 1
        message["seq"] = self._seq
        message["sent_ns"] = max(self.theme.stamp(now_ns), 0)
        if rng.random() < 0.1 * wild:
            message["seq"] = max(integer(rng), 0)
        if rng.random() < 0.1 * wild:
            message["incarnation"] = max(integer(rng), 0)
        if rng.random() < 0.1 * wild:
            message[rng.choice(("fleet", "src", "dst", "target", "common"))] = text(rng)
        return message


def packed(message: Any, rng: Random) -> bytes:
    """As bytes that a robot may send; what cannot be packed is noise."""
    try:
        payload = bytes(msgpack.packb(message))
    except (OverflowError, ValueError, TypeError):
        return rng.randbytes(30)
    return payload if len(payload) <= MAX_PAYLOAD or rng.random() < 0.01 else payload[:MAX_PAYLOAD]


def teller(plan: Plan, recording: Recording, rng: Random) -> Tell:
    """The liars of a plan: (step, now_ns) -> their lies. To be asked once for every step, in order."""
    liars = {mouth: Liar(plan, mouth, rng) for mouth in plan.mouths}
    rate = rng.choice(RATES)

    def overhear(step: int) -> None:
        for heard in recording.said[plan.victim][step]:
            if heard.src in liars:
                liars[heard.src].overhear(msgpack.unpackb(heard.payload)["target"], heard.payload)

    for step in range(max(0, plan.start - 10), plan.start):
        overhear(step)

    def tell(step: int, now_ns: int) -> list[Lie]:
        overhear(step)
        if rng.random() < GAP:
            return []
        chosen = [rng.choice(plan.mouths) for _ in range(rate)]
        return [(mouth, payload) for mouth in chosen if (payload := liars[mouth].lie(now_ns))]

    return tell
