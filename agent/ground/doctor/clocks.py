"""How far away robots are, and how far their clocks are from ours. Pure, but for asking."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agent.ground.finding import Finding

ASKED = 5  # times; the fastest answer is the truest
APART_S = 0.1  # clocks that are further apart are told of, where both ways were measured
ONE_WAY_S = 1.0  # and where only one was: a state is that late on no link of ours


class Stamps(NamedTuple):
    """Of a question and its answer, ns: the outer two by our clock, the inner two by the robot's."""

    asked_ns: int
    arrived_ns: int
    answered_ns: int
    back_ns: int


class Offset(NamedTuple):
    """What stamps come to."""

    way_s: float  # there and back, without the wait at the robot
    ahead_s: float  # the robot's clock minus ours; wrong by half of `way_s` at most


def best(stamps: Sequence[Stamps]) -> Offset:
    """As NTP reckons (RFC 5905, section 8), of the answer with the shortest way."""
    way_ns, ahead_ns = min(
        (
            (s.back_ns - s.asked_ns) - (s.answered_ns - s.arrived_ns),
            ((s.arrived_ns - s.asked_ns) + (s.answered_ns - s.back_ns)) / 2,
        )
        for s in stamps
    )
    return Offset(way_ns * 1e-9, ahead_ns * 1e-9)


def clock_finding(name: str, measured: Offset | None, late_ns: int) -> Finding | None:
    """Whether a robot's clock is ours. `late_ns`: how late, by both clocks, its fastest state was."""
    if measured is not None:
        wrong, ahead_s = abs(measured.ahead_s) - measured.way_s / 2 > APART_S, measured.ahead_s
    else:
        ahead_s = -late_ns * 1e-9
        wrong = abs(ahead_s) > ONE_WAY_S
    if not wrong:
        return None
    where = "ahead of" if ahead_s > 0 else "behind"
    text = f"its clock is {_long(abs(ahead_s))} {where} this computer's: certificates are judged by it, and recordings"
    return Finding("warning", name, f"{text} lie side by side by it; set both by one server (chrony, or timedatectl)")


def _long(seconds: float) -> str:
    if seconds >= 7200:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
