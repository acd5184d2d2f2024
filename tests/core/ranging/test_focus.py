"""The peak fit against curves with known peaks, and h with its inverse and its variance."""

import math

import numpy as np
import pytest

from agent.core.ranging.focus import NoPeak, Peak, fit_peak, fit_peaks, h, lens_position, range_variance
from tests.known_lens import FITTED as FIT

SWEEP = np.linspace(0, 1023, 30).round()


def curve(x, x0, w, noise=0.0, seed=0):
    return 1000 / (1 + ((np.asarray(x) - x0) / w) ** 2) + 80 + np.random.default_rng(seed).normal(0, noise, len(x))


@pytest.mark.parametrize("x0", [80.0, 333.3, 700.0, 960.0])
@pytest.mark.parametrize("w", [30.0, 90.0, 250.0])
def test_peak_of_the_model_itself_is_exact(x0, w):
    peak = fit_peak(SWEEP.tolist(), curve(SWEEP, x0, w).tolist())
    assert isinstance(peak, Peak)
    assert peak.lens_position == pytest.approx(x0, abs=0.01)
    assert peak.width == pytest.approx(w, rel=1e-3)
    assert peak.quality > 0.9999


def test_sigma_is_the_spread_of_the_error():
    normalised = []
    for seed in range(150):
        x0 = 300 + seed
        peak = fit_peak(SWEEP.tolist(), curve(SWEEP, x0, 90, 15, seed).tolist())
        normalised.append((peak.lens_position - x0) / peak.sigma)
    assert 0.8 < np.std(normalised) < 1.25
    assert abs(np.mean(normalised)) < 0.3


def test_short_sweep_with_known_width_is_nearly_as_good_as_a_full_one():
    errors = []
    for seed in range(60):
        window = np.linspace(-1.5, 1.5, 7) * 90 + 400
        peak = fit_peak(window.tolist(), curve(window, 410, 90, 15, seed).tolist(), width=90.0)
        assert isinstance(peak, Peak) and peak.width == 90.0
        errors.append(peak.lens_position - 410)
    assert np.std(errors) < 3.0 and abs(np.mean(errors)) < 1.0


def test_unequal_steps_in_any_order():
    x = np.array([500.0, 410, 430, 340, 460, 395, 300, 445])
    peak = fit_peak(x.tolist(), curve(x, 421, 60).tolist())
    assert isinstance(peak, Peak) and peak.lens_position == pytest.approx(421, abs=0.01)


@pytest.mark.parametrize(
    ("x", "y", "word"),
    [
        ([1, 2, 3, 4], [1, 5, 5, 1], "positions"),
        ([1, 2, 2, 2, 2, 3], [1, 5, 5, 5, 5, 1], "positions"),
        (SWEEP.tolist(), [7.0] * 30, "flat"),
        (SWEEP.tolist(), [0.0] * 30, "flat"),
        (SWEEP.tolist(), curve(SWEEP, -50, 90).tolist(), "edge"),
        (SWEEP.tolist(), curve(SWEEP, 1030, 90).tolist(), "edge"),
        (SWEEP.tolist(), (curve(SWEEP, 250, 60) + curve(SWEEP, 780, 60)).tolist(), "no single peak"),
    ],
)
def test_no_peak_is_refused_with_its_reason(x, y, word):
    result = fit_peak(x, y)
    assert isinstance(result, NoPeak)
    assert word in result.reason and "\n" not in result.reason


def test_noise_alone_is_not_accepted():
    noise = np.random.default_rng(5).normal(1000, 200, (300, 30))
    assert fit_peaks(SWEEP, noise).accepted.mean() < 0.01


def test_many_curves_give_what_one_gives():
    curves = np.stack([curve(SWEEP, 100 + 40 * k, 70 + k, 10, k) for k in range(20)])
    many = fit_peaks(SWEEP, curves)
    assert many.accepted.all()
    for k in range(20):
        one = fit_peak(SWEEP.tolist(), curves[k].tolist())
        assert one == Peak(many.lens_position[k], many.sigma[k], many.width[k], many.quality[k])


def test_scale_of_the_clarity_does_not_matter():
    y = curve(SWEEP, 512, 80, 10)
    a, b = fit_peak(SWEEP.tolist(), y.tolist()), fit_peak(SWEEP.tolist(), (1e6 * y).tolist())
    assert a.lens_position == pytest.approx(b.lens_position, abs=1e-6)


def test_h_and_its_inverse():
    for u_m in (0.2, 0.45, 1.3):
        assert h(FIT, lens_position(FIT, u_m)) == pytest.approx(u_m, abs=1e-12)


def test_at_and_beyond_the_pole_there_is_no_range():
    assert h(FIT, FIT.rho0) is None
    assert h(FIT, FIT.rho0 - 20) is None
    assert h(FIT, FIT.rho0 + 1) is None  # 136 m
    with pytest.raises(ValueError, match="nearer"):
        lens_position(FIT, -0.01)


def test_range_variance_agrees_with_monte_carlo():
    rng = np.random.default_rng(1)
    rho, xx_zz = lens_position(FIT, 0.5), FIT.covariance
    xx, xy, xz, yy, yz, zz = xx_zz
    C = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    random_m2, systematic_m2 = range_variance(FIT, rho, 2.0)
    peaks = [h(FIT, rho + d) for d in rng.normal(0, 2.0, 4000)]
    assert math.sqrt(random_m2) == pytest.approx(np.std(peaks), rel=0.05)
    values, vectors = np.linalg.eigh(C)
    draws = rng.normal(0, 1, (4000, 3)) * np.sqrt(np.maximum(values, 0)) @ vectors.T
    fits = [FIT.u_inf_m + a + (FIT.b_m + b) / (rho - FIT.rho0 - c) for a, b, c in draws]
    assert math.sqrt(systematic_m2) == pytest.approx(np.std(fits), rel=0.06)
    assert range_variance(FIT, rho, 0.01)[0] == range_variance(FIT, rho, FIT.noise)[0]


@pytest.mark.parametrize(("method", "within"), [("matched", 0.01), ("parabola", 3.0), ("argmax", 18.0)])
def test_methods_differ_in_the_peak_alone(method, within):
    curves = np.stack([curve(SWEEP, 300 + 3 * k, 60) for k in range(40)])
    peaks, matched = fit_peaks(SWEEP, curves, method=method), fit_peaks(SWEEP, curves)
    error = np.abs(peaks.lens_position - (300 + 3 * np.arange(40)))
    assert within / 20 < error.max() < within or (method == "matched" and error.max() < within)
    assert np.array_equal(peaks.accepted, matched.accepted) and peaks.accepted.all()


# A narrow peak in noise, in percent: from the best template the full step makes the fit worse.
NARROW = (-13, 2, -15, 6, 22, -5, 56, 46, 12, 7, -6, 3, -3, 9, 3, 6, 1, 5, 4, -6, 2, 11, -5, -1, 0, -5, -2, 6, -12,
          2)  # fmt: skip


def test_a_step_that_makes_the_fit_worse_is_halved_not_dropped():
    y = np.array(NARROW, float)
    peaks = fit_peaks(SWEEP, y[None])
    x0, w = peaks.lens_position[0], peaks.width[0]
    around = [_sse(y, x0 + dx, w * dw) for dx in (-1.0, 0.0, 1.0) for dw in (0.97, 1.0, 1.03)]
    assert _sse(y, x0, w) <= min(around) * (1 + 1e-6)


def _sse(y, x0, w):
    columns = np.stack([1 / (1 + ((SWEEP - x0) / w) ** 2), np.ones_like(SWEEP)], axis=1)
    best = np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(((columns @ best - y) ** 2).sum())


def test_a_second_rise_is_refused_whatever_the_quality():
    y = curve(SWEEP, 300, 120) + 0.4 * curve(SWEEP, 760, 70)
    result = fit_peak(SWEEP.tolist(), y.tolist())
    assert isinstance(result, NoPeak) and "rises again" in result.reason


def test_sigma_has_a_floor():
    peak = fit_peak(SWEEP.tolist(), curve(SWEEP, 500, 90).tolist())
    assert 0.1 < peak.sigma < 2.0  # the model itself, without noise
