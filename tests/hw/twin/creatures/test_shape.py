"""The body of a creature bends in a wave that runs to its tail, and hangs together."""

import math
from itertools import pairwise

import numpy as np
import pytest

from hw.twin.creatures import PARTS, Attitude, bend, swimming
from hw.twin.scene import Creature

FISH = Creature(name="fish", length_m=0.2)


def test_the_tail_beats_a_tenth_of_the_length_and_the_nose_not_at_all():
    beats = np.linspace(0, 2 * math.pi, 181)
    assert max(bend(1.0, beat, 1.0)[0] for beat in beats) == pytest.approx(0.1, rel=1e-3)
    assert max(abs(bend(0.0, beat, 1.0)[0]) for beat in beats) == 0.0
    assert max(abs(bend(1.0, beat, 0.5)[0]) for beat in beats) == pytest.approx(0.05, rel=1e-3)


def test_the_wave_runs_to_the_tail_and_parts_point_along_it():
    """A quarter of a beat later the crest is a quarter of a wave further back."""
    s = np.linspace(0.2, 1.0, 401)
    shares = 0.02 * s + 0.08 * s * s

    def crest(beat):
        return s[np.argmax([bend(x, beat, 1.0)[0] / share for x, share in zip(s, shares, strict=True)])]

    assert crest(math.pi / 2) - crest(0.0) == pytest.approx(0.25, abs=0.005)
    for x in (0.3, 0.9):
        (ahead, _), (behind, _) = bend(x - 1e-6, 1.0, 1.0), bend(x + 1e-6, 1.0, 1.0)
        assert math.tan(bend(x, 1.0, 1.0)[1]) == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


def test_it_looks_where_it_heads_and_is_as_long_as_said():
    """Nose to tail along the heading, nose up by the pitch; each part overlaps with the next."""
    attitude = Attitude(1.0, 1.2, 0.3, math.radians(30), math.radians(10), 0.7, 0.0)
    parts = swimming(FISH, attitude, 0).parts[: len(PARTS) - 1]
    ahead = np.array([math.cos(0.5236) * math.cos(0.17453), math.sin(0.5236) * math.cos(0.17453), math.sin(0.17453)])
    nose, tail = parts[0].position_m + parts[0].radii_m[0] * ahead, parts[-1].position_m - parts[-1].radii_m[0] * ahead
    np.testing.assert_allclose(nose - tail, 0.2 * ahead, atol=1e-5)
    np.testing.assert_allclose((nose + tail) / 2, attitude[:3], atol=1e-9)
    for width in (0.0, 1.0):
        bent = swimming(FISH, attitude._replace(width=width), 0).parts[: len(PARTS) - 1]
        assert all(
            np.linalg.norm(a.position_m - b.position_m) < 0.8 * (a.radii_m[0] + b.radii_m[0]) for a, b in pairwise(bent)
        )


def test_a_look_alike_wears_the_same_blotches_another_of_the_colour_does_not():
    def pattern(**keywords):
        creature = Creature(**keywords)
        parts = swimming(creature, Attitude(1, 1, 0.2, 0, 0, 0, 0), 3).parts
        return [(part.pattern_m, part.material) for part in parts]

    assert pattern(name="two", like="fish") == pattern(name="fish") != pattern(name="two")
    assert pattern(name="fish", colour="silver")[0][1] != pattern(name="fish")[0][1]
