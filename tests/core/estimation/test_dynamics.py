"""How a target moves unseen: the closed form against integrals, many short steps, and drawn paths."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from agent.core.estimation.track import ROLLING, SMALL, Growth, Track, growth, predict, swimming

FISH = swimming(0.2, 2.0)


def test_a_fish_of_20_cm_a_second_in_the_plane() -> None:
    assert FISH.first_speed_m_s == pytest.approx(0.2 / math.sqrt(2))
    assert FISH.psd_m2_s3 == pytest.approx(2e-2)


@pytest.mark.parametrize("h_s", [1e-6, 1e-3, SMALL * 2.0 * 0.999, SMALL * 2.0 * 1.001, 0.2, 3.0, 60.0])
def test_what_a_step_brings_is_the_integral(h_s) -> None:
    """Place and velocity answer an impulse of dW that is s old with T (1 - e^(-s/T)) and e^(-s/T)."""
    q, T, _ = FISH

    def answer(s):
        return -T * math.expm1(-s / T), math.exp(-s / T)

    def variance(i, j):
        return q * quad(lambda s: answer(s)[i] * answer(s)[j], 0, h_s, epsrel=1e-12, epsabs=0)[0]

    assert growth(FISH, h_s) == pytest.approx(
        Growth(*answer(h_s), variance(0, 0), variance(0, 1), variance(1, 1)), rel=1e-9
    )


def test_two_steps_are_one_and_slow_turning_is_a_random_walk() -> None:
    track = Track(0, (1.0, 0.5, 0.2), (0.1, -0.05, 0.0), (1e-4, 1e-5, 0.0, 2e-4, 0.0, 1e-4), (1e-5,) * 9, (0.02,) * 6)
    once, twice = predict(track, 10**9, FISH), predict(predict(track, 3 * 10**8, FISH), 10**9, FISH)
    for a, b in zip(once, twice, strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-16)
    slow, rolling = predict(track, 10**9, ROLLING._replace(turn_s=1e7)), predict(track, 10**9, ROLLING)
    assert (slow.x_m, slow.v_m_s) == (pytest.approx(rolling.x_m, rel=1e-6), pytest.approx(rolling.v_m_s, rel=1e-6))
    for a, b in zip(slow[3:], rolling[3:], strict=True):
        assert a[:-1] == pytest.approx(b[:-1], rel=1e-6), "the last one, upwards, grows less"
        assert a[-1] < b[-1]


def test_drawn_paths_spread_as_the_covariance_says() -> None:
    """20 000 of them, in steps of 5 ms by Euler and Maruyama; from rest, which is no steady state."""
    rng, (q, T, _), h_s, n = np.random.default_rng(0), FISH, 0.005, 20_000
    x, v = np.zeros(n), np.full(n, 0.1)
    for _ in range(200):
        x += h_s * v
        v += -v * h_s / T + math.sqrt(q * h_s) * rng.standard_normal(n)
    start = Track(0, (0.0,) * 3, (0.1,) * 3, (0.0,) * 6, (0.0,) * 9, (0.0,) * 6)
    track = predict(start, 10**9, FISH)
    assert np.mean(x) == pytest.approx(track.x_m[0], abs=4 * math.sqrt(track.A[0] / n) + 2e-4)
    assert np.mean(v) == pytest.approx(track.v_m_s[0], abs=4 * math.sqrt(track.D[0] / n) + 2e-4)
    assert [np.var(x), np.cov(x, v)[0, 1], np.var(v)] == pytest.approx([track.A[0], track.C[0], track.D[0]], rel=0.04)


def test_unseen_for_long_its_speed_is_as_unknown_as_at_first() -> None:
    track = predict(Track(0, (0.0,) * 3, (0.3,) * 3, (0.0,) * 6, (0.0,) * 9, (0.0,) * 6), 60 * 10**9, FISH)
    assert pytest.approx([FISH.first_speed_m_s**2 * i for i in (1, 0, 0, 1, 0, 0.09)], abs=1e-12) == track.D
    assert track.v_m_s == pytest.approx((0, 0, 0), abs=1e-12)
