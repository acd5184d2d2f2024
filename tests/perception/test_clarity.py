"""Tenengrad against the formula written out in plain numpy; the sums are integers, so equality is exact."""

import cv2
import numpy as np
import pytest

from agent.core.ranging.focus import fit_peaks
from agent.perception.clarity import (
    block_peaks,
    gradient_energy,
    grid,
    growth_power,
    half_clarity,
    luminance,
    tenengrad_blocks,
    tenengrad_disc,
    tenengrad_grid,
    tenengrad_region,
)


def sobel_energy(grey):
    y = np.pad(grey.astype(np.int64), 1, mode="reflect")
    height, width = grey.shape
    part = {(r, c): y[1 + r : 1 + r + height, 1 + c : 1 + c + width] for r in (-1, 0, 1) for c in (-1, 0, 1)}
    gx = sum(k * (part[r, 1] - part[r, -1]) for r, k in ((-1, 1), (0, 2), (1, 1)))
    gy = sum(k * (part[1, c] - part[-1, c]) for c, k in ((-1, 1), (0, 2), (1, 1)))
    return gx * gx + gy * gy


@pytest.fixture
def grey():
    return np.random.default_rng(0).integers(0, 256, (127, 211), dtype=np.uint8)


def test_energy_is_the_formula(grey):
    assert np.array_equal(gradient_energy(grey), sobel_energy(grey))


@pytest.mark.parametrize("block", [50, 25, 127])
def test_blocks(grey, block):
    energy = sobel_energy(grey)
    got = tenengrad_blocks(grey, block)
    assert got.shape == (127 // block, 211 // block)
    for r in range(got.shape[0]):
        for c in range(got.shape[1]):
            part = energy[r * block : (r + 1) * block, c * block : (c + 1) * block]
            assert got[r, c] == part.sum() / block**2


def test_a_block_of_the_strongest_gradients_does_not_overflow():
    stripes = np.tile(np.array([0, 0, 255, 255], np.uint8), (100, 25))
    assert tenengrad_blocks(stripes, 100)[0, 0] == sobel_energy(stripes).sum() / 100**2 > 9e5


def test_a_block_larger_than_the_image_is_an_error(grey):
    with pytest.raises(ValueError, match="200 px does not fit"):
        tenengrad_blocks(grey, 200)


@pytest.mark.parametrize(
    ("centre", "radius"), [((100.0, 60.0), 30.0), ((99.5, 60.25), 12.7), ((3.0, 2.0), 20.0), ((205.0, 120.0), 30.0)]
)
def test_disc(grey, centre, radius):
    v, u = np.mgrid[: grey.shape[0], : grey.shape[1]]
    inside = (u - centre[0]) ** 2 + (v - centre[1]) ** 2 <= radius**2
    value, area = tenengrad_disc(grey, centre, radius)
    assert area == inside.sum()
    assert value == sobel_energy(grey)[inside].sum() / area


def test_a_disc_outside_the_image_has_no_area(grey):
    assert tenengrad_disc(grey, (-50.0, 10.0), 20.0) == (0.0, 0.0)


def test_white_noise_adds_24_sigma_squared():
    noise = np.random.default_rng(1).normal(128, 5, (600, 600)).round().astype(np.uint8)
    assert tenengrad_blocks(noise, 600)[0, 0] == pytest.approx(24 * (25 + 1 / 12), rel=0.03)


def test_luminance_of_grey_is_itself(grey):
    assert luminance(grey) is grey
    assert np.array_equal(luminance(np.repeat(grey[:, :, None], 3, axis=2)), grey)


@pytest.fixture
def colour():
    return np.random.default_rng(2).integers(0, 256, (127, 211, 3), dtype=np.uint8)


def test_the_way_from_colours_is_the_library_s(colour):
    assert np.array_equal(tenengrad_blocks(colour, 25), tenengrad_blocks(luminance(colour), 25))
    assert tenengrad_disc(colour, (90.0, 50.0), 20.0) == tenengrad_disc(luminance(colour), (90.0, 50.0), 20.0)


def test_any_grid_and_any_region(grey):
    energy = sobel_energy(grey)
    rows, cols = np.array([3, 9, 9, 60, 127]), np.array([0, 1, 50, 211])
    got = tenengrad_grid(grey, rows, cols)
    for r, c in np.ndindex(4, 3):
        part = energy[rows[r] : rows[r + 1], cols[c] : cols[c + 1]]
        assert got[r, c] == (part.mean() if part.size else 0.0)
    inside = np.random.default_rng(3).random(grey.shape) < 0.3
    value, area = tenengrad_region(grey, inside)
    assert area == inside.sum() and value == energy[inside].sum() / area


def test_a_block_of_many_rows_does_not_overflow():
    stripes = np.tile(np.array([0, 0, 255, 255], np.uint8), (1500, 10))
    assert tenengrad_grid(stripes, np.array([0, 1500]), np.array([0, 40]))[0, 0] == sobel_energy(stripes).mean()


def test_a_part_of_an_image_need_not_lie_in_one_piece(grey):
    part = grey[10:90, 20:170]
    assert np.array_equal(tenengrad_blocks(part, 40), tenengrad_blocks(part.copy(), 40))


def test_the_grid_grows_about_the_principal_point():
    assert grid(640, 50).tolist() == list(range(0, 601, 50))
    assert grid(640, 50, 0.95, 319.5).tolist() == [16, 64, 111, 158, 206, 254, 301, 348, 396, 444, 491, 538, 586]
    assert grid(100, 50, 1.5).tolist() == [0, 50, 100]  # cut off at the image
    small, large = grid(640, 40, 0.97, 200.0), grid(640, 40, 1.0, 200.0)
    fixed = (large - 0.5 - 200.0) * 0.97 + 200.0 + 0.5
    assert np.abs(small - fixed).max() <= 0.5


# --- peaks ---
# The compiled fit of many curves against the kernel's own, on curves of every kind.

SWEEP = np.linspace(0, 1023, 30).round()


def curves(noise, seed):
    rng = np.random.default_rng(seed)
    x0, w = rng.uniform(-50, 1070, 300), rng.uniform(25, 400, 300)
    clean = 1000 / (1 + ((SWEEP - x0[:, None]) / w[:, None]) ** 2) + 80
    return clean + rng.normal(0, noise, clean.shape)


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (15.0, 1), (100.0, 2)])
def test_as_the_kernel_fits(noise, seed):
    y = curves(noise, seed)
    compiled, kernel = block_peaks(SWEEP, y), fit_peaks(SWEEP, y)
    assert np.array_equal(compiled.accepted, kernel.accepted) and kernel.accepted.any()
    for name in ("lens_position", "sigma", "width", "quality"):
        ours, theirs = (getattr(peaks, name)[kernel.accepted] for peaks in (compiled, kernel))
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (15.0, 1), (100.0, 2)])
def test_uneven_steps(noise, seed):
    """Narrow templates tie where they see one sample only; what starts from another ends where both stop to refine."""
    lens_positions, y = np.sort(np.random.default_rng(9).uniform(0, 1000, 30)), curves(noise, seed)
    compiled, kernel = block_peaks(lens_positions, y), fit_peaks(lens_positions, y)
    apart = np.abs(compiled.lens_position - kernel.lens_position)[kernel.accepted]
    assert np.array_equal(compiled.accepted, kernel.accepted)
    assert np.mean(apart > 1e-9 * 1000) < 0.05 and apart.max() < 0.01 * 1000 / 30  # a hundredth of a step


def test_curves_without_a_peak_are_refused():
    flat = np.vstack([np.zeros(30), np.full(30, 7.0), np.random.default_rng(3).normal(1000, 200, (50, 30))])
    assert block_peaks(SWEEP, flat).accepted.sum() == fit_peaks(SWEEP, flat).accepted.sum() <= 1


@pytest.mark.parametrize("method", ["parabola", "argmax"])
def test_the_baselines_are_those_of_the_kernel(method):
    y = curves(15.0, 4)
    assert np.array_equal(block_peaks(SWEEP, y, method).lens_position, fit_peaks(SWEEP, y, method=method).lens_position)


@pytest.mark.parametrize("coarse_px", [1.5, 2.0, 3.0, 6.0])
def test_a_picture_tells_how_its_clarity_falls_as_it_grows(coarse_px: float):
    """White noise through a Gaussian, drawn as it is and 5 % larger."""
    texture = cv2.GaussianBlur(np.random.default_rng(0).normal(0.0, 1.0, (1200, 1600)), (0, 0), coarse_px)
    texture *= 40.0 / texture.std()
    rows, cols = grid(480, 40), grid(640, 40)

    def drawn(size: float) -> np.ndarray:
        larger = cv2.warpAffine(texture, np.diag([size, size, 1.0])[:2], (640, 480), flags=cv2.INTER_CUBIC)
        return np.clip(np.rint(128.0 + larger), 0, 255).astype(np.uint8)

    clarity = [tenengrad_grid(drawn(size), rows, cols) for size in (1.0, 1.05)]
    fell = np.log(clarity[0].mean() / clarity[1].mean()) / np.log(1.05)
    told = growth_power(clarity[0][None], half_clarity(drawn(1.0), rows, cols)[None])
    assert np.median(told) == pytest.approx(fell, abs=0.2)
    assert 0.5 < fell < 2.0, "a constant for all would not do"
