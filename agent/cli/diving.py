"""Run robots, or what stands in for them; record them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.core.config import Fleet, Protocol
from agent.process.command import (
    Failed,
    FleetFile,
    FleetFiles,
    Port,
    RobotName,
    Speed,
    complain,
    shipped_names,
    terminal,
)
from agent.process.launch import refuse_too_little_memory, until_signal
from agent.robot.fleet_reader import load_fleet
from router_config.settings import ROUTER, ROUTER_LISTEN

ALONE_S, WITH_PAGE_S = 120.0, 1800.0  # time limits of a dive that nobody looks at, and of one with a page

SHIPPED = ", ".join(shipped_names())

app = typer.Typer()


@app.command(epilog="Example: aucamp demo --robots 3 --seed 1")
def demo(
    robots: Annotated[
        int | None,
        typer.Option(help="How many: the first ones of the fleet file; if not given all, of the tank three."),
    ] = None,
    protocol: Annotated[Protocol | None, typer.Option(help="How robots agree.")] = None,
    loss: Annotated[float | None, typer.Option(min=0.0, max=0.99, help="Share of link messages thrown away.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Which world of the twin: hidden parameters and noise.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(min=1.0, help="Time limit in seconds of the dive; 120 if not given, with --page 1800."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the recordings; runs/<UTC time> if not given.")] = None,
    fleet: Annotated[str, typer.Option(help=f"A fleet that ships ({SHIPPED}), or a fleet file.")] = "tank",
    speed: Speed = 1.0,
    secure: Annotated[bool, typer.Option("--secure", help="All links are TLS, with certificates of this run.")] = False,
    page: Annotated[
        bool, typer.Option("--page", help="With a page to look at it and to give orders, in a browser; until Ctrl-C.")
    ] = False,
) -> None:
    """Robots find a target in the twin's tank within two minutes; a table at the end, recordings and a report.

    What is not given is as the fleet file has it.
    """
    from agent.demo.demo import demo as dive
    from agent.demo.demo import keeping
    from agent.demo.display import verdict
    from agent.perception.depth_sweep import sweep_depth
    from agent.process.command import with_spinner
    from replay.report.report import report

    limit_s = duration or (WITH_PAGE_S if page else ALONE_S)
    run, summary = dive(robots, protocol, loss, seed, limit_s, out, terminal(), fleet, speed, secure, page)
    with keeping(run, terminal()), with_spinner(terminal(), "writing the report"):
        written = report(run, depth=sweep_depth)
    terminal().print(f"{verdict(summary)}. Look at {written}; recordings are beside it")
    raise typer.Exit(0 if summary["verdict"] == "pass" else 1)


@app.command(epilog="Example: aucamp agent fleet.toml --robot r1 --arm")
def agent(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="Folder of the recording; the current one if not given.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Start the motors; without it they stay off.")] = False,
    lossless: Annotated[bool, typer.Option("--lossless", help="Record camera frames bit by bit, not as JPEG.")] = False,
    behaviour: Annotated[
        str | None,
        typer.Option(
            metavar="TABLE", help="""What it does in place of what the file says, as there: '{ kind = "hold" }'."""
        ),
    ] = None,
) -> None:
    """One robot's agent, until Ctrl-C or SIGTERM; then the motors go off. Its log is on standard error."""
    refuse_too_little_memory()
    with until_signal() as stop:
        from agent.ground.check import before_dive
        from agent.process.agent_process import run

        def doubts(read: Fleet) -> str | None:
            return before_dive(read, robot, fleet, out or Path())

        run(fleet, robot, out, arm, stop, lossless, behaviour, doubts)


@app.command(epilog="Example: aucamp twin fleet.toml")
def twin(
    fleet: FleetFile,
    bench: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="Clamp this robot on the calibration bench instead.")
    ] = None,
    speed: Speed = 1.0,
) -> None:
    """The tank twin, until Ctrl-C: serial ports and cameras for every robot, and the clock that all follow."""
    with until_signal() as stop:  # importing takes a while; then the twin looks for signals itself
        from hw.twin.__main__ import run
    raise typer.Exit(0 if stop.is_set() else run(fleet, bench=bench, speed=speed))


@app.command(epilog="Example: aucamp record fleet.toml --out fleet.mcap")
def record(
    fleet: FleetFiles,
    out: Annotated[Path, typer.Option(help="File to write: NAME.mcap. Of several fleets a folder: FLEET.mcap in it.")],
) -> None:
    """Record all traffic of a fleet, or of several, until Ctrl-C or SIGTERM. The robots do not notice.

    Where nothing was heard nothing is written, and the exit code is 1.
    """
    with until_signal() as stop:
        from agent.ground.observe import record_fleets

        recorded = record_fleets(fleet, out, stop, complain)
    for line in recorded.done:
        terminal().print(line)
    if recorded.failed:
        raise Failed("; ".join(recorded.failed))


@app.command(epilog="Example: aucamp router fleet.toml")
def router(
    fleet: FleetFile,
    listen: Annotated[
        str | None,
        typer.Option(metavar="tcp/HOST:PORT", help=f"Where consoles attach; else {ROUTER_LISTEN}, or tls/ there."),
    ] = None,
) -> None:
    """A place to look from, until Ctrl-C: consoles attach to it. The robots do not need it."""
    with until_signal() as stop:
        from agent.process.certificates import credentials
        from agent.process.transport import run_router

        robots = load_fleet(fleet)
        run_router(robots, stop, listen, complain, credentials(robots, ROUTER, fleet))


@app.command(epilog="Example: aucamp view fleet.toml")
def view(fleet: FleetFiles, port: Port = 8765) -> None:
    """Serve what a running fleet knows and sees to Foxglove, on this machine only, until Ctrl-C.

    Of several fleets each has a port of its own: PORT, PORT + 1 and so on.
    """
    with until_signal() as stop:
        from agent.ground.observe import view_fleets

        view_fleets(fleet, port, stop, typer.echo)
