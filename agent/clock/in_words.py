"""How fast a clock went, for a person."""

from collections.abc import Sequence


def how_fast(dive_s: float, wall_s: float, rates: Sequence[float]) -> str:
    """`rates`: of shorter times, of which the least and the most are told where they differ."""
    text = f"{dive_s:.1f} s of dive in {wall_s:.1f} s, {dive_s / wall_s:.2f} times real time"
    bounds = [f"{bound:.2f}" for bound in (min(rates), max(rates))] if rates else []
    return f"{text} ({bounds[0]} to {bounds[1]})" if len(set(bounds)) == 2 else text
