"""What can be done with pictures and cameras: depth, tracking, enhancement and its training, calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from agent.core.config import ConfigError
from agent.process.command import FleetFile, RobotName, terminal

app = typer.Typer()
train_app = typer.Typer(no_args_is_help=True, help="Train what the robots see with.")
app.add_typer(train_app, name="train")

# Of enhance.Variant, whose file loads OpenCV and numba.
Variant = Literal["plain", "folded", "fast", "classic", "auto"]


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
    from agent.tools.depth_map import run

    terminal().print(run(source, out, block, calibration, tilt_deg=tilt, box=box))


@app.command("track", epilog="Example: aucamp track dive.mp4 --box 210,140,90,60 --out followed.mp4")
def track(
    source: Annotated[str, typer.Argument(help="Folder of pictures, video file, or a camera URL.")],
    box: Annotated[
        str | None, typer.Option(help="Around the thing in the first picture: X,Y,W,H in pixels; else --truth's.")
    ] = None,
    backbone: Annotated[Path | None, typer.Option(help="NanoTrack V2's backbone (ONNX).")] = None,
    neck: Annotated[Path | None, typer.Option(help="NanoTrack V2's neck and head (ONNX).")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many; a camera needs it.")] = None,
    out: Annotated[Path | None, typer.Option(help="Pictures with the box: new folder, or .mp4, .avi.")] = None,
    truth: Annotated[Path | None, typer.Option(help="CSV of boxes that are right: says how well it follows.")] = None,
    rate: Annotated[
        float | None, typer.Option(min=0.1, help="Pictures a second, for --truth; the video's own, or 30.")
    ] = None,
    result: Annotated[Path | None, typer.Option(help="Figures of --truth; else result.json in --out or runs/.")] = None,
) -> None:
    """Follow what is in a box; a line per picture says where it is, how sure, and whether it is lost."""
    from agent.tools.track import Asked, run

    raise typer.Exit(0 if run(source, Asked(box, backbone, neck, frames, out, truth, rate, result), typer.echo) else 1)


@app.command("tags", epilog="Example: aucamp tags photographs/ --calibration calibration/r1.toml --out seen")
def tags(
    source: Annotated[str, typer.Argument(help="Image, folder, video, or a camera such as v4l2:/dev/video0.")],
    calibration: Annotated[Path | None, typer.Option(help="Calibration file of the camera that took them.")] = None,
    fleet: Annotated[
        Path | None,
        typer.Option(help=r"Fleet file: says which ids its \[landmarks] do not have, and which are missing."),
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many; a camera needs it.")] = None,
    out: Annotated[Path | None, typer.Option(help="Pictures with the tags: new folder, or .mp4, .avi.")] = None,
) -> None:
    """Which AprilTags (36h11) there are: a line for each says id, size, blur and corners."""
    from agent.tools.tags import Asked, run

    raise typer.Exit(0 if run(source, Asked(calibration, fleet, frames, out), typer.echo) else 1)


@app.command(epilog="Example: aucamp enhance photographs/ --out clear --side-by-side")
def enhance(
    source: Annotated[str, typer.Argument(help="Image, folder, video, or a camera such as v4l2:/dev/video0.")] = "",
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("enhanced"),
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="The picture before beside the one after.")
    ] = False,
    variant: Annotated[Variant, typer.Option(help="How; classic needs no network, auto chooses.")] = "auto",
    weights: Annotated[
        Path | None, typer.Option(help="Weights of the network, or its authors' .pth; else the shipped ones.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many, of a camera (30) or a video (all).")] = None,
    evaluate: Annotated[tuple[Path, Path] | None, typer.Option(help="RAW REFERENCE: figures, no pictures.")] = None,
    size: Annotated[str, typer.Option(help="Of --evaluate: WIDTHxHEIGHT, or own.")] = "256x256",
) -> None:
    """Pictures as if there were less water in front of them; --evaluate measures how well."""
    from agent.perception.enhancement import enhance as ways
    from agent.tools import enhance as enhance_source
    from agent.tools import evaluate_enhance as enhance_evaluate

    assert get_args(Variant) == get_args(ways.Variant)
    if (bool(source)) == (evaluate is not None):
        raise ConfigError("enhance: give either a SOURCE or --evaluate RAW REFERENCE")
    if evaluate is not None:
        raise typer.Exit(enhance_evaluate.run(*evaluate, variant, weights, size, terminal())[1])
    raise typer.Exit(enhance_source.run(source, out, side_by_side, variant, weights, frames, terminal()))


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
    from agent.tools.training_pairs import check

    check(pairs, start, out, resume, cross_validate)  # before torch, whose import takes seconds
    try:
        import safetensors  # noqa: F401
        import torch
    except ImportError as error:
        raise ConfigError("training needs torch: in your clone: pip install -e '.[train]'") from error
    from agent.tools.train_enhance import cross_validation, plan_of, train

    torch.set_flush_denormal(True)  # else a vanishing gain costs a hundred times its worth
    plan = plan_of(steps, seed, start is not None, pairs is not None)
    if cross_validate is not None and pairs is not None and start is not None:
        cross_validation(pairs, start, plan, cross_validate, terminal())
    else:
        train(pairs, out, plan, start, resume, everything, terminal())


# --- calibrate ---
# `aucamp calibrate`.

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
