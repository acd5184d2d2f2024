"""Sweeps of a still camera's lens over views of the tank and over its wall, with the truth for every block.

Lens positions are equally spaced over the whole range, always from the lowest up: one direction, one hysteresis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from agent.experiments.still_camera import StillCamera, TankView
from agent.perception.clarity import grid
from agent.perception.depth_peaks import measure_growth
from agent.perception.depth_sweep import HOME_SETTLE_S, SETTLE_S, SWEEP_STEPS
from agent.process.command import Failed
from hw.camera.camera import Image, Roi

BLOCK_PX = 50  # the paper's
GROWTH_M = 0.5  # distance of the wall on which focus breathing is measured
FLAT = 0.2  # of the range: a block whose depth spreads less, 5 to 95 percent, has one depth that can be called its own
QUALITY = 0.998  # of a block's peak: leaves out most blocks astride an edge in depth, and few others
WATER_INDEX = 1.333

VIEWS = (
    TankView((0.30, 0.25, 0.12), 34.0, -8.0),  # the ball half a metre away, the corner behind it
    TankView((0.62, 0.28, 0.10), 62.0, -4.0),  # the ball close
    TankView((0.20, 0.85, 0.25), 8.0, -18.0),  # the stone, and the floor from near to far
    TankView((0.75, 0.85, 0.20), 20.0, -10.0),  # the wall, at an angle
)


class SweptView(NamedTuple):
    """One sweep over one view, and the truth for its blocks."""

    view: TankView
    lens_positions: Array  # (n,)
    images: list[Image]
    growth: float  # of the picture over the sweep, relative
    truth_m: Array  # (rows, cols) harmonic mean of a block's z-depths: blocks are sharp at their mean vergence
    flat: NDArray[np.bool_]  # (rows, cols)
    pixels_m: NDArray[np.float32]  # (height, width) z-depth of every pixel


def sweep_view(camera: StillCamera, view: TankView, growth: float) -> SweptView:
    """Sweep once; `growth` as measured on the wall."""
    camera.view = view
    images, rho = sweep(camera), lens_positions(camera)
    largest = rho[-1] if growth >= 0 else rho[0]  # blocks are squares in the largest picture
    pixels = camera.truth_m(float(largest))
    rows, cols = (len(grid(size, BLOCK_PX)) - 1 for size in pixels.shape)
    tiles = pixels[: rows * BLOCK_PX, : cols * BLOCK_PX].reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    blocks = tiles.transpose(0, 2, 1, 3).reshape(rows, cols, -1).astype(float)
    truth_m = truth_on(pixels, rows, cols, BLOCK_PX)
    nearest, farthest = np.quantile(blocks, (0.05, 0.95), axis=-1)
    flat = (farthest - nearest) / truth_m < FLAT
    return SweptView(view, np.array(rho, float), images, growth, truth_m, flat, pixels.astype(np.float32))


def truth_on(pixels_m: NDArray[Any], rows: int, cols: int, side_px: float) -> Array:
    """Harmonic mean (rows, cols) of the z-depths in squares of `side_px`, whose edges are rounded to whole pixels."""
    down, across = (np.rint(np.arange(count + 1) * side_px).astype(int) for count in (rows, cols))
    sums = np.add.reduceat(
        np.add.reduceat(1.0 / pixels_m[: down[-1], : across[-1]].astype(float), down[:-1]), across[:-1], 1
    )
    truth_m: Array = np.outer(np.diff(down), np.diff(across)) / sums
    return truth_m


def sweep(camera: StillCamera, roi: Roi | None = None) -> list[Image]:
    """The pictures of one sweep."""
    camera.set_focus(camera.focus_range().lowest)
    camera.read(roi, settle_s=HOME_SETTLE_S)
    images = []
    for lens_position in lens_positions(camera):
        camera.set_focus(lens_position)
        images.append(camera.read(roi, settle_s=SETTLE_S).image)
    return images


def lens_positions(camera: StillCamera) -> list[int]:
    """Those of every sweep."""
    limits = camera.focus_range()
    return [round(p) for p in np.linspace(limits.lowest, limits.highest, SWEEP_STEPS)]


def breathing(camera: StillCamera) -> float:
    """Growth of the picture over a sweep, on the wall. Raises Failed where it cannot be measured."""
    camera.view = facing_wall(GROWTH_M)
    growth = measure_growth(sweep(camera))
    if growth is None:
        raise Failed("the wall's pictures cannot be registered, so focus breathing is unknown; try another --seed")
    return growth


def facing_wall(u_m: float, tilt_deg: float = 0.0) -> TankView:
    """A view of the wall at the far end of the tank's x axis, `u_m` from it."""
    return TankView((1.5 - u_m, 0.6, 0.25), 0.0, tilt_deg)
