"""The command line: options in, one call out, errors as one line.

Exit 0: done; 1: the answer is no; 2: bad input; 128 + n: ended by signal n, 130 by Ctrl-C.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from typing import Annotated, cast, get_args

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
experiment_app = typer.Typer(no_args_is_help=True, help="The paper's experiments, on the twin.")
app.add_typer(experiment_app, name="experiment")
replay_app = typer.Typer(no_args_is_help=True, help="Look into recordings.")
app.add_typer(replay_app, name="replay")
train_app = typer.Typer(no_args_is_help=True, help="Train what the robots see with.")
app.add_typer(train_app, name="train")

FleetFile = Annotated[Path, typer.Argument(metavar="FLEET", help="Fleet file (TOML).")]
RobotName = Annotated[str, typer.Option("--robot", help="Which robot of the fleet file.")]
Seed = Annotated[int, typer.Option(min=0, help="Which world of the twin.")]
Port = Annotated[int, typer.Option(min=1024, max=65535, help="WebSocket port on this machine.")]
Recordings = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings (MCAP).")]
Runs = Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of runs, or recordings (MCAP).")]
OutFolder = Annotated[Path | None, typer.Option(help="Folder for result.json and figures; runs/<UTC> if not given.")]


@app.command(epilog="Example: aucamp demo --robots 3 --seed 1")
def demo(
    robots: Annotated[int, typer.Option(help="How many: the first ones of the fleet file.")] = 3,
    protocol: Annotated[str, typer.Option(help="How robots agree: evidence, metropolis or paper.")] = "evidence",
    loss: Annotated[float, typer.Option(min=0.0, max=0.99, help="Share of link messages thrown away.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Which world of the twin: hidden parameters and noise.")] = 0,
    duration: Annotated[float, typer.Option(min=1.0, help="Time limit in seconds, calibration not counted.")] = 120.0,
    enhance: Annotated[bool, typer.Option(help="Where a frame shows no ball, look for it enhanced.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the recordings; runs/<UTC time> if not given.")] = None,
    fleet: Annotated[str, typer.Option(help="A fleet that ships (tank, two_balls), or a fleet file.")] = "tank",
) -> None:
    """Robots find a ball in the twin's tank within two minutes; a table at the end, recordings and a report."""
    from agent.demo import demo as dive
    from agent.sweep_depth import sweep_depth
    from replay.report import report

    run, summary = dive(robots, one_of_protocols(protocol), loss, seed, duration, enhance, out, terminal(), fleet)
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
    from agent.runtime import run

    run(fleet, robot, out, arm, lossless, view)


@app.command(epilog="Example: aucamp twin fleet.toml")
def twin(
    fleet: FleetFile,
    bench: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="Clamp this robot on the calibration bench instead.")
    ] = None,
) -> None:
    """The tank twin, until Ctrl-C: serial ports and cameras for every robot whose devices are `twin:`."""
    from hw.twin.__main__ import run

    raise typer.Exit(run(fleet, bench=bench))


@app.command(epilog="Example: aucamp record fleet.toml --out fleet.mcap")
def record(
    fleet: FleetFile,
    out: Annotated[Path, typer.Option(help="File to write (MCAP).")],
    view: Annotated[bool, typer.Option(help="Record channels for Foxglove and Rerun as well.")] = True,
) -> None:
    """Record all traffic of a fleet until Ctrl-C or SIGTERM. The robots do not notice."""
    from agent.runtime import until_signal
    from replay.recorder import record as run

    with until_signal() as stop:
        robots = load_fleet(fleet)
        complain(f"recording fleet '{robots.fleet}'; Ctrl-C ends it")
        counts = run(robots, out, stop, views=view)
    terminal().print(", ".join(f"{name} {count}" for name, count in counts.items()))


@app.command(epilog="Example: aucamp router fleet.toml")
def router(fleet: FleetFile) -> None:
    """A place to look from, until Ctrl-C: consoles attach to it. The robots do not need it."""
    from agent.router import run_router
    from agent.runtime import until_signal

    with until_signal() as stop:
        run_router(load_fleet(fleet), stop, complain)


@app.command(epilog="Example: aucamp view fleet.toml")
def view(
    fleet: FleetFile,
    port: Port = 8765,
) -> None:
    """Serve a running fleet's state to Foxglove, on this machine only, until Ctrl-C."""
    from agent.runtime import until_signal
    from replay.view import view as serve

    with until_signal() as stop:
        serve(load_fleet(fleet), stop, port, typer.echo)


@app.command("depth-map", epilog="Example: aucamp depth-map photographs/ --out depth.png")
def depth_map(
    source: Annotated[str, typer.Argument(help="Folder of focus-bracketed photographs, or a camera URL.")],
    out: Annotated[Path, typer.Option(help="Picture to write; the numbers go beside it as .csv.")] = Path("depth.png"),
    block: Annotated[int, typer.Option(min=8, help="Side of a block, pixels.")] = 50,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file: gives metres.")] = None,
    box: Annotated[str | None, typer.Option(help="Range of the thing in this box too: X,Y,W,H in pixels.")] = None,
    tilt: Annotated[
        float, typer.Option(min=-90, max=90, help="Degrees by which the camera looks up; its lens sags.")
    ] = 0,
) -> None:
    """How far each part of the view is, from the focus position at which it is sharpest."""
    from agent.depth_map import run

    terminal().print(run(source, out, block, calibration, tilt_deg=tilt, box=box))


@app.command("track", epilog="Example: aucamp track dive.mp4 --box 210,140,90,60 --out followed.mp4")
def track(
    source: Annotated[str, typer.Argument(help="Folder of pictures, video file, or a camera URL.")],
    box: Annotated[str, typer.Option(help="Around the thing in the first picture: X,Y,W,H in pixels.")],
    backbone: Annotated[Path | None, typer.Option(help="NanoTrack V2's backbone (ONNX).")] = None,
    neck: Annotated[Path | None, typer.Option(help="NanoTrack V2's neck and head (ONNX).")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many; a camera needs it.")] = None,
    out: Annotated[Path | None, typer.Option(help="Pictures with the box: new folder, or .mp4, .avi.")] = None,
) -> None:
    """Follow what is in a box; a line per picture says where it is, how sure, and whether it is lost."""
    from agent.track import run

    raise typer.Exit(0 if run(source, box, backbone, neck, frames, out, typer.echo) else 1)


@app.command(epilog="Example: aucamp enhance photographs/ --out clear --side-by-side")
def enhance(
    source: Annotated[str, typer.Argument(help="Image, folder, video, or a camera such as v4l2:/dev/video0.")] = "",
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("enhanced"),
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="The picture before beside the one after.")
    ] = False,
    variant: Annotated[str, typer.Option(help="plain, folded, fast, classic (no network), or auto.")] = "auto",
    weights: Annotated[Path | None, typer.Option(help="Weights of the network; the shipped ones if not given.")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many, of a camera (30) or a video (all).")] = None,
    evaluate: Annotated[tuple[Path, Path] | None, typer.Option(help="RAW REFERENCE: figures, no pictures.")] = None,
    size: Annotated[str, typer.Option(help="Of --evaluate: WIDTHxHEIGHT, or own.")] = "256x256",
) -> None:
    """Pictures as if there were less water in front of them; --evaluate measures how well."""
    from agent import enhance_evaluate, enhance_source
    from agent.perception.enhance import VARIANTS

    if (bool(source)) == (evaluate is not None):
        raise ConfigError("enhance: give either a SOURCE or --evaluate RAW REFERENCE")
    way = next((known for known in VARIANTS if known == variant), None)
    if way is None:
        raise ConfigError(f"--variant {variant}: no such variant; choose {', '.join(VARIANTS)}")
    if evaluate is not None:
        raise typer.Exit(enhance_evaluate.run(*evaluate, way, weights, size, terminal())[1])
    raise typer.Exit(enhance_source.run(source, out, side_by_side, way, weights, frames, terminal()))


@calibrate_app.command("run", epilog="Example: aucamp calibrate run fleet.toml --robot r1 --out calibration/r1.toml")
def calibrate_run(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="File to write; the fleet file's own if not given.")] = None,
) -> None:
    """Board at known distances, one focus sweep each, then the gimbal; on the twin's bench for a `twin:` camera."""
    from agent.experiments.calibrate_run import run

    run(fleet, robot, out, terminal())


@calibrate_app.command("focus", epilog="Example: aucamp calibrate focus table.csv --out calibration/r1.toml")
def calibrate_focus(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="CSV with the columns u_mm and code.")],
    out: Annotated[Path | None, typer.Option(help=r"Calibration file whose table \[focus] is to be written.")] = None,
) -> None:
    """Range against sharpest lens position, from a table measured by hand; a plot beside it and a verdict."""
    from agent.experiments.calibrate_focus import run

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
    from agent.experiments.calibrate_camera import run

    run(folder, columns, rows, square_mm, out, terminal())


@experiment_app.command("calibration", epilog="Example: aucamp experiment calibration --seed 3")
def experiment_calibration(seed: Seed = 0, out: OutFolder = None) -> None:
    """Range against focus position, on the twin's bench."""
    from agent.experiments.calibration import calibration

    calibration(seed, out, terminal())


@experiment_app.command("depth", epilog="Example: aucamp experiment depth --seed 1")
def experiment_depth(seed: Seed = 0, out: OutFolder = None) -> None:
    """Depth of whole views from focus, against the twin's truth: our peak and the paper's."""
    from agent.experiments.depth_table import run

    run(seed, out, terminal())


@experiment_app.command("detection", epilog="Example: aucamp experiment detection --count 200")
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


@experiment_app.command("peak-shift", epilog="Example: aucamp experiment peak-shift --water turbid")
def experiment_peak_shift(
    seed: Seed = 0,
    sensor: Annotated[str, typer.Option(help="Camera of the twin.")] = "imx519_640",
    water: Annotated[list[str] | None, typer.Option(help="Only this kind; again for more. All if not given.")] = None,
    out: OutFolder = None,
) -> None:
    """How far the focus peak moves when frames are enhanced before clarity is taken, in every kind of water."""
    from agent.experiments.peak_shift import run

    run(seed, sensor, out, terminal(), water)


@experiment_app.command("consistency", epilog="Example: aucamp experiment consistency --count 100")
def experiment_consistency(
    seed: Seed = 0, count: Annotated[int, typer.Option(min=1, help="Measurements.")] = 1000, out: OutFolder = None
) -> None:
    """Whether measurements of a ball are as wrong as they say: with focus, with size, with both."""
    from agent.experiments.consistency_table import run

    raise typer.Exit(0 if run(seed, count, out, terminal()) else 1)


@experiment_app.command("localization", epilog="Example: aucamp experiment localization --quick")
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


@experiment_app.command("orientation", epilog="Example: aucamp experiment orientation --seeds 5")
def experiment_orientation(
    seed: Seed = 0, seeds: Annotated[int, typer.Option(min=1, help="Robots per case.")] = 20, out: OutFolder = None
) -> None:
    """Push and depth step under the three control laws, real firmware on the twin's physics."""
    from agent.experiments.orientation import run

    run(seed, seeds, out, terminal())


@train_app.command("enhance", epilog="Example: aucamp train enhance --out lu2net.safetensors --seed 0")
def train_enhance(
    pairs: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="RAW REFERENCE", help="Folders of pairs to train on instead of pairs of our own making."),
    ] = None,
    start: Annotated[Path | None, typer.Option(help="Weights to go on from; from scratch if not given.")] = None,
    out: Annotated[Path | None, typer.Option(help="Weights to write; runs/<UTC> if not given.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Batches; 4000 from scratch, 400 from weights.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the weights, of the pairs, of their order.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint beside --out.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Keep none of --pairs back for validation.")] = False,
    cross_validate: Annotated[
        int | None, typer.Option(min=2, help="Write nothing: figures of --start tuned on --pairs, in so many folds.")
    ] = None,
) -> None:
    """LU2Net's weights, from pairs of pictures with and without water; loss and validation curves beside them."""
    try:
        import safetensors  # noqa: F401
        import torch
    except ImportError as error:
        raise ConfigError("training needs torch: pip install 'aucamp[train]'") from error
    from agent.enhancement.command import cross_validation, plan_of, train

    torch.set_flush_denormal(True)  # else a vanishing gain costs a hundred times its worth
    plan = plan_of(steps, seed, start is not None)
    if cross_validate is None:
        train(pairs, out, plan, start, resume, everything, terminal())
    elif pairs is None or start is None:
        raise ConfigError("--cross-validate needs --pairs RAW REFERENCE and --start WEIGHTS")
    else:
        cross_validation(pairs, start, plan, cross_validate, terminal())


@replay_app.command("info", epilog="Example: aucamp replay info runs/20260101T120000Z/r1.mcap")
def replay_info(
    files: Recordings, as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False
) -> None:
    """What is in a recording, and whether it is whole."""
    from replay.info import info_all

    info_all(files, as_json, typer.echo)


@replay_app.command("recover", epilog="Example: aucamp replay recover r1.mcap.active")
def replay_recover(
    files: Recordings,
    force: Annotated[bool, typer.Option("--force", help="Even if it looks as if it were being written.")] = False,
) -> None:
    """Mend a torn recording into a new file, and say what was lost."""
    from replay.recover import recover_all

    raise typer.Exit(recover_all(files, force, typer.echo))


@replay_app.command("check", epilog="Example: aucamp replay check runs/20260101T120000Z")
def replay_check(
    paths: Runs,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
    ignore: Annotated[Path | None, typer.Option(help="Fields that may differ (TOML).")] = None,
    vision: Annotated[bool, typer.Option("--vision", help="See the recorded frames again instead.")] = False,
    update: Annotated[bool, typer.Option("--update", help="Accept what today's code gives; needs --reason.")] = False,
    reason: Annotated[str, typer.Option(help="Why the outputs may change; goes into the file.")] = "",
) -> None:
    """Does today's code do what the recording says? Byte for byte; exit 1 if not, 2 if it cannot be checked."""
    from agent.perception.again import see_again
    from replay.accept import accept
    from replay.check import check, text
    from replay.leftovers import mended
    from replay.vision_check import check_vision

    bar = Console(stderr=True)
    if update:
        for accepted in accept(paths, reason):
            typer.echo(str(accepted))
        return
    paths = mended(paths, complain)
    if vision:
        seen = check_vision(paths, see_again, bar)
        for one in seen:
            typer.echo(json.dumps(one.as_json()) if as_json else str(one))
        raise typer.Exit(2 if any(not one.frames for one in seen) else int(any(not one.passed for one in seen)))
    checked = check(paths, ignore, bar)
    typer.echo(json.dumps(checked.as_json()) if as_json else text(checked))
    raise typer.Exit(checked.exit_code)


@replay_app.command("explain", epilog="Example: aucamp replay explain r1.mcap --at 16")
def replay_explain(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="One robot's recording.")],
    at: Annotated[str | None, typer.Option(help="Iteration 16, time 12.5s or step:812; the last if not given.")] = None,
) -> None:
    """Why a robot believed what it believed: whom it heard, with which weights."""
    from replay.explain import explain
    from replay.leftovers import mended

    (there,) = mended([file], complain)
    typer.echo(explain(there, at))


@replay_app.command("report", epilog="Example: aucamp replay report runs/20260101T120000Z")
def replay_report(run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording.")]) -> None:
    """One page with the run's figures: report.html in its folder."""
    from agent.sweep_depth import sweep_depth
    from replay.leftovers import mended
    from replay.report import report

    (there,) = mended([run], complain)
    terminal().print(f"written to {report(there, depth=sweep_depth)}")


def complain(line: str) -> None:
    """What a person should know but a program that reads our output should not."""
    typer.echo(line, err=True)


def terminal() -> Console:
    """Lines with paths are not folded; a pipe is as wide as our widest table."""
    return Console(soft_wrap=True, width=None if sys.stdout.isatty() else 140)


def one_of_protocols(text: str) -> Protocol:
    for protocol in get_args(Protocol):
        if text == protocol:
            return cast(Protocol, protocol)
    raise ConfigError(f"--protocol {text}: no such protocol; choose {', '.join(get_args(Protocol))}")


def leave(number: int, frame: object) -> None:
    """A signal ends the program as Ctrl-C does, so that what it started ends with it."""
    raise SystemExit(128 + number)


def main() -> None:
    """Run the command line; what a user can cause ends in one line on stderr and exit code 2."""
    from agent.launch import Failed
    from hw.camera import CameraError

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup has it ignored, and means it
            signal.signal(number, leave)
    try:
        app()
    except (ConfigError, CameraError) as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(2)
    except Failed as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        sys.stderr.write(f"aucamp: {error.filename}: {error.strerror}; choose a file or folder that can be used\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
