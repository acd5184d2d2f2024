"""L(v) against the blur circles of a thin lens, and the note's figures for a small module."""

import math

import pytest

from agent.core.ranging.focus import depth_of_field_in_water_m, depth_of_field_m

F, G, D = 3.6e-3, 2.0, 1.12e-6


@pytest.mark.parametrize("u", [0.3, 0.5, 1.0])
def test_at_both_limits_the_blur_is_the_spot(u):
    v = 1 / (1 / F - 1 / u)

    def blur(distance):
        image = 1 / (1 / F - 1 / distance)
        return F / G * abs(v - image) / image

    low, high = 0.01, u
    for _ in range(80):  # the near limit: blur falls towards u
        mid = (low + high) / 2
        low, high = (mid, high) if blur(mid) > D else (low, mid)
    near = low
    low, high = u, 1e3
    for _ in range(80):
        mid = (low + high) / 2
        low, high = (mid, high) if blur(mid) < D else (low, mid)
    assert depth_of_field_m(u, F, G, D) == pytest.approx(low - near, rel=1e-3)


@pytest.mark.parametrize(("u", "air_mm", "water_mm"), [(0.3, 31, 24), (0.5, 86, 66), (1.0, 355, 266)])
def test_figures_of_a_small_module(u, air_mm, water_mm):
    assert depth_of_field_m(u, F, G, D) == pytest.approx(air_mm * 1e-3, rel=0.03)
    from_window = depth_of_field_in_water_m(u + 0.005, F, G, D, 1.333, 0.005)
    assert from_window == pytest.approx(water_mm * 1e-3, rel=0.03)


def test_beyond_the_hyperfocal_distance_it_has_no_end():
    hyperfocal = F * F / (G * D) + F
    assert depth_of_field_m(1.001 * hyperfocal, F, G, D) == math.inf
    assert math.isfinite(depth_of_field_m(0.999 * hyperfocal, F, G, D))
