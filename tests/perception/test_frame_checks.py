"""Frames that are none, and pictures that stand still."""

from __future__ import annotations

import numpy as np
import pytest

from agent.perception.vision import FROZEN_FRAMES, FROZEN_NS, FrozenWatch, check
from hw.camera.camera import CameraError, Frame, Roi
from hw.camera.files import StackCamera

SIZE = (64, 48)
WHOLE, PART = Roi(0, 0, *SIZE), Roi(8, 8, 32, 32)
MS = 1_000_000
SCENE = np.random.default_rng(3).integers(0, 256, (48, 64, 3), np.uint8)


def noisy(seed: int) -> np.ndarray:
    """The same scene, one grey level of noise in every other pixel."""
    return SCENE ^ np.random.default_rng(seed).integers(0, 2, SCENE.shape, np.uint8)


def frame(number: int, image: np.ndarray = SCENE, roi: Roi = WHOLE, still: bool = False) -> Frame:
    return Frame(number * MS, number, image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width], roi, still)


@pytest.mark.parametrize(
    ("image", "roi", "why"),
    [
        (np.zeros((0, 0, 3), np.uint8), Roi(0, 0, 0, 0), "0x0 pixels"),
        (np.zeros((48, 0, 3), np.uint8), WHOLE, "0x48 pixels for 64x48"),
        (np.zeros((47, 64, 3), np.uint8), WHOLE, "64x47 pixels for 64x48"),
        (np.zeros((48, 64), np.uint8), WHOLE, r"uint8 of shape \(48, 64\), not three bytes"),
        (np.zeros((48, 64, 4), np.uint8), WHOLE, "not three bytes"),
        (np.zeros((48, 64, 3), np.float32), WHOLE, "float32"),
        (np.zeros((48, 64, 3), np.uint8), Roi(1, 0, 64, 48), "outside its 64x48"),
        (np.zeros((8, 8, 3), np.uint8), Roi(-8, 0, 8, 8), "outside its 64x48"),
        (None, WHOLE, "NoneType"),
    ],
)
def test_what_is_no_frame_is_refused_in_one_line(image, roi, why):
    with pytest.raises(CameraError, match=why) as refused:
        check(Frame(1, 1, image, roi), SIZE)
    assert "\n" not in str(refused.value)


def test_a_frame_and_a_part_of_one_are_accepted():
    check(frame(1), SIZE)
    check(frame(2, roi=PART), SIZE)


def told(frames: list[Frame], every_ns: int = 250 * MS) -> list[str | None]:
    watch = FrozenWatch()
    return [watch.see(one, i * every_ns) for i, one in enumerate(frames)]


def test_the_same_picture_for_two_seconds_is_frozen_and_over_when_it_moves():
    frames = [frame(i, noisy(4 if 4 <= i <= 30 else i)) for i in range(40)]  # the same from 4 to 30, numbered on
    why = told(frames)
    first = 4 + FROZEN_NS // (250 * MS)
    assert why[:first] == [None] * first
    assert all(text is not None and "same picture" in text for text in why[first:31])
    assert why[31:] == [None] * 9


def test_a_sweep_of_the_lens_over_a_frozen_picture_is_frozen_too():
    """Between frames of the whole come those of a part, and the part may wander."""
    rois = [WHOLE, *[PART] * 6, WHOLE, *[PART] * 6, WHOLE, *[Roi(16, 8, 32, 32)] * 6] * 3
    why = told([frame(i, roi=roi) for i, roi in enumerate(rois)], every_ns=100 * MS)
    assert why[-1] is not None


def test_the_same_frame_again_is_frozen_whatever_is_in_it():
    why = told([Frame(7, 7, noisy(i), WHOLE) for i in range(12)])
    assert why[-1] is not None and "same frame" in why[-1]


def test_a_sensor_that_looks_at_a_still_scene_is_not_frozen():
    assert set(told([frame(i, noisy(i)) for i in range(60)])) == {None}


def test_a_machine_that_stood_still_is_no_frozen_camera():
    assert told([frame(i) for i in range(FROZEN_FRAMES)], every_ns=10 * FROZEN_NS) == [None] * FROZEN_FRAMES


def test_photographs_may_repeat():
    camera = StackCamera([], SCENE)
    assert set(told([camera.read() for _ in range(60)])) == {None}
