"""People in charge: what they tell robots that run."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from agent.process.command import FleetFile
from agent.robot.fleet_reader import load_fleet
from agent.robot.verbs import VERBS

Verb = StrEnum("Verb", [(verb, verb) for verb in VERBS])  # type: ignore[misc]

app = typer.Typer()


@app.command(epilog="Example: aucamp order fleet.toml --as ann hold r1 depth_m=0.3")
def order(
    fleet: FleetFile,
    verb: Annotated[Verb, typer.Argument(help="What to do; docs/orders.md says what each is and takes.")],
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[ROBOT|NAME=VALUE]...", help="Robots, or all; and how. Stops go to all if none is named."
        ),
    ] = None,
    console: Annotated[
        str, typer.Option("--as", metavar="NAME", help="Who orders: a console of the fleet file, by whose keys.")
    ] = "me",
) -> None:
    """Order robots that run, and say what each answered.

    Exit 0: all do it; 1: one refused, or did not answer; 2: bad input.
    """
    from agent.ground.console import give, line, typed, verdict

    robots = load_fleet(fleet)
    told = typed(robots, fleet, verb.value, words or ())
    outcomes = {}
    for robot, outcome in give(robots, fleet, console, told):
        outcomes[robot] = outcome
        typer.echo(line(robot, outcome))
    typer.echo(f"{told.verb}: {verdict(outcomes)}")
    raise typer.Exit(0 if all(outcome.ok for outcome in outcomes.values()) else 1)
