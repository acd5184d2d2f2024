"""What the library of CSI cameras is asked for, and when its frames were exposed; the library is a stand-in."""

import sys

import numpy as np
import pytest

from hw.camera.camera import CameraError, CameraGone
from hw.camera.libcamera import open_libcamera
from tests.hw.camera.fake_picamera2 import MEASURED, PERIOD_NS
from tests.hw.camera.fake_v4l2 import scene


@pytest.fixture
def open_it(pi):
    return lambda size=(96, 64), mains_hz=50: open_libcamera("0", size, mains_hz, pi.clock)


def test_without_the_library_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "picamera2", None)
    with pytest.raises(CameraError, match=r"camera 'libcamera:0': needs picamera2 .*apt install python3-picamera2"):
        open_libcamera("0", (96, 64))


@pytest.mark.parametrize(
    ("place", "kind", "says"),
    [
        ("imx708", CameraError, "cameras have numbers here; write libcamera:0"),
        ("1", CameraGone, r"'libcamera:1': is not there; there is libcamera:0 \(imx708\)"),
    ],
)
def test_an_address_that_means_no_camera(pi, place, kind, says):
    with pytest.raises(kind, match=says):
        open_libcamera(place, None, 50, pi.clock)


def test_a_camera_that_another_program_has(pi, open_it):
    pi.in_use = True
    with pytest.raises(CameraGone, match=r"'libcamera:0': cannot be opened .*; end other programs that use it"):
        open_it()


@pytest.mark.parametrize(("mains_hz", "period_us"), [(50, 10_000), (60, 8333)])
def test_all_that_changes_by_itself_is_held(pi, open_it, mains_hz, period_us):
    camera = open_it(mains_hz=mains_hz)
    assert camera.shortcomings == ()
    held = pi.camera.set
    assert {name: held[name] for name in MEASURED} == MEASURED
    assert held["AeEnable"] is held["AwbEnable"] is False
    assert held["AfMode"] == 0 and held["Sharpness"] == 0.0 and held["FrameDurationLimits"] == (33_333, 33_333)
    assert held["AeFlickerMode"] == 1 and held["AeFlickerPeriod"] == period_us
    assert "NoiseReductionMode" not in held  # which this one does not have


def test_what_it_cannot_hold_is_said_and_a_fixed_lens_too(pi, open_it, caplog):
    del pi.controls["ColourGains"], pi.controls["LensPosition"]
    camera = open_it()
    assert camera.focus_range() is None and camera.read().image.shape == (64, 96, 3)
    no_white_balance, no_focus = camera.shortcomings
    assert "no control of white balance" in no_white_balance and "from the target's size alone" in no_focus
    assert "libcamera:0 ('imx708'): its focus cannot be set" in caplog.text
    with pytest.raises(CameraError, match="use a camera with the control LensPosition"):
        camera.set_focus(0)


def test_a_lens_that_the_tuning_file_does_not_know_is_no_focus(pi, open_it):
    """An IMX519 with the stock file: positions are taken without a word, and the lens stays."""
    pi.tuned = False
    camera = open_it()
    assert camera.focus_range() is None
    assert "tuning file of its sensor says nothing of a lens (rpi.af)" in camera.shortcomings[0]


def test_an_exposure_that_is_not_held_is_said(pi, open_it, monkeypatch):
    monkeypatch.setitem(MEASURED, "ExposureTime", 8000)
    pi.keeps_us = 20_000
    assert open_it().shortcomings == ("its exposure is not held: 20000 us in place of 8000",)


def test_lens_positions_are_hundredths_of_dioptres(pi, open_it):
    camera = open_it()
    assert camera.focus_range() == (0, 30, 3)
    assert camera.set_focus(17) == 18
    assert np.array_equal(camera.read().image, scene(18))
    assert pi.camera.set["LensPosition"] == 0.18


def test_frames_on_the_way_are_of_the_lens_position_before(pi, open_it):
    """And the lens goes from end to end in several frames, which tell how far it is."""
    camera = open_it()
    for lens_position in (30, 0, 15):
        camera.set_focus(lens_position)
        frame = camera.read(settle_s=0.05)
        assert np.array_equal(frame.image, scene(lens_position))
        left_ns = max(t_ns for t_ns, lens in pi.camera.lens if abs(100 * lens - lens_position) > 1)
        assert frame.t_ns - 4_000_000 >= left_ns + PERIOD_NS + 50_000_000


def test_a_stamp_is_the_end_of_the_first_rows_exposure(pi, open_it):
    frame = open_it().read()
    began_ns = pi.camera.began_ns - PERIOD_NS
    assert frame.t_ns == began_ns + 4_000_000


def test_a_lens_that_does_not_move_ends_in_one_line(pi, open_it):
    camera = open_it()
    camera.set_focus(30)
    pi.camera.queued.clear()
    with pytest.raises(CameraGone, match=r"no new frame with the lens at 0\.3 dioptres within 0\.5 s"):
        camera.read(timeout_s=0.5)
