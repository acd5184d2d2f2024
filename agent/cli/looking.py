"""Look at a running fleet from outside: one picture, and what its messages look like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.process.command import FleetFile, RobotName, new_file, run_folder
from agent.robot.fleet_reader import load_fleet, load_robot

app = typer.Typer()


@app.command(epilog="Example: aucamp snapshot fleet.toml --robot r1 --out r1.jpg")
def snapshot(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="File to write (JPEG); ROBOT.jpg if not given.")] = None,
    target: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Print the table that makes a thing in the picture a target, too."),
    ] = None,
) -> None:
    """The next picture of a running robot's camera, as the robot shows it. It does not notice."""
    from agent.ground.observe import about, next_picture, target_table
    from agent.process.certificates import credentials
    from agent.process.transport import LOOKER

    robots = load_fleet(fleet)
    load_robot(robots, robot, fleet)
    path = new_file(out or Path(f"{robot}.jpg"))
    image = next_picture(robots, robot, credentials(robots, LOOKER, fleet))
    path.write_bytes(image.jpeg)
    typer.echo(about(path, image))
    if target is not None:
        typer.echo(target_table(robots, target, path, image))


@app.command(epilog="Example: aucamp schemas --out schemas")
def schemas(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into: new, or empty.")],
) -> None:
    """JSON Schemas of the messages on the network, and the table of keys, for programs of your own."""
    from agent.ground.schemas import write

    for path in write(run_folder(out)):
        typer.echo(path)
