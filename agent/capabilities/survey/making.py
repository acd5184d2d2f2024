"""The clarity peaks of a sweep's blocks, and where the camera was, as a keyframe."""

from __future__ import annotations

import math

from agent.capabilities.survey.grid import SIGMA_AT_M, SIGMA_UNIT_MM
from agent.capabilities.survey.rays import block_slopes, quaternion
from agent.core.capability_messages import (
    BEND_ONE,
    MOST_BLOCKS,
    PX_ONE,
    UNIT_M,
    Blocks,
    Frame,
    Lens,
    place_of,
    quantised,
)
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, Eye, at_lens_position, to_world
from agent.core.ranging.focus import at_tilt, h, lens_position, phase_sigma, range_variance
from agent.core.step_io import BlockPeaks

ACROSS, DOWN = 25, 19
HULL_M, HULL_HIGH_M = 0.21, 0.12  # around a robot's centre: its ring and hull, and what neither knows of where it is
NOISIER = 1.4  # than the grid alone are blocks of a robot that sways: 1.3 to 1.5 in the twin


def block_px(camera: CameraFit) -> int:
    """Side of the blocks of a picture: as many as a keyframe can hold."""
    side = max(camera.width_px // ACROSS, camera.height_px // DOWN, 8)
    while (camera.width_px // side) * (camera.height_px // side) > MOST_BLOCKS:
        side += 1
    return side


def lens_of(camera: CameraFit, lens_position: float | None) -> tuple[Lens, int]:
    """Where the blocks of a picture look, and how many rows of them there are; blocks begin at the upper left."""
    side, at = block_px(camera), at_lens_position(camera, lens_position)
    # A pixel's centre is a whole number, the corner of the first block half a pixel before.
    lens = Lens(
        round(at.f_px * PX_ONE),
        round((at.cx_px + 0.5) * PX_ONE),
        round((at.cy_px + 0.5) * PX_ONE),
        round(at.bend * BEND_ONE),
        round(at.ahead_m / UNIT_M),
        side,
        camera.width_px // side,
    )
    return lens, camera.height_px // side


def sigma_of(calibration: Calibration) -> int:
    """What is expected of a block's depth at SIGMA_AT_M, in units of SIGMA_UNIT_MM: by the grid of its pixels, the
    lens's noise, and the calibration."""
    fit, side = calibration.focus, block_px(calibration.camera)
    variance = range_variance(fit, lens_position(fit, SIGMA_AT_M), phase_sigma(fit.width, side * side))
    return min(max(round(NOISIER * 1000.0 * math.sqrt(sum(variance)) / SIGMA_UNIT_MM), 1), 10**5)


def frame_of(
    peaks: BlockPeaks,
    eye: Eye,
    hulls_m: tuple[Vector, ...],
    calibration: Calibration,
    origin: str,
    incarnation: int,
    number: int,
) -> Frame | None:
    """The keyframe of one sweep; None where no block has a depth. What is seen where another robot is (hulls_m) is that
    robot, which is elsewhere soon, and left out."""
    lens, rows = lens_of(calibration.camera, peaks.focus)
    if (peaks.cols, peaks.block_px, peaks.rows) != (lens.cols, lens.block, rows):
        return None
    forward = eye.rotation[2][2]  # of the optical axis upwards
    fit = at_tilt(calibration.focus, math.asin(min(max(forward, -1.0), 1.0)))
    count = lens.cols * rows
    slopes, ahead_m = block_slopes(lens, lens.cols * rows), lens.ahead * UNIT_M
    depths: list[float | None] = [None] * count
    sigmas = [0.0] * count
    for k, position, sigma in peaks.peaks:
        if k < count and (z_m := h(fit, position)) is not None:
            x, y = slopes[k]
            there = to_world(eye, (x * (z_m - ahead_m), y * (z_m - ahead_m), z_m))
            if any(_is_at(there, hull_m) for hull_m in hulls_m):
                continue
            depths[k], sigmas[k] = z_m, math.sqrt(sum(range_variance(fit, position, sigma)))
    if all(z_m is None for z_m in depths):
        return None
    packed = quantised(Blocks(lens.cols, tuple(depths), tuple(sigmas)))
    place, turn = place_of(eye.position_m), quaternion(eye.rotation)
    return Frame(origin, incarnation, number, place, turn, lens, *packed)


def _is_at(place_m: Vector, hull_m: Vector) -> bool:
    return math.dist(place_m[:2], hull_m[:2]) < HULL_M and abs(place_m[2] - hull_m[2]) < HULL_HIGH_M
