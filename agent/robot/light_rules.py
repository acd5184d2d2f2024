"""What may not be in a fleet file of robots that light for each other, or that have lamps and do not."""

from __future__ import annotations

from collections.abc import Iterator

from agent.core.config import Fleet

MOST_LAMPS = 8  # that a lease can name
LEAST_GUARD_S = 0.1  # two steps: there and back


def broken_light_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    lamps = [name for name, robot in fleet.robot.items() if robot.lamp]
    if fleet.lighting is None:
        for name in lamps:
            yield (
                f"robot.{name}.lamp",
                "nobody says in what water lamps burn; add a table [lighting], or remove the key",
            )
        return
    if not lamps:
        yield "lighting", "nobody has a lamp; write lamp = true under the robots that have one, or remove the table"
    if len(lamps) > MOST_LAMPS:
        yield "lighting", f"{len(lamps)} robots have lamps, and a lease names {MOST_LAMPS} at most; leave some dark"
    if fleet.lighting.guard_s < LEAST_GUARD_S:
        yield "lighting.guard_s", f"{fleet.lighting.guard_s} s is over before anybody can answer; write 0.1 or more"
    apart = [
        (name, other)
        for name in fleet.robot
        for other in lamps
        if other != name and other not in fleet.robot[name].neighbours
    ]
    if apart:
        name, other = apart[0]
        yield (
            f"robot.{name}.neighbours",
            f"'{other}' has a lamp and is no neighbour, so that its light would come and go unasked; "
            f"add '{other}', or remove its lamp",
        )
