import cv2
import numpy as np

from agent.perception.enhancement.enhance import classic, white_balance
from tests.perception.painted import ball_frame


def test_a_cast_is_taken_out():
    frame = ball_frame((0.0, 0.0, 1.0)).astype(float) * (1.0, 0.9, 0.55)
    before, after = frame.mean(axis=(0, 1)), white_balance(frame.astype(np.uint8)).mean(axis=(0, 1))
    assert np.ptp(before) > 25
    assert np.ptp(after) < 3


def test_a_plane_without_light_is_not_blown_up_to_noise():
    frame = np.full((60, 80, 3), 100, np.uint8)
    frame[:, :, 2] = 4
    assert white_balance(frame)[:, :, 2].max() == 10  # 2.5 times, no more


def test_a_veil_is_lifted():
    veiled = (0.3 * ball_frame((0.0, 0.0, 1.0)) + 130).astype(np.uint8)
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).std() for image in (veiled, classic(veiled))]
    assert grey[1] > 1.5 * grey[0]


def test_shape_and_type_stay_and_the_input_is_left_alone():
    frame = ball_frame((0.0, 0.0, 1.0))
    kept = frame.copy()
    out = classic(frame)
    assert out.shape == frame.shape and out.dtype == np.uint8
    assert np.array_equal(frame, kept)
