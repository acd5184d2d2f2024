"""Run robots, or what stands in for them; record them, look at them while they run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.commands.options import FleetFile, Port, RobotName, Speed, complain, terminal
from agent.kernel.config import Protocol
from agent.kernel.fleet_reader import load_fleet

app = typer.Typer()


@app.command(epilog="Example: aucamp demo --robots 3 --seed 1")
def demo(
    robots: Annotated[int, typer.Option(help="How many: the first ones of the fleet file.")] = 3,
    protocol: Annotated[Protocol, typer.Option(help="How robots agree.")] = "evidence",
    loss: Annotated[float, typer.Option(min=0.0, max=0.99, help="Share of link messages thrown away.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Which world of the twin: hidden parameters and noise.")] = 0,
    duration: Annotated[float, typer.Option(min=1.0, help="Time limit in seconds of the dive.")] = 120.0,
    enhance: Annotated[bool, typer.Option(help="Where a frame shows no ball, look for it enhanced.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the recordings; runs/<UTC time> if not given.")] = None,
    fleet: Annotated[str, typer.Option(help="A fleet that ships (tank, two_balls), or a fleet file.")] = "tank",
    speed: Speed = 1.0,
) -> None:
    """Robots find a ball in the twin's tank within two minutes; a table at the end, recordings and a report."""
    from agent.demo import demo as dive
    from agent.pictures.recorded_depth import sweep_depth
    from replay.report.report import report

    run, summary = dive(robots, protocol, loss, seed, duration, enhance, out, terminal(), fleet, speed)
    report(run, depth=sweep_depth)
    raise typer.Exit(0 if summary["verdict"] == "pass" else 1)


@app.command(epilog="Example: aucamp agent fleet.toml --robot r1 --arm")
def agent(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="Folder of the recording; the current one if not given.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Start the motors; without it they stay off.")] = False,
    lossless: Annotated[bool, typer.Option("--lossless", help="Record camera frames bit by bit, not as JPEG.")] = False,
    view: Annotated[bool, typer.Option(help="Record channels for Foxglove and Rerun as well.")] = True,
) -> None:
    """One robot's agent, until Ctrl-C or SIGTERM; then the motors go off. Its log is on standard error."""
    from agent.agent_process import run

    run(fleet, robot, out, arm, lossless, view)


@app.command(epilog="Example: aucamp twin fleet.toml")
def twin(
    fleet: FleetFile,
    bench: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="Clamp this robot on the calibration bench instead.")
    ] = None,
    speed: Speed = 1.0,
) -> None:
    """The tank twin, until Ctrl-C: serial ports and cameras for every robot, and the clock that all follow."""
    from hw.twin.__main__ import run

    raise typer.Exit(run(fleet, bench=bench, speed=speed))


@app.command(epilog="Example: aucamp record fleet.toml --out fleet.mcap")
def record(
    fleet: FleetFile,
    out: Annotated[Path, typer.Option(help="File to write (MCAP).")],
    view: Annotated[bool, typer.Option(help="Record channels for Foxglove and Rerun as well.")] = True,
) -> None:
    """Record all traffic of a fleet until Ctrl-C or SIGTERM. The robots do not notice."""
    from agent.fleet_clock import fleet_clock
    from agent.stop_signal import until_signal
    from replay.recorder import record as run

    with until_signal() as stop:
        robots = load_fleet(fleet)
        clock = fleet_clock(robots)
        complain(f"recording fleet '{robots.fleet}'; Ctrl-C ends it")
        counts = run(robots, out, stop, clock, views=view)
    terminal().print(", ".join(f"{name} {count}" for name, count in counts.items()))


@app.command(epilog="Example: aucamp router fleet.toml")
def router(fleet: FleetFile) -> None:
    """A place to look from, until Ctrl-C: consoles attach to it. The robots do not need it."""
    from agent.router import run_router
    from agent.stop_signal import until_signal

    with until_signal() as stop:
        run_router(load_fleet(fleet), stop, say=complain)


@app.command(epilog="Example: aucamp view fleet.toml")
def view(
    fleet: FleetFile,
    port: Port = 8765,
) -> None:
    """Serve what a running fleet knows and sees to Foxglove, on this machine only, until Ctrl-C."""
    from agent.fleet_clock import fleet_clock
    from agent.stop_signal import until_signal
    from replay.view import view as serve

    robots = load_fleet(fleet)
    with until_signal() as stop:
        serve(robots, stop, fleet_clock(robots), port, typer.echo)
