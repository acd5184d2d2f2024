"""How far each track stands from all the others, in place and velocity together.

Where a track says the target is now may be vague, and still it knows a line through place and velocity well: from one
sure sample a while ago. In the agreed track, whose velocity the others know, that sample is as sure as ever. So a robot
that stands near the others by its place alone, because it knows little of it, may stand far from them by both.

A track's covariance is taken in blocks of 3x3, P = [[A, C], [C^T, D]], and inverted by Schur's complement of D.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from typing import NamedTuple

from agent.core.estimation.fuse import DOUBTED, LOW
from agent.core.estimation.track import Square, Track, add_times, image, product, square, symmetric_part, transpose
from agent.core.matrix import ZERO, apply, difference, invert, minus, plus, quadratic
from agent.core.messages import Symmetric, Vector

BOTH_LOW = 3.26  # sigma; honest tracks stand farther off in six dimensions as seldom as farther than LOW in three


class Blocks(NamedTuple):
    """A symmetric 6x6 matrix."""

    A: Symmetric
    C: Square
    D: Symmetric


class Word(NamedTuple):
    """P^-1 of place and velocity, and P^-1 (x, v): words add up."""

    information: Blocks
    x: Vector
    v: Vector


NOTHING = Word(Blocks(ZERO, (0.0,) * 9, ZERO), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def distances2(tracks: Mapping[str, Track]) -> dict[str, float]:
    """d^2 of each track of one moment from the mean of the others, in units in which LOW is what is seldom passed."""
    if len(tracks) < DOUBTED:
        return {}
    words = [_word(track) for track in tracks.values()]
    before = list(accumulate(words, _both, initial=NOTHING))
    after = list(accumulate(reversed(words), _both, initial=NOTHING))[::-1]
    found = {}
    for j, (name, track) in enumerate(tracks.items()):
        others = _both(before[j], after[j + 1])
        P = inverse(others.information)
        x, v = _image(P, others.x, others.v)
        apart = inverse(Blocks(plus(P.A, track.A), add_times(P.C, 1.0, track.C), plus(P.D, track.D)))
        d2 = _quadratic(apart, difference(track.x_m, x), difference(track.v_m_s, v))
        found[name] = d2 * (LOW / BOTH_LOW) ** 2
    return found


def inverse(m: Blocks) -> Blocks:
    """The inverse of a covariance, or of an information matrix, of a track."""
    D = invert(m.D)
    K = product(m.C, square(D))
    A = invert(minus(m.A, symmetric_part(product(K, transpose(m.C)))))
    C = product(square(A), K)
    return Blocks(A, add_times((0.0,) * 9, -1.0, C), plus(D, symmetric_part(product(transpose(K), C))))


def _word(track: Track) -> Word:
    information = inverse(Blocks(track.A, track.C, track.D))
    return Word(information, *_image(information, track.x_m, track.v_m_s))


def _both(a: Word, b: Word) -> Word:
    (p, x, v), (q, y, w) = a, b
    return Word(Blocks(plus(p.A, q.A), add_times(p.C, 1.0, q.C), plus(p.D, q.D)), _plus(x, y), _plus(v, w))


def _image(m: Blocks, x: Vector, v: Vector) -> tuple[Vector, Vector]:
    return _plus(apply(m.A, x), image(m.C, v)), _plus(image(transpose(m.C), x), apply(m.D, v))


def _quadratic(m: Blocks, x: Vector, v: Vector) -> float:
    a, b, c = image(m.C, v)
    return quadratic(m.A, x) + quadratic(m.D, v) + 2.0 * (x[0] * a + x[1] * b + x[2] * c)


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
