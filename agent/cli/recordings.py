"""What can be done with recordings: replay, export, reconstruction."""

from __future__ import annotations

import json
from enum import StrEnum
from itertools import count
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from agent.cli.ground import extra
from agent.core.config import ConfigError
from agent.process.command import (
    FleetFile,
    Recordings,
    Runs,
    complain,
    new_file,
    plain_console,
    refuse_options,
    run_folder,
    terminal,
)
from agent.robot.fleet_reader import load_fleet

app = typer.Typer(no_args_is_help=True, help="Look into recordings.")


@app.command("info", epilog="Example: aucamp replay info runs/20260101T120000Z/r1.mcap")
def replay_info(files: Runs, as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False) -> None:
    """What happened in a dive, what is in its recording, and whether that is whole."""
    from replay.story import info_all

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
    update: Annotated[
        str | None, typer.Option(metavar="REASON", help="Accept what today's code gives; why goes into the file.")
    ] = None,
) -> None:
    """Does today's code do what the recording says? Byte for byte; exit 1 if not, 2 if it cannot be checked."""
    from replay.check.check import check, text, update_recordings
    from replay.files.recover import auto_recovered

    bar = plain_console(stderr=True)
    if update is not None:
        for updated in update_recordings(paths, update):
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
    file: Annotated[Path, typer.Argument(metavar="FILE", help="One robot's recording; with --track a demo's folder.")],
    at: Annotated[str | None, typer.Option(help="Iteration 16, time 12.5s or step:812; the last if not given.")] = None,
    track: Annotated[bool, typer.Option("--track", help="What each cause of a track's error was worth.")] = False,
) -> None:
    """Why a robot believed what it believed: whom it heard, with which weights."""
    from replay.check.explain import explain
    from replay.files.recover import auto_recovered

    (there,) = auto_recovered([file], complain)
    if track:
        refuse_options("replay explain --track", {"--at": at}, ())
        from replay.report.creature_track import causes_table, track_causes

        typer.echo(causes_table(track_causes(there)))
        return
    typer.echo(explain(there, at))


@app.command("report", epilog="Example: aucamp replay report runs/20260101T120000Z")
def replay_report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the folder, or report.2.html and so on.")
    ] = None,
) -> None:
    """One page with the run's figures, beside those that are there."""
    from agent.perception.depth_sweep import sweep_depth
    from replay.files.recover import auto_recovered
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


# --- export ---
# `aucamp export`.

export_app = typer.Typer()


@export_app.command("export", epilog="Example: aucamp export csv runs/20260101T120000Z --out tables")
def export_command(
    kind: Annotated[
        Literal["csv", "mp4", "webp", "jsonl", "rosbag"],
        typer.Argument(
            help="Tables of each robot; what one robot's camera saw; a dive in twelve seconds; each message as a line; "
            "what a fleet showed, for ROS 2."
        ),
    ],
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording (MCAP).")],
    out: Annotated[Path, typer.Option(help="New folder for csv and rosbag, else a new file.")],
    robot: Annotated[str | None, typer.Option(help="Only this robot.")] = None,
    channel: Annotated[list[str] | None, typer.Option(help="jsonl: only this channel; again for more.")] = None,
) -> None:
    """A recording for other programs: tables, a film, a clip, lines of JSON, or a bag of ROS 2."""
    from replay.export import write_lines, write_tables
    from replay.files.recover import auto_recovered

    takes = {"jsonl": ("--channel", "--robot"), "webp": (), "rosbag": ()}.get(kind, ("--robot",))
    refuse_options(f"export {kind}", {"--channel": channel or None, "--robot": robot}, takes)
    if kind in ("mp4", "webp") and out.suffix != f".{kind}":
        raise ConfigError(f"--out {out}: a film's name ends in .{kind}")
    if kind != "csv":
        new_file(out)
    elif out.exists():
        run_folder(out)  # empty, or it says so
    (there,) = auto_recovered([run], complain)
    if kind == "csv":
        files = write_tables(there, out, robot)
        said = f"{len(files)} tables written to {out}"
    elif kind in ("mp4", "webp"):
        from replay.film import write_clip, write_film

        frames = write_film(there, out, robot) if kind == "mp4" else write_clip(there, out)
        said = f"{frames} frames written to {out}"
    elif kind == "rosbag":
        with extra("ros", "rosbags"):
            from agent.ground.bridges.ros2 import write_bag
        said = f"{write_bag(there, out)} messages written to {out}"
    else:
        said = f"{write_lines(there, out, robot, channel or [])} lines written to {out}"
    terminal().print(said, markup=False, highlight=False)


# --- reconstruct ---
# `aucamp reconstruct`.

reconstruct_app = typer.Typer()

KINDS = ("ply", "glb", "colmap", "transforms.json", "splat", "mcap")
# typer takes a list of an Enum, not of a Literal
Export = StrEnum("Export", [(kind, kind) for kind in KINDS])  # type: ignore[misc]


@reconstruct_app.command(
    "reconstruct", epilog="Example: aucamp reconstruct runs/20260101T120000Z --out scene --export glb"
)
def reconstruct_command(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into: new, or empty.")],
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="[RUN]...", help="Folders of runs, or black boxes (MCAP).")
    ] = None,
    export: Annotated[
        list[Export] | None, typer.Option("--export", help="For other programs; again for more. ply if none is given.")
    ] = None,
    transforms: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Not recordings: pictures with poses in nerfstudio's layout.")
    ] = None,
    length: Annotated[
        str | None,
        typer.Option(metavar="A,B,METRES", help="--transforms: two pictures, and how far apart their cameras were."),
    ] = None,
    cell_mm: Annotated[float, typer.Option(min=1.0, max=100.0, help="Of the grid that the surface is found on.")] = 5.0,
    stereo: Annotated[
        bool, typer.Option("--stereo/--no-stereo", help="Compare pictures, too; without: by focus alone, in seconds.")
    ] = True,
    refine: Annotated[
        bool, typer.Option("--refine/--no-refine", help="Move robots' poses to where their pictures fit best.")
    ] = True,
    model: Annotated[
        Literal["surfels", "field"], typer.Option(help="Image model; a field needs torch, and takes five minutes.")
    ] = "surfels",
    video: Annotated[bool, typer.Option("--video/--no-video", help="A film once round the scene.")] = True,
) -> None:
    """A scene in three dimensions from a fleet's focus sweeps: surface, files for other programs, a report."""
    from agent.process.command import with_bar
    from agent.reconstruction.export import Kind
    from agent.reconstruction.report import in_metres
    from agent.reconstruction.run import Settings, run
    from agent.reconstruction.sources import parse_length
    from replay.files.recover import auto_recovered

    assert get_args(Kind) == KINDS
    if bool(runs) == (transforms is not None):
        raise ConfigError("give recordings to reconstruct from, or --transforms, not both")
    if not stereo and transforms is not None:
        raise ConfigError("--no-stereo: pictures without focus have no depths but by comparing them; leave it out")
    if transforms is not None and not transforms.exists():
        raise ConfigError(f"{transforms}: no such file or folder")
    if length is not None and transforms is None:
        raise ConfigError("--length: recordings are in metres; give it with --transforms")
    there = auto_recovered(list(runs or ()), complain)
    folder = run_folder(out)
    exports = tuple(kind for kind in get_args(Kind) if kind in [str(one) for one in export or ("ply",)])
    asked = Settings(
        runs=tuple(there),
        transforms=transforms,
        length=None if length is None else parse_length(length),
        exports=exports,
        cell_m=cell_mm * 1e-3,
        stereo=stereo,
        refine=refine,
        model=model,
        video=video,
    )
    console = terminal()
    result = with_bar(console, "reading", lambda show: run(asked, folder, show))
    for reason, many in result.passed_over.items():
        complain(f"{many} passed over: {reason}")
    for note in result.notes:
        complain(note)
    f = result.figures
    if in_metres(f):
        area, sigma = f"{f['area_m2']:.2f} m2", f"{f['sigma_mm']['p50']:.1f} mm"
    else:
        area, sigma = f"{f['area_units2']:.3g} of its own units squared", f"{f['sigma_units']['p50']:.2g} units"
    console.print(
        f"{f['triangles']} triangles, {area}, from {f['views']} keyframes; standard deviation {sigma} "
        f"(median, were views independent); {f['concluded']:.0%} of the surface was concluded from its rim",
        highlight=False,
    )
    learnt = f["image"]
    worth = learnt["psnr_held_back_db"]
    on = f"{worth:.1f} dB on {f['held_back']} photographs held back" if worth is not None else "none held back"
    thick = f"; its surface is {learnt['beta_mm']:.1f} mm thick" if learnt["beta_mm"] is not None else ""
    console.print(f"image model: {learnt['kind']}, {on}{thick}", highlight=False)
    beside = ", ".join(path.name for path in result.files if path.name != "report.html")
    console.print(f"look at {folder / 'report.html'}; beside it {beside}", highlight=False)
