"""Poses between ticks, and those that are not kept."""

import numpy as np
import pytest

from hw.camera.camera import CameraGone
from hw.twin.dive import SPAN
from hw.twin.physics.body import matrix, quaternion
from hw.twin.physics.tank import TICK_NS
from tests.hw.twin.filled_history import START_NS, filled


def test_poses_are_interpolated_between_ticks():
    pose, other = filled(20).at(START_NS + 12 * TICK_NS + TICK_NS // 4)
    np.testing.assert_allclose(pose.position_m, (0.01225, 0.2, 0.1))
    np.testing.assert_allclose(pose.rotation, matrix(quaternion(0, 0, 0.1225)), atol=1e-7)
    assert pose.pan_deg == pytest.approx(1.225)
    np.testing.assert_allclose(other.position_m, (1.0, 0.8, 0.1))


def test_a_pose_of_the_future_or_the_forgotten_past_is_refused():
    history = filled(SPAN + 50)
    assert history.at(START_NS + 50 * TICK_NS)
    assert history.at(history.newest_ns)
    for t_ns in (START_NS + 50 * TICK_NS - 1, history.newest_ns + 1):
        with pytest.raises(CameraGone):
            history.at(t_ns)
