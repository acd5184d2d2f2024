"""The peaks of all blocks of a sweep at compiled speed: the matched fit of agent.core.ranging.focus, curve by curve.

The kernel fits one curve a sweep and stays in numpy, so that it replays to the bit. A depth map fits a hundred and
more at once, and is to cost no more than four passes over the bytes of its frames. From 30 frames of 640x480 to 108
depths it costs 4.5 with this fit and 6.2 with the kernel's, 3.6 of them for clarity (medians of one run on a busy
machine; `make bench` has all three). Both follow the same steps; sums are added in another order, so results agree to
rounding (a test holds them together to 1e-9).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from agent.core.ranging.focus import CONVERGED, REFINEMENTS, WIDTHS, Array, Method, Peaks, Solved, fit_peaks
from hw.compiled import compiled

kernel = compiled(error_model="numpy")


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


@kernel
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
    """What focus._at says of one curve: sum of squares, height, steps of x0 and w, variance of x0 for unit noise."""
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
