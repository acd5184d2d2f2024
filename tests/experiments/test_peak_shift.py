"""The peak-shift claim measures what a way of enhancement does, and nothing where it does nothing."""

import numpy as np
import pytest

from agent.experiments.still_camera import WATER_INDEX, mm_per_position
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from hw.twin.optics.lens import draw_lens
from hw.twin.scene import generator
from tests.bench.pictures import bench_peak_shift as claim
from tests.bench.pictures.bench_peak_shift import Settings, shifts


def test_a_way_that_does_nothing_moves_nothing_and_one_that_turns_the_contrast_does(monkeypatch):
    """A contrast that rises over the sweep pulls every peak to its end. Of light that rises maps take it out."""

    def rising(sweep):
        shares = 0.8 + 0.2 * np.arange(len(sweep)) / len(sweep)
        return [np.uint8(image.mean() + k * (image - image.mean())) for k, image in zip(shares, sweep, strict=True)]

    monkeypatch.setattr(claim, "ways", lambda: {"classic": lambda sweep: sweep, "fast": rising})
    still, moved = rows = claim.run(0, "tap", Settings(views=1))
    assert still["enhanced"] == still["raw"] > 10
    assert still["median_steps"] == still["p95_mm"] == 0.0
    assert moved["mean_steps"] > 0.05 and moved["median_mm"] > 1.0
    found = claim.summary({"tap": rows, "turbid": rows})
    assert found["classic_kept"] == 100.0 and found["fast_mean_steps"] == pytest.approx(moved["mean_steps"])
    assert not any(key.startswith("held") for key in found)


def test_millimetres_per_lens_position_are_the_slope_of_the_lens_equation():
    lens = draw_lens("imx519_640", generator(0, "r1", "lens"))

    def position(range_m):
        return (lens.image_m(WATER_INDEX / range_m) - lens.at_rest_m) / lens.per_position_m

    slope = (1e3 * 2e-4) / abs(position(0.5 + 1e-4) - position(0.5 - 1e-4))
    assert mm_per_position(lens, np.array([position(0.5)]))[0] == pytest.approx(slope, rel=1e-5)


def test_nothing_in_common_is_no_figure():
    empty = np.full((2, 2), np.nan)
    blocks = GridPeaks(empty, empty, empty, empty, np.full((2, 2), Reason.NO_TEXTURE, np.uint8))
    found = DepthMap(50, blocks, None, np.zeros((100, 100, 3), np.uint8), 0.0)
    assert shifts([found], [found], [empty], 35.0) == {}
