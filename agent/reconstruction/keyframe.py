"""What one whole sweep of the focus says: a picture that is sharp everywhere, and how far each pixel is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.core.ranging.camera_model import Calibration, at_lens_position
from agent.core.ranging.focus import Array, at_tilt
from agent.perception.clarity.breathing import measure_growth
from agent.perception.depth_sweep import clarity_of, measure
from agent.reconstruction.camera import Camera, shrunk
from agent.reconstruction.composite import Picture, composite, shrunk_frame
from agent.reconstruction.focus_maps import FocusMap, focus_map
from hw.camera.camera import Image

BLOCKS_ACROSS = 25  # blocks of 50 px in a picture of 1280: enough texture for a peak, enough of them for a surface
PICTURE_WIDTH = 320  # about what pictures are reduced to: there what is out of focus by a step looks sharp


class Swept(NamedTuple):
    """A keyframe but for where it was taken."""

    camera: Camera
    picture: Picture
    depth: FocusMap


def reduction(width_px: int) -> int:
    """How many times smaller pictures are made."""
    return max(1, round(width_px / PICTURE_WIDTH))


def keyframe(
    images: Sequence[Image],
    lens_positions: Array,
    calibration: Calibration,
    tilt_rad: float,
    corner_px: tuple[int, int] = (0, 0),
    grown_about_px: tuple[float, float] | None = None,
    sharp_everywhere: bool = True,
) -> Swept:
    """Frames of one sweep, in the order of their lens positions (n,); the camera looks up by tilt_rad.

    corner_px: upper left corner of the frames in the whole picture, if they show a part of it. grown_about_px: what
    stays where it is in the frames as they grow; None: the optical axis.
    sharp_everywhere: else the picture is the one frame that is sharp in most of it. Raises ConfigError for frames that
    are smaller than a block.
    """
    height, width = images[0].shape[:2]
    times, block = reduction(calibration.camera.width_px), max(8, calibration.camera.width_px // BLOCKS_ACROSS)
    block = min(block - block % 2, height, width)
    growth = growth_of(images, lens_positions, calibration)
    swept = clarity_of(list(images), lens_positions, block, growth, split=True)
    focus = at_tilt(calibration.focus, tilt_rad)
    found = measure(swept, block, focus)
    fit = at_lens_position(calibration.camera, float(lens_positions[swept.reference]))
    whole = Camera(fit.f_px, fit.cx_px - corner_px[0], fit.cy_px - corner_px[1], fit.bend, fit.ahead_m, width, height)
    size = 1.0 + growth * (lens_positions - lens_positions[0]) / (lens_positions[-1] - lens_positions[0])
    size = size / size[swept.reference]
    centre, gamma = grown_about_px or (whole.cx_px, whole.cy_px), calibration.camera.gamma
    finest = swept.clarity if swept.finer is None else swept.finer.parts
    if sharp_everywhere:
        picture = composite(images, size, centre, finest, block / found.along, times, gamma)
    else:
        n = int(np.bincount(finest.argmax(axis=0).ravel()).argmax())
        picture = shrunk_frame(images[n], float(size[n]), centre, times, gamma)
    camera = shrunk(whole, times)
    return Swept(camera, picture, focus_map(found, focus, times, (camera.width, camera.height)))


def growth_of(images: Sequence[Image], lens_positions: Array, calibration: Calibration) -> float:
    """Relative growth of the picture over the sweep, as calibrated; measured where nobody did, 0 where it cannot be."""
    breathing = calibration.camera.breathing
    if breathing == 0.0:
        return measure_growth(images) or 0.0
    first, last = (at_lens_position(calibration.camera, float(lens_positions[n])).f_px for n in (0, -1))
    return last / first - 1.0
