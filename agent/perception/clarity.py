"""How sharp an image is: Tenengrad, the mean energy of the 3x3 Sobel gradient, in blocks or over a disc.

T = mean of Gx^2 + Gy^2, Gx = Y * [[-1,0,1],[-2,0,2],[-1,0,1]], Gy its transpose, Y the 8-bit luminance, no threshold.
White noise of standard deviation s adds 24 s^2 to T: an offset that the peak fit leaves free.

It is taken on the raw frame: an enhancement that looks at the whole picture changes its gain from one lens position
to the next, and so moves the peak. Luminance, gradient and sums are integers, so the results are exact. They are made
band by band, a few rows that stay in the processor's nearest cache, so that a frame is read from memory once; each
step has a loop of its own, over arrays of one narrow type, which is what LLVM turns into the widest vectors.

Clarity of a target is taken well inside it: its silhouette is sharp at another lens position than its skin, and what is
behind it at a third. The peaks of all blocks of a sweep are fitted at compiled speed.
"""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import INNER_DISC
from agent.core.ranging.focus import CONVERGED, REFINEMENTS, WIDTHS, Array, Method, Peaks, Solved, fit_peaks
from hw.camera.camera import Frame, Roi
from hw.compiled import compiled

Edges = NDArray[np.int64]  # pixels at which the blocks of a grid begin, and the end of the last one
Sums = NDArray[np.int64]  # (rows, cols), a whole number for each block

BAND = 2  # rows worked on at once; of eight, reading comes in bursts that the arithmetic does not hide
FLUSH_ROWS = 256  # rows of a column that an int32 holds: at most 4.2e6 a pixel
EVERYWHERE = np.empty((0, 0), np.bool_)  # no region: every pixel counts

kernel = compiled(error_model="numpy")


def grid(length_px: int, block: int, scale: float = 1.0, centre_px: float | None = None, cuts: int = 1) -> Edges:
    """Edges of the whole blocks along one side of an image, magnified about the principal point, in whole pixels.

    A lens that focuses nearer stands farther from the sensor, and its picture grows as v/f: blocks that grow with it
    keep their piece of the scene. `centre_px` is the principal point, the middle if not given. What the scale moves
    beyond the image is cut off. `cuts`, a power of two, cuts each block into so many cells, whose edges hold those of
    the blocks. Raises ValueError for a block larger than the image.
    """
    if block > length_px:
        raise ValueError(f"a block of {block} px does not fit {length_px} px")
    middle = (length_px - 1) / 2 if centre_px is None else centre_px
    # Pixel k covers k - 1/2 to k + 1/2: an edge at the left of pixel k lies at k - 1/2.
    edges = middle + scale * (np.arange(length_px // block * cuts + 1) * (block / cuts) - 0.5 - middle) + 0.5
    whole: Edges = np.clip(np.rint(edges), 0, length_px).astype(np.int64)
    return whole


def tenengrad_grid(image: NDArray[np.uint8], rows: Edges, cols: Edges) -> NDArray[np.float64]:
    """T of every block of a grid -> (len(rows) - 1, len(cols) - 1), per pixel; 0 for a block without pixels.

    `image` is (height, width, 3) blue green red or (height, width) grey; edges rise and lie within it.
    """
    means: NDArray[np.float64] = tenengrad_sums(image, rows, cols) / areas(rows, cols)
    return means


def tenengrad_sums(image: NDArray[np.uint8], rows: Edges, cols: Edges) -> Sums:
    """Gx^2 + Gy^2 over all pixels of every block of a grid: those of a block's cells add up to its own, exactly."""
    sums = np.empty((len(rows) - 1, len(cols) - 1), np.int64)
    _sums(_flat(image), _colours(image), rows, cols, EVERYWHERE, sums)
    return sums


def areas(rows: Edges, cols: Edges) -> Sums:
    """Pixels of every block of a grid, at least 1."""
    pixels: Sums = np.maximum((rows[1:] - rows[:-1])[:, None] * (cols[1:] - cols[:-1]), 1)
    return pixels


def tenengrad_blocks(image: NDArray[np.uint8], block: int = 50) -> NDArray[np.float64]:
    """T of every whole block of `block` x `block` pixels -> (rows, cols), per pixel.

    Pixels right of and below the last whole block are unused. Raises ValueError for a block larger than the image.
    """
    height, width = image.shape[:2]
    return tenengrad_grid(image, grid(height, block), grid(width, block))


def tenengrad_region(image: NDArray[np.uint8], inside: NDArray[np.bool_]) -> tuple[float, float]:
    """T over the pixels where `inside` (height, width) is true, per pixel, and how many there are; (0.0, 0.0): none."""
    area = int(np.count_nonzero(inside))
    if area == 0:
        return 0.0, 0.0
    rows, cols = (np.array([0, size]) for size in inside.shape)  # one block
    total = np.empty((1, 1), np.int64)
    _sums(_flat(image), _colours(image), rows, cols, np.ascontiguousarray(inside), total)
    return float(total[0, 0]) / area, float(area)


def tenengrad_disc(image: NDArray[np.uint8], centre_px: tuple[float, float], radius_px: float) -> tuple[float, float]:
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
    return tenengrad_region(image[y0:y1, x0:x1], inside)


def _flat(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(height, width * colours): with one index LLVM makes vector code of the way from colours to luminance."""
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)


def _colours(image: NDArray[np.uint8]) -> int:
    return 3 if image.ndim == 3 else 1


@compiled("void(u1[:,::1], i8, i8[::1], i8[::1], b1[:,::1], i8[:,::1])", error_model="numpy")
def _sums(image: Any, colours: int, rows: Edges, cols: Edges, inside: Any, sums: Any) -> None:
    """Energy of each block of the grid: sums (len(rows) - 1, len(cols) - 1) int64.

    inside: (height, width), the pixels that count; all of them if it is empty.
    """
    width = image.shape[1] // colours
    stride = width + 2  # a row with its mirrored neighbours
    band = np.empty((BAND + 2) * stride, np.int16)  # luminance from the row above the band to the row below it
    gx, gy = np.empty(BAND * stride, np.int16), np.empty(BAND * stride, np.int16)
    b, g, r = np.empty(width, np.uint8), np.empty(width, np.uint8), np.empty(width, np.uint8)
    columns, waiting = np.zeros(width, np.int32), 0  # energy of so many rows that has not reached the sums
    sums[:] = 0
    for k in range(rows.size - 1):
        for top in range(rows[k], rows[k + 1], BAND):
            height = min(BAND, rows[k + 1] - top)
            known = 0 if top == rows[0] else 2  # rows that the band before has left
            for row in range(known, height + 2):
                source, at = image[_mirrored(top - 1 + row, image.shape[0])], row * stride + 1
                if colours == 3:
                    _split(source, b, g, r)
                    _mix(b, g, r, band[at : at + width])
                else:
                    _copy(source, band[at : at + width])
                band[at - 1], band[at + width] = band[at + _mirrored(-1, width)], band[at + _mirrored(width, width)]
            size = height * stride - 2
            _gradient(band, stride, gx[:size], gy[:size])
            for row in range(height):
                at = row * stride
                if inside.size:
                    _keep(inside[top + row], gx[at : at + width], gy[at : at + width])
                _add_squares(gx[at : at + width], gy[at : at + width], columns)
            _copy(band[height * stride : (height + 2) * stride], band[: 2 * stride])
            waiting += height
            if waiting > FLUSH_ROWS - BAND or top + height == rows[k + 1]:
                _flush(columns, cols, sums[k])
                waiting = 0


@kernel
def _copy(source: Any, to: Any) -> None:
    for x in range(to.size):
        to[x] = source[x]


@kernel
def _split(source: Any, b: Any, g: Any, r: Any) -> None:
    """Blue green red of one row, (3 width,) -> one plane each, (width,)."""
    for x in range(b.size):
        b[x] = source[3 * x]
        g[x] = source[3 * x + 1]
        r[x] = source[3 * x + 2]


@kernel
def _mix(b: Any, g: Any, r: Any, grey: Any) -> None:
    """Luminance with OpenCV's integer weights; all (width,)."""
    for x in range(grey.size):
        weighted = np.int32(3735) * b[x] + np.int32(19235) * g[x]
        weighted += np.int32(9798) * r[x]
        grey[x] = (np.int32(weighted) + np.int32(1 << 14)) >> np.int32(15)


@kernel
def _mirrored(k: int, size: int) -> int:
    """Index inside 0 to size - 1 for one that is at most one outside; the border itself is not repeated."""
    if size == 1:
        return 0
    return -k if k < 0 else 2 * size - 2 - k if k >= size else k


@kernel
def _gradient(band: Any, stride: int, gx: Any, gy: Any) -> None:
    """Gx and Gy of the rows of a band but its first and last; what falls between two rows means nothing.

    Slices instead of x + 1: an index that could be negative costs a branch, and eleven times the time.
    """
    nw, n, ne = band, band[1:], band[2:]
    w, e = band[stride:], band[stride + 2 :]
    sw, s, se = band[2 * stride :], band[2 * stride + 1 :], band[2 * stride + 2 :]
    for x in range(gx.size):
        falling, rising = np.int16(se[x] - nw[x]), np.int16(ne[x] - sw[x])
        gx[x] = falling + rising + 2 * (e[x] - w[x])
        gy[x] = falling - rising + 2 * (s[x] - n[x])


@kernel
def _keep(inside: Any, gx: Any, gy: Any) -> None:
    """No gradient outside a region: all three (width,)."""
    for x in range(gx.size):
        gx[x] *= inside[x]
        gy[x] *= inside[x]


@kernel
def _add_squares(gx: Any, gy: Any, columns: Any) -> None:
    """Add Gx^2 + Gy^2 of one row of pixels to columns (width,)."""
    for x in range(columns.size):
        columns[x] += np.int32(gx[x]) * np.int32(gx[x]) + np.int32(gy[x]) * np.int32(gy[x])


@kernel
def _flush(columns: Any, cols: Edges, sums: Any) -> None:
    """Add the columns of each block to its sum, and empty them."""
    for c in range(cols.size - 1):
        total = np.int64(0)
        for energy in columns[cols[c] : cols[c + 1]]:
            total += energy
        sums[c] += total
    columns[:] = 0


# --- clarity of a target, and the part of the next frame to read ---

INNER_BOX = 0.5  # share of a box's width and height: a thing rarely fills the corners of its box
ROI_MARGIN = 1.15  # of the ball's radius, and
ROI_BORDER_PX = 24  # the blur at the end of a tracking sweep

Clarity = tuple[float | None, float | None]  # per pixel, and over how many; None where the frame shows none of it
UNSEEN: Clarity = (None, None)


class Sized(Protocol):
    """A target that was found: it has the size of a box, or the radius of a ball."""

    @property
    def size_px(self) -> tuple[float, float] | None: ...
    @property
    def radius_px(self) -> float | None: ...


def around(centre_px: tuple[float, float] | None, radius_px: float | None, size: tuple[int, int]) -> Roi | None:
    """The part of a frame that holds a ball, its outline's blur and a little motion; None: the whole frame.

    A target that is no ball has no radius, and its tracker compares whole frames.
    """
    if centre_px is None or radius_px is None:
        return None
    half = ROI_MARGIN * radius_px + ROI_BORDER_PX
    left, top = (max(0, int(c - half)) for c in centre_px)
    right, bottom = (min(s, int(c + half) + 1) for c, s in zip(centre_px, size, strict=True))
    if left + 16 > right or top + 16 > bottom or (right - left, bottom - top) == size:
        return None
    return Roi(left, top, right - left, bottom - top)


def prepare() -> None:
    """Load the compiled code now, which takes 0.3 s of a core, so that the first frame is not late for it."""
    frame = Frame(0, 0, np.zeros((16, 16, 3), np.uint8), Roi(0, 0, 16, 16))
    disc_clarity(frame, (8.0, 8.0), 8.0)
    box_clarity(frame, (8.0, 8.0), (16.0, 16.0))


def disc_clarity(frame: Frame, centre_px: tuple[float, float], radius_px: float) -> Clarity:
    """Clarity of the raw luminance on a ball's inner disc."""
    x, y, radius = centre_px[0] - frame.roi.x, centre_px[1] - frame.roi.y, INNER_DISC * radius_px
    left, top = max(0, int(x - radius) - 2), max(0, int(y - radius) - 2)
    part: NDArray[np.uint8] = frame.image[top : int(y + radius) + 4, left : int(x + radius) + 4]
    if min(part.shape[:2]) < 3:
        return UNSEEN
    clarity, area_px = tenengrad_disc(part, (x - left, y - top), radius)
    return (clarity, area_px) if area_px else UNSEEN


def box_clarity(frame: Frame, centre_px: tuple[float, float], size_px: tuple[float, float]) -> Clarity:
    """Clarity of the raw luminance on the inner part of a box, as far as the frame shows it; whole pixels."""
    (left, right), (top, bottom) = (
        _span(centre - start, INNER_BOX * side, length)
        for centre, start, side, length in zip(
            centre_px, frame.roi[:2], size_px, (frame.image.shape[1], frame.image.shape[0]), strict=True
        )
    )
    if min(right - left, bottom - top) < 3:
        return UNSEEN
    clarity = tenengrad_grid(frame.image, np.array([top, bottom]), np.array([left, right]))
    return float(clarity[0, 0]), float((right - left) * (bottom - top))


def target_clarity(frame: Frame, centre_px: tuple[float, float], found: Sized, first: Sized | None) -> Clarity:
    """Clarity over a part as large as in the sweep's first frame: areas stay comparable while the blur changes."""
    if found.size_px is not None:
        return box_clarity(frame, centre_px, (first and first.size_px) or found.size_px)
    assert found.radius_px is not None  # a ball
    return disc_clarity(frame, centre_px, (first and first.radius_px) or found.radius_px)


def _span(middle: float, length: float, limit: int) -> tuple[int, int]:
    """First pixel and the one behind the last, of `length` around `middle`, within 0 to `limit`."""
    first = round(middle + 0.5 - length / 2)
    return max(0, first), min(limit, first + round(length))


# --- peaks of all blocks of a sweep ---
#
# The matched fit of agent.core.ranging.focus, curve by curve. The kernel fits one curve a sweep and stays in numpy, so
# that it replays to the bit. A depth map fits a hundred and more at once, and is to cost no more than four passes over
# the bytes of its frames. From 30 frames of 640x480 to 108 depths it costs 4.5 with this fit and 6.2 with the kernel's,
# 3.6 of them for clarity (medians of one run on a busy machine; `aucamp experiment frames` has all three). Both follow
# the same steps; sums are added in another order, so results agree to rounding (a test holds them together to 1e-9).


def block_peaks(lens_positions: Array, curves: Array, method: Method = "matched") -> Peaks:
    """`fit_peaks` with a free width: lens positions (n,), curves (m, n), n >= 5."""
    return fit_peaks(lens_positions, curves, None, method, solve)


def solve(x: Array, y: Array, width: float | None) -> Solved:
    """Bank of matched filters and Gauss-Newton for each curve: x (n,) rising, y (m, n). The width must be free."""
    assert width is None  # short sweeps are fitted one at a time, by the kernel
    span = float(x[-1] - x[0])
    step = span / (np.unique(x).size - 1)
    centres, widths = np.linspace(x[0], x[-1], x.size), np.geomspace(0.7 * step, span, WIDTHS)
    x0, w = np.repeat(centres, widths.size), np.tile(widths, centres.size)
    out = np.empty((5, len(y)))
    _solve(x, y, x0, w, CONVERGED * span / x.size, out)
    return Solved(*out)


@compiled("void(f8[::1], f8[:,::1], f8[::1], f8[::1], f8, f8[:,::1])", error_model="numpy")
def _solve(x: Array, y: Array, centres: Array, widths: Array, tolerance: float, out: Array) -> None:
    """Rows of out (5, m): x0, w, sum of squares of the residuals, height, variance of x0 for unit noise."""
    n, bank = x.size, centres.size
    templates = np.empty((n, bank))  # a sample a row: the loop over templates is the vector
    for t in range(bank):
        mean = square = 0.0
        for i in range(n):
            templates[i, t] = 1.0 / (1.0 + ((x[i] - centres[t]) / widths[t]) ** 2)
            mean += templates[i, t] / n
        for i in range(n):
            templates[i, t] -= mean
            square += templates[i, t] ** 2
        for i in range(n):
            templates[i, t] /= np.sqrt(square)
    match, dy = np.empty(bank), np.empty(n)
    for m in range(len(y)):
        match[:] = 0.0
        for i in range(n):
            _add(match, templates[i], y[m, i])
        best = np.argmax(match)
        mean = y[m].sum() / n
        for i in range(n):
            dy[i] = y[m, i] - mean
        out[0, m], out[1, m], out[2, m], out[3, m], out[4, m] = _refine(x, dy, centres[best], widths[best], tolerance)


@kernel
def _add(match: Array, templates: Array, sample: float) -> None:
    for t in range(match.size):
        match[t] += sample * templates[t]


@kernel
def _refine(x: Array, dy: Array, x0: float, w: float, tolerance: float) -> Any:
    """Gauss-Newton; a step that makes the fit worse is halved and tried again."""
    share = 1.0
    model = np.empty((3, x.size))
    sse, a, step_x0, step_w, spread = _at(x, dy, x0, w, model)
    for _ in range(REFINEMENTS):
        new_x0 = min(max(x0 + share * min(max(step_x0, -0.5 * w), 0.5 * w), x[0]), x[-1])
        new_w = w * min(max(1.0 + share * step_w / w, 0.6), 1.6)
        there = _at(x, dy, new_x0, new_w, model)
        last = max(abs(new_x0 - x0), abs(new_w - w)) < tolerance
        if there[0] < sse:
            x0, w = new_x0, new_w
            sse, a, step_x0, step_w, spread = there
            share = min(2.0 * share, 1.0)
        else:
            share *= 0.5
        if last:
            break
    return x0, w, sse, a, spread


@kernel
def _at(x: Array, dy: Array, x0: float, w: float, model: Array) -> Any:
    """Of one curve, as `_at` of agent.core.ranging.focus: sum of squares, height, steps of x0 and w, variance of x0
    for unit noise."""
    n = x.size
    t_sum = s_sum = q_sum = tt = ty = ss = qq = sq = st = qt = 0.0
    _derivatives(x, x0, w, model)
    for i in range(n):
        t_sum += model[0, i]
    mean = t_sum / n
    for i in range(n):
        dt, s, q = model[0, i] - mean, model[1, i], model[2, i]
        tt += dt * dt
        ty += dt * dy[i]
        st += s * dt
        qt += q * dt
        ss += s * s
        qq += q * q
        sq += s * q
        s_sum += s
        q_sum += q
    a = ty / tt
    sse = sr = qr = 0.0
    for i in range(n):
        r = dy[i] - a * (model[0, i] - mean)
        sse += r * r
        sr += model[1, i] * r
        qr += model[2, i] * r
    k = 2.0 * a / w
    ss = max(ss - s_sum * s_sum / n - st * st / tt, 0.0)
    qq = max(qq - q_sum * q_sum / n - qt * qt / tt, 0.0)
    sq = sq - s_sum * q_sum / n - st * qt / tt
    determinant = max(ss * qq - sq * sq, 1e-12 * abs(ss * qq) + 1e-300)
    return (
        sse,
        a,
        _ratio(qq * sr - sq * qr, k * determinant),
        _ratio(ss * qr - sq * sr, k * determinant),
        _ratio(qq, k * k * determinant),
    )


@kernel
def _derivatives(x: Array, x0: float, w: float, model: Array) -> None:
    """model (3, n): T, dT/dx0 and dT/dw, the last two over 2 / w."""
    for i in range(x.size):
        z = (x[i] - x0) / w
        t = 1.0 / (1.0 + z * z)
        model[0, i] = t
        model[1, i] = z * t * t
        model[2, i] = z * z * t * t


@kernel
def _ratio(numerator: float, denominator: float) -> float:
    ratio = numerator / (1e-300 if denominator == 0.0 else denominator)
    return 0.0 if np.isnan(ratio) else min(max(ratio, -1e300), 1e300)


# --- luminance and gradient of a whole picture, by OpenCV ---

Grey = NDArray[np.uint8]  # (height, width)


def luminance(image: NDArray[np.uint8]) -> Grey:
    """(height, width, 3) blue green red, or already grey -> (height, width)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]


def gradient_energy(grey: Grey) -> NDArray[np.float32]:
    """Gx^2 + Gy^2 of every pixel, (height, width); the image goes on as its own mirror beyond its border."""
    gx, gy = (g.astype(np.float32) for g in cv2.spatialGradient(grey, borderType=cv2.BORDER_REFLECT_101))
    return gx * gx + gy * gy  # at most 2.1e6: exact in single precision


# --- clarity of a picture that grows ---

POOL = 5  # squares across and down that tell it together: one may have a single edge
POWERS = -1.0, 2.0  # between which it lies


def half_clarity(image: NDArray[np.uint8], rows: Edges, cols: Edges) -> Array:
    """Clarity per pixel of the squares between these edges, in the picture at half its size."""
    grey = luminance(image)
    height, width = (length // 2 for length in grey.shape)
    small = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return tenengrad_grid(small, np.minimum(rows // 2, height), np.minimum(cols // 2, width))


def growth_power(clarity: Array, at_half: Array) -> Array:
    """The power of a picture's size with which clarity a pixel falls as the picture grows, of each square (rows, cols).

    clarity (n, rows, cols) of n frames, and as `half_clarity` has it. A picture that grows spreads its gradients over
    more pixels: that is 2 for texture coarser than a pixel, 0 for one that is alike at every scale, less for grain. At
    half its size a picture is what the camera sees from twice as far, so the frame in which a square is sharpest tells.
    """
    best = clarity.argmax(axis=0)[None]
    whole, half = (np.take_along_axis(each, best, axis=0)[0] for each in (clarity, at_half))
    together = (cv2.blur(each, (POOL, POOL), borderType=cv2.BORDER_REPLICATE) for each in (whole, half))
    full, small = (np.maximum(each, 1e-9) for each in together)
    power: Array = np.clip(np.log2(small / full), *POWERS)
    return power
