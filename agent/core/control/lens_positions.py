"""Which lens positions a sweep visits.

Equal lens steps are equal steps in dioptres. All sweeps run towards larger positions and come from before their first
one, so that the lens's play is the same constant in every sweep, and in the calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.core.ranging.calibration import FocusFit

TRACK_STEPS = 7
TRACK_SPAN = 1.5  # half span of a tracking sweep, peak half-widths: beyond it the flanks say little
EXPECTED_SPAN = 1.5  # half span of a first sweep around where others say that a target is, likewise
HOME = 0.6  # how far before its first position a sweep starts, peak half-widths
FULL_MARGIN = 0.12  # a full sweep passes the calibrated positions at both ends by this share of their span
PAST_INFINITY = 0.5  # and infinity by so many peak half-widths: a far target's peak has two flanks, too


def full_positions(fit: FocusFit, steps: int) -> tuple[int, ...]:
    """All that is in the water: past both ends of the calibrated positions, and past infinity."""
    margin = FULL_MARGIN * (fit.highest - fit.lowest)
    first, last = fit.lowest - margin, fit.highest + margin
    nearest = last if fit.b_m > 0.0 else first
    # By a step at least: a peak is believed from the second position on.
    beyond = max(PAST_INFINITY * fit.width, abs(nearest - fit.rho0) / max(steps - 2, 1))
    if fit.b_m > 0.0:  # larger positions are nearer
        return spread(min(first, fit.rho0 - beyond), last, steps)
    return spread(first, max(last, fit.rho0 + beyond), steps)


def track_positions(lens_position: float, width: float, span: float = TRACK_SPAN) -> tuple[int, ...]:
    """A few around that of the last peak, `span` half-widths to either side: wide enough to see both flanks."""
    return spread(lens_position - span * width, lens_position + span * width, TRACK_STEPS)


def expected_positions(lens_position: float, width: float, full_steps: int) -> tuple[int, ...]:
    """Half as many as of a full sweep, around where a target is believed to be: both flanks, and room for a doubt."""
    half_span = EXPECTED_SPAN * width
    return spread(lens_position - half_span, lens_position + half_span, max(full_steps // 2, 2 * TRACK_STEPS))


def home_position(lens_positions: Sequence[int], fit: FocusFit) -> int:
    """Where the lens waits before the first of `lens_positions`."""
    return max(round(lens_positions[0] - HOME * fit.width), 0)


def spread(first: float, last: float, steps: int) -> tuple[int, ...]:
    """`steps` whole lens positions from first, or from 0, the lowest of every driver, to last, rising."""
    first = max(first, 0.0)
    return tuple(round(first + (last - first) * k / (steps - 1)) for k in range(steps))


def short_of_infinity(fit: FocusFit, reported: Sequence[int]) -> str | None:
    """What it means that the lens, told to pass infinity, came to rest at these positions; None where it got there."""
    ordered = sorted(set(reported), reverse=fit.b_m < 0.0)  # the far end first
    if len(ordered) < 2 or (fit.rho0 - ordered[0]) * fit.b_m >= 0.0:
        return None
    # A peak is believed from the second position on; there the hyperbola has its farthest range.
    reach_m = fit.u_inf_m + fit.b_m / (ordered[1] - fit.rho0)
    return f"the lens stops at {ordered[0]}, infinity is at {fit.rho0:.0f}: no range to targets beyond {reach_m:.1f} m"
