"""How sharp an image is: Tenengrad, the mean energy of the 3x3 Sobel gradient, in blocks or over a disc.

T = mean of Gx^2 + Gy^2, Gx = Y * [[-1,0,1],[-2,0,2],[-1,0,1]], Gy its transpose, Y the 8-bit luminance, no threshold.
`modified` adds the same operator along both diagonals. (Aucamp names a modified Tenengrad and prints no formula; four
directions is what the literature mostly means.) White noise of standard deviation s adds 24 s^2 to T, 48 s^2 to the
modified one: an offset that the peak fit leaves free.

It is taken on the raw frame: an enhancement that looks at the whole picture changes its gain from one focus position
to the next, and so moves the peak. Luminance, gradient and sums are integers and made in one pass, row by row, so
that a frame is read from memory once; the results are exact.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Grey = NDArray[np.uint8]  # (height, width)
Edges = NDArray[np.int64]  # pixels at which the blocks of a grid begin, and the end of the last one

FLUSH_ROWS = 256  # rows of a column that an int32 holds: at most 4.2e6 a pixel
RING = 4  # luminance rows kept: three are looked at; a power of two makes the index cheap

kernel = njit(nogil=True, cache=True, error_model="numpy")


def luminance(image: NDArray[np.uint8]) -> Grey:
    """(height, width, 3) blue green red, or already grey -> (height, width)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]


def gradient_energy(grey: Grey) -> NDArray[np.float32]:
    """Gx^2 + Gy^2 of every pixel, (height, width); the image goes on as its own mirror beyond its border."""
    gx, gy = (g.astype(np.float32) for g in cv2.spatialGradient(grey, borderType=cv2.BORDER_REFLECT_101))
    return gx * gx + gy * gy  # at most 2.1e6: exact in single precision


def grid(length_px: int, block: int, scale: float = 1.0, centre_px: float | None = None) -> Edges:
    """Edges of the whole blocks along one side of an image, magnified about the principal point, in whole pixels.

    A lens that focuses nearer stands farther from the sensor, and its picture grows as v/f: blocks that grow with it
    keep their piece of the scene. `centre_px` is the principal point, the middle if not given. What the scale moves
    beyond the image is cut off. Raises ValueError for a block larger than the image.
    """
    if block > length_px:
        raise ValueError(f"a block of {block} px does not fit {length_px} px")
    middle = (length_px - 1) / 2 if centre_px is None else centre_px
    # Pixel k covers k - 1/2 to k + 1/2: an edge at the left of pixel k lies at k - 1/2.
    edges = middle + scale * (np.arange(0, length_px + 1, block) - 0.5 - middle) + 0.5
    whole: Edges = np.clip(np.rint(edges), 0, length_px).astype(np.int64)
    return whole


def tenengrad_grid(image: NDArray[np.uint8], rows: Edges, cols: Edges, modified: bool = False) -> NDArray[np.float64]:
    """T of every block of a grid -> (len(rows) - 1, len(cols) - 1), per pixel; 0 for a block without pixels.

    `image` is (height, width, 3) blue green red or (height, width) grey; edges rise and lie within it.
    """
    sums = np.zeros((len(rows) - 1, len(cols) - 1), np.int64)
    _blocks(_flat(image), _colours(image), rows, cols, modified, sums)
    means: NDArray[np.float64] = sums / np.maximum(np.outer(np.diff(rows), np.diff(cols)), 1)
    return means


def tenengrad_blocks(image: NDArray[np.uint8], block: int = 50, modified: bool = False) -> NDArray[np.float64]:
    """T of every whole block of `block` x `block` pixels -> (rows, cols), per pixel.

    Pixels right of and below the last whole block are unused. Raises ValueError for a block larger than the image.
    """
    height, width = image.shape[:2]
    return tenengrad_grid(image, grid(height, block), grid(width, block), modified)


def tenengrad_region(
    image: NDArray[np.uint8], inside: NDArray[np.bool_], modified: bool = False
) -> tuple[float, float]:
    """T over the pixels where `inside` (height, width) is true, per pixel, and how many there are; (0.0, 0.0): none."""
    area = int(np.count_nonzero(inside))
    if area == 0:
        return 0.0, 0.0
    total = _region(_flat(image), _colours(image), np.ascontiguousarray(inside), modified)
    return float(total) / area, float(area)


def tenengrad_disc(
    image: NDArray[np.uint8], centre_px: tuple[float, float], radius_px: float, modified: bool = False
) -> tuple[float, float]:
    """T over the pixels whose centres lie in a disc, per pixel, and how many there are.

    `centre_px` is (u, v) in pixels of this image. A disc wholly outside gives (0.0, 0.0).
    """
    u, v = centre_px
    height, width = image.shape[:2]
    # One pixel more on each side, where there is one: gradients in the disc see their true neighbours.
    x0, x1 = max(0, int(np.ceil(u - radius_px)) - 1), min(width, int(np.floor(u + radius_px)) + 2)
    y0, y1 = max(0, int(np.ceil(v - radius_px)) - 1), min(height, int(np.floor(v + radius_px)) + 2)
    if x0 >= x1 or y0 >= y1:
        return 0.0, 0.0
    inside = (np.arange(x0, x1) - u) ** 2 + (np.arange(y0, y1)[:, None] - v) ** 2 <= radius_px**2
    return tenengrad_region(image[y0:y1, x0:x1], inside, modified)


def _flat(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(height, width * colours): with one index LLVM makes vector code of the way from colours to luminance."""
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)


def _colours(image: NDArray[np.uint8]) -> int:
    return 3 if image.ndim == 3 else 1


@kernel
def _blocks(image: Any, colours: int, rows: Edges, cols: Edges, modified: bool, sums: Any) -> None:
    """Add Gx^2 + Gy^2 of every pixel to the block that it lies in; sums (len(rows) - 1, len(cols) - 1) int64."""
    width = image.shape[1] // colours
    ring = np.empty((RING, width + 2), np.int16)
    columns = np.zeros(width, np.int32)  # of the rows since the last flush
    for k in range(rows.size - 1):
        for y in range(rows[k], rows[k + 1]):
            if y == rows[0]:
                _luma(image, colours, y - 1, ring)
                _luma(image, colours, y, ring)
            _luma(image, colours, y + 1, ring)
            above, here, below = ring[(y - 1) % RING], ring[y % RING], ring[(y + 1) % RING]
            _add_energy(above, here, below, columns)
            if modified:
                _add_diagonals(above, here, below, columns)
            if y + 1 == rows[k + 1] or (y - rows[k]) % FLUSH_ROWS == FLUSH_ROWS - 1:
                for c in range(cols.size - 1):
                    total = np.int64(0)
                    for energy in columns[cols[c] : cols[c + 1]]:
                        total += energy
                    sums[k, c] += total
                columns[:] = 0


@kernel
def _region(image: Any, colours: int, inside: Any, modified: bool) -> np.int64:
    """Sum of the energy where `inside` (height, width) is true."""
    width = image.shape[1] // colours
    ring = np.empty((RING, width + 2), np.int16)
    energy, total = np.empty(width, np.int32), np.int64(0)
    _luma(image, colours, -1, ring)
    _luma(image, colours, 0, ring)
    for y in range(image.shape[0]):
        energy[:] = 0
        _luma(image, colours, y + 1, ring)
        above, here, below = ring[(y - 1) % RING], ring[y % RING], ring[(y + 1) % RING]
        _add_energy(above, here, below, energy)
        if modified:
            _add_diagonals(above, here, below, energy)
        row = inside[y]
        for x in range(width):
            total += energy[x] if row[x] else np.int32(0)
    return total


@kernel
def _luma(image: Any, colours: int, y: int, ring: Any) -> None:
    """Luminance of image row y, mirrored at all borders, into its place in the ring; OpenCV's integer weights."""
    height, width = image.shape[0], image.shape[1] // colours
    source = image[_mirrored(y, height)]
    padded = ring[y % RING]
    grey = padded[1:-1]
    if colours == 3:
        for x in range(width):
            weighted = np.int32(3735) * source[3 * x] + np.int32(19235) * source[3 * x + 1]
            weighted += np.int32(9798) * source[3 * x + 2]
            grey[x] = (np.int32(weighted) + np.int32(1 << 14)) >> np.int32(15)
    else:
        for x in range(width):
            grey[x] = source[x]
    padded[0], padded[width + 1] = grey[_mirrored(-1, width)], grey[_mirrored(width, width)]


@kernel
def _mirrored(k: int, size: int) -> int:
    """Index inside 0 to size - 1 for one that is at most one outside; the border itself is not repeated."""
    if size == 1:
        return 0
    return -k if k < 0 else 2 * size - 2 - k if k >= size else k


@kernel
def _add_energy(above: Any, here: Any, below: Any, energy: Any) -> None:
    """Add Gx^2 + Gy^2 of one row of pixels to energy (width,); the rows around it have a pixel more on either side.

    Slices instead of x + 1: an index that could be negative costs a branch, and eleven times the time.
    """
    nw, n, ne = above[:-2], above[1:-1], above[2:]
    w, e = here[:-2], here[2:]
    sw, s, se = below[:-2], below[1:-1], below[2:]
    for x in range(energy.size):
        gx = np.int16((ne[x] - nw[x]) + 2 * (e[x] - w[x]) + (se[x] - sw[x]))
        gy = np.int16((sw[x] - nw[x]) + 2 * (s[x] - n[x]) + (se[x] - ne[x]))
        energy[x] += np.int32(gx) * np.int32(gx) + np.int32(gy) * np.int32(gy)


@kernel
def _add_diagonals(above: Any, here: Any, below: Any, energy: Any) -> None:
    """Add the squares of the same operator turned by 45 degrees, both ways."""
    nw, n, ne = above[:-2], above[1:-1], above[2:]
    w, e = here[:-2], here[2:]
    sw, s, se = below[:-2], below[1:-1], below[2:]
    for x in range(energy.size):
        up = np.int16(2 * (ne[x] - sw[x]) + (n[x] - w[x]) + (e[x] - s[x]))
        down = np.int16(2 * (se[x] - nw[x]) + (s[x] - w[x]) + (e[x] - n[x]))
        energy[x] += np.int32(up) * np.int32(up) + np.int32(down) * np.int32(down)
