"""`aucamp depth-map SOURCE`: sweep the focus once, give each block the distance of its clarity peak."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from agent.core.config import ConfigError
from agent.core.ranging.camera_model import FocusFit, load_focus
from agent.core.ranging.focus import NoPeak, at_tilt
from agent.perception.depth_box import BoxRange, as_json, box_range
from agent.perception.depth_edges import any_part
from agent.perception.depth_sweep import DepthMap, OnStep, measure, sweep
from agent.perception.tracking.box import Box
from agent.perception.tracking.follow import parse_box
from agent.process.command import Failed, new_file, plain_console, with_bar
from agent.tools.depth_files import write_csv
from agent.tools.depth_picture import draw
from agent.tools.depth_ranges import ranges_in_words
from hw.camera.open import open_camera


def depth_map(
    source: str,
    out: Path,
    block: int,
    twin_dir: Path,
    focus: FocusFit | None,
    progress: OnStep,
    growth: float | None = None,
    box: Box | None = None,
) -> DepthMap:
    """Sweep `source` (a camera address, or a directory of photographs), write the PNG `out` and a CSV beside it.

    block: edge in pixels. growth: see `sweep`. box: around one thing, whose range goes into a JSON file beside them.
    Raises CameraError and ConfigError, each one line.
    """
    if out.suffix.lower() != ".png" or not out.parent.is_dir():
        raise ConfigError(f"{out}: give --out a name that ends in .png, in a folder that exists")
    for file in _files(out, box is not None):
        new_file(file)
    camera = open_camera(_address(source), twin_dir, None)
    try:
        taken = sweep(camera, block, progress, growth, box)
    finally:
        camera.close()
    result = measure(taken, block, focus)
    if box is not None and taken.box_clarity is not None:
        result = result._replace(box_range=box_range(taken.lens_positions, taken.box_clarity, box, focus))
    try:
        write_csv(result, out.with_suffix(".csv"))
        draw(result, out, box)
        if box is not None and isinstance(result.box_range, BoxRange):
            out.with_suffix(".json").write_text(as_json(box, result.box_range), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}; choose another place") from None
    return result


def run(
    source: str,
    out: Path,
    block: int,
    calibration: Path | None,
    growth: float | None = None,
    tilt_deg: float = 0.0,
    box: str | None = None,
) -> str:
    """What `aucamp depth-map` does and says. A camera of the twin is named by its socket: twin:/path/r1.camera.

    tilt_deg: how far the camera looks up. Raises Failed where no block has a clear peak, where the calibration is not
    of this camera, or the thing in the box has no single clear peak; the map is written all the same.
    """
    drawn = None if box is None else parse_box(box)
    focus = None if calibration is None else at_tilt(load_focus(calibration), math.radians(tilt_deg))
    result = with_bar(
        plain_console(stderr=True),
        "focus sweep",
        lambda progress: depth_map(source, out, block, Path(), focus, progress, growth, drawn),
    )
    blocks, parts = result.blocks.accepted, result.used_parts()
    if not blocks.any() and not parts.any():
        raise Failed(
            f"{source}: no block has a clear peak: nothing in the view has texture, or it is sharp nowhere in the "
            f"sweep; the map, which is empty, is in {out}"
        )
    files = ", ".join(map(str, _files(out, box is not None)))
    split = any_part(parts, result.along)
    also = f", {np.count_nonzero(split)} more in parts" if split.any() else ""
    said = [
        f"{np.count_nonzero(blocks)} of {blocks.size} blocks have a clear peak{also}, "
        f"the picture grew by {result.growth:.1%}: {files}"
    ]
    if focus is not None and calibration is not None:
        said += ranges_in_words(result, focus, calibration, out)
    if isinstance(result.box_range, NoPeak):
        raise Failed(f"box {box}: {result.box_range.reason}; the map is in {out}")
    return "\n".join(said if result.box_range is None else [*said, f"in the box: {result.box_range}"])


def _files(out: Path, box: bool) -> list[Path]:
    """What is written: the map, its numbers, and those of the box."""
    return [out, out.with_suffix(".csv"), *([out.with_suffix(".json")] if box else [])]


def _address(source: str) -> str:
    """The address of the camera that is meant; a folder of photographs is one."""
    if Path(source).is_dir():
        return f"stack:{source}"
    if ":" not in source:
        what = "a file" if Path(source).exists() else "no such folder"
        raise ConfigError(f"{source}: {what}; give a folder of photographs, or a camera such as v4l2:/dev/video0")
    return source
