"""One contract, every backend: what an agent relies on, whatever is behind the camera."""

from pathlib import Path

import numpy as np
import pytest

from hw.camera import CameraError, CameraGone, FocusRange, Roi, deliverable, nearest, open_camera
from hw.twin.frame_socket import FrameServer

SIZE = (96, 64)
NOWHERE = Path("/nonexistent")


@pytest.fixture(params=["twin", "stack", "video", "v4l2"])
def camera(request, closing, tmp_path):
    if request.param == "twin":
        server = FrameServer(tmp_path / "r1.camera", request.getfixturevalue("source"))
        server.start()
        closing(server)
        return closing(open_camera("twin:r1", tmp_path, SIZE))
    if request.param == "v4l2":
        return closing(request.getfixturevalue("driver").camera())
    return closing(open_camera(f"{request.param}:{request.getfixturevalue(request.param)}", NOWHERE, SIZE))


class TestEveryCamera:
    def test_full_frame(self, camera):
        frame = camera.read()
        assert camera.size == SIZE
        assert frame.roi == Roi(0, 0, *SIZE)
        assert frame.image.shape == (64, 96, 3) and frame.image.dtype == np.uint8

    def test_time_and_number_go_on(self, camera):
        frames = [camera.read() for _ in range(3)]
        assert frames[0].seq < frames[1].seq < frames[2].seq
        assert frames[0].t_ns < frames[1].t_ns < frames[2].t_ns

    def test_a_region_is_that_part_of_the_frame(self, camera):
        whole = camera.read().image
        frame = camera.read(Roi(10, 17, 30, 20))
        assert frame.roi == Roi(8, 16, 32, 24)
        assert np.array_equal(frame.image, whole[16:40, 8:40])

    def test_a_region_over_the_border_is_cut(self, camera):
        assert camera.read(Roi(-5, 50, 500, 500)).roi == Roi(0, 48, 96, 16)

    def test_a_region_outside_is_refused_and_the_camera_goes_on(self, camera):
        with pytest.raises(CameraError, match="region"):
            camera.read(Roi(200, 0, 10, 10))
        assert camera.read().image.shape == (64, 96, 3)

    def test_frames_belong_to_the_caller(self, camera):
        first = camera.read(Roi(0, 0, 16, 16))
        kept = first.image.copy()
        first.image[:] = 255
        assert np.array_equal(camera.read(Roi(0, 0, 16, 16)).image, kept)

    def test_focus(self, camera, picture):
        focus = camera.focus_range()
        if focus is None:
            with pytest.raises(CameraError, match="cannot be set"):
                camera.set_focus(0)
            return
        for wanted in (focus.lowest, focus.lowest + focus.step, focus.highest):
            assert camera.set_focus(wanted) == wanted
            assert np.array_equal(camera.read().image, picture(wanted))

    def test_focus_outside_the_range_is_its_end(self, camera):
        focus = camera.focus_range()
        if focus is None:
            pytest.skip("no focus")
        assert camera.set_focus(focus.lowest - 1000) == focus.lowest
        assert camera.set_focus(focus.highest + 1000) == focus.highest


@pytest.mark.parametrize("url", ["webcam:0", "twin", "stack:", "/dev/video0", ""])
def test_an_address_of_no_kind_names_the_kinds(url):
    with pytest.raises(CameraError) as caught:
        open_camera(url, NOWHERE, SIZE)
    assert all(f"{scheme}:" in str(caught.value) for scheme in ("twin", "stack", "video", "v4l2"))
    assert "\n" not in str(caught.value)


def test_another_size_than_calibrated_is_refused(stack):
    with pytest.raises(CameraError, match="96x64 pixels, not 640x480"):
        open_camera(f"stack:{stack}", NOWHERE, (640, 480))


def test_nobody_there(tmp_path):
    with pytest.raises(CameraGone, match="no twin serves"):
        open_camera("twin:r1", tmp_path, SIZE)
    with pytest.raises(CameraError, match="cannot be opened"):
        open_camera("v4l2:/dev/video_that_is_not", NOWHERE, SIZE)


def test_a_twin_address_may_be_a_path(tmp_path, source, closing):
    server = FrameServer(tmp_path / "cam.sock", source)
    server.start()
    closing(server)
    assert closing(open_camera(f"twin:{tmp_path}/cam.sock", NOWHERE, None)).size == SIZE


def test_nearest_position_that_the_lens_can_take():
    focus = FocusRange(3, 252, 5)
    assert [nearest(wanted, focus) for wanted in (-9, 5, 6, 250, 252, 999)] == [3, 3, 8, 248, 252, 252]


def test_delivered_region_holds_what_was_asked_for():
    rng = np.random.default_rng(1)
    for _ in range(200):
        x, y = rng.integers(-50, 120, 2)
        width, height = rng.integers(1, 120, 2)
        inside = max(x, 0) < min(x + width, 100) and max(y, 0) < min(y + height, 70)
        if not inside:
            with pytest.raises(CameraError):
                deliverable(Roi(x, y, width, height), (100, 70))
            continue
        roi = deliverable(Roi(x, y, width, height), (100, 70))
        assert 0 <= roi.x <= max(x, 0) and min(x + width, 100) <= roi.x + roi.width <= 100
        assert 0 <= roi.y <= max(y, 0) and min(y + height, 70) <= roi.y + roi.height <= 70
        assert roi.width - width < 16 and roi.height - height < 16
