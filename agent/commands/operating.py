"""What a fleet needs before and around its dives, beside the robots themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.commands.options import FleetFile
from agent.kernel.fleet_reader import load_fleet

app = typer.Typer()


@app.command(epilog="Example: aucamp keys fleet.toml --out keys")
def keys(
    fleet: FleetFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into; made where there is none.")],
    only: Annotated[str | None, typer.Option(metavar="ROBOT", help="For this robot alone: one that is new.")] = None,
) -> None:
    """A pair of signing keys for each robot, so that nobody can say of a target what another one measured.

    NAME.sign is private, NAME.sign.pub public. Nothing is ever overwritten; what goes where is said at the end.
    """
    from agent.keys.make import fleet_keys

    for line in fleet_keys(load_fleet(fleet), fleet, out, only):
        typer.echo(line)
