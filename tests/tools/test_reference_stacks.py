"""Depth from focus on the reference stacks, where they are present: against the truth of the simulated one."""

import cv2
import numpy as np
import pytest

from agent.perception.depth_peaks import Reason
from agent.perception.depth_sweep import measure, sweep
from agent.tools.depth_map import depth_map
from hw.camera.camera import CameraError
from hw.camera.files import open_stack
from tests.places import DATA
from tests.tools.planes import quiet

STACKS = DATA / "focal_stacks"


@pytest.mark.skipif(not STACKS.is_dir(), reason=f"reference stacks are not here: set AUCAMP_DATA (looked in {STACKS})")
class TestReferenceStacks:
    @pytest.mark.parametrize("block", [12, 13])
    def test_simulated_against_truth(self, block):
        """Half a step over the whole object. The truth lies 0.3 steps from every method's peaks; it is counted."""
        stack = STACKS / "bracket_simulated"
        taken = sweep(open_stack(stack), block, quiet)
        result, parabola = measure(taken, block, None), measure(taken, block, None, "parabola")
        with np.load(stack / "truth.npz") as truth:
            depth, mask = truth["depth"], truth["mask"]
        rows, cols = result.blocks.lens_position.shape
        tiles = (slice(rows * block), slice(cols * block))
        inside = mask[tiles].reshape(rows, block, cols, block).all(axis=(1, 3))
        true = depth[tiles].reshape(rows, block, cols, block).mean(axis=(1, 3))
        counted = inside & result.blocks.accepted
        assert counted.sum() >= 0.7 * inside.sum()
        error, baseline = ((r.blocks.lens_position - true)[counted] / 0.02 for r in (result, parabola))  # steps
        assert np.sqrt(np.mean(error**2)) <= 0.5
        assert np.median(np.abs(error)) <= 0.36
        assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(baseline**2))
        beside = ~cv2.dilate(mask.astype(np.uint8), np.ones((101, 101)))[tiles].astype(bool)  # 50 px from the object
        nothing = beside.reshape(rows, block, cols, block).all(axis=(1, 3))
        assert nothing.sum() > 200 and not result.blocks.accepted[nothing].any()

    def test_real_bracket(self, tmp_path):
        result = depth_map(str(STACKS / "bracket_real"), tmp_path / "real.png", 32, tmp_path, None, quiet)
        assert np.isfinite(result.lens_position_on_parts()).mean() > 0.8  # textured metal all over; the rest are edges
        assert (result.blocks.reason == Reason.TWO_DEPTHS).mean() > 0.1
        disc, recess = result.blocks.lens_position[4:8, 4:12], result.blocks.lens_position[17:19, 8:24]
        for plane in (disc, recess):
            assert np.median(np.abs(plane - np.median(plane))) < 0.03  # flat; a third of a step
        assert np.median(disc) - np.median(recess) > 0.7
        # Smooth: across the metal, a block differs from the median of its 3 x 3 by less than the focus step of 0.1.
        lens_position = np.where(result.blocks.accepted, result.blocks.lens_position, np.nan)
        rows, cols = lens_position.shape
        around = np.stack([lens_position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
        rough = np.abs(lens_position[1:-1, 1:-1] - np.median(around, axis=0))  # NaN beside what has none
        assert np.nanmedian(rough) < 0.02 and np.nanmean(rough > 0.1) < 0.05

    def test_a_stack_without_positions(self, tmp_path):
        with pytest.raises(CameraError, match=r"positions\.csv is missing"):
            depth_map(str(STACKS / "phone_balls"), tmp_path / "m.png", 50, tmp_path, None, quiet)
