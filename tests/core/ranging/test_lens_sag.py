"""The lens's own weight: found from views up and down, taken out of every range, and worth what it says."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Target
from agent.core.ranging.camera_model import CameraFit, FocusFit
from agent.core.ranging.fix import focus_range
from agent.core.ranging.focus import UNKNOWN_SAG, TiltedPeak, at_tilt, h, lens_position, phase_sigma, with_sag

FIT = FocusFit(
    u_inf_m=-0.001,
    b_m=136.0,
    rho0=102.0,
    covariance=(0.0, 0.0, 0.0, 0.0, 0.0, 0.04),
    noise=0.6,
    width=115.0,
    lowest=215,
    highest=720,
    r2=0.999,
    rmse_m=0.001,
    held_out_rmse_m=0.001,
)
TILTS = np.radians([-20.0, 20.0] * 3)
DISTANCES_M = (0.40, 0.40, 0.43, 0.43, 0.46, 0.46)


def peaks(sag, noise=0.0, warm=0.0, seed=0):
    off = np.random.default_rng(seed).normal(0.0, noise, len(TILTS)) if noise else np.zeros(len(TILTS))
    return [
        TiltedPeak(u, lens_position(FIT, u) + sag * math.sin(t) + warm + e, t)
        for u, t, e in zip(DISTANCES_M, TILTS, off, strict=True)
    ]


def test_sag_comes_back_whatever_has_warmed_up():
    assert with_sag(FIT, peaks(5.5)).sag == pytest.approx(5.5)
    assert with_sag(FIT, peaks(-3.0, warm=2.0)).sag == pytest.approx(-3.0)


def test_it_is_as_wrong_as_it_says():
    fits = [with_sag(FIT, peaks(5.5, FIT.noise, seed=seed)) for seed in range(200)]
    z = np.array([(fit.sag - 5.5) / fit.sag_sigma for fit in fits])
    assert 0.7 < z.std() < 1.1 and abs(z.mean()) < 0.25


def test_views_that_hardly_differ_in_tilt_tell_nothing():
    flat = [peak._replace(tilt_rad=0.05) for peak in peaks(5.5)]
    assert with_sag(FIT, flat) == FIT and with_sag(FIT, peaks(5.5)[:2]) == FIT


def test_sweeps_of_one_tilt_and_distance_share_what_the_tape_has_wrong():
    once = with_sag(FIT, peaks(5.5, 3.0))
    often = with_sag(FIT, peaks(5.5, 3.0) * 5)
    assert (often.sag, often.sag_sigma) == pytest.approx((once.sag, once.sag_sigma))
    assert with_sag(FIT, peaks(5.5)[:2] * 5) == FIT  # two settings tell nothing of their own scatter


def test_a_level_lens_is_left_alone():
    known = with_sag(FIT, peaks(5.5))
    assert at_tilt(known, 0.0) == known and at_tilt(FIT, 0.0) == FIT


def test_tilted_peaks_give_the_true_range():
    known, up = replace(FIT, sag=5.5, sag_sigma=0.7), math.radians(-25.0)
    rho = lens_position(FIT, 0.7) + 5.5 * math.sin(up)
    assert h(at_tilt(known, up), rho) == pytest.approx(0.7)
    assert h(known, rho) > 0.708


def test_a_measured_sag_is_trusted_more_than_an_unknown_one():
    camera, ball = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5), Target(radius_m=0.07)
    ranges = [
        focus_range(fit, camera, (319.5, 239.5), lens_position(FIT, 0.5), 0.5, ball, -0.5)
        for fit in (FIT, replace(FIT, sag=0.0, sag_sigma=0.7), replace(FIT, sag=0.0, sag_sigma=0.0))
    ]
    slope = FIT.b_m / (lens_position(FIT, 0.5) - FIT.rho0) ** 2
    unknown, measured, exact = (one.systematic_m2 for one in ranges)
    assert unknown - exact == pytest.approx((slope * UNKNOWN_SAG * FIT.width * math.sin(0.5)) ** 2)
    assert measured - exact == pytest.approx((slope * 0.7 * math.sin(0.5)) ** 2)


def test_more_pixels_or_a_narrower_peak_owe_less_to_the_grid():
    assert phase_sigma(120.0, 3600.0) == pytest.approx(1.0)
    assert phase_sigma(60.0, 14400.0) == pytest.approx(0.25)
