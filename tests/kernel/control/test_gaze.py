"""The gaze at a target that swims: still while it is seen, then to and fro, wider and wider."""

import numpy as np
import pytest

from agent.kernel.control.gaze import LOST_NS, PERIOD_S, Gaze, swing_deg, triangle

S, START_NS = 1_000_000_000, 10**18


def test_the_triangle() -> None:
    assert [triangle(k / 8) for k in range(9)] == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
    assert triangle(3.25) == triangle(0.25)


def test_it_swings_to_both_sides_up_to_the_widest() -> None:
    quarters = PERIOD_S * (np.arange(8) / 2 + 0.25)
    assert [swing_deg(t, 0.0) for t in quarters] == pytest.approx([25.0, -45.0, 65.0, -70.0, 70.0, -70.0, 70.0, -70.0])
    at_once = [swing_deg(0.0, share) for share in (0.0, 1 / 3, 2 / 3)]
    assert at_once == pytest.approx([0.0, 10.0, -10.0]), "not all to one side"


def test_it_rests_while_it_sees_and_again_after_a_look_elsewhere() -> None:
    gaze = Gaze(0.25)
    for t_ns in range(START_NS, START_NS + S, S // 20):
        assert gaze.offset_deg(t_ns) == (
            0.0 if t_ns <= START_NS + LOST_NS else pytest.approx(swing_deg((t_ns - START_NS - LOST_NS) * 1e-9, 0.25))
        )
    assert not gaze.sees(START_NS + S)
    gaze.saw(START_NS + S - 100_000_000)
    assert gaze.offset_deg(START_NS + S) == 0.0 and gaze.sees(START_NS + S)
    gaze.saw(START_NS)
    assert gaze.sees(START_NS + S), "an older frame that comes later says nothing new"
    assert gaze.offset_deg(START_NS + 3 * S) == 0.0, "the camera was elsewhere meanwhile"
