"""`aucamp replay`."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Annotated

import typer

from agent.process.command import FleetFile, Recordings, Runs, complain, new_file, plain_console, terminal
from agent.robot.fleet_reader import load_fleet

app = typer.Typer(no_args_is_help=True, help="Look into recordings.")


@app.command("info", epilog="Example: aucamp replay info runs/20260101T120000Z/r1.mcap")
def replay_info(files: Runs, as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False) -> None:
    """What happened in a dive, what is in its recording, and whether that is whole."""
    from replay.story.told import info_all

    info_all(files, as_json, typer.echo)


@app.command("recover", epilog="Example: aucamp replay recover r1.mcap.active")
def replay_recover(
    files: Recordings,
    force: Annotated[bool, typer.Option("--force", help="Even if it looks as if it were being written.")] = False,
) -> None:
    """Mend a torn recording into a new file, and say what was lost."""
    from replay.files.recover import recover_all

    raise typer.Exit(recover_all(files, force, typer.echo))


@app.command("check", epilog="Example: aucamp replay check runs/20260101T120000Z")
def replay_check(
    paths: Runs,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
    ignore: Annotated[Path | None, typer.Option(help="Fields that may differ (TOML).")] = None,
    vision: Annotated[bool, typer.Option("--vision", help="See the recorded frames again instead.")] = False,
    update: Annotated[bool, typer.Option("--update", help="Accept what today's code gives; needs --reason.")] = False,
    reason: Annotated[str, typer.Option(help="Why the outputs may change; goes into the file.")] = "",
) -> None:
    """Does today's code do what the recording says? Byte for byte; exit 1 if not, 2 if it cannot be checked."""
    from replay.check.check import check, text
    from replay.check.update import update_recordings
    from replay.files.auto_recover import auto_recovered

    bar = plain_console(stderr=True)
    if update:
        for updated in update_recordings(paths, reason):
            typer.echo(str(updated))
        return
    paths = auto_recovered(paths, complain)
    if vision:
        from agent.perception.vision import rerun_vision
        from replay.check.vision_check import check_vision

        seen = check_vision(paths, rerun_vision, bar)
        for one in seen:
            typer.echo(json.dumps(one.as_json()) if as_json else str(one))
        raise typer.Exit(2 if any(not one.frames for one in seen) else int(any(not one.passed for one in seen)))
    checked = check(paths, ignore, bar)
    typer.echo(json.dumps(checked.as_json()) if as_json else text(checked))
    raise typer.Exit(checked.exit_code)


@app.command("explain", epilog="Example: aucamp replay explain r1.mcap --at 16")
def replay_explain(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="One robot's recording.")],
    at: Annotated[str | None, typer.Option(help="Iteration 16, time 12.5s or step:812; the last if not given.")] = None,
) -> None:
    """Why a robot believed what it believed: whom it heard, with which weights."""
    from replay.check.explain import explain
    from replay.files.auto_recover import auto_recovered

    (there,) = auto_recovered([file], complain)
    typer.echo(explain(there, at))


@app.command("report", epilog="Example: aucamp replay report runs/20260101T120000Z")
def replay_report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the folder, or report.2.html and so on.")
    ] = None,
) -> None:
    """One page with the run's figures: report.html in its folder."""
    from agent.perception.depth_sweep import sweep_depth
    from replay.files.auto_recover import auto_recovered
    from replay.report.report import page_of, report

    if out is not None:
        new_file(out)
    (there,) = auto_recovered([run], complain)
    page = report(there, unused_page(page_of(there)) if out is None else out, sweep_depth)
    terminal().print(f"written to {page}", markup=False)


@app.command("layout", epilog="Example: aucamp replay layout fleet.toml --out layout.json")
def replay_layout(
    fleet: FleetFile, out: Annotated[Path, typer.Option(help="File to write (JSON); Foxglove imports it.")]
) -> None:
    """How Foxglove shows a fleet's recordings, and the fleet live: its robots, its targets, its tank."""
    from replay.viewers.layout import write

    write(load_fleet(fleet), new_file(out))
    terminal().print(f"written to {out}", markup=False)


def unused_page(path: Path) -> Path:
    """report.html, or report.2.html and so on where a report is there already."""
    numbers = (path.with_name(f"{path.stem}.{n}{path.suffix}") for n in count(2))
    return path if not path.exists() else next(page for page in numbers if not page.exists())
