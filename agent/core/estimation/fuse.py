"""Fuse what each robot says into one place: a vote finds those that agree, then each is left out in turn.

One robot that is wrong must not move the others, and it is not known beforehand which one it is. Two opinions agree
when their distance is likely under the sum of their covariances; the largest group that agrees with one of its members
enters. Inside it a liar may still stand, just near enough to one honest robot, and with a covariance so small that it
would be the mean. So every origin is tested for how far it stands from what the others say without it. While no origin
stands out, all count as they claim. Where one does, the place is a mean over the ways to leave one out, each weighted
by how plausible it is that all are right but this one: an origin that stands apart takes itself out, and where two are
equally suspect, the place lies between what follows from either.

No weight depends on what was said before: a robot that speaks the truth again is believed at once. Covariances hold the
systematic error of their robot, so no robot grows surer than its survey and calibration allow.

What all robots have wrong alike shows in no vote, and does not fall with their number. Where all ranges are long by a
share eps, sigma S, the place by robot j is off by eps a_j, a_j its lever from camera to target, and the mean by eps g,
g = sum W_j a_j. Where robots stand around the target g is small, on one side it is not. Opinions hold S^2 a_j a_j',
for the vote; in the mean S^2 g g' takes the place of S^2 sum W_j a_j a_j' W_j'.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import accumulate
from typing import Literal, NamedTuple

from agent.core.estimation.track import (
    Square,
    Track,
    add_times,
    image,
    outer,
    product,
    square,
    symmetric_part,
    transpose,
)
from agent.core.linear_algebra import (
    ZERO,
    add,
    apply,
    difference,
    distance2,
    inner,
    invert,
    minus,
    plus,
    quadratic,
    times,
    trace,
)
from agent.core.messages import Symmetric, Vector

Verdict = Literal["none", "single", "ok", "ambiguous", "outlier"]
Word = tuple[Symmetric, Vector]  # (P^-1, P^-1 x), which add up

AGREE = 16.27  # chi^2, 3 degrees of freedom, 0.999: honest robots disagree once in a thousand pairs
VOTERS = 64  # beyond this many, pairs take longer than a tick has: then the group is what is consistent with the median
DOUBTED = 3  # opinions from which on one can be left out and two still compared
PAIRS = (7, 32)  # fewest opinions among which two liars can be found, and most for whose pairs a tick has the time

# Of honest opinions one in ten stands farther than LOW from the others, and one in nine hundred farther than HIGH.
LOW = 2.5  # sigma; up to here no origin stands out. What one robot can move unseen grows with it
HIGH = 4.0  # sigma; from here on some origin is wrong
TEMPER = 0.3  # of the likelihoods: covariances are themselves only estimates. 0.5 lets a liar move more, and costs more


class Opinion(NamedTuple):
    """Where one robot places the target, by its own samples alone; world frame."""

    origin: str
    x_m: Vector
    cov_m2: (
        Symmetric  # random part, shrunk by its samples, plus systematic part, plus what the scale makes of its lever
    )
    precision: Symmetric  # the inverse of that, 1/m^2
    lever_m: Vector = (0.0, 0.0, 0.0)  # from its camera to there
    random_m2: Symmetric = ZERO


class Shared(NamedTuple):
    """What all robots have wrong alike."""

    place_m2: Symmetric = ZERO  # covariance: frame of the tank, level of the water
    scale: float = 0.0  # standard deviation of the share by which all ranges are long

    def scale_m2(self, lever_m: Vector) -> Symmetric:
        """Covariance that the scale gives to a place with this lever, S^2 a a'."""
        return times(self.scale * self.scale, outer(lever_m))


NONE = Shared()  # nothing


class Ballot(NamedTuple):
    """Outcome of a vote."""

    group: frozenset[str]  # the leader and the origins that are consistent with it
    verdict: Verdict
    votes: dict[str, int]  # origins consistent with each, itself included


class Without(NamedTuple):
    """What a group says without some of its members, and how far these stand from it."""

    out: frozenset[str]
    x_m: Vector
    cov_m2: Symmetric
    d2: float  # by which chi^2 of the group falls when they go


class Doubt(NamedTuple):
    """Whether an origin in a group stands out, and which."""

    strength: float  # 0: none does, 1: one is wrong for certain
    ways: list[tuple[float, Without]]  # "all are right but these", with probabilities of sum 1; empty at strength 0

    def factors(self, group: Iterable[Opinion]) -> dict[str, float]:
        """What is left of the weight of each of the group."""
        wrong: dict[str, list[float]] = {opinion.origin: [] for opinion in group}
        for p, without in self.ways:
            for origin in without.out:
                wrong[origin].append(p)
        return {origin: 1.0 - self.strength * math.fsum(each) for origin, each in wrong.items()}


class Parts(NamedTuple):
    """Of what the trace of a covariance is made, m^2."""

    random_m2: float  # falls with more samples
    own_m2: float  # what each robot has wrong for itself: falls with more robots
    scale_m2: float  # of all ranges alike: falls where robots stand around
    place_m2: float  # level and survey: does not fall


class Fused(NamedTuple):
    """The agreed place, and how it came about."""

    x_m: Vector
    cov_m2: Symmetric
    verdict: Verdict
    votes: dict[str, int]  # origins consistent with each, itself included
    factors: dict[str, float]  # what counts of each origin's claim; 0: left out
    shares: dict[str, float]  # of each origin in the mean, by trace of information; sum 1
    sway_m: dict[str, float]  # of each in the group: from here to where the others would be without it


def fuse(opinions: Sequence[Opinion], shared: Shared = NONE, liars: int = 1) -> Fused | None:
    """Fuse opinions given in the order of their names; None without any.

    `liars`: how many may be wrong at once, 1 or 2; two are looked for where as many agree as PAIRS says.
    """
    if not opinions:
        return None
    ballot = vote(opinions)
    group = [opinion for opinion in opinions if opinion.origin in ballot.group]
    information, vector = _sum(map(_word, group))
    covariance = invert(information)
    everybody = apply(covariance, vector), plus(covariance, _stretched(group, covariance, shared))
    singles = list(_leaving_one_out(group)) if len(group) >= DOUBTED else []
    doubt = _doubt(group, singles, liars)
    x, covariance = everybody
    if doubt.ways:
        x, covariance = mixture([(1.0 - doubt.strength, *everybody), *_places(group, doubt, shared)])
    factors = doubt.factors(group)
    sizes = {opinion.origin: factors[opinion.origin] * trace(opinion.precision) for opinion in group}
    total = math.fsum(sizes.values())
    return Fused(
        x,
        plus(covariance, shared.place_m2),
        ballot.verdict,
        ballot.votes,
        {opinion.origin: factors.get(opinion.origin, 0.0) for opinion in opinions},
        {name: size / total for name, size in sizes.items()},
        {name: math.dist(x, single.x_m) for single in singles for name in single.out},
    )


def _places(group: Sequence[Opinion], doubt: Doubt, shared: Shared) -> Iterator[tuple[float, Vector, Symmetric]]:
    """Where a group puts the target without those that may be wrong."""
    for p, way in doubt.ways:
        others = (opinion for opinion in group if opinion.origin not in way.out)
        yield doubt.strength * p, way.x_m, plus(way.cov_m2, _stretched(others, way.cov_m2, shared))


def _stretched(group: Iterable[Opinion], covariance: Symmetric, shared: Shared) -> Symmetric:
    """S^2 (g g' - sum W a a' W'): what one scale for all makes of the mean of a group, beyond what each has of it."""
    scale = shared.scale
    if scale == 0.0:
        return ZERO
    g, apart = (0.0, 0.0, 0.0), ZERO
    for opinion in group:
        moved = apply(covariance, apply(opinion.precision, opinion.lever_m))
        g, apart = add(g, 1.0, moved), plus(apart, outer(moved))
    return times(scale * scale, minus(outer(g), apart))


def parts(group: Sequence[Opinion], shared: Shared) -> Parts:
    """Of what the covariance of those that agree is made, none of them doubted; there is at least one."""
    covariance = invert(reduce(plus, (opinion.precision for opinion in group)))
    random_m2, scale2, g, apart_m2 = 0.0, shared.scale * shared.scale, (0.0, 0.0, 0.0), 0.0
    for opinion in group:
        weight = product(square(covariance), square(opinion.precision))
        random_m2 += trace(symmetric_part(product(product(weight, square(opinion.random_m2)), transpose(weight))))
        moved = image(weight, opinion.lever_m)
        g, apart_m2 = add(g, 1.0, moved), apart_m2 + scale2 * inner(moved, moved)
    own_m2 = max(trace(covariance) - random_m2 - apart_m2, 0.0)
    return Parts(random_m2, own_m2, scale2 * inner(g, g), trace(shared.place_m2))


def mixture(places: Iterable[tuple[float, Vector, Symmetric]]) -> tuple[Vector, Symmetric]:
    """Mean and covariance of places (weight, x, P) whose weights sum to 1: their disagreement widens it."""
    found = list(places)
    x = (
        math.fsum(w * at[0] for w, at, _ in found),
        math.fsum(w * at[1] for w, at, _ in found),
        math.fsum(w * at[2] for w, at, _ in found),
    )
    covariance = ZERO
    for w, at, cov in found:
        a, b, c = difference(at, x)
        covariance = plus(covariance, times(w, plus(cov, (a * a, a * b, a * c, b * b, b * c, c * c))))
    return x, covariance


def stretch(opinions: Sequence[Opinion], shared: Shared = NONE) -> tuple[float, float] | None:
    """By which share all ranges are long, x_j = x + eps a_j with the levers a_j, and its sigma, the scale's in it.

    It is fitted with the place, and used for words alone: fused so, a robot would move the place by its lever. None
    for fewer than three, or where the levers do not tell it.
    """
    if len(opinions) < DOUBTED:
        return None
    levers = [of.lever_m for of in opinions]
    precisions = [_unstretched(of, shared) for of in opinions]
    covariance = invert(reduce(plus, precisions))
    _, vector = _sum((L, apply(L, of.x_m)) for L, of in zip(precisions, opinions, strict=True))
    _, pulled = _sum((L, apply(L, a)) for L, a in zip(precisions, levers, strict=True))
    x, lever = apply(covariance, vector), apply(covariance, pulled)
    known = math.fsum(inner(a, apply(L, difference(a, lever))) for L, a in zip(precisions, levers, strict=True))
    if known <= 0.0:
        return None
    off = [difference(of.x_m, x) for of in opinions]
    seen = math.fsum(inner(a, apply(L, e)) for L, a, e in zip(precisions, levers, off, strict=True))
    return seen / known, math.sqrt(1.0 / known + shared.scale * shared.scale)


def _unstretched(of: Opinion, shared: Shared) -> Symmetric:
    """Its precision without what the scale makes of its lever."""
    return of.precision if shared.scale == 0.0 else invert(minus(of.cov_m2, shared.scale_m2(of.lever_m)))


# --- origins that stand out ---


def doubts(group: Sequence[Opinion], liars: int = 1, beside: Mapping[str, float] | None = None) -> Doubt:
    """Which of a group that agrees may still be wrong; none in a group too small to tell.

    beside: d^2 of each by what else is known of it, where one is left out; the larger counts.
    """
    singles = list(_leaving_one_out(group)) if len(group) >= DOUBTED else []
    if beside:
        singles = [way._replace(d2=max(way.d2, *(beside.get(name, 0.0) for name in way.out))) for way in singles]
    return _doubt(group, singles, liars)


def _doubt(group: Sequence[Opinion], singles: list[Without], liars: int) -> Doubt:
    """singles: the group without each of its members."""
    ways, scale = singles, 1.0
    if liars > 1 and PAIRS[0] <= len(group) <= PAIRS[1]:
        ways, scale = list(_leaving_two_out(group)), math.sqrt(2.0)  # two are twice as many degrees of freedom
    largest = max((way.d2 for way in ways), default=0.0)
    strength = min(1.0, (math.sqrt(largest) / scale - LOW) / (HIGH - LOW))
    if strength <= 0.0:
        return Doubt(0.0, [])
    odds = [math.exp(-0.5 * TEMPER * (largest - way.d2)) for way in ways]
    total = math.fsum(odds)
    return Doubt(strength, [(odd / total, way) for odd, way in zip(odds, ways, strict=True)])


def _leaving_one_out(group: Sequence[Opinion]) -> Iterator[Without]:
    """The others are summed, not taken from the sum of all: next to an origin that claims a tiny covariance, rounding
    would leave nothing of them."""
    before, after = _partial_sums(group)
    for j, opinion in enumerate(group):
        information, vector = _both(before[j], after[j + 1])
        covariance = invert(information)
        x = apply(covariance, vector)
        d2 = distance2(plus(opinion.cov_m2, covariance), difference(opinion.x_m, x))
        yield Without(frozenset((opinion.origin,)), x, covariance, d2)


def _leaving_two_out(group: Sequence[Opinion]) -> Iterator[Without]:
    before, after = _partial_sums(group)
    words = [_word(opinion) for opinion in group]
    for j, one in enumerate(group):
        between: Word = (ZERO, (0.0, 0.0, 0.0))
        for k in range(j + 1, len(group)):
            two = group[k]
            information, vector = _both(_both(before[j], between), after[k + 1])
            covariance = invert(information)
            x = apply(covariance, vector)
            information, vector = _both(words[j], words[k])
            pair = invert(information)
            apart = distance2(plus(one.cov_m2, two.cov_m2), difference(one.x_m, two.x_m))
            d2 = apart + distance2(plus(pair, covariance), difference(apply(pair, vector), x))
            yield Without(frozenset((one.origin, two.origin)), x, covariance, d2)
            between = _both(between, words[k])


def _partial_sums(group: Sequence[Opinion]) -> tuple[list[Word], list[Word]]:
    """Sums of the first k, and sums from the k-th on."""
    words, nothing = [_word(opinion) for opinion in group], (ZERO, (0.0, 0.0, 0.0))
    before = list(accumulate(words, _both, initial=nothing))
    after = list(accumulate(reversed(words), _both, initial=nothing))
    return before, after[::-1]


# --- the vote ---


def vote(opinions: Sequence[Opinion]) -> Ballot:
    """Which opinions agree, of opinions given in the order of their names; at least one.

    The most numerous group wins; of equals the one that is closest in itself, by the mean distance of its pairs:
    small covariances are no merit here, or a liar would only have to claim them.
    """
    groups, distances2 = _consistent(opinions)
    most = max(map(len, groups))
    largest = {id(group): group for group in groups if len(group) == most}  # of many, all that agree share one list
    tied = list(dict.fromkeys(map(tuple, largest.values())))
    group = tied[0] if len(tied) == 1 else min(tied, key=lambda each: _spread(each, distances2))
    return Ballot(
        frozenset(opinions[j].origin for j in group),
        _verdict(most, len(opinions)),
        {opinion.origin: len(each) for opinion, each in zip(opinions, groups, strict=True)},
    )


def _verdict(agreeing: int, all_: int) -> Verdict:
    if all_ == 1:
        return "single"
    if 2 * agreeing <= all_:
        return "ambiguous"
    return "ok" if agreeing == all_ else "outlier"


def _consistent(opinions: Sequence[Opinion]) -> tuple[list[list[int]], list[list[float]]]:
    """Indices of those that agree with each opinion, itself included, in order; d^2 of [k][j], j < k, none if many."""
    n = len(opinions)
    if n > VOTERS:
        median = _median(opinions)
        agrees = [quadratic(o.precision, difference(o.x_m, median)) < AGREE for o in opinions]
        near = [j for j in range(n) if agrees[j]]
        return [near if agrees[j] else [j] for j in range(n)], []
    consistent: list[list[int]] = [[j] for j in range(n)]
    distances2: list[list[float]] = []
    for j in range(n):
        _, xj, pj, *_ = opinions[j]
        row = [distance2(plus(pj, o.cov_m2), difference(xj, o.x_m)) for o in opinions[:j]]
        for k, d2 in enumerate(row):
            if d2 < AGREE:
                consistent[j].append(k)
                consistent[k].append(j)
        distances2.append(row)
    return [sorted(each) for each in consistent], distances2


def _spread(group: tuple[int, ...], distances2: list[list[float]]) -> float:
    """Sum of d^2 over the pairs of a group; groups of one size, so it stands for the mean. Nothing where none is."""
    return math.fsum(distances2[k][j] for at, k in enumerate(group) for j in group[:at]) if distances2 else 0.0


def _median(opinions: Sequence[Opinion]) -> Vector:
    """Weighted median of each coordinate, by the inverse trace of the covariance."""
    weights = [1.0 / trace(opinion.cov_m2) for opinion in opinions]
    half = 0.5 * math.fsum(weights)

    def along(axis: int) -> float:
        order = sorted((o.x_m[axis], w) for o, w in zip(opinions, weights, strict=True))
        passed = accumulate(weight for _, weight in order)
        return next(value for (value, _), sum_ in zip(order, passed, strict=True) if sum_ >= half)

    return along(0), along(1), along(2)


def _word(opinion: Opinion) -> Word:
    return opinion.precision, apply(opinion.precision, opinion.x_m)


def _both(a: Word, b: Word) -> Word:
    (p, (x, y, z)), (q, (u, v, w)) = a, b
    return plus(p, q), (x + u, y + v, z + w)


def _sum(words: Iterable[Word]) -> Word:
    *_, total = accumulate(words, _both)
    return total


# --- distance of a track from the others ---
# How far each track stands from all the others, in place and velocity together.
#
# Where a track says the target is now may be vague, and still it knows a line through place and velocity well: from one
# sure sample a while ago. In the agreed track, whose velocity the others know, that sample is as sure as ever. So a
# robot that stands near the others by its place alone, because it knows little of it, may stand far from them by both.
#
# A track's covariance is taken in blocks of 3x3, P = [[A, C], [C^T, D]], and inverted by Schur's complement of D.

BOTH_LOW = 3.26  # sigma; honest tracks stand farther off in six dimensions as seldom as farther than LOW in three


class Blocks(NamedTuple):
    """A symmetric 6x6 matrix."""

    A: Symmetric
    C: Square
    D: Symmetric


class TrackWord(NamedTuple):
    """P^-1 of place and velocity, and P^-1 (x, v): words add up."""

    information: Blocks
    x: Vector
    v: Vector


NOTHING = TrackWord(Blocks(ZERO, (0.0,) * 9, ZERO), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def distances2(tracks: Mapping[str, Track]) -> dict[str, float]:
    """d^2 of each track of one moment from the mean of the others, scaled so that honest tracks pass LOW as seldom as
    honest places do."""
    if len(tracks) < DOUBTED:
        return {}
    words = [_track_word(track) for track in tracks.values()]
    before = list(accumulate(words, _both_tracks, initial=NOTHING))
    after = list(accumulate(reversed(words), _both_tracks, initial=NOTHING))[::-1]
    found = {}
    for j, (name, track) in enumerate(tracks.items()):
        others = _both_tracks(before[j], after[j + 1])
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


def _track_word(track: Track) -> TrackWord:
    information = inverse(Blocks(track.A, track.C, track.D))
    return TrackWord(information, *_image(information, track.x_m, track.v_m_s))


def _both_tracks(a: TrackWord, b: TrackWord) -> TrackWord:
    (p, x, v), (q, y, w) = a, b
    return TrackWord(Blocks(plus(p.A, q.A), add_times(p.C, 1.0, q.C), plus(p.D, q.D)), _plus(x, y), _plus(v, w))


def _image(m: Blocks, x: Vector, v: Vector) -> tuple[Vector, Vector]:
    return _plus(apply(m.A, x), image(m.C, v)), _plus(image(transpose(m.C), x), apply(m.D, v))


def _quadratic(m: Blocks, x: Vector, v: Vector) -> float:
    a, b, c = image(m.C, v)
    return quadratic(m.A, x) + quadratic(m.D, v) + 2.0 * (x[0] * a + x[1] * b + x[2] * c)


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
