"""`aucamp calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.process.command import FleetFile, RobotName, terminal

calibrate_app = typer.Typer(no_args_is_help=True, help="Measure what a camera's lens and gimbal really do.")


@calibrate_app.command("run", epilog="Example: aucamp calibrate run fleet.toml --robot r1 --out calibration/r1.toml")
def calibrate_run(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="File to write; the fleet file's own if not given.")] = None,
) -> None:
    """Board at known distances, one focus sweep each, then the gimbal; on the twin's bench for a `twin:` camera."""
    from agent.tools.bench_calibration import run

    run(fleet, robot, out, terminal())


@calibrate_app.command("focus", epilog="Example: aucamp calibrate focus table.csv --out calibration/r1.toml")
def calibrate_focus(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="CSV with the columns u_mm and code.")],
    out: Annotated[Path | None, typer.Option(help=r"Calibration file whose table \[focus] is to be written.")] = None,
) -> None:
    """Range against sharpest lens position, from a table measured by hand; a plot beside it and a verdict."""
    from agent.tools.focus_calibration import run

    run(table, out, terminal())


@calibrate_app.command("camera", epilog="Example: aucamp calibrate camera photographs/ --out calibration/r1.toml")
def calibrate_camera(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Photographs of a chessboard, taken in water.")],
    columns: Annotated[int, typer.Option(min=3, help="Inner corners of the board along its longer side.")] = 14,
    rows: Annotated[int, typer.Option(min=3, help="Inner corners along its shorter side.")] = 9,
    square_mm: Annotated[float, typer.Option(min=0.1, help="Side of a square.")] = 20.0,
    out: Annotated[Path | None, typer.Option(help=r"Calibration file whose table \[camera] is to be written.")] = None,
) -> None:
    """Focal length and centre from photographs of a board."""
    from agent.tools.camera_calibration import calibrate_camera as run

    run(folder, columns, rows, square_mm, out, terminal())


@calibrate_app.command("gamma", epilog="Example: aucamp calibrate gamma blurred/ --out calibration/r1.toml")
def calibrate_gamma(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Pictures of AprilTags, out of focus.")],
    out: Annotated[Path | None, typer.Option(help=r"Calibration file whose table \[camera] gets the gamma.")] = None,
) -> None:
    """How the camera codes light, from how lopsided it shows blurred edges."""
    from agent.tools.camera_calibration import calibrate_gamma as run

    run(folder, out, terminal())


@calibrate_app.command("body", epilog="Example: aucamp calibrate body runs/trial/r1.mcap --out calibration/r1.toml")
def calibrate_body(
    recording: Annotated[Path, typer.Argument(metavar="FILE", help="Black box of a robot with behaviour 'trial'.")],
    out: Annotated[Path | None, typer.Option(help=r"Calibration file whose table \[body] is to be written.")] = None,
) -> None:
    """Mass, inertia and drag of a robot that swims, from the recording of a trial."""
    from agent.tools.body_calibration import run

    run(recording, out, terminal())


@calibrate_app.command(
    "landmarks", epilog="Example: aucamp calibrate landmarks film.mp4 fleet.toml --calibration r1.toml --known 0"
)
def calibrate_landmarks(
    source: Annotated[str, typer.Argument(help="Video, folder of pictures, a dive's folder or recording of a robot.")],
    fleet: FleetFile,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file of the camera that filmed; recordings have their own.")
    ] = None,
    known: Annotated[
        list[int] | None, typer.Option(help="Tag whose place in the fleet file counts; all of them if none is given.")
    ] = None,
    flat: Annotated[bool, typer.Option(help="Whether tags are glued flat to walls and floor.")] = True,
    lens: Annotated[int | None, typer.Option(help="Lens position of all pictures, if it is known.")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Of a film, at most so many.")] = None,
    out: Annotated[Path | None, typer.Option(help=r"File for the table \[landmarks]; printed if not given.")] = None,
) -> None:
    """Where the tags of a tank are, from a film of them, and how well each is known."""
    from agent.tools.tag_map import Asked, run

    run(source, fleet, Asked(calibration, tuple(known or ()), flat, lens, frames, out), terminal())
