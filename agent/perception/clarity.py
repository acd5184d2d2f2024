"""How sharp an image is: Tenengrad, the mean energy of the 3x3 Sobel gradient, in blocks or over a disc.

T = mean of Gx^2 + Gy^2, Gx = Y * [[-1,0,1],[-2,0,2],[-1,0,1]], Gy its transpose, Y the 8-bit luminance, no threshold.
It is taken on the raw frame: an enhancement that looks at the whole picture changes its gain from one focus position
to the next, and so moves the peak. White noise of standard deviation s adds 24 s^2 to T, an offset that the peak fit
leaves free. The sums are sums of integers and exact in double precision.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]  # (height, width)


def luminance(image: NDArray[np.uint8]) -> Grey:
    """(height, width, 3) blue green red, or already grey -> (height, width)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]


def gradient_energy(grey: Grey) -> NDArray[np.float32]:
    """Gx^2 + Gy^2 of every pixel, (height, width); the image goes on as its own mirror beyond its border."""
    gx, gy = (g.astype(np.float32) for g in cv2.spatialGradient(grey, borderType=cv2.BORDER_REFLECT_101))
    return gx * gx + gy * gy  # at most 2.1e6: exact in single precision


def tenengrad_blocks(grey: Grey, block: int = 50) -> NDArray[np.float64]:
    """T of every whole block of `block` x `block` pixels -> (rows, cols), per pixel.

    Pixels right of and below the last whole block are unused. Raises ValueError for a block larger than the image.
    """
    rows, cols = grey.shape[0] // block, grey.shape[1] // block
    if rows == 0 or cols == 0:
        raise ValueError(f"a block of {block} px does not fit an image of {grey.shape[1]}x{grey.shape[0]} px")
    energy = gradient_energy(grey)[: rows * block, : cols * block]
    sums: NDArray[np.float64] = energy.reshape(rows, block, cols, block).sum(axis=(1, 3), dtype=np.float64)
    return sums / block**2


def tenengrad_disc(grey: Grey, centre_px: tuple[float, float], radius_px: float) -> tuple[float, float]:
    """T over the pixels whose centres lie in a disc, per pixel, and how many there are.

    `centre_px` is (u, v) in pixels of this image. A disc wholly outside gives (0.0, 0.0).
    """
    u, v = centre_px
    height, width = grey.shape
    left, right = max(0, int(np.ceil(u - radius_px))), min(width - 1, int(np.floor(u + radius_px)))
    top, bottom = max(0, int(np.ceil(v - radius_px))), min(height - 1, int(np.floor(v + radius_px)))
    if left > right or top > bottom:
        return 0.0, 0.0
    # One pixel more on each side, where there is one: gradients in the disc see their true neighbours.
    x0, y0 = max(0, left - 1), max(0, top - 1)
    energy = gradient_energy(np.ascontiguousarray(grey[y0 : bottom + 2, x0 : right + 2]))
    energy = energy[top - y0 : bottom + 1 - y0, left - x0 : right + 1 - x0]
    du, dv = np.arange(left, right + 1) - u, np.arange(top, bottom + 1) - v
    inside = du[None, :] ** 2 + dv[:, None] ** 2 <= radius_px**2
    area = int(np.count_nonzero(inside))
    return (float(energy.sum(where=inside, dtype=np.float64)) / area, float(area)) if area else (0.0, 0.0)
