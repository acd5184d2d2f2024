"""`aucamp order`: what a person types becomes an order, and what robots answered becomes lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from agent.core.codec import Refusal
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Arg
from agent.ground.console import OrderConsole, Outcome
from agent.process.fleet_certificates import credentials
from agent.robot.fleet_reader import load_robot
from agent.robot.rights import why_closed
from agent.robot.verbs import CLOCK, URGENT, arguments

ALL = "all"


class Typed(NamedTuple):
    """An order, and whom it is for."""

    robots: tuple[str, ...]
    verb: str
    args: dict[str, Arg]


def typed(fleet: Fleet, fleet_path: Path, verb: str, words: Sequence[str]) -> Typed:
    """What stands behind the verb: names of robots, and NAME=VALUE. Raises ConfigError for what cannot be ordered."""
    names = [word for word in words if "=" not in word]
    given = dict(word.split("=", 1) for word in words if "=" in word)
    if not names and verb not in (*URGENT, CLOCK):
        raise ConfigError(f"{verb}: which robot? Write one of {', '.join(fleet.robot)}, or {ALL}")
    everybody = not names or ALL in names
    for name in names:
        if name != ALL:
            load_robot(fleet, name, fleet_path)
    try:
        what = arguments(verb, given, strict=False)
    except Refusal as refusal:
        raise ConfigError(str(refusal)) from None
    whole = msgspec.to_builtins(what)
    args: dict[str, Arg] = {name: whole[name] for name in given}
    return Typed(tuple(fleet.robot) if everybody else tuple(dict.fromkeys(names)), verb, args)


def give(fleet: Fleet, fleet_path: Path, console: str, order: Typed) -> Iterator[tuple[str, Outcome]]:
    """Order, and say what became of it at each robot, as it comes. Raises ConfigError where this console may not."""
    if why := why_closed(fleet, console):
        raise ConfigError(f"{fleet_path}: {why}")
    with OrderConsole(fleet, console, credentials(fleet, console, fleet_path)) as link:
        yield from link.orders(order.robots, order.verb, order.args)


def line(robot: str, outcome: Outcome) -> str:
    """What became of it at one robot."""
    if outcome.answer is None:
        return f"{robot}: {outcome.why}"
    what = f"does: {outcome.answer.order}" if outcome.ok else f"refuses: {outcome.answer.why}"
    return f"{robot}: {what} ({1e3 * outcome.took_s:.0f} ms)"


def verdict(outcomes: Mapping[str, Outcome]) -> str:
    return f"{sum(outcome.ok for outcome in outcomes.values())} of {len(outcomes)}"
