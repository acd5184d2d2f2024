"""A sweep of the focus over whole frames of a robot in the water: where the clarity of each block has its peak.

The blocks are squares in the last frame. The others lie elsewhere, for the robot drifts and sways by some pixels while
its lens moves, and the picture grows: by how much it grows the calibration knows, and where it lies is found by phase
correlation of each frame with the one before, whose blur is nearly the same (Kuglin and Hines 1975). The pictures
themselves are never resampled, which would change their clarity.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.ranging.focus import MIN_POSITIONS, phase_sigma
from agent.core.step_io import BlockPeaks, SweepPlan
from agent.perception.clarity.breathing import GROWTH_POWER
from agent.perception.clarity.clarity import areas, tenengrad_sums
from agent.perception.clarity.peaks import block_peaks

Image = NDArray[np.uint8]
SMALL = 4  # frames are compared at so many times fewer pixels
MIN_RESPONSE = 0.05  # of phase correlation: below, nothing is said of how the frames lie
MOST_PX = 40.0  # between frames that follow each other; more is no drift
MIN_RISE = 20.0  # of a block's clarity above its median: noise of two grey levels has 96 everywhere, but no rise
MIN_QUALITY = 0.96  # of a block's peak: over many blocks a wrong one costs more than a missing one


class BlockSweep:
    """Frames are given in as they come; the lens positions of a plan rise."""

    def __init__(self, plan: SweepPlan, camera: CameraFit) -> None:
        self._plan, self._camera = plan, camera
        self._frames: list[tuple[Image, int, int]] = []  # picture, lens position, time
        self._shifts: list[NDArray[np.float64]] = []  # of each against the one before, px
        self._before: NDArray[np.float32] | None = None

    def add(self, image: Image, lens_position: int, t_ns: int) -> None:
        """One whole frame, grey or in colour."""
        small = _reduced(image)
        shift = np.zeros(2)
        if self._before is not None:
            window = cv2.createHanningWindow((small.shape[1], small.shape[0]), cv2.CV_32F)
            (x, y), response = cv2.phaseCorrelate(self._before, small, window)
            if response > MIN_RESPONSE and np.hypot(x, y) * SMALL < MOST_PX:
                shift = SMALL * np.array([x, y])
        self._before = small
        self._shifts.append(shift)
        self._frames.append((image.copy(), lens_position, t_ns))

    def peaks(self) -> BlockPeaks:
        """What all frames so far show, counted in the blocks of the last."""
        side = self._plan.block_px
        height, width = self._frames[-1][0].shape[:2]
        rows, cols = height // side, width // side
        _, focus, t_ns = self._frames[-1]
        told = BlockPeaks(t_ns=t_ns, sweep=self._plan.sweep, focus=focus, block_px=side, cols=cols, rows=rows)
        positions = np.array([float(lens_position) for _, lens_position, _ in self._frames])
        if np.unique(positions).size < MIN_POSITIONS:
            return told
        clarity, whole = self._clarity(rows, cols)
        rise = clarity.max(axis=1) - np.median(clarity, axis=1)
        asked = np.flatnonzero((rise >= MIN_RISE) & whole)
        if not asked.size:
            return told
        found = block_peaks(positions, np.ascontiguousarray(clarity[asked]))
        sigma = np.hypot(found.sigma, phase_sigma(found.width, side * side))
        clear = found.accepted & (found.quality >= MIN_QUALITY) & np.isfinite(sigma)
        peaks = tuple(
            (int(k), float(position), float(s))
            for k, position, s in zip(asked[clear], found.lens_position[clear], sigma[clear], strict=True)
        )
        return BlockPeaks(**{**{name: getattr(told, name) for name in told.__struct_fields__}, "peaks": peaks})

    def _clarity(self, rows: int, cols: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Clarity per pixel (rows * cols, n), and which blocks lie whole in each frame."""
        side, n = self._plan.block_px, len(self._frames)
        height, width = self._frames[-1][0].shape[:2]
        f_last = at_lens_position(self._camera, self._frames[-1][1]).f_px
        off, curves, whole = np.zeros(2), np.empty((rows * cols, n)), np.ones((rows, cols), bool)
        for k in range(n - 1, -1, -1):
            image, lens_position, _ = self._frames[k]
            scale = at_lens_position(self._camera, lens_position).f_px / f_last
            xs, ys = (
                c + shift + scale * (np.arange(count + 1) * side - 0.5 - c) + 0.5
                for c, shift, count in ((self._camera.cx_px, off[0], cols), (self._camera.cy_px, off[1], rows))
            )
            whole &= ((ys[:-1] >= -1) & (ys[1:] <= height + 1))[:, None] & (xs[:-1] >= -1) & (xs[1:] <= width + 1)
            row_edges, col_edges = (
                np.clip(np.rint(edges), 0, size).astype(np.int64) for edges, size in ((ys, height), (xs, width))
            )
            mean = tenengrad_sums(image, row_edges, col_edges) / areas(row_edges, col_edges)
            curves[:, k] = (mean * scale**GROWTH_POWER).ravel()
            # The frame before lies elsewhere by this frame's own shift, and by what its growth moved of that.
            off = off - self._shifts[k]
        return curves, whole.ravel()


def _reduced(image: Image) -> NDArray[np.float32]:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    height, width = grey.shape
    small = cv2.resize(grey, (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA)
    return small.astype(np.float32)
