"""The compiled fit of many curves against the kernel's own, on curves of every kind."""

import numpy as np
import pytest

from agent.core.ranging.focus import fit_peaks
from agent.perception.clarity import block_peaks

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
