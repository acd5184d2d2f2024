"""A depth map from the frames of a robot's own sweep: what `aucamp depth-map` measures, while the robot hangs in water.

The robot drifts by some pixels while its lens moves, and the picture grows. Both are seen on the target: its centre
says where the frames lie on each other, its radius by how much they grow. That is true to a pixel or two, which blocks
bear and their parts would not: blocks are not split here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.focus import MIN_POSITIONS
from agent.perception.depth_sweep import MAX_GROWTH, clarity_of, measure
from replay.viewers.whole_sweeps import SweepDepth, SweepFrame

BLOCK_PX = 25  # half of what a whole view gets: the part that a sweep reads is half as wide
MIN_BLOCKS = 4  # across and down; less is no map


def sweep_depth(frames: Sequence[SweepFrame], calibration: Calibration) -> SweepDepth | None:
    """The map of one sweep, or None where too few frames show the target, or too little around it.

    Frames without a ball are left out: nothing says where they belong. A box around something else trembles too much.
    """
    seen = [frame for frame in frames if frame.sighting.radius_px and frame.sighting.focus is not None]
    if len({frame.sighting.focus for frame in seen}) < MIN_POSITIONS:
        return None
    half_x, half_y = (min(_reach(frame, axis) for frame in seen) for axis in (0, 1))
    if min(half_x, half_y) < MIN_BLOCKS * BLOCK_PX / 2:
        return None
    images = []
    for frame in seen:
        x, y = _centre(frame)
        images.append(frame.image[y - half_y : y + half_y + 1, x - half_x : x + half_x + 1])
    lens_positions = np.array([float(frame.sighting.focus or 0) for frame in seen])
    grown = growth(lens_positions, [frame.sighting.radius_px or 0.0 for frame in seen])
    taken = clarity_of(images, lens_positions, BLOCK_PX, grown)
    found = measure(taken, BLOCK_PX, calibration.focus)
    assert found.blocks.range_m is not None  # there is a calibration
    reference = seen[taken.reference]
    x, y = _centre(reference)
    return SweepDepth(
        t_ns=seen[0].sighting.t_ns,
        block_px=BLOCK_PX,
        left_px=reference.roi[0] + x - half_x,
        top_px=reference.roi[1] + y - half_y,
        range_m=found.blocks.range_m,
        sharp=found.sharp,
    )


def growth(lens_positions: np.ndarray, radius_px: Sequence[float]) -> float:
    """How much the target's radius grew from the first to the last frame, relative: a line over the lens position."""
    slope, at_zero = np.polyfit(lens_positions, radius_px, 1)
    first = at_zero + slope * lens_positions[0]
    relative = slope * (lens_positions[-1] - lens_positions[0]) / first if first > 0 else 0.0
    return float(np.clip(relative, -MAX_GROWTH, MAX_GROWTH))


def _centre(frame: SweepFrame) -> tuple[int, int]:
    """The target's centre in the image, whole pixels."""
    assert frame.sighting.centre_px is not None
    return round(frame.sighting.centre_px[0]) - frame.roi[0], round(frame.sighting.centre_px[1]) - frame.roi[1]


def _reach(frame: SweepFrame, axis: int) -> int:
    """How far the image goes on to both sides of the target, pixels."""
    centre = _centre(frame)[axis]
    return min(centre, frame.roi[2 + axis] - 1 - centre)
