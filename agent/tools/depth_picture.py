"""A depth map as a picture, drawn by OpenCV: the library for figures takes longer to draw than the map to measure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from agent.perception.depth_sweep import DepthMap
from agent.perception.tracking.box import Box
from hw.camera.camera import Image

PANEL_PX = 640  # a panel's longer side, at most
LEFT_PX, TOP_PX, GAP_PX, BOTTOM_PX, BAR_PX, RIGHT_PX = 50, 34, 30, 30, 16, 110  # around the panels, and the scale
INK, LIGHT, GREY, RED = (40, 40, 40), (225, 225, 225), (165, 165, 165), (40, 40, 200)
HATCH_PX = 9  # from line to line of what has no distance
TICKS = 6  # along an axis, about
SHOWN = (1, 99)  # percent of the values between the ends of the scale: a few wrong ones shall not take all colours


def draw(result: DepthMap, path: Path, box: Box | None = None) -> None:
    """The picture, everywhere sharp, and beside it the map with its scale; hatched: no distance. Raises OSError."""
    height, width = result.sharp.shape[:2]
    scale = min(1.0, PANEL_PX / max(height, width))
    size = round(width * scale), round(height * scale)
    values, label = result.range_on_parts(), "z-depth in metres"
    if values is None or not np.isfinite(values).any():
        values, label = result.lens_position_on_parts(), "lens position of the clarity peak"
    right = LEFT_PX + size[0] + GAP_PX + LEFT_PX
    page = np.full((TOP_PX + size[1] + BOTTOM_PX, right + size[0] + RIGHT_PX, 3), 255, np.uint8)
    view = cv2.resize(result.sharp, size, interpolation=cv2.INTER_AREA)
    if box is not None:
        corners = [
            (round(scale * x), round(scale * y)) for x, y in ((box.x, box.y), (box.x + box.width, box.y + box.height))
        ]
        cv2.rectangle(view, corners[0], corners[1], RED, 2)
    limits = scale_of(values)
    drawn = coloured(values, scale * result.block_px / result.along, (size[1], size[0]), limits)
    for left, panel in ((LEFT_PX, view), (right, drawn)):
        page[TOP_PX : TOP_PX + size[1], left : left + size[0]] = panel
        for value, at in ticks(0.0, width, scale):
            text(page, f"{value:g}", (left + at, TOP_PX + size[1] + 18), "middle")
        for value, at in ticks(0.0, height, scale):
            text(page, f"{value:g}", (left - 6, TOP_PX + at + 4), "end")
    blocks = result.blocks.accepted
    split = f", {np.count_nonzero(result.used_parts())} parts of others" if result.used_parts().any() else ""
    text(page, "each part from its sharpest frame; pixels", (LEFT_PX, 22))
    text(page, f"{label}: {np.count_nonzero(blocks)} of {blocks.size} blocks{split}; hatched: none", (right, 22))
    if limits is not None:
        draw_scale(page[TOP_PX : TOP_PX + size[1], right + size[0] + 14 :], limits)
    done, encoded = cv2.imencode(".png", page)
    assert done  # of 8 bits it always is
    path.write_bytes(encoded.tobytes())


def scale_of(values: Array) -> tuple[float, float] | None:
    """Values at the ends of the scale; None where there are none."""
    shown = values[np.isfinite(values)]
    if shown.size == 0:
        return None
    low, high = np.percentile(shown, SHOWN)
    return float(low), float(high if high > low else low + max(abs(low), 1.0) * 1e-3)


def coloured(values: Array, square_px: float, size: tuple[int, int], limits: tuple[float, float] | None) -> Image:
    """One colour a square of `square_px`, hatched where NaN or where there is no square; size: (height, width)."""
    rows, cols = (((np.arange(length) + 0.5) / square_px).astype(int) for length in size)
    wide = np.full((max(rows[-1] + 1, values.shape[0]), max(cols[-1] + 1, values.shape[1])), np.nan)
    wide[: values.shape[0], : values.shape[1]] = values
    low, high = limits or (0.0, 1.0)
    level = np.clip((np.nan_to_num(wide, nan=low) - low) / (high - low), 0.0, 1.0)
    picture: Image = colour_map((255.0 * level).round().astype(np.uint8))[rows][:, cols]
    blank = np.isnan(wide)[rows][:, cols]
    picture[blank] = LIGHT
    picture[blank & (np.add.outer(np.arange(size[0]), np.arange(size[1])) % HATCH_PX == 0)] = GREY
    return picture


def colour_map(levels: NDArray[np.uint8]) -> Image:
    """0 to 255 (rows, cols) -> blue green red (rows, cols, 3)."""
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), np.uint8)


def draw_scale(place: Image, limits: tuple[float, float]) -> None:
    """The colours from the highest value down, with some of the values beside them."""
    height, (low, high) = len(place), limits
    levels = np.linspace(255, 0, height).round().astype(np.uint8)
    place[:, :BAR_PX] = colour_map(np.repeat(levels[:, None], BAR_PX, axis=1))
    for value, at in ticks(low, high, height / (high - low)):
        text(place, f"{value:g}", (BAR_PX + 6, height - 1 - at + 4))


def ticks(low: float, high: float, px_per_unit: float) -> Iterator[tuple[float, int]]:
    """Round values from low to high, and how many pixels from low each lies."""
    about = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(about))
    step = next(power * k for k in (1, 2, 5, 10) if power * k >= about)
    for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield round(k * step, 12), round((k * step - low) * px_per_unit)


def text(page: Image, words: str, at: tuple[int, int], anchor: str = "start") -> None:
    """Small dark letters, their left end, middle or right end at (x, y)."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.42
    (width, _), _ = cv2.getTextSize(words, font, size, 1)
    x = at[0] - {"start": 0, "middle": width // 2, "end": width}[anchor]
    cv2.putText(page, words, (x, at[1]), font, size, INK, 1, cv2.LINE_AA)
