"""Can what a robot believes of a target be trusted? One word for people, and the likeliest causes in their terms.

A word is raised at once, and lowered after five seconds without a cause. Nothing that a robot does hangs on it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from typing import NamedTuple

from msgspec import UNSET

from agent.core.messages import Explain, Verdict
from agent.core.step_transaction import Revertible

ORDER: tuple[Verdict, ...] = ("consistent", "suspect", "contradicted", "missing")
KEEPS_NS = 5_000_000_000

WINDOW_NS, FEWEST = 30_000_000_000, 20  # own samples whose scatter is judged: of so long, at least so many
SCATTERS = (1.8, 3.0)  # their mean NIS in units of its expectation: suspect, contradicted
TURNS = (2.5, 4.0)  # the same of a target that moves: in some half minutes it turns more than its dynamics have it
SWEEPS, FEWEST_SWEEPS = 20, 5
REFUSED = (0.1, 0.5)  # share of sweeps in which focus and size contradict each other
APART = (3.0, 6.0)  # sigma, of the ratio of both ranges
LONG = 3.5  # sigma, of a factor that all ranges have in common

# Misses are counted in nats: -log of the probability to see nothing though it is there.
MISSED = 3.0  # one in twenty
FOUND_NS, ALONE_NS = 8_000_000_000, 20_000_000_000  # nobody found it for so long: two robots missed it; one did


class Cause(NamedTuple):
    """Why a word was raised, and when that was last so."""

    word: Verdict
    text: str
    at_ns: int


class Ratio(NamedTuple):
    """Of one sweep: the logarithm of the range by focus over that by size."""

    log: float
    random: float  # variance that averages out
    systematic: float  # variance that does not


class Consistency(Revertible):
    """What speaks against the belief of one robot about one target."""

    def __init__(self, me: str) -> None:
        self._me = me
        self._causes: dict[str, Cause] = {}
        self._scatter: deque[tuple[int, float]] = deque()
        self._ratios: deque[Ratio] = deque(maxlen=SWEEPS)
        self._refused: deque[bool] = deque(maxlen=SWEEPS)

    def verdict(self, now_ns: int) -> tuple[Verdict, tuple[str, ...]]:
        """The word, and its causes, the worst first."""
        held = [cause for cause in self._causes.values() if now_ns - cause.at_ns <= KEEPS_NS]
        held.sort(key=lambda cause: -ORDER.index(cause.word))
        return held[0].word if held else "consistent", tuple(cause.text for cause in held)

    def sweep(self, ratio: Ratio | None, refused: bool, now_ns: int) -> None:
        """Take note of a sweep that had a peak. refused: for its two ranges contradict each other."""
        self._refused.append(refused)
        if ratio is not None:
            self._ratios.append(ratio)
        if len(self._refused) < FEWEST_SWEEPS or not self._ratios:
            return
        n = len(self._ratios)
        q = sum(one.log for one in self._ratios) / n
        sigma = math.sqrt(sum(one.systematic + one.random / n for one in self._ratios) / n)
        text = (
            f"focus says {100.0 * abs(math.expm1(q)):.1f} % {'more' if q > 0.0 else 'less'} than size: check radius_m"
        )
        self._raise("cues", abs(q) / sigma, APART, f"{text}, the lens and the focus table", now_ns)
        share = sum(self._refused) / len(self._refused)
        self._raise("refused", share, REFUSED, f"{100.0 * share:.0f} % of the sweeps are refused: {text}", now_ns)

    def update(self, explain: Explain, bearing: bool, now_ns: int) -> None:
        """Take note of an iteration. bearing: its own sample was one."""
        if explain.moved_m is not UNSET and explain.moved_m is not None:
            by_mm = 1e3 * math.hypot(*explain.moved_m)
            self._put("moved", "suspect", f"it may have moved by {by_mm:.0f} mm: robots look again", now_ns)
        if explain.status == "ambiguous":
            self._put("vote", "contradicted", "robots place it apart, and no majority agrees", now_ns)
        apart = sorted(name for name, factor in explain.doubted.items() if factor < 0.5)
        if apart and explain.status != "ambiguous":
            names = "this robot stands" if apart == [self._me] else f"{', '.join(apart)} stand{'s' * (len(apart) == 1)}"
            self._put("vote", "suspect", f"{names} apart from the others: check pose and calibration", now_ns)
        if explain.nis is not None:
            self._scatter.append((now_ns, explain.nis / (2.0 if bearing else 3.0)))
        while self._scatter and now_ns - self._scatter[0][0] > WINDOW_NS:
            self._scatter.popleft()
        if len(self._scatter) >= FEWEST and now_ns - self._scatter[0][0] > WINDOW_NS // 2:
            times = sum(value for _, value in self._scatter) / len(self._scatter)
            text = f"samples scatter {math.sqrt(times):.1f} times as much as they say"
            self._raise("scatter", times, TURNS if explain.epoch.moving else SCATTERS, text, now_ns)
        if explain.stretch is not UNSET and explain.stretch is not None:
            by, sigma = explain.stretch
            if abs(by) > LONG * sigma:
                what = f"all ranges are {100.0 * abs(by):.1f} % (+-{100.0 * sigma:.1f}) {'long' if by > 0 else 'short'}"
                self._put("stretch", "suspect", f"{what}: check radius_m, refractive_index and the survey", now_ns)

    def missed(self, nats: Mapping[str, float], sees: Collection[str], found_ns: int | None, now_ns: int) -> None:
        """Take note of who looks where the target should be and does not see it. sees: who does; found_ns: when a robot
        last did."""
        if found_ns is None:
            return
        who, unseen_ns = sorted(name for name, each in nats.items() if each >= MISSED), now_ns - found_ns
        if (len(who) >= 2 and unseen_ns >= FOUND_NS) or (who and unseen_ns >= ALONE_NS):
            self._put("missed", "missing", f"not seen where it was by {', '.join(who)}", now_ns)
        elif who and unseen_ns >= FOUND_NS:
            self._put("missed", "suspect", f"not seen where it was by {who[0]}", now_ns)
        elif len(who) >= 2 and any(name not in who for name in sees):
            self._put("missed", "contradicted", f"not seen by {', '.join(who)} where another sees it", now_ns)

    def _raise(self, kind: str, value: float, limits: tuple[float, float], text: str, now_ns: int) -> None:
        if value > limits[0]:
            self._put(kind, "contradicted" if value > limits[1] else "suspect", text, now_ns)

    def _put(self, kind: str, word: Verdict, text: str, now_ns: int) -> None:
        self._causes[kind] = Cause(word, text, now_ns)
