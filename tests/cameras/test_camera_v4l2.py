"""The rules for a real camera, checked on a driver that is faked below the ioctl call."""

import cv2
import numpy as np
import pytest

from hw import camera_v4l2 as v4l2
from hw.camera import CameraError, CameraGone


def test_autofocus_goes_off_before_the_lens_is_moved(driver):
    camera = driver.camera()
    assert driver.value(v4l2.FOCUS_AUTO) == 0
    camera.set_focus(10)
    controls = [control for control, _ in driver.written]
    assert controls.index(v4l2.FOCUS_AUTO) < controls.index(v4l2.FOCUS_ABSOLUTE)


def test_positions_are_those_of_the_driver(driver):
    camera = driver.camera()
    assert camera.focus_range() == (0, 20, 5)
    assert camera.set_focus(12) == 10
    driver.controls[v4l2.FOCUS_ABSOLUTE][1] = 17  # a driver that clamps and says nothing
    assert camera.set_focus(20) == 17


@pytest.mark.parametrize("change", ["absent", "no travel"])
def test_a_camera_without_focus(driver, change):
    if change == "absent":
        del driver.controls[v4l2.FOCUS_ABSOLUTE], driver.controls[v4l2.FOCUS_AUTO]
    else:
        driver.controls[v4l2.FOCUS_ABSOLUTE] = [0, 0, 1, 0]
    camera = driver.camera()
    assert camera.focus_range() is None
    with pytest.raises(CameraError, match="cannot be set"):
        camera.set_focus(1)


def test_autofocus_that_stays_on_is_refused(driver):
    driver.controls[v4l2.FOCUS_AUTO] = [1, 1, 1, 1]
    with pytest.raises(CameraError, match="autofocus"):
        driver.camera()


def test_exposure_is_locked_where_the_automatic_left_it(driver):
    driver.camera()
    assert driver.value(v4l2.EXPOSURE_AUTO) == v4l2.EXPOSURE_MANUAL
    assert driver.value(v4l2.EXPOSURE_100US) == 100  # not the 40 of before the warm-up
    assert driver.value(v4l2.WHITE_BALANCE_AUTO) == 0 and driver.value(v4l2.WHITE_BALANCE_K) == 5000
    assert driver.value(v4l2.SHARPNESS) == 1


@pytest.mark.parametrize("control", [v4l2.EXPOSURE_AUTO, v4l2.WHITE_BALANCE_AUTO])
def test_an_automatic_that_stays_on_is_refused(driver, control):
    driver.controls[control] = [3, 3, 1, 3]  # takes any value, keeps its own
    with pytest.raises(CameraError, match=f"{control:#010x} cannot be switched off"):
        driver.camera()


def test_format(driver):
    camera = driver.camera((1280, 960))
    assert driver.properties[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"YUYV")
    assert driver.properties[cv2.CAP_PROP_BUFFERSIZE] == 1
    assert camera.size == (1280, 960)


def test_a_frame_that_was_waiting_is_not_taken(driver):
    camera = driver.camera()
    asked_ns = driver.now_ns
    frame = camera.read()
    assert frame.t_ns == asked_ns + 5_000_000  # its exposure, 100 x 100 us, begins now; the middle is half of it later


def test_a_frame_is_exposed_after_the_lens_has_settled(driver):
    camera = driver.camera()
    camera.set_focus(15)
    set_ns = driver.now_ns
    frame = camera.read(settle_s=0.1)
    assert set_ns + 100_000_000 <= frame.t_ns - 5_000_000 < set_ns + 100_000_000 + driver.FRAME_NS
    assert np.all(frame.image[..., 2] == 8 * 15)
    assert camera.read(settle_s=0.1).t_ns - frame.t_ns == 2 * driver.FRAME_NS  # settled: only the queued one is lost


def test_frames_that_never_are_new(driver):
    camera = driver.camera()
    driver.get = lambda prop: 0.0  # no stamps
    with pytest.raises(CameraGone, match=r"no new frame within 0\.5 s"):
        camera.read(timeout_s=0.5)


def test_unplugged(driver):
    camera = driver.camera()
    driver.unplugged = True
    with pytest.raises(CameraGone, match="unplugged"):
        camera.read()
    with pytest.raises(CameraGone, match="unplugged"):
        camera.set_focus(5)
    camera.close()
    assert driver.released


def test_a_control_that_the_driver_refuses_is_one_line(driver):
    camera = driver.camera()
    driver.controls[v4l2.FOCUS_AUTO][3] = 1  # another program switched it on again
    with pytest.raises(CameraError, match="0x009a090a: Permission denied"):
        camera.set_focus(5)
