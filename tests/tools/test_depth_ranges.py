"""What is said of a calibration that does not suit, or suits in part, the lens of a sweep."""

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.ranging.focus import h
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.process.command import Failed
from agent.tools.depth_map import ranges_in_words
from tests.tools.planes import FOCUS

OWN = replace(FOCUS, u_inf_m=0.05, b_m=0.1, rho0=0.0, width=0.1, lowest=0, highest=1)  # of the lens of PEAKS
PEAKS = np.array([[0.21, 0.21, 0.388, 0.388, 0.388]])


def said_with(**changed):
    """Of a view with these peaks and a block without one, by a lens that differs from its own in so much."""
    focus, shape = replace(OWN, **changed), (1, 6)
    peaks = np.append(PEAKS, [[0.3]], axis=1)
    accepted = np.arange(6).reshape(shape) < 5
    range_m = np.array([[math.nan if (m := h(focus, rho)) is None else m for rho in peaks[0]]])
    range_m[~accepted] = math.nan
    reason = np.where(accepted, Reason.ACCEPTED, Reason.NO_TEXTURE).astype(np.uint8)
    blocks = GridPeaks(peaks, np.ones(shape), np.full(shape, 0.1), np.ones(shape), reason, range_m)
    found = DepthMap(10, blocks, None, np.zeros((10, 60, 3), np.uint8), 0.0)
    return ranges_in_words(found, focus, Path("r1.toml"), Path("depth.png"))


def test_a_calibration_that_suits_is_not_worth_a_word():
    assert said_with() == []


@pytest.mark.parametrize(("lens", "or_far"), [
    ({"rho0": 180.0, "b_m": 130.0, "lowest": 200, "highest": 700}, False),
    ({"rho0": 0.4, "lowest": 1, "highest": 2}, True),
])  # fmt: skip
def test_a_calibration_that_gives_no_range_is_of_another_camera(lens, or_far):
    with pytest.raises(Failed) as caught:
        said_with(**lens)
    said = str(caught.value)
    assert said.startswith("r1.toml: gives a range to none of the 5 clear peaks, so it is a calibration of another")
    assert "the peaks lie at lens positions 0.21 to 0.388" in said
    assert f"it was made at lens positions {lens['lowest']} to {lens['highest']} (" in said
    assert ("or all of the view is farther than 10 m" in said) == or_far


def test_what_has_no_range_or_one_that_was_not_calibrated_is_counted():
    none, extrapolated = said_with(rho0=0.3, lowest=1, highest=2)
    assert none == "2 of them have no range: 2 are sharp where the lens is set to infinity or beyond"
    assert extrapolated.startswith(
        "3 ranges are extrapolated: they are not at lens positions 1 to 2 (0.11 m to 0.19 m)"
    )


def test_peaks_far_wider_or_narrower_than_those_of_the_calibration_are_doubtful():
    for width in (0.01, 10.0):
        (line,) = said_with(width=width)
        assert line.startswith("doubtful: peaks are ") and "r1.toml, which may be a calibration of another" in line
