"""What can be done with pictures and cameras: depth, tracking, enhancement and its training, calibration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from agent.core.config import ConfigError, to_install
from agent.process.command import Failed, complain, refuse_options, terminal

app = typer.Typer()

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
    nanotrack: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="BACKBONE NECK", help="NanoTrack V2's two files (ONNX); else a correlation filter."),
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="How many; a camera needs it.")] = None,
    out: Annotated[Path | None, typer.Option(help="Pictures with the box: new folder, or .mp4, .avi.")] = None,
    truth: Annotated[Path | None, typer.Option(help="CSV of boxes that are right: says how well it follows.")] = None,
    rate: Annotated[
        float | None, typer.Option(min=0.1, help="Pictures a second, for --truth and a film; the video's own, or 30.")
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep/--strict", help="Rather follow what it is no longer than call lost what is there.")
    ] = False,
) -> None:
    """Follow what is in a box; a line per picture says where it is, how sure, and whether it is lost."""
    from agent.tools.track import Asked, run

    raise typer.Exit(0 if run(source, Asked(box, nanotrack, frames, out, truth, rate, keep), typer.echo) else 1)


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
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to, enhanced if not given; of one picture also a NAME.png.")
    ] = None,
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
        given = {"--out": out, "--side-by-side": side_by_side, "--frames": frames}
        refuse_options("enhance --evaluate", given, ())
        raise typer.Exit(enhance_evaluate.run(*evaluate, variant, weights, size, terminal())[1])
    folder = out or Path("enhanced")
    raise typer.Exit(enhance_source.run(source, folder, side_by_side, variant, weights, frames, terminal()))


@app.command(epilog="Example: aucamp train --out lu2net.safetensors --seed 0")
def train(
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
        raise ConfigError(f"training needs torch: {to_install('train')}") from error
    from agent.tools import training

    torch.set_flush_denormal(True)  # else a vanishing gain costs a hundred times its worth
    plan = training.plan_of(steps, seed, start is not None, pairs is not None)
    if cross_validate is not None and pairs is not None and start is not None:
        training.cross_validation(pairs, start, plan, cross_validate, terminal())
    else:
        training.train(pairs, out, plan, start, resume, everything, terminal())


# --- calibrate ---
# `aucamp calibrate KIND`.

Kind = Literal["cameras", "board", "run", "focus", "camera", "gamma", "body", "landmarks"]
CALIBRATE_TAKES: dict[Kind, tuple[str, ...]] = {
    "cameras": (),
    "board": ("--board",),
    "run": ("--robot",),
    "focus": (),
    "camera": ("--board",),
    "gamma": (),
    "body": (),
    "landmarks": ("FLEET", "--calibration", "--known", "--no-flat", "--lens", "--frames"),
}


@app.command(no_args_is_help=True, epilog="Example: aucamp calibrate run fleet.toml --robot r1")
def calibrate(
    kind: Annotated[Kind, typer.Argument(help="What is measured.")],
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="What it is measured from, as above.")] = "",
    fleet: Annotated[
        Path | None, typer.Argument(metavar="[FLEET]", help="landmarks: the fleet file that lists the tags.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help=r"File whose table is written, such as \[focus]; run: else the fleet file's own; board: the PDF."
        ),
    ] = None,
    robot: Annotated[str | None, typer.Option(help="run: which robot of the fleet file.")] = None,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMNSxROWSxMM",
            help="camera, board: inner corners both ways and side of a square; 14x9x20 if not given.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="landmarks: of the camera that filmed; recordings have their own.")
    ] = None,
    known: Annotated[
        list[int] | None,
        typer.Option(help="landmarks: a tag whose place in the file counts; again for more; else all."),
    ] = None,
    no_flat: Annotated[
        bool, typer.Option("--no-flat", help="landmarks: tags are not glued flat to walls and floor.")
    ] = False,
    lens: Annotated[int | None, typer.Option(help="landmarks: lens position of all pictures, if it is known.")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="landmarks: how many pictures; a camera needs it.")] = None,
) -> None:
    """Measure what a camera, a body or a tank really is; each kind writes its own table of a file.

    \b
    cameras                 measures nothing: lists what is plugged in, what
                            works, and the address for the fleet file
    board                   measures nothing: the board to print, true to size
    run FLEET               lens and gimbal: a board at known distances, focus
                            swept; on the twin's bench for a twin's camera
    focus TABLE             range against lens position: CSV with u_mm, code
    camera DIR              focal length and centre: photographs of a
                            chessboard, taken in water
    gamma DIR               how it codes light: AprilTags out of focus
    body RECORDING          mass, inertia, drag of a robot that swam a trial
    landmarks SOURCE FLEET  where a tank's tags are: a film, a folder of
                            pictures, a dive or a robot's recording
    """
    given: dict[str, object] = {"FLEET": fleet, "--robot": robot, "--board": board, "--calibration": calibration}
    given |= {"--known": known or None, "--no-flat": no_flat, "--lens": lens, "--frames": frames}
    if kind == "cameras":
        given |= {"SOURCE": source or None, "--out": out}
    elif kind == "board":
        given["SOURCE"] = source or None
    elif not source:
        raise ConfigError(f"calibrate {kind}: say what it is measured from, the SOURCE; see aucamp calibrate --help")
    refuse_options(f"calibrate {kind}", given, CALIBRATE_TAKES[kind])
    if kind == "cameras":
        list_cameras()
    elif kind == "board":
        from agent.tools import camera_calibration

        camera_calibration.print_board(*as_board(board or "14x9x20"), out or Path("board.pdf"), terminal())
    elif kind == "run":
        from agent.tools import calibrate_run

        if robot is None:
            raise ConfigError("calibrate run: say which robot with --robot")
        calibrate_run.run(Path(source), robot, out, terminal())
    elif kind == "focus":
        from agent.tools import focus_calibration

        focus_calibration.run(Path(source), out, terminal())
    elif kind == "camera":
        from agent.tools import camera_calibration

        camera_calibration.calibrate_camera(Path(source), *as_board(board or "14x9x20"), out, terminal())
    elif kind == "gamma":
        from agent.tools import tags

        tags.calibrate_gamma(Path(source), out, terminal())
    elif kind == "body":
        from agent.tools import body_calibration

        body_calibration.run(Path(source), out, terminal())
    else:
        from agent.tools import tag_map

        if fleet is None:
            raise ConfigError("calibrate landmarks: say which fleet file lists the tags, after the source")
        asked = tag_map.Asked(calibration, tuple(known or ()), not no_flat, lens, frames, out)
        tag_map.run(source, fleet, asked, terminal())


def list_cameras() -> None:
    """What is plugged in, and which address to write. Raises Failed if nothing is; exit 1 if nothing can be used."""
    from hw.camera import plugged_in

    found = plugged_in()
    if not found:
        raise Failed("no camera is plugged in; a CSI camera also needs picamera2, see docs/cameras.md")
    for one in found:
        typer.echo(one.name)
        warnings = [("warning", line) for line in one.shortcomings]
        works = [*one.facts, *warnings, ("write", f'camera = "{one.address}"')]
        for what, line in [("refused", one.refused)] if one.refused else works:
            typer.echo(f"  {what:<9} {line}")
    if not any(one.address for one in found):
        raise typer.Exit(1)


SQUARE_MM = (3.0, 200.0)  # of boards in use


def as_board(text: str) -> tuple[int, int, float]:
    """COLUMNSxROWSxMM: inner corners along the longer and the shorter side, side of a square. Raises ConfigError."""
    try:
        columns, rows, square = text.split("x")
        board = int(columns), int(rows), float(square)
    except ValueError:
        board = 0, 0, 0.0
    if not (min(board[:2]) >= 3 and 0.1 <= board[2] < math.inf):
        raise ConfigError(f"--board '{text}': write inner corners both ways and mm of a square's side, such as 14x9x20")
    if not SQUARE_MM[0] <= board[2] <= SQUARE_MM[1]:
        complain(f"--board '{text}': squares of {board[2]:g} mm are rarely printed; the last number is in millimetres")
    return board
