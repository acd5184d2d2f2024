"""Video nodes: the numbers of their system calls, and finding one camera among them; the cameras are faked."""

import os

import numpy as np
import pytest

from hw.camera import v4l2_node
from hw.camera import v4l2_node as v4l2
from hw.camera.camera import CameraError, CameraGone
from hw.camera.v4l2 import MJPG, YUYV
from tests.hw.camera.fake_v4l2 import FakeCamera, scene, through_yuyv


class TestCalls:
    def test_numbers_are_those_of_the_header(self):
        """Values that a C compiler gives for linux/videodev2.h on a 64-bit machine."""
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
