"""What robots' clocks say: asked by orders of the verb `clock`, which change nothing and are answered at once."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence

from agent.clock import machine
from agent.core import topics
from agent.core.codec import Refusal, decode, encode
from agent.core.config import Fleet
from agent.core.messages import Answer, Order
from agent.ground.doctor.clocks import ASKED, Stamps
from router_config.door import Reply, Session

ANSWER_S = 0.5  # of the wall, for all robots together


def ask_clocks(
    session: Session, fleet: Fleet, console: str, robots: Collection[str], now_ns: Callable[[], int]
) -> Mapping[str, Sequence[Stamps]]:
    """Stamps of each robot that answered, ASKED of them where nothing is lost. All are asked at the same time."""
    stamps: dict[str, list[Stamps]] = defaultdict(list)
    for _ in range(ASKED):
        for robot, stamp in _ask_once(session, fleet, console, robots, now_ns).items():
            stamps[robot].append(stamp)
    return stamps


def _ask_once(
    session: Session, fleet: Fleet, console: str, robots: Collection[str], now_ns: Callable[[], int]
) -> dict[str, Stamps]:
    found: dict[str, Stamps] = {}
    over: list[threading.Event] = []
    for robot in robots:
        asked_ns = now_ns()

        def replied(reply: Reply, robot: str = robot, asked_ns: int = asked_ns) -> None:
            back_ns = now_ns()
            try:
                answer = decode(reply.payload, Answer)
            except Refusal:  # an error, or of another version
                return
            if answer.robot == robot and answer.ok:
                found[robot] = Stamps(asked_ns, answer.arrived_ns, answer.sent_ns, back_ns)

        done = threading.Event()
        over.append(done)
        key = topics.ORDER.format(fleet=fleet.fleet, robot=robot, console=console)
        session.ask(Order, key, encode(Order(id=asked_ns, verb="clock")), ANSWER_S, replied, done.set)
    deadline_s = machine.monotonic_s() + ANSWER_S
    for done in over:
        machine.wait(done, max(0.0, deadline_s - machine.monotonic_s()))
    return found
