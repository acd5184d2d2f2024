"""Lens positions of a full sweep, whichever end of them is infinity."""

import itertools

import pytest
from msgspec.structs import replace

from agent.core.control.sweep import full_positions, home_position, short_of_infinity
from tests.known_lens import PLAIN

FIT = replace(PLAIN, u_inf_m=0.0, lowest=200)


@pytest.mark.parametrize("nearer", ["larger", "smaller"])
def test_a_full_sweep_passes_infinity_and_both_ends_in_equal_steps(nearer: str) -> None:
    fit = FIT if nearer == "larger" else replace(FIT, b_m=-130.0, rho0=1000.0)
    lens_positions = full_positions(fit, 30)
    assert lens_positions[0] <= fit.lowest - 60 and lens_positions[-1] >= fit.highest + 60
    infinity = lens_positions[1] <= fit.rho0 if nearer == "larger" else lens_positions[-2] >= fit.rho0
    assert infinity  # between the second position from either end, where a peak is believed
    steps = {b - a for a, b in itertools.pairwise(lens_positions)}
    assert max(steps) - min(steps) <= 1 and min(steps) > 0
    assert home_position(lens_positions, fit) < lens_positions[0]


def test_the_other_end_where_smaller_positions_are_nearer() -> None:
    fit = replace(FIT, b_m=-130.0, rho0=1000.0)
    assert short_of_infinity(fit, [200, 600, 990, 1010]) is None
    says = short_of_infinity(fit, [200, 600, 900, 930, 930])
    assert says == "the lens stops at 930, infinity is at 1000: no range to targets beyond 1.3 m"
