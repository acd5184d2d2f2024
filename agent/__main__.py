"""The command line: options in, one call out, errors as one line. Exit 0: done; 1: the answer is no; 2: bad input."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from agent.config import ConfigError, Protocol, load_fleet

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Small groups of low-cost underwater robots that find a target together.",
)
calibrate_app = typer.Typer(no_args_is_help=True, help="Measure what a camera's lens and gimbal really do.")
app.add_typer(calibrate_app, name="calibrate")
replay_app = typer.Typer(no_args_is_help=True, help="Look into recordings.")
app.add_typer(replay_app, name="replay")

FleetFile = Annotated[Path, typer.Argument(metavar="FLEET", help="Fleet file (TOML).")]
RobotName = Annotated[str, typer.Option("--robot", help="Which robot of the fleet file.")]


@app.command(epilog="Example: aucamp demo --robots 3 --seed 1")
def demo(
    robots: Annotated[int, typer.Option(help="How many of the tank's robots.")] = 3,
    protocol: Annotated[str, typer.Option(help="How robots agree: paper.")] = "paper",
    loss: Annotated[float, typer.Option(min=0.0, max=0.99, help="Share of link messages thrown away.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Which world of the twin: hidden parameters and noise.")] = 0,
    duration: Annotated[float, typer.Option(min=1.0, help="Time limit in seconds, calibration not counted.")] = 120.0,
    enhance: Annotated[bool, typer.Option(help="White balance before detection (LU2Net is not here yet).")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the recordings; runs/<UTC time> if not given.")] = None,
) -> None:
    """Three robots find a ball in the twin's tank; a table at the end, recordings and summary.json in a folder."""
    from agent.demo import demo as dive
    from replay.report import report

    run, summary = dive(robots, one_of_protocols(protocol), loss, seed, duration, enhance, out, Console(soft_wrap=True))
    report(run)
    raise typer.Exit(0 if summary["verdict"] == "pass" else 1)


@app.command(epilog="Example: aucamp agent fleet.toml --robot r1 --arm")
def agent(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="Folder of the recording; here if not given.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Start the motors; without it they stay off.")] = False,
) -> None:
    """One robot's agent, until Ctrl-C or SIGTERM."""
    from agent.runtime import run

    run(fleet, robot, out, arm)


@app.command(epilog="Example: aucamp twin fleet.toml")
def twin(
    fleet: FleetFile,
    bench: Annotated[str | None, typer.Option(help="Clamp this robot on the calibration bench instead.")] = None,
) -> None:
    """The tank twin: serial ports and cameras for every robot whose devices are `twin:`."""
    from hw.twin.__main__ import run

    raise typer.Exit(run(fleet, bench=bench))


@app.command(epilog="Example: aucamp record fleet.toml --out fleet.mcap")
def record(fleet: FleetFile, out: Annotated[Path, typer.Option(help="File to write (MCAP).")]) -> None:
    """Record all traffic of a fleet until Ctrl-C or SIGTERM. The robots do not notice."""
    from agent.runtime import until_signal
    from replay.recorder import record as run

    with until_signal() as stop:
        counts = run(load_fleet(fleet), out, stop)
    Console(soft_wrap=True).print(", ".join(f"{name} {count}" for name, count in counts.items()))


@app.command(epilog="Example: aucamp router fleet.toml")
def router(fleet: FleetFile) -> None:
    """A place to look from: clients attach to it. The robots do not need it."""
    from agent.router import run_router
    from agent.runtime import until_signal

    with until_signal() as stop:
        run_router(load_fleet(fleet), stop)


@app.command("depth-map", epilog="Example: aucamp depth-map photographs/ --out depth.png")
def depth_map(
    source: Annotated[str, typer.Argument(help="Folder of focus-bracketed photographs, or a camera URL.")],
    out: Annotated[Path, typer.Option(help="Picture to write; the numbers go beside it as .csv.")] = Path("depth.png"),
    block: Annotated[int, typer.Option(min=8, help="Side of a block, pixels.")] = 50,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file: gives metres.")] = None,
) -> None:
    """How far each part of the view is, from the focus position at which it is sharpest."""
    from agent.depth_map import run

    Console(soft_wrap=True).print(run(source, out, block, calibration))


@calibrate_app.command("run", epilog="Example: aucamp calibrate run fleet.toml --robot r1 --out calibration/r1.toml")
def calibrate_run(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="File to write; the fleet file's own if not given.")] = None,
) -> None:
    """Board at known distances, one focus sweep each, then the gimbal; on the twin's bench for a `twin:` camera."""
    from agent.experiments.calibrate_run import run

    run(fleet, robot, out, Console(soft_wrap=True))


@replay_app.command("report", epilog="Example: aucamp replay report runs/20260101T120000Z")
def replay_report(run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder that a demo wrote.")]) -> None:
    """One page with the run's figures: report.html in its folder."""
    from replay.report import report

    Console(soft_wrap=True).print(f"written to {report(run)}")


def one_of_protocols(text: str) -> Protocol:
    if text != "paper":
        raise ConfigError(f"--protocol {text}: no such protocol; choose paper")
    return "paper"


def main() -> None:
    """Run the command line; what a user can cause ends in one line on stderr and exit code 2."""
    from agent.launch import Failed
    from hw.camera import CameraError

    try:
        app()
    except (ConfigError, CameraError) as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(2)
    except Failed as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
