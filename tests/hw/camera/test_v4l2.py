"""Which pictures a camera delivers and when they were exposed, checked on one faked below the system calls."""

import numpy as np
import pytest

from hw.camera import v4l2_node as v4l2
from hw.camera.camera import CameraError, CameraGone
from hw.camera.v4l2 import exposed
from hw.camera.v4l2_node import MJPG, NV12, UYVY, YUYV
from tests.hw.camera.fake_v4l2 import FRAME_NS, STAMPS, FakeCamera, fourcc, scene, through_yuyv

HALF_EXPOSURE_NS = 5_000_000  # of 100 x 100 us, where the automatic exposure comes to rest


class TestFormat:
    def test_plain_pictures_are_preferred(self, computer, device):
        assert computer.open().size == (96, 64)
        assert device.fourcc == YUYV

    def test_the_size_that_is_set_where_none_is_asked_for(self, computer, device):
        device.size = (96, 64)
        assert computer.open(size=None).size == (96, 64)

    @pytest.mark.parametrize("planes", [False, True])
    @pytest.mark.parametrize("encoding", [YUYV, UYVY, NV12, MJPG])
    def test_colours_are_right(self, computer, device, encoding, planes):
        """Also where rows are padded, and of a queue that is multi-planar."""
        device.planes = device.strict = planes
        device.padding = 32
        device.formats = {fourcc("RG10"): {(96, 64): 30}, encoding: {(96, 64): 30}}
        camera = computer.open()
        camera.set_focus(20)
        frame = camera.read()
        assert np.abs(frame.image.astype(int) - scene(20)).mean() < 3
        assert encoding != YUYV or np.array_equal(frame.image, through_yuyv(scene(20)))

    @pytest.mark.parametrize("encoding", [UYVY, NV12])
    def test_what_is_not_compressed_is_preferred(self, computer, device, encoding):
        device.formats = {MJPG: {(96, 64): 30}, encoding: {(96, 64): 30}}
        computer.open()
        assert device.fourcc == encoding

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

    @pytest.mark.parametrize(
        ("formats", "says"),
        [
            (["H264"], r"gives film alone \(H264\), no whole pictures; use its node of YUYV or MJPG"),
            (["RG10"], r"raw mosaic \(RG10\), as CSI cameras do; write libcamera:0 in the fleet file"),
            (["RGB3", "H264"], "gives RGB3, H264, and none of YUYV, UYVY, NV12 and MJPG; use another camera"),
        ],
    )
    def test_a_camera_of_other_formats_is_refused(self, computer, device, formats, says):
        device.formats = {fourcc(name): {(96, 64): 30} for name in formats}
        with pytest.raises(CameraError, match=f"^/dev/video7: .*{says}"):
            computer.open()
        assert not device.opened

    def test_a_camera_with_a_node_of_film_beside_is_found_by_name(self, computer, device):
        film = FakeCamera("/dev/video8", computer.clock)
        film.formats = {fourcc("H264"): {(96, 64): 30}}
        computer.there = {film.path: film, **computer.there}
        computer.open()
        assert device.streaming and not film.opened

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
        """True whichever clock the driver stamps it by, and at whichever moment."""
        device.stamps = stamps
        camera = computer.open()
        for lens_position in (15, 0, 20, 5):
            computer.clock.now_ns += 7_000_000
            camera.set_focus(lens_position)
            set_ns = computer.clock.now_ns
            frame = camera.read(settle_s=0.1)
            assert set_ns + 100_000_000 <= frame.t_ns <= set_ns + 100_000_000 + 3 * FRAME_NS
            assert np.array_equal(frame.image, through_yuyv(scene(lens_position)))

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

    @pytest.mark.parametrize("hold", [0, 1])
    def test_uvcvideo_stamps_the_arrival_whatever_it_says(self, computer, device, hold):
        """A camera that holds a frame back before it sends it: what a C920 does."""
        device.driver, device.hold = "uvcvideo", hold
        camera = computer.open()
        assert camera.stamp == "arrival"
        for lens_position in (15, 0, 20):
            camera.set_focus(lens_position)
            set_ns = computer.clock.now_ns
            frame = camera.read(settle_s=0.1)
            assert set_ns + 100_000_000 <= frame.t_ns <= set_ns + 100_000_000 + 4 * FRAME_NS
            assert np.array_equal(frame.image, through_yuyv(scene(lens_position)))
            began_ns = frame.t_ns - HALF_EXPOSURE_NS
            late_ns = (began_ns - computer.camera.exposing_ns) % FRAME_NS
            assert min(late_ns, FRAME_NS - late_ns) < 400_000  # its driver says 30 frames/s, and it takes 33 ms

    def test_uvcvideo_with_hardware_stamps_is_believed(self, computer, device):
        assert computer.open().stamp == "exposure-start"
        device.driver, computer.hardware_stamps = "uvcvideo", True
        assert computer.open().stamp == "exposure-start"
        device.stamps = "unknown"
        assert computer.open().stamp == "arrival"

    def test_when_a_frame_was_exposed(self):
        """Exposure 10, period 33, stamp 1000, arrival 2000 or 900."""
        assert exposed(STAMPS["start"], 1000, 900, 10, 33) == (857, 878)  # not even begun when it arrived
        assert exposed(STAMPS["start"], 1000, 2000, 10, 33) == (1000, 1005)
        assert exposed(STAMPS["start"], 1000, 2000, 10, 33, first_packet=True) == (957, 962)
        assert exposed(STAMPS["end"], 1000, 2000, 10, 33) == (957, 978)
        assert exposed(STAMPS["unknown"], 1000, 2000, 10, 33) == (1957, 1978)
        assert exposed(STAMPS["copy"], 1000, 2000, 10, 33) == (1957, 1978)

    @pytest.mark.parametrize("damage", [v4l2.BUF_FLAG_ERROR, lambda data: data[:-200], lambda data: b""])
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
