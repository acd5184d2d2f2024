"""Arguments and options that several commands share, and where commands write to."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from agent.process.plain_console import plain_console

FleetFile = Annotated[Path, typer.Argument(metavar="FLEET", help="Fleet file (TOML).")]
FleetFiles = Annotated[list[Path], typer.Argument(metavar="FLEET...", help="Fleet file (TOML), or several.")]
RobotName = Annotated[str, typer.Option("--robot", help="Which robot of the fleet file.")]
Seed = Annotated[int, typer.Option(min=0, help="Which world of the twin.")]
Port = Annotated[int, typer.Option(min=1024, max=65535, help="WebSocket port on this machine.")]
Recordings = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings (MCAP).")]
Runs = Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of runs, or recordings (MCAP).")]
OutFolder = Annotated[Path | None, typer.Option(help="Folder for result.json and figures; runs/<UTC> if not given.")]

SLOWEST = 0.01  # slower than this nobody can tell from a clock that stands


def as_speed(text: str) -> float:
    """A positive number, or max: no limit. Raises typer.BadParameter."""
    try:
        speed = math.inf if text == "max" else float(text)
    except ValueError:
        speed = math.nan
    if not speed >= SLOWEST:
        raise typer.BadParameter(f"'{text}': write max, or a number from {SLOWEST:g} on")
    return speed


Speed = Annotated[
    float,
    typer.Option(parser=as_speed, metavar="NUMBER|max", help="Seconds of the dive in one of the wall, at most."),
]


def complain(line: str) -> None:
    """What a person should know but a program that reads our output should not."""
    typer.echo(line, err=True)


def terminal() -> Console:
    """Where results go."""
    return plain_console()
