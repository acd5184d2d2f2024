"""Windows of pictures along affine maps, and where one is most like another: zero-mean normalised cross correlation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Floats
from hw.compiled import compiled

LEAST_TEXTURE = 1e-5  # variance of tones, 0 to 1: a standard deviation of 0.3 %

kernel = compiled(error_model="numpy")
quick = compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})


@kernel
def square(side: int) -> Floats:
    return np.empty((side, side))


@kernel
def read(
    picture: NDArray[np.float32], width: int, height: int, u: float, v: float,
    across: tuple[float, float], down: tuple[float, float], out: Floats,
) -> None:  # fmt: skip
    """Fill out (odd, odd) from about (u, v), a column on by `across`, a row on by `down`; NaN beyond the rim."""
    half = out.shape[0] // 2
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            x = u + (j - half) * across[0] + (i - half) * down[0]
            y = v + (j - half) * across[1] + (i - half) * down[1]
            if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                out[i, j] = math.nan
                continue
            a, b = int(y), int(x)
            above = picture[a, b] + (x - b) * (picture[a, b + 1] - picture[a, b])
            below = picture[a + 1, b] + (x - b) * (picture[a + 1, b + 1] - picture[a + 1, b])
            out[i, j] = above + (y - a) * (below - above)


@quick
def correlate(own: Floats, wide: Floats, alike: Floats) -> None:
    """Fill alike: ZNCC of a window with each of its size in a wider one; -1 where that has a NaN, or no texture."""
    side = own.shape[0]
    n = float(side * side)
    mean, texture = 0.0, 0.0
    for i in range(side):
        for j in range(side):
            mean += own[i, j] / n
    for i in range(side):
        for j in range(side):
            texture += (own[i, j] - mean) ** 2
    for a in range(alike.shape[0]):
        for b in range(alike.shape[1]):
            total, squares, product = 0.0, 0.0, 0.0
            for i in range(side):
                for j in range(side):
                    value = wide[a + i, b + j]
                    total += value
                    squares += value * value
                    product += value * (own[i, j] - mean)
            rest = squares - total * total / n
            textured = rest > LEAST_TEXTURE * n and texture > LEAST_TEXTURE * n
            alike[a, b] = product / math.sqrt(texture * rest) if textured else -1.0


@kernel
def top(alike: Floats) -> tuple[int, int]:
    """Row and column of the most alike."""
    row, col = 0, 0
    for i in range(alike.shape[0]):
        for j in range(alike.shape[1]):
            if alike[i, j] > alike[row, col]:
                row, col = i, j
    return row, col


@kernel
def elsewhere(alike: Floats, row: int, col: int) -> float:
    """The most that is not beside (row, col)."""
    best = -1.0
    for i in range(alike.shape[0]):
        for j in range(alike.shape[1]):
            if (abs(i - row) > 2 or abs(j - col) > 2) and alike[i, j] > best:
                best = alike[i, j]
    return best


@kernel
def summit(alike: Floats, row: int, col: int) -> tuple[float, float]:
    """Row and column with parabolas through the neighbours; not for the rim."""
    here = alike[row, col]
    down = _vertex(alike[row - 1, col], here, alike[row + 1, col])
    return row + down, col + _vertex(alike[row, col - 1], here, alike[row, col + 1])


@kernel
def _vertex(before: float, here: float, after: float) -> float:
    curve = before + after - 2.0 * here
    return 0.5 * (before - after) / curve if curve < 0.0 and before > -0.9 and after > -0.9 else 0.0
