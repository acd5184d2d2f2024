"""`aucamp experiment`."""

from __future__ import annotations

from typing import Annotated

import typer

from agent.commands.terms import OutFolder, Seed, terminal
from agent.config import ConfigError

app = typer.Typer(no_args_is_help=True, help="The paper's experiments, on the twin.")


@app.command("calibration", epilog="Example: aucamp experiment calibration --seed 3")
def experiment_calibration(seed: Seed = 0, out: OutFolder = None) -> None:
    """Range against focus position, on the twin's bench."""
    from agent.experiments.calibration import calibration

    calibration(seed, out, terminal())


@app.command("depth", epilog="Example: aucamp experiment depth --seed 1")
def experiment_depth(seed: Seed = 0, out: OutFolder = None) -> None:
    """Depth of whole views from focus, against the twin's truth: our peak and the paper's."""
    from agent.experiments.depth_table import run

    run(seed, out, terminal())


@app.command("detection", epilog="Example: aucamp experiment detection --count 200")
def experiment_detection(
    seed: Seed = 0,
    count: Annotated[int, typer.Option(min=1, help="Places in each kind of water.")] = 200,
    sensor: Annotated[str, typer.Option(help="Camera of the twin.")] = "imx519_640",
    water: Annotated[list[str] | None, typer.Option(help="Only this kind; again for more. All if not given.")] = None,
    out: OutFolder = None,
) -> None:
    """Whether the ball is found, and how exactly, in every kind of water, sharp and not, raw and enhanced."""
    from agent.experiments.detection import run

    run(seed, count, sensor, out, terminal(), water)


@app.command("peak-shift", epilog="Example: aucamp experiment peak-shift --water turbid")
def experiment_peak_shift(
    seed: Seed = 0,
    sensor: Annotated[str, typer.Option(help="Camera of the twin.")] = "imx519_640",
    water: Annotated[list[str] | None, typer.Option(help="Only this kind; again for more. All if not given.")] = None,
    out: OutFolder = None,
) -> None:
    """How far the focus peak moves when frames are enhanced before clarity is taken, in every kind of water."""
    from agent.experiments.peak_shift import run

    run(seed, sensor, out, terminal(), water)


@app.command("consistency", epilog="Example: aucamp experiment consistency --count 100")
def experiment_consistency(
    seed: Seed = 0, count: Annotated[int, typer.Option(min=1, help="Measurements.")] = 1000, out: OutFolder = None
) -> None:
    """Whether measurements of a ball are as wrong as they say: with focus, with size, with both."""
    from agent.experiments.consistency_table import run

    raise typer.Exit(0 if run(seed, count, out, terminal()) else 1)


@app.command("localization", epilog="Example: aucamp experiment localization --quick")
def experiment_localization(
    seed: Seed = 0,
    out: OutFolder = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few draws, small swarms: for a look.")] = False,
    full: Annotated[bool, typer.Option("--full", help="More draws, losses and robots.")] = False,
) -> None:
    """Protocols against the Cramer-Rao bound: graphs, loss, schedules of views, a robot that is wrong."""
    if quick and full:
        raise ConfigError("--quick and --full contradict each other; give one of them")
    from agent.experiments.localization import localization, table, verdict_table
    from agent.launch import run_folder, with_bar

    console, folder = terminal(), run_folder(out)
    result = with_bar(console, "dives", lambda show: localization(seed, folder, show, quick, full))
    console.print(table(result))
    console.print(verdict_table(result))
    console.print(f"written to {folder}")


@app.command("orientation", epilog="Example: aucamp experiment orientation --seeds 5")
def experiment_orientation(
    seed: Seed = 0, seeds: Annotated[int, typer.Option(min=1, help="Robots per case.")] = 20, out: OutFolder = None
) -> None:
    """Push and depth step under the three control laws, real firmware on the twin's physics."""
    from agent.experiments.orientation import run

    run(seed, seeds, out, terminal())
