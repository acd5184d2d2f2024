"""From blocks to pixels: a plane stays one, what does not hang together is left out, sigma is the calibration's."""

import numpy as np
import pytest

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import range_variance
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction.views import FLOOR_M, composite, focus_map, linear, range_sigma_m, shrunk_frame

FOCUS = FocusFit(u_inf_m=0.001, b_m=130.0, rho0=90.0, covariance=(0.0,) * 6, noise=0.7, width=250.0, lowest=190,
                 highest=700, r2=1.0, rmse_m=0.0, held_out_rmse_m=0.0)  # fmt: skip
BLOCK, TIMES = 50, 4


def grid(range_m: np.ndarray) -> DepthMap:
    """Blocks at these ranges, all accepted but those that are NaN."""
    rho = FOCUS.rho0 + FOCUS.b_m / (range_m - FOCUS.u_inf_m)
    reason = np.where(np.isnan(range_m), Reason.POOR_FIT, Reason.ACCEPTED).astype(np.uint8)
    ones = np.ones_like(range_m)
    blocks = GridPeaks(rho, 2.0 * ones, 250.0 * ones, ones, reason, range_m)
    return DepthMap(BLOCK, blocks, None, np.zeros((1, 1, 3), np.uint8), 0.0)


def test_a_plane_between_blocks_is_a_plane() -> None:
    """1/z of a plane is linear in the pixel; the middle of block n is pixel 50 n + 24.5."""
    u, v = np.meshgrid(50 * np.arange(8) + 24.5, 50 * np.arange(6) + 24.5)
    found = focus_map(grid(1.0 / (2.0 + 4e-4 * u - 3e-4 * v)), FOCUS, TIMES, (100, 75))
    small_u, small_v = np.meshgrid(4 * np.arange(100) + 1.5, 4 * np.arange(75) + 1.5)
    known = np.isfinite(found.depth_m)
    assert known.mean() > 0.7  # half a block at the rim has no four around it
    truth = 1.0 / (2.0 + 4e-4 * small_u - 3e-4 * small_v)
    np.testing.assert_allclose(found.depth_m[known], truth[known], rtol=1e-6)


def test_three_blocks_tell_what_lies_between_them() -> None:
    """The middle of block (2, 3) is small pixel (43.25, 30.75) of (u, v), 12.5 of them are a block."""
    u, v = np.meshgrid(50 * np.arange(8) + 24.5, 50 * np.arange(6) + 24.5)
    ranges = 1.0 / (2.0 + 4e-4 * u - 3e-4 * v)
    ranges[2, 3] = np.nan
    found = focus_map(grid(ranges), FOCUS, TIMES, (100, 75))
    u, v = np.meshgrid(np.arange(100), np.arange(75))
    away = np.abs(u - 43.25) / 12.5 + np.abs(v - 30.75) / 12.5  # 1 at the four blocks beside it
    asked = (u > 6) & (u < 93) & (v > 6) & (v < 68) & (np.abs(away - 1.0) > 1e-9)
    np.testing.assert_array_equal(np.isfinite(found.depth_m)[asked], (away > 1.0)[asked])
    truth = 1.0 / (2.0 + 4e-4 * (4 * u + 1.5) - 3e-4 * (4 * v + 1.5))
    known = np.isfinite(found.depth_m)
    np.testing.assert_allclose(found.depth_m[known], truth[known], rtol=1e-6)


def test_across_a_step_nothing_is_guessed() -> None:
    ranges = np.full((6, 8), 0.5)
    ranges[:, 4:] = 0.7
    ranges[2, 1] = np.nan
    found = focus_map(grid(ranges), FOCUS, TIMES, (100, 75))
    between = slice(int((50 * 3 + 24.5) / 4) + 2, int((50 * 4 + 24.5) / 4) - 1)
    assert np.isnan(found.depth_m[:, between]).all()
    assert np.isnan(found.depth_m[27:35, 15:22]).all()  # what is nearer to the unknown block than to all others
    assert set(np.unique(found.depth_m[np.isfinite(found.depth_m)]).round(4)) == {np.float32(0.5), np.float32(0.7)}


def test_sigma_is_the_calibrations() -> None:
    found = grid(np.array([[0.3, 0.6], [0.9, 1.2]]))
    told = range_sigma_m(found.blocks, FOCUS)
    for row, col in np.ndindex(2, 2):
        rho = float(found.blocks.lens_position[row, col])
        assert told[row, col] ** 2 == pytest.approx(range_variance(FOCUS, rho, 2.0)[0])
    flat = focus_map(grid(np.full((6, 8), 0.5)), FOCUS, TIMES, (100, 75))
    s = np.sqrt(range_variance(FOCUS, float(grid(np.full((1, 1), 0.5)).blocks.lens_position[0, 0]), 2.0)[0])
    np.testing.assert_allclose(flat.sigma_m[np.isfinite(flat.sigma_m)], np.hypot(s, FLOOR_M), rtol=1e-5)


def test_each_part_comes_from_its_sharpest_frame_on_the_largest_ones_scale() -> None:
    rng = np.random.default_rng(2)
    scene = np.kron(rng.integers(40, 220, (12, 16, 3)), np.ones((20, 20, 1))).astype(np.uint8)  # 320 x 240
    dark = np.zeros_like(scene)
    left, right = scene.copy(), scene.copy()
    left[:, 160:], right[:, :160] = dark[:, 160:], dark[:, :160]
    clarity = np.zeros((2, 4, 8))
    clarity[0, :, :4], clarity[1, :, 4:] = 1.0, 1.0
    picture = composite([left, right], np.ones(2), (159.5, 119.5), clarity, 40.0, 4, 2.2)
    truth = linear(scene, 2.2).reshape(60, 4, 80, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(picture[:, :34], truth[:, :34], atol=1e-6)
    np.testing.assert_allclose(picture[:, 46:], truth[:, 46:], atol=1e-6)


def test_a_smaller_frame_is_brought_to_the_largest_ones_scale() -> None:
    """A disc of radius 60 about the axis, 57 in a frame 0.95 times as large."""
    v, u = np.mgrid[:240, :320]
    discs = [np.where(np.hypot(u - 150.0, v - 110.0) < r, 200, 20).astype(np.uint8) for r in (60.0, 57.0)]
    frames = [np.repeat(one[..., None], 3, axis=2) for one in discs]
    same = [shrunk_frame(f, s, (150.0, 110.0), 4, 2.2) for f, s in zip(frames, (1.0, 0.95), strict=True)]
    wrong = shrunk_frame(frames[1], 1.0, (150.0, 110.0), 4, 2.2)
    apart = [float(np.abs(same[0] - other).mean()) for other in (same[1], wrong)]
    assert apart[0] < 0.15 * apart[1]
