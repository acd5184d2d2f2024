"""Linear algebra in scalar floats: the same bits on every processor, which BLAS does not give.

A symmetric 3x3 matrix is its upper triangle, xx xy xz yy yz zz; its inverse is a closed form (adjugate over
determinant). A symmetric matrix of any other size is its rows; it is solved by loops. Angles are in rad.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from agent.core.messages import Symmetric, Vector

# --- vectors and symmetric 3x3 matrices ---

ZERO: Symmetric = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
IDENTITY: Symmetric = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
SINGULAR = 1e-14  # determinant over (trace / 3)^3, the largest it can be: below this an inverse is not to be trusted
WELL = 1e-6  # the same measure: from here on, an inverse is as good as the matrix to ten digits


def upper(matrix: Iterable[Iterable[float]]) -> Symmetric:
    """The upper triangle of a symmetric 3x3 matrix, as it travels."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (tuple(map(float, row)) for row in matrix)
    return (xx, xy, xz, yy, yz, zz)


def full(a: Symmetric) -> tuple[Vector, Vector, Vector]:
    """All rows of it, for what takes a matrix."""
    xx, xy, xz, yy, yz, zz = a
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


def plus(a: Symmetric, b: Symmetric) -> Symmetric:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


def minus(a: Symmetric, b: Symmetric) -> Symmetric:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5]


def times(k: float, a: Symmetric) -> Symmetric:
    return k * a[0], k * a[1], k * a[2], k * a[3], k * a[4], k * a[5]


def trace(a: Symmetric) -> float:
    return a[0] + a[3] + a[5]


def apply(a: Symmetric, v: Vector) -> Vector:
    """a v"""
    xx, xy, xz, yy, yz, zz = a
    x, y, z = v
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def inner(a: Vector, b: Vector) -> float:
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def add(a: Vector, k: float, b: Vector) -> Vector:
    """a + k b"""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def quadratic(a: Symmetric, v: Vector) -> float:
    """v^T a v"""
    xx, xy, xz, yy, yz, zz = a
    x, y, z = v
    return xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)


def adjugate(a: Symmetric) -> tuple[Symmetric, float]:
    """(adj a, det a)"""
    xx, xy, xz, yy, yz, zz = a
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    return (c00, c01, c02, xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy), xx * c00 + xy * c01 + xz * c02


def inverse(a: Symmetric) -> Symmetric | None:
    """The inverse of a positive definite matrix; None where it has none that can be trusted."""
    third = trace(a) / 3.0
    adj, det = adjugate(a)
    if not (third > 0.0 and det > SINGULAR * third * third * third):
        return None
    return times(1.0 / det, adj)


def well_conditioned(a: Symmetric) -> bool:
    """Whether a positive matrix knows all its directions well enough to be inverted without a further check."""
    third = trace(a) / 3.0
    return adjugate(a)[1] > WELL * third * third * third


def invert(a: Symmetric) -> Symmetric:
    """The inverse of a sum of matrices that `inverse` accepts.

    Unchecked: det^(1/3) is concave (Minkowski), so a sum is no nearer to singular than the worst of its terms.
    """
    adj, det = adjugate(a)
    return times(1.0 / det, adj)


def distance2(p: Symmetric, d: Vector) -> float:
    """d^T p^-1 d of a positive definite p: the squared Mahalanobis distance."""
    adj, det = adjugate(p)
    return quadratic(adj, d) / det


def semidefinite(a: Symmetric, slack: float) -> bool:
    """Whether a + slack I has no negative eigenvalue: all principal minors, not only the leading ones."""
    xx, xy, xz, yy, yz, zz = a[0] + slack, a[1], a[2], a[3] + slack, a[4], a[5] + slack
    shifted = (xx, xy, xz, yy, yz, zz)
    tiny = 1e-12 * max(trace(shifted), 0.0)  # minors of a singular matrix round to either side of zero
    (c00, _, _, c11, _, c22), det = adjugate(shifted)
    size = max(trace(shifted), 0.0)
    return min(xx, yy, zz) >= 0.0 and min(c00, c11, c22) >= -tiny * size and det >= -tiny * size * size


# --- symmetric matrices of any size ---

Row = Sequence[float]
Rows = Sequence[Row]


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
    """L^-1 B of rows of nine, without inner loops: six times as fast. It takes half the time of a pose fix."""
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


def lower_inverse(L: Rows) -> list[list[float]]:
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
    """`dot` of eight numbers, without a loop."""
    a0, a1, a2, a3, a4, a5, a6, a7 = a
    b0, b1, b2, b3, b4, b5, b6, b7 = b
    return a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3 + a4 * b4 + a5 * b5 + a6 * b6 + a7 * b7


# --- angles ---


def wrap(angle: float) -> float:
    """The same angle within -pi to pi, rad."""
    return math.remainder(angle, 2.0 * math.pi)
