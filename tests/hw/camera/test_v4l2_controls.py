"""What a camera may not change by itself in a sweep, checked on one that is faked below the system calls."""

import logging

import pytest

from hw.camera import v4l2_node as v4l2
from hw.camera.camera import CameraError


def test_autofocus_goes_off_before_the_lens_is_moved(computer, device):
    camera = computer.open()
    assert device.value(v4l2.FOCUS_AUTO) == 0
    camera.set_focus(10)
    controls = [control for control, _ in device.written]
    assert controls.index(v4l2.FOCUS_AUTO) < controls.index(v4l2.FOCUS_ABSOLUTE)


def test_positions_are_those_of_the_driver(computer, device):
    camera = computer.open()
    assert camera.focus_range() == (0, 20, 5)
    assert camera.set_focus(12) == 10
    device.controls[v4l2.FOCUS_ABSOLUTE][1] = 17  # a driver that clamps and says nothing
    assert camera.set_focus(20) == 17


@pytest.mark.parametrize("change", ["absent", "no travel"])
def test_a_camera_without_focus(computer, device, change, caplog):
    if change == "absent":
        del device.controls[v4l2.FOCUS_ABSOLUTE], device.controls[v4l2.FOCUS_AUTO]
    else:
        device.controls[v4l2.FOCUS_ABSOLUTE] = [0, 0, 1, 0]
    camera = computer.open()
    assert camera.focus_range() is None
    assert "its focus cannot be set" in caplog.text
    with pytest.raises(CameraError, match="cannot be set"):
        camera.set_focus(1)


def test_exposure_is_locked_where_the_automatic_left_it(computer, device):
    computer.open()
    assert device.value(v4l2.EXPOSURE_AUTO) == v4l2.EXPOSURE_MANUAL
    assert device.value(v4l2.EXPOSURE_ABSOLUTE) == 100  # not the 40 of before the warm-up
    assert device.value(v4l2.EXPOSURE_AUTO_PRIORITY) == 0
    assert device.value(v4l2.AUTO_WHITE_BALANCE) == 0 and device.value(v4l2.WHITE_BALANCE_TEMPERATURE) == 5000
    assert device.value(v4l2.SHARPNESS) == 1


@pytest.mark.parametrize("control", [v4l2.EXPOSURE_AUTO, v4l2.AUTO_WHITE_BALANCE, v4l2.FOCUS_AUTO])
def test_an_automatic_that_stays_on_is_refused(computer, device, control):
    device.controls[control] = [3, 3, 1, 3]  # takes any value, keeps its own
    with pytest.raises(CameraError, match=f"automatic|autofocus.*{control:#010x}.*cannot be switched off"):
        computer.open()
    assert not device.opened and not device.streaming


def test_a_control_that_the_driver_refuses_is_one_line(computer, device):
    camera = computer.open()
    device.controls[v4l2.FOCUS_AUTO][3] = 1  # another program switched it on again
    with pytest.raises(CameraError, match=r"the focus \(control 0x009a090a\): Permission denied"):
        camera.set_focus(5)


def test_what_it_cannot_hold_is_said_once(computer, device, caplog):
    for control in (
        v4l2.AUTO_WHITE_BALANCE,
        v4l2.WHITE_BALANCE_TEMPERATURE,
        v4l2.SHARPNESS,
        v4l2.EXPOSURE_AUTO_PRIORITY,
    ):
        del device.controls[control]
    caplog.set_level(logging.WARNING)
    camera = computer.open()
    for lens_position in (0, 5, 10):
        camera.set_focus(lens_position)
        camera.read()
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 1
    assert lines[0].startswith("/dev/video7 ('Deep Webcam'): it has no control of gain, white balance, sharpening;")
