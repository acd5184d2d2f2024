"""The map as a picture: every square in its place and colour, hatched where nothing is known."""

import numpy as np
import pytest

from agent.tools.depth_map import GREY, LIGHT, coloured, scale_of, ticks


def test_squares_are_drawn_at_their_size():
    values = np.array([[1.0, 2.0], [np.nan, 3.0]])
    drawn = coloured(values, 12.5, (30, 30), (1.0, 3.0))
    assert drawn.shape == (30, 30, 3) and drawn.dtype == np.uint8
    for row, col in ((0, 0), (0, 1), (1, 1)):
        square = drawn[int(12.5 * row + 1) : int(12.5 * row + 12), int(12.5 * col + 1) : int(12.5 * col + 12)]
        assert len(np.unique(square.reshape(-1, 3), axis=0)) == 1
    nothing = np.concatenate([drawn[13:25, :12].reshape(-1, 3), drawn[26:].reshape(-1, 3)])
    assert {tuple(pixel) for pixel in nothing.tolist()} == {LIGHT, GREY}


def test_a_scale_without_values_or_with_one():
    assert scale_of(np.full((2, 2), np.nan)) is None
    low, high = scale_of(np.array([[0.4, np.nan]]))
    assert low == 0.4 < high
    assert coloured(np.full((2, 2), np.nan), 5.0, (10, 10), None).shape == (10, 10, 3)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1024.0), (-0.066, 0.85), (208.0, 717.0), (0.4, 0.4004)])
def test_ticks_are_round_and_within(low, high):
    found = list(ticks(low, high, 500 / (high - low)))
    assert 3 <= len(found) <= 13
    assert all(low - 1e-9 <= value <= high + 1e-9 and 0 <= at <= 500 for value, at in found)
    steps = np.diff([value for value, _ in found])
    assert np.allclose(steps, steps[0])
