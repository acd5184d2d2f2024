"""`aucamp depth-map SOURCE`: sweep the focus once, give every block of the picture the distance of its clarity peak."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from agent.failure import Failed
from agent.kernel.config import ConfigError
from agent.kernel.ranging.calibration import Calibration, load_calibration
from agent.kernel.ranging.focus import NoPeak
from agent.kernel.ranging.lens_sag import at_tilt
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import parse_box
from agent.pictures.depth_box import BoxRange, as_json, box_range
from agent.pictures.depth_files import draw, write_csv
from agent.pictures.depth_sweep import DepthMap, OnStep, measure, sweep
from agent.plain_console import plain_console
from agent.progress import with_bar
from hw.camera.open import open_camera


def depth_map(
    source: str,
    out: Path,
    block: int,
    twin_dir: Path,
    calibration: Calibration | None,
    progress: OnStep,
    growth: float | None = None,
    box: Box | None = None,
) -> DepthMap:
    """Sweep `source` (a camera address, or a directory of photographs), write the PNG `out` and a CSV beside it.

    block: edge in pixels. growth: see `sweep`. box: around one thing, whose range goes into a JSON file beside them.
    Raises CameraError and ConfigError, each one line.
    """
    if out.suffix.lower() != ".png" or not out.parent.is_dir():
        raise ConfigError(f"{out}: give a name that ends in .png, in a directory that exists")
    camera = open_camera(_address(source), twin_dir, None)
    try:
        taken = sweep(camera, block, progress, growth, box)
    finally:
        camera.close()
    result = measure(taken, block, calibration)
    if box is not None and taken.box_clarity is not None:
        result = result._replace(box_range=box_range(taken.lens_positions, taken.box_clarity, box, calibration))
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

    tilt_deg: how far the camera looks up. Raises Failed where the thing in the box has no single clear peak; the map
    is written all the same.
    """
    drawn = None if box is None else parse_box(box)
    known = None if calibration is None else load_calibration(calibration)
    if known is not None:
        known = replace(known, focus=at_tilt(known.focus, math.radians(tilt_deg)))
    result = with_bar(
        plain_console(stderr=True),
        "focus sweep",
        lambda progress: depth_map(source, out, block, Path(), known, progress, growth, drawn),
    )
    found, blocks = np.count_nonzero(result.accepted), result.accepted.size
    said = (
        f"{found} of {blocks} blocks have a clear peak, the picture grew by {result.growth:.1%}: "
        f"{out}, {out.with_suffix('.csv')}"
    )
    if isinstance(result.box_range, NoPeak):
        raise Failed(f"box {box}: {result.box_range.reason}; the map is in {out}")
    return said if result.box_range is None else f"{said}, {out.with_suffix('.json')}\nin the box: {result.box_range}"


def _address(source: str) -> str:
    """The address of the camera that is meant; a folder of photographs is one."""
    if Path(source).is_dir():
        return f"stack:{source}"
    if ":" not in source:
        what = "a file" if Path(source).exists() else "no such folder"
        raise ConfigError(f"{source}: {what}; give a folder of photographs, or a camera such as v4l2:/dev/video0")
    return source
