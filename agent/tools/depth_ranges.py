"""What a calibration makes of the peaks of a map, in words: how many have a range, why the others have none.

Nothing in a sweep says which camera took it. But peaks that the calibration cannot give a range to, that lie where it
was not measured, or that are far wider or narrower than those it was made of, are rarely those of its camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import FARTHEST_M, Array, h
from agent.perception.depth_sweep import DepthMap
from agent.process.command import Failed

LEAST_SHARE = 0.05  # of the clear peaks: fewer ranges are chance, or what a speck of dirt in the view has
NEAR_POLE = 0.25  # of the peak's half width: warmth and sag shift the focus at infinity by less
STRANGE_WIDTH = 5.0  # times that of the calibration, or a part: texture and range change a peak's width twofold


def ranges_in_words(result: DepthMap, focus: FocusFit, calibration: Path, out: Path) -> list[str]:
    """No line where every clear peak has a range that was calibrated. Raises Failed where (nearly) none has one."""
    positions, ranges, widths = _accepted(result)
    count, given = positions.size, int(np.isfinite(ranges).sum())
    low, high = sorted((focus.lowest, focus.highest))
    covered = f"lens positions {low} to {high} ({_metres(focus, focus.highest)} to {_metres(focus, focus.lowest)})"
    where = f"the peaks lie at lens positions {positions.min():.4g} to {positions.max():.4g}, it was made at {covered}"
    if given < LEAST_SHARE * count:
        at_infinity = abs(float(np.median(positions)) - focus.rho0) <= NEAR_POLE * focus.width
        or_far = f", or all of the view is farther than {FARTHEST_M:g} m" if at_infinity else ""
        raise Failed(
            f"{calibration}: gives a range to {given or 'none'} of the {count} clear peaks, so it is a calibration of "
            f"another camera{or_far}: {where}. Give this camera's own; {out} is in lens positions"
        )
    told = []
    if given < count:
        beyond = int(np.sum(~np.isfinite(ranges) & ((positions - focus.rho0) * focus.b_m <= 0.0)))
        told.append(f"{count - given} of them have no range: {_why(beyond, count - given)}")
    outside = int(np.sum(np.isfinite(ranges) & ((positions < low) | (positions > high))))
    if outside:
        told.append(f"{outside} ranges are extrapolated: they are not at {covered}, where the calibration was made")
    ratio = float(np.median(widths)) / focus.width
    if not 1.0 / STRANGE_WIDTH <= ratio <= STRANGE_WIDTH:
        told.append(
            f"doubtful: peaks are {ratio:.2g} times as wide as those of {calibration}, which may be a calibration of "
            f"another camera; {where}"
        )
    return told


def _accepted(result: DepthMap) -> tuple[Array, Array, Array]:
    """Lens position, range and width of every clear peak, of blocks and of the parts of split ones."""
    grids = [(result.blocks, result.blocks.accepted)]
    if result.parts is not None:
        grids.append((result.parts, result.used_parts()))
    found = []
    for grid, used in grids:
        assert grid.range_m is not None  # it was measured with a calibration
        found.append((grid.lens_position[used], grid.range_m[used], grid.width[used]))
    positions, ranges, widths = (np.concatenate(field) for field in zip(*found, strict=True))
    return positions, ranges, widths


def _why(beyond: int, missing: int) -> str:
    """Beyond the pole of h is beyond infinity; the others are too far to tell, or nearer than any lens can focus."""
    reasons = []
    if beyond:
        reasons.append(f"{beyond} are sharp where the lens is set to infinity or beyond")
    if beyond < missing:
        reasons.append(f"{missing - beyond} would be farther than {FARTHEST_M:g} m, or nearer than the lens itself")
    return ", ".join(reasons)


def _metres(focus: FocusFit, lens_position: float) -> str:
    range_m = h(focus, lens_position)
    return "no range" if range_m is None else f"{range_m:.2f} m"
