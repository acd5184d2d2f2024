"""Video nodes: the numbers of their system calls, and finding one camera among them; the cameras are faked."""

import logging
import os

import numpy as np
import pytest

from agent.clock.clock import SystemClock
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import SweepPlan
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.camera import v4l2_node
from hw.camera import v4l2_node as v4l2
from hw.camera.camera import CameraError, CameraGone
from hw.camera.v4l2_node import MJPG, NV12, UYVY, YUYV
from tests.hw.camera.fake_v4l2 import FakeCamera, FakeComputer, scene, through_yuyv
from tests.sightings import collect
from tests.waiting import until


class TestCalls:
    def test_numbers_are_those_of_the_header(self):
        """Values that a C compiler gives for linux/videodev2.h on a 64-bit machine."""
        assert v4l2.QUERYCAP == 0x80685600
        assert (v4l2.G_FMT, v4l2.S_FMT, v4l2.S_PARM) == (0xC0D05604, 0xC0D05605, 0xC0CC5616)
        assert (v4l2.REQBUFS, v4l2.QUERYBUF, v4l2.QBUF, v4l2.DQBUF) == (0xC0145608, 0xC0585609, 0xC058560F, 0xC0585611)
        assert (v4l2.STREAMON, v4l2.STREAMOFF) == (0x40045612, 0x40045613)
        assert (v4l2.QUERYCTRL, v4l2.G_CTRL, v4l2.S_CTRL) == (0xC0445624, 0xC008561B, 0xC008561C)
        assert (v4l2.ENUM_FMT, v4l2.QUERYMENU) == (0xC0405602, 0xC02C5625)
        assert (v4l2.ENUM_FRAMESIZES, v4l2.ENUM_FRAMEINTERVALS) == (0xC02C564A, 0xC034564B)
        assert (YUYV, UYVY, NV12, MJPG) == (0x56595559, 0x59565955, 0x3231564E, 0x47504A4D)
        assert v4l2.PLANE.size == 64

    def test_a_node_waits_calls_and_closes(self):
        reading, writing = os.pipe()
        node = v4l2_node.Node("/dev/video7", reading)
        assert not node.wait(0.0)
        os.write(writing, b"x")
        assert node.wait(0.0)
        with pytest.raises(OSError, match="ioctl"):
            node.ioctl(v4l2.QUERYCAP, bytearray(v4l2.CAPABILITY.size))
        node.close()
        node.close()
        os.close(writing)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(reading)


class TestPlace:
    def test_what_is_no_video_device(self):
        with pytest.raises(CameraError, match="/dev/null: not a video device"):
            v4l2_node.find("/dev/null")

    def test_a_node_that_is_not_there_may_come(self):
        with pytest.raises(CameraGone, match="cannot be opened"):
            v4l2_node.find("/dev/video_that_is_not")

    def test_a_metadata_node_is_refused_by_path_and_passed_over_by_name(self, computer, device):
        other = FakeCamera("/dev/video8", computer.clock)
        other.capabilities = 0x0080_0000 | v4l2.CAP_STREAMING  # V4L2_CAP_META_CAPTURE
        computer.there = {"/dev/video8": other, **computer.there}
        with pytest.raises(CameraError, match="gives no pictures here"):
            computer.open("/dev/video8")
        assert not other.opened
        computer.open().close()

    def test_a_name_that_there_is_not_names_those_that_there_are(self, computer, device):
        with pytest.raises(CameraGone, match=r"called 'Shallow'; there is 'Deep Webcam' at usb-0000:00:14\.0-1"):
            computer.open("Shallow")
        assert not device.opened

    @pytest.mark.parametrize("place", ["/dev/video7", FakeCamera.card])
    def test_a_node_that_we_may_not_open_says_which_group(self, computer, device, place):
        device.forbidden = True
        with pytest.raises(CameraError, match="/dev/video7: you may not open it; join its group"):
            computer.open(place)

    def test_of_two_with_one_name_the_port_tells(self, computer, device):
        twin = FakeCamera("/dev/video8", computer.clock)
        twin.bus = "usb-0000:00:14.0-2"
        computer.there["/dev/video8"] = twin
        with pytest.raises(CameraError, match=r"name one by its port: v4l2:usb-.*-1 or v4l2:usb-.*-2"):
            computer.open()
        assert not device.opened and not twin.opened
        computer.open(twin.bus)
        assert twin.streaming and not device.streaming

    @pytest.mark.parametrize("place", [FakeCamera.card, FakeCamera.bus])
    def test_it_is_found_again_under_another_number_and_set_up_anew(self, computer, place):
        camera = computer.open(place)
        computer.pull()
        with pytest.raises(CameraGone, match="unplugged"):
            camera.set_focus(5)
        camera.close()
        computer.plug("/dev/video12")
        again = computer.open(place)
        assert computer.camera.path == "/dev/video12"
        assert computer.camera.value(v4l2.FOCUS_AUTO) == 0
        assert again.set_focus(15) == 15 and np.array_equal(again.read().image, through_yuyv(scene(15)))


# --- camera replug ---
# A camera is pulled out and comes back as another node: the vision worker goes on by itself.

CAMERA = CameraFit(width_px=96, height_px=64, f_px=150.0, cx_px=47.5, cy_px=31.5)


def test_a_sweep_after_the_replug_is_carried_out_on_the_new_node():
    computer = FakeComputer()
    fleet = load_fleet(shipped_fleet())
    vision = Vision(computer.open, fleet, CAMERA, load_detectors(fleet, CAMERA), SystemClock())
    vision.start()
    try:
        vision.plan(SweepPlan(sweep=1, focus=(0, 5, 10)))
        collect(vision, lambda seen: any(s.sweep == 1 for s in seen), 30.0)
        computer.pull()
        until(lambda: vision.errors)
        computer.plug("/dev/video12")
        until(lambda: vision.fault is None)
        vision.plan(SweepPlan(sweep=2, focus=(0, 5, 10, 15, 20)))
        seen = collect(vision, lambda seen: any(s.sweep == 2 and s.index == 4 for s in seen), 30.0)
        assert [s.focus for s in seen if s.sweep == 2] == [5, 10, 15, 20]
        assert computer.camera.path == "/dev/video12" and computer.camera.value(v4l2.FOCUS_AUTO) == 0
    finally:
        vision.close()


# --- v4l2 controls ---
# What a camera may not change by itself in a sweep, checked on one that is faked below the system calls.


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


def test_a_lens_that_moves_by_itself_is_refused(computer, device):
    device.controls[v4l2.FOCUS_AUTO] = [3, 3, 1, 3]  # takes any value, keeps its own
    with pytest.raises(CameraError, match=r"/dev/video7: the autofocus .*0x009a090c.*cannot be switched off"):
        computer.open()
    assert not device.opened and not device.streaming


@pytest.mark.parametrize("control", [v4l2.EXPOSURE_AUTO, v4l2.AUTO_WHITE_BALANCE])
def test_an_automatic_that_stays_on_is_a_warning(computer, device, control):
    device.controls[control] = [3, 3, 1, 3]
    camera = computer.open()
    no_gain, line = camera.shortcomings
    assert "no control of gain;" in no_gain and f"{control:#010x}) cannot be switched off" in line
    assert camera.read().image.shape == (64, 96, 3)


@pytest.mark.parametrize("control", [v4l2.GAIN, v4l2.EXPOSURE_ABSOLUTE, v4l2.SHARPNESS, v4l2.FOCUS_AUTO])
def test_one_control_that_fails_is_a_warning_with_its_name(computer, device, control):
    device.controls.setdefault(control, [0, 9, 1, 0])
    device.failing = {control}
    device.controls[v4l2.FOCUS_AUTO][3] = 0
    camera = computer.open()
    lines = [line for line in camera.shortcomings if "no control" not in line]
    assert lines and all(f"{v4l2.NAMES[control]} (control {control:#010x}) fails: Input/output" in one for one in lines)
    camera.set_focus(15)
    assert np.array_equal(camera.read().image, through_yuyv(scene(15)))


@pytest.mark.parametrize(
    "menu", [{0: "Auto Mode", 2: "Shutter Priority Mode"}, {0: "Auto Mode", 3: "Aperture Priority"}]
)
def test_an_exposure_menu_without_manual(computer, device, menu):
    device.menus[v4l2.EXPOSURE_AUTO] = menu
    camera = computer.open()
    held = 2 in menu
    assert (device.value(v4l2.EXPOSURE_AUTO) == 2) is held
    has = "the automatic exposure (control 0x009a0901) cannot be held, it has only: Auto Mode, Aperture Priority"
    assert camera.shortcomings[1:] == (() if held else (has,))


@pytest.mark.parametrize(("mains_hz", "entry"), [(50, 1), (60, 2)])
def test_mains_flicker_is_the_countrys(computer, device, mains_hz, entry):
    camera = computer.open(mains_hz=mains_hz)
    assert device.value(v4l2.POWER_LINE_FREQUENCY) == entry and len(camera.shortcomings) == 1
    device.controls[v4l2.POWER_LINE_FREQUENCY][1] = 0
    assert f"cannot be set to {mains_hz} Hz" in computer.open(mains_hz=mains_hz).shortcomings[1]


def test_an_exposure_that_its_driver_does_not_tell_is_refused_by_brightness(computer, device):
    """Held at what the control reads, which is not what the automatic had."""
    device.tells_exposure, device.shows_exposure = False, True
    for exposure, how in ((20, "darker"), (300, "brighter")):
        device.controls[v4l2.EXPOSURE_ABSOLUTE][3] = exposure
        with pytest.raises(CameraError, match=f"/dev/video7: its pictures are much {how} .* set it by hand"):
            computer.open()
        assert not device.opened and device.value(v4l2.EXPOSURE_AUTO) == 3
    device.tells_exposure = True
    computer.open()


def test_an_exposure_set_by_hand_is_kept_unless_it_shows_nothing(computer, device):
    device.shows_exposure = True
    device.controls[v4l2.EXPOSURE_AUTO][3] = v4l2.EXPOSURE_MANUAL
    device.controls[v4l2.EXPOSURE_ABSOLUTE][3] = 30
    camera = computer.open()
    assert device.value(v4l2.EXPOSURE_ABSOLUTE) == 30
    camera.close()
    assert device.value(v4l2.EXPOSURE_AUTO) == v4l2.EXPOSURE_MANUAL
    device.controls[v4l2.EXPOSURE_ABSOLUTE][3] = 2000
    with pytest.raises(CameraError, match="/dev/video7: its exposure is constant, and its pictures are burnt out"):
        computer.open()
    device.controls[v4l2.EXPOSURE_ABSOLUTE][3] = 1
    assert "nearly black; if it is not dark there, set it by hand" in computer.open().shortcomings[-1]


def test_automatics_are_put_back_so_that_the_next_opening_measures_anew(computer, device):
    camera = computer.open()
    camera.close()
    for control in (v4l2.EXPOSURE_AUTO, v4l2.AUTO_WHITE_BALANCE, v4l2.FOCUS_AUTO):
        assert device.value(control) == (3 if control == v4l2.EXPOSURE_AUTO else 1)
    assert not device.opened


def test_a_control_that_the_driver_refuses_is_one_line(computer, device):
    camera = computer.open()
    device.controls[v4l2.FOCUS_AUTO][3] = 1  # another program switched it on again
    with pytest.raises(CameraError, match=r"the focus \(control 0x009a090a\) fails: Permission denied"):
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
