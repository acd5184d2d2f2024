"""Orders of whoever stands at the page: through a console, by the states that he has seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from agent.core.codec import Refusal
from agent.core.messages import State
from agent.ground.console import OrderConsole
from agent.ground.page.live import Reply, Seen
from agent.robot.verbs import CLOCK, URGENT

BEHIND_NS = 3_000_000_000  # robots refuse what goes by an older State, too


def give(console: OrderConsole, robots: list[str], verb: str, args: Mapping[str, Any], seen: Seen) -> Iterator[Reply]:
    """Order, and tell what comes of it at each robot as it comes. Raises Refusal for what cannot be ordered, or was
    decided by an old page.

    The console goes by the newest State that has reached this process. What a page shows may be older: it was frozen,
    or its browser is far away.
    """
    if verb not in (*URGENT, CLOCK):
        newest = console.states()
        for robot, looked_at in seen.items():
            if robot in newest and _is_behind(looked_at, newest[robot]):
                raise Refusal("clock", f"the page showed {robot} as it was seconds ago; look at it, and order again")
    for robot, outcome in console.orders(robots, verb, args):
        answer = outcome.answer
        if answer is None:
            yield Reply(robot, None, outcome.why, "")
        else:
            yield Reply(robot, answer.ok, answer.why, str(answer.id))


def _is_behind(looked_at: tuple[int, int], newest: State) -> bool:
    incarnation, sent_ns = looked_at
    return newest.incarnation != incarnation or newest.sent_ns - sent_ns > BEHIND_NS
