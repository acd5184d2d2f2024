"""The rules for a real camera, checked on a computer whose cameras are faked below the system calls."""

import logging
import os

import numpy as np
import pytest
from fake_v4l2 import FRAME_NS, STAMPS, FakeCamera, FakeComputer, scene, through_yuyv

from hw import v4l2_calls as v4l2
from hw import v4l2_node
from hw.camera import CameraError, CameraGone
from hw.v4l2_format import MJPG, YUYV
from hw.v4l2_stream import exposed

HALF_EXPOSURE_NS = 5_000_000  # of 100 x 100 us, where the automatic exposure comes to rest


@pytest.fixture
def computer():
    return FakeComputer()


@pytest.fixture
def device(computer):
    return computer.camera


class TestCalls:
    def test_numbers_are_those_of_the_header(self):
        """As a C compiler gives them for linux/videodev2.h on a 64-bit machine."""
        assert v4l2.QUERYCAP == 0x80685600
        assert (v4l2.G_FMT, v4l2.S_FMT, v4l2.S_PARM) == (0xC0D05604, 0xC0D05605, 0xC0CC5616)
        assert (v4l2.REQBUFS, v4l2.QUERYBUF, v4l2.QBUF, v4l2.DQBUF) == (0xC0145608, 0xC0585609, 0xC058560F, 0xC0585611)
        assert (v4l2.STREAMON, v4l2.STREAMOFF) == (0x40045612, 0x40045613)
        assert (v4l2.QUERYCTRL, v4l2.G_CTRL, v4l2.S_CTRL) == (0xC0445624, 0xC008561B, 0xC008561C)
        assert (YUYV, MJPG) == (0x56595559, 0x47504A4D)

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
        other.capabilities = 0x0080_0000 | v4l2.CAN_STREAM  # V4L2_CAP_META_CAPTURE
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


class TestControls:
    def test_autofocus_goes_off_before_the_lens_is_moved(self, computer, device):
        camera = computer.open()
        assert device.value(v4l2.FOCUS_AUTO) == 0
        camera.set_focus(10)
        controls = [control for control, _ in device.written]
        assert controls.index(v4l2.FOCUS_AUTO) < controls.index(v4l2.FOCUS_ABSOLUTE)

    def test_positions_are_those_of_the_driver(self, computer, device):
        camera = computer.open()
        assert camera.focus_range() == (0, 20, 5)
        assert camera.set_focus(12) == 10
        device.controls[v4l2.FOCUS_ABSOLUTE][1] = 17  # a driver that clamps and says nothing
        assert camera.set_focus(20) == 17

    @pytest.mark.parametrize("change", ["absent", "no travel"])
    def test_a_camera_without_focus(self, computer, device, change, caplog):
        if change == "absent":
            del device.controls[v4l2.FOCUS_ABSOLUTE], device.controls[v4l2.FOCUS_AUTO]
        else:
            device.controls[v4l2.FOCUS_ABSOLUTE] = [0, 0, 1, 0]
        camera = computer.open()
        assert camera.focus_range() is None
        assert "its focus cannot be set" in caplog.text
        with pytest.raises(CameraError, match="cannot be set"):
            camera.set_focus(1)

    def test_exposure_is_locked_where_the_automatic_left_it(self, computer, device):
        computer.open()
        assert device.value(v4l2.EXPOSURE_AUTO) == v4l2.EXPOSURE_MANUAL
        assert device.value(v4l2.EXPOSURE_100US) == 100  # not the 40 of before the warm-up
        assert device.value(v4l2.EXPOSURE_MAY_SLOW) == 0
        assert device.value(v4l2.WHITE_BALANCE_AUTO) == 0 and device.value(v4l2.WHITE_BALANCE_K) == 5000
        assert device.value(v4l2.SHARPNESS) == 1

    @pytest.mark.parametrize("control", [v4l2.EXPOSURE_AUTO, v4l2.WHITE_BALANCE_AUTO, v4l2.FOCUS_AUTO])
    def test_an_automatic_that_stays_on_is_refused(self, computer, device, control):
        device.controls[control] = [3, 3, 1, 3]  # takes any value, keeps its own
        with pytest.raises(CameraError, match=f"automatic|autofocus.*{control:#010x}.*cannot be switched off"):
            computer.open()
        assert not device.opened and not device.streaming

    def test_a_control_that_the_driver_refuses_is_one_line(self, computer, device):
        camera = computer.open()
        device.controls[v4l2.FOCUS_AUTO][3] = 1  # another program switched it on again
        with pytest.raises(CameraError, match=r"the focus \(control 0x009a090a\): Permission denied"):
            camera.set_focus(5)

    def test_what_it_cannot_hold_is_said_once(self, computer, device, caplog):
        for control in (v4l2.WHITE_BALANCE_AUTO, v4l2.WHITE_BALANCE_K, v4l2.SHARPNESS, v4l2.EXPOSURE_MAY_SLOW):
            del device.controls[control]
        caplog.set_level(logging.WARNING)
        camera = computer.open()
        for position in (0, 5, 10):
            camera.set_focus(position)
            camera.read()
        lines = [record.getMessage() for record in caplog.records]
        assert len(lines) == 1
        assert lines[0].startswith("/dev/video7 ('Deep Webcam'): it has no control of gain, white balance, sharpening;")


class TestFormat:
    def test_plain_pictures_are_preferred(self, computer, device):
        assert computer.open().size == (96, 64)
        assert device.fourcc == YUYV

    def test_the_size_that_is_set_where_none_is_asked_for(self, computer, device):
        device.size = (96, 64)
        assert computer.open(size=None).size == (96, 64)

    def test_padded_rows(self, computer, device):
        device.padding = 32
        camera = computer.open()
        camera.set_focus(10)
        assert np.array_equal(camera.read().image, through_yuyv(scene(10)))

    def test_colours_are_right(self, computer):
        camera = computer.open()
        camera.set_focus(20)
        difference = np.abs(camera.read().image.astype(int) - scene(20))
        assert difference.mean() < 3

    @pytest.mark.parametrize("why", ["no YUYV", "YUYV too slow"])
    def test_jpeg_where_it_must_be(self, computer, device, why, caplog):
        if why == "no YUYV":
            del device.formats[YUYV]
        else:
            device.formats[YUYV][96, 64] = 5
        camera = computer.open()
        assert device.fourcc == MJPG and "JPEG" in caplog.text
        camera.set_focus(10)
        assert np.abs(camera.read().image.astype(int) - scene(10)).mean() < 3

    def test_a_size_that_only_jpeg_has(self, computer, device):
        del device.formats[YUYV][1280, 960]
        device.encoded = lambda image: b""  # too large for the fake's memory
        with pytest.raises(CameraGone, match="old or torn"):
            computer.open(size=(1280, 960))
        assert device.fourcc == MJPG and device.size == (1280, 960)

    def test_a_camera_of_other_formats_is_refused(self, computer, device):
        device.formats = {int.from_bytes(b"H264", "little"): {(96, 64): 30}}
        with pytest.raises(CameraError, match="neither YUYV nor MJPG"):
            computer.open()
        assert not device.opened

    def test_a_camera_that_another_program_reads(self, computer, device):
        device.in_use = True
        with pytest.raises(CameraError, match="another program uses it"):
            computer.open()
        assert not device.opened


class TestStream:
    def test_frames_that_were_waiting_are_not_taken(self, computer, device):
        """Three buffers hold frames of before; a fourth is under way when the next one is asked for."""
        camera = computer.open()
        computer.clock.now_ns += 10 * FRAME_NS
        asked_ns = computer.clock.now_ns
        frame = camera.read()
        assert asked_ns <= frame.t_ns - HALF_EXPOSURE_NS <= asked_ns + FRAME_NS

    @pytest.mark.parametrize("stamps", STAMPS)
    def test_a_frame_is_exposed_after_the_lens_has_settled(self, computer, device, stamps):
        """By whichever clock, and at whichever moment, the driver stamps it."""
        device.stamps = stamps
        camera = computer.open()
        for position in (15, 0, 20, 5):
            computer.clock.now_ns += 7_000_000
            camera.set_focus(position)
            set_ns = computer.clock.now_ns
            frame = camera.read(settle_s=0.1)
            assert set_ns + 100_000_000 <= frame.t_ns <= set_ns + 100_000_000 + 3 * FRAME_NS
            assert np.array_equal(frame.image, through_yuyv(scene(position)))

    def test_a_stamp_that_is_yet_to_come_is_not_believed(self, computer, device, caplog):
        """Flagged as monotonic, but of the wall clock: every old frame would pass for new."""
        device.late_ns = -(10**18)
        camera = computer.open()
        assert "unknown clock" in caplog.text
        camera.set_focus(20)
        assert np.array_equal(camera.read().image, through_yuyv(scene(20)))

    @pytest.mark.parametrize("stamps", ["unknown", "copy"])
    def test_a_clock_that_is_not_ours_is_said(self, computer, device, stamps, caplog):
        device.stamps = stamps
        computer.open()
        assert "unknown clock" in caplog.text

    def test_when_a_frame_was_exposed(self):
        """Exposure 10, period 33, stamp 1000, arrival 2000 or 900."""
        assert exposed(STAMPS["start"], 1000, 900, 10, 33) == (857, 878)  # not even begun when it arrived
        assert exposed(STAMPS["start"], 1000, 2000, 10, 33) == (1000, 1005)
        assert exposed(STAMPS["end"], 1000, 2000, 10, 33) == (957, 978)
        assert exposed(STAMPS["unknown"], 1000, 2000, 10, 33) == (1957, 1978)
        assert exposed(STAMPS["copy"], 1000, 2000, 10, 33) == (1957, 1978)

    @pytest.mark.parametrize("damage", [v4l2.DAMAGED, lambda data: data[:-200], lambda data: b""])
    @pytest.mark.parametrize("fourcc", [YUYV, MJPG])
    def test_torn_frames_are_passed_over(self, computer, device, damage, fourcc):
        device.formats = {fourcc: device.formats[fourcc]}
        camera = computer.open()
        first = camera.read()
        device.damage = [0, damage, damage]  # the frame that is under way is too old anyhow
        frame = camera.read()
        assert np.array_equal(frame.image, first.image)
        assert frame.t_ns - first.t_ns == 4 * FRAME_NS

    def test_nothing_there_after_all(self, computer, device):
        camera = computer.open()
        device.again = 5
        assert camera.read().image.shape == (64, 96, 3)
        assert device.again == 0

    def test_silence(self, computer, device):
        camera = computer.open()
        device.silent = True
        device.filled.clear()
        before_ns = computer.clock.now_ns
        with pytest.raises(CameraGone, match=r"no new frame within 0\.5 s: none at all"):
            camera.read(timeout_s=0.5)
        assert computer.clock.now_ns - before_ns < 510_000_000

    def test_frames_that_never_are_new(self, computer, device):
        camera = computer.open()
        device.late_ns = 10**9
        with pytest.raises(CameraGone, match=r"within 0\.5 s: \d+ were old or torn; does its driver stamp by another"):
            camera.read(timeout_s=0.5)

    def test_unplugged_while_it_is_waited_for(self, computer, device):
        camera = computer.open()
        device.unplugged = True
        with pytest.raises(CameraGone, match=r"/dev/video7: went away; .* v4l2:CARD"):
            camera.read()

    def test_closing_gives_the_buffers_back(self, computer, device):
        camera = computer.open()
        camera.close()
        assert not device.opened and not device.streaming
        for view in device.views:
            with pytest.raises(ValueError, match="released"):
                len(view)
