"""Algebra of small symmetric matrices of any size, in loops: the same bits on every processor.

A matrix is its rows. Those of 3x3, which are most, have closed forms in estimation/matrix.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Row = Sequence[float]
Rows = Sequence[Row]

SINGULAR = 1e-14  # a pivot's share of its diagonal: what is left below this is rounding


def cholesky(a: Rows) -> list[list[float]] | None:
    """Lower L with L L' = a, its rows of growing length; None where a is not positive definite."""
    L: list[list[float]] = []
    for i, row in enumerate(a):
        new: list[float] = []
        for j in range(i):
            above = L[j]
            rest = row[j]
            for p, q in zip(new, above, strict=False):
                rest -= p * q
            new.append(rest / above[j])
        rest = row[i]
        for p in new:
            rest -= p * p
        if not rest > SINGULAR * row[i]:
            return None
        new.append(math.sqrt(rest))
        L.append(new)
    return L


def forward(L: Rows, b: Row) -> list[float]:
    """L^-1 b"""
    y: list[float] = []
    for row, rest in zip(L, b, strict=True):
        for p, q in zip(row, y, strict=False):
            rest -= p * q
        y.append(rest / row[len(y)])
    return y


def forward_all(L: Rows, B: Rows) -> list[list[float]]:
    """L^-1 B, row by row."""
    Y: list[list[float]] = []
    for row, new in zip(L, B, strict=True):
        rest = list(new)
        for p, y in zip(row, Y, strict=False):
            rest = [b - p * q for b, q in zip(rest, y, strict=True)]
        over = 1.0 / row[len(Y)]
        Y.append([over * b for b in rest])
    return Y


def forward_nine(L: Rows, B: Rows) -> list[tuple[float, ...]]:
    """The same of rows of nine, without inner loops: six times as fast, and half of a fix."""
    Y: list[tuple[float, ...]] = []
    for row, (a, b, c, d, e, f, g, h, i) in zip(L, B, strict=True):
        for p, (qa, qb, qc, qd, qe, qf, qg, qh, qi) in zip(row, Y, strict=False):
            a, b, c = a - p * qa, b - p * qb, c - p * qc
            d, e, f = d - p * qd, e - p * qe, f - p * qf
            g, h, i = g - p * qg, h - p * qh, i - p * qi
        o = 1.0 / row[len(Y)]
        Y.append((o * a, o * b, o * c, o * d, o * e, o * f, o * g, o * h, o * i))
    return Y


def backward(L: Rows, y: Row) -> list[float]:
    """L'^-1 y"""
    x = list(y)
    for i in range(len(x) - 1, -1, -1):
        row = L[i]
        x[i] /= row[i]
        for j in range(i):
            x[j] -= row[j] * x[i]
    return x


def inverse(L: Rows) -> list[list[float]]:
    """(L L')^-1, exactly symmetric: its column k is that of the unit vector k, and the lower half is the upper's."""
    n = len(L)
    columns = [backward(L, forward(L, [float(i == k) for i in range(n)])) for k in range(n)]
    return [[columns[max(i, k)][min(i, k)] for k in range(n)] for i in range(n)]


def dot(a: Row, b: Row) -> float:
    """Sum of products, from the first on; not `sum`, which rounds otherwise from Python 3.12 on."""
    total = 0.0
    for p, q in zip(a, b, strict=True):
        total += p * q
    return total


def dot8(a: Row, b: Row) -> float:
    """The same of eight, without a loop."""
    a0, a1, a2, a3, a4, a5, a6, a7 = a
    b0, b1, b2, b3, b4, b5, b6, b7 = b
    return a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3 + a4 * b4 + a5 * b5 + a6 * b6 + a7 * b7
