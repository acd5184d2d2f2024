"""A page to stand at: a running fleet or a recording in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.process.command import Port
from agent.process.launch import until_signal

app = typer.Typer()


@app.command(epilog="Example: aucamp page fleet.toml --as ann")
def page(
    what: Annotated[
        Path,
        typer.Argument(metavar="FLEET|RUN", help="Fleet file (TOML); or a run's folder, or its recording fleet.mcap."),
    ],
    console: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="Give orders, as this console of the fleet file; else only look."),
    ] = None,
    port: Port = 8766,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for what is recorded by the page's button.")
    ] = Path(),
) -> None:
    """A running fleet, or what was recorded of one, in a browser on this machine, until Ctrl-C.

    The address that is printed is good for this run, and for whoever has it.
    """
    with until_signal() as stop:
        from agent.ground.page.server import run

        run(what, console, port, out, stop, typer.echo)
