"""What a fleet needs before and around its dives, beside the robots themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from agent.core.config import ConfigError
from agent.process.command import FleetFile, new_file
from agent.robot.fleet_reader import load_fleet

if TYPE_CHECKING:
    from agent.ground.check import Checked
    from agent.ground.doctor import Diagnosis

app = typer.Typer()


@app.command(epilog="Example: aucamp init --twin --robots 3 --out fleet.toml")
def init(
    robots: Annotated[int, typer.Option(min=1, max=10, help="How many.")] = 3,
    twin: Annotated[bool, typer.Option("--twin", help="In the twin, which needs no hardware.")] = False,
    out: Annotated[Path, typer.Option(help="File to write: NAME.toml.")] = Path("fleet.toml"),
) -> None:
    """A fleet file to begin with, with comments that say what to change. Of real robots, unless --twin is given."""
    from agent.ground.new_fleet import write_fleet

    if out.suffix != ".toml":
        raise ConfigError(f"--out {out}: a fleet file is a TOML file; give it a name that ends in .toml")
    for line in write_fleet(new_file(out), robots, twin):
        typer.echo(line)


@app.command(epilog="Example: aucamp check fleet.toml --robot r1")
def check(
    fleet: FleetFile,
    robot: Annotated[str | None, typer.Option(help="This robot alone, whose computer this is.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """All that can be known before a dive: file, addresses, devices, calibrations, keys, disk. Nothing is started.

    One line for each thing: ok, warning or wrong, and what to do. Exit 1 if something is wrong.
    """
    from agent.ground.check import check as look

    _tell(look(fleet, robot, Path()), as_json)


@app.command(epilog="Example: aucamp keys fleet.toml --out keys")
def keys(
    fleet: FleetFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into; made where there is none.")],
    only: Annotated[
        str | None, typer.Option(metavar="NAME", help="For this one alone: a robot, observer or console that is new.")
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=3650, help="How long certificates are good.")] = 825,
) -> None:
    """A pair of signing keys for each robot, so that nobody can say of a target what another one measured.

    Where robots listen on tls/, also an authority of the fleet's own, and a certificate for each robot, observer and
    console. Nothing is ever overwritten; what goes where is said at the end.
    """
    from agent.ground.new_fleet import fleet_keys

    for line in fleet_keys(load_fleet(fleet), fleet, out, only, days):
        typer.echo(line)


@app.command(epilog="Example: aucamp doctor fleet.toml --as ann")
def doctor(
    fleet: FleetFile,
    name: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="As this console, observer or robot; else as one whose key is here."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Why robots of a running fleet do not hear each other, or us: ports, certificates, links, rules, clocks.

    One line for each thing: ok, warning or wrong, and what to do. Exit 1 unless all are ok.
    """
    from agent.ground.doctor import examine

    _tell(examine(fleet, name, Path()), as_json)


def _tell(found: Checked | Diagnosis, as_json: bool) -> NoReturn:
    """Show what was found, and end: 0 where all is well, else 1."""
    if as_json:
        typer.echo(json.dumps(found.as_json()))
    else:
        for finding in found.findings:
            typer.echo(finding)
        typer.echo(found.verdict)
    raise typer.Exit(0 if found.well else 1)
