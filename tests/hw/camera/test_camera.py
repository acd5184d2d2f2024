"""One contract, every backend: what an agent relies on, whatever is behind the camera."""

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from agent.__main__ import main
from hw.camera import libcamera, open_camera, v4l2, v4l2_node
from hw.camera.camera import Camera, CameraError, CameraGone, FocusRange, Image, Roi, deliverable, nearest
from hw.camera.files import open_stack, open_video
from hw.camera.frame_socket import FrameServer
from hw.camera.libcamera import open_libcamera
from hw.twin.camera_device import DiveCamera, FrameClock
from hw.twin.dive import RobotPose
from hw.twin.optics.lens import draw_lens
from hw.twin.truth import Stage
from tests.hw.camera.fake_v4l2 import FakeCamera, FakeComputer, fourcc, scene, through_yuyv

SIZE = (96, 64)
NOWHERE = Path("/nonexistent")


class Rig(NamedTuple):
    """A device that a camera can be opened on, and what can be done to it."""

    open: Callable[[], Camera]
    pull: Callable[[], None]  # whatever takes this kind of camera away
    plug: Callable[[], None]
    picture: Callable[[int], Image]  # what it shows at a lens position
    clock_ns: Callable[[], int] | None = None  # of its stamps, where it tells the time
    settles: bool = False  # it shows where the lens was when a frame was exposed


def socket_rig(tmp_path, source, closing):
    servers = []

    def plug():
        servers.append(closing(FrameServer(tmp_path / "r1.camera", source)))
        servers[-1].start()

    plug()
    return Rig(
        lambda: open_camera("twin:r1", tmp_path, SIZE), lambda: servers[-1].close(), plug, scene, time.monotonic_ns
    )


class TwinsLens:
    """Painter, motor of the lens and history of a camera of the twin, in a dive of its own time."""

    def __init__(self):
        self.now_ns, self.moves = 10**12, [(0, 0)]

    def clock_ns(self):
        return self.now_ns

    def command(self, lens_position, t_ns):
        self.moves.append((t_ns, lens_position))
        return lens_position

    def image_distance_m(self, t_ns, elevation_rad):
        return next(lens_position for since_ns, lens_position in reversed(self.moves) if since_ns <= t_ns)

    def expose(self, moment, lens_position, roi, *rest):
        x, y, width, height = roi or (0, 0, *SIZE)
        return scene(lens_position)[y : y + height, x : x + width]

    def at(self, t_ns):
        return [RobotPose(np.zeros(3), np.eye(3), 0.0, 0.0)]

    def wait(self, t_ns):
        """The water is as it was."""

    @contextlib.contextmanager
    def deliver(self, delivered_ns, latest_ns):
        yield
        self.now_ns = delivered_ns


def dive_rig(tmp_path, closing):
    """The camera of a dive behind its socket."""
    water, servers = TwinsLens(), []
    lens = draw_lens("imx519_640", np.random.default_rng(0))
    lens = lens._replace(width=SIZE[0], height=SIZE[1], lowest=0, highest=20)
    seen = (water, lens, water, water, (0.1, 0.0, 0.0), Stage((), ()), FrameClock(0), water.clock_ns, water.deliver)

    def plug():
        servers.append(closing(FrameServer(tmp_path / "r1.camera", DiveCamera(0, *seen))))
        servers[-1].start()

    plug()
    return Rig(
        lambda: open_camera("twin:r1", tmp_path, SIZE), lambda: servers[-1].close(), plug, scene, water.clock_ns, True
    )


def file_rig(kind, path):
    away = path.with_name(f"{path.name}.away")
    return Rig(
        lambda: open_camera(f"{kind}:{path}", NOWHERE, SIZE),
        lambda: path.rename(away) and None,
        lambda: away.rename(path) and None,
        scene,
    )


def v4l2_rig():
    computer = FakeComputer()
    return Rig(
        computer.open,
        computer.pull,
        computer.plug,
        lambda lens_position: through_yuyv(scene(lens_position)),
        computer.clock,
        True,
    )


def libcamera_rig(pi):
    return Rig(
        lambda: open_libcamera("0", SIZE, clock_ns=pi.clock),
        lambda: setattr(pi, "gone", True),
        lambda: setattr(pi, "gone", False),
        scene,
        pi.clock,
        True,
    )


@pytest.fixture(params=["socket", "twin", "stack", "video", "v4l2", "libcamera"])
def rig(request, closing, tmp_path):
    if request.param == "socket":
        return socket_rig(tmp_path, request.getfixturevalue("source"), closing)
    if request.param == "twin":
        return dive_rig(tmp_path, closing)
    if request.param == "v4l2":
        return v4l2_rig()
    if request.param == "libcamera":
        return libcamera_rig(request.getfixturevalue("pi"))
    return file_rig(request.param, request.getfixturevalue(request.param))


@pytest.fixture
def camera(rig, closing):
    return closing(rig.open())


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

    def test_it_says_what_its_stamps_mean(self, camera):
        assert camera.stamp in ("exposure-start", "arrival")

    def test_a_frame_is_exposed_after_the_lens_has_settled(self, rig, camera):
        focus = camera.focus_range()
        if focus is None or not rig.settles:
            pytest.skip("nothing moves")
        for lens_position in (focus.highest, focus.lowest):
            camera.set_focus(lens_position)
            set_ns = rig.clock_ns()
            frame = camera.read(settle_s=0.1)
            assert frame.t_ns >= set_ns + 100_000_000
            assert np.array_equal(frame.image, rig.picture(lens_position))

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

    def test_focus(self, rig, camera):
        focus = camera.focus_range()
        if focus is None:
            with pytest.raises(CameraError, match="cannot be set"):
                camera.set_focus(0)
            return
        for wanted in (focus.lowest, focus.lowest + focus.step, focus.highest):
            assert camera.set_focus(wanted) == wanted
            assert np.array_equal(camera.read().image, rig.picture(wanted))

    def test_positions_between_the_steps_of_the_lens_are_the_nearest(self, camera):
        focus = camera.focus_range()
        if focus is None:
            pytest.skip("no focus")
        for wanted in range(focus.lowest, focus.highest + 1):
            reported = camera.set_focus(wanted)
            assert (reported - focus.lowest) % focus.step == 0 and abs(reported - wanted) <= focus.step / 2

    def test_a_frame_is_exposed_after_it_was_asked_for(self, rig, camera):
        if rig.clock_ns is None:
            pytest.skip("nothing moves")
        for _ in range(3):
            asked_ns = rig.clock_ns()
            assert asked_ns <= camera.read().t_ns <= rig.clock_ns()

    def test_focus_outside_the_range_is_its_end(self, camera):
        focus = camera.focus_range()
        if focus is None:
            pytest.skip("no focus")
        assert camera.set_focus(focus.lowest - 1000) == focus.lowest
        assert camera.set_focus(focus.highest + 1000) == focus.highest


class TestEveryCameraThatGoesAway:
    def test_reading_on_ends_in_one_line(self, rig, camera):
        camera.read()
        rig.pull()
        with pytest.raises(CameraError) as lost:
            read_on(camera)
        assert "\n" not in str(lost.value)

    def test_it_cannot_be_opened_and_can_when_it_is_back(self, rig):
        camera = rig.open()
        camera.read()
        rig.pull()
        camera.close()
        with pytest.raises(CameraError) as lost:
            rig.open()
        assert "\n" not in str(lost.value)
        rig.plug()
        again = rig.open()
        focus = again.focus_range()
        if focus is not None:
            assert again.set_focus(focus.highest) == focus.highest
            assert np.array_equal(again.read().image, rig.picture(focus.highest))
        assert again.read().roi == Roi(0, 0, *SIZE)
        again.close()

    def test_closing_it_then_is_no_error(self, rig):
        camera = rig.open()
        rig.pull()
        camera.close()
        camera.close()


def read_on(camera):
    """Read through all lens positions, and beyond the end of a video."""
    focus = camera.focus_range()
    for k in range(20):
        if focus is not None:
            camera.set_focus(min(focus.lowest + k * focus.step, focus.highest))
        camera.read()


@pytest.mark.parametrize("url", ["webcam:0", "twin", "stack:", "/dev/video0", ""])
def test_an_address_of_no_kind_names_the_kinds(url):
    with pytest.raises(CameraError) as caught:
        open_camera(url, NOWHERE, SIZE)
    assert all(f"{scheme}:" in str(caught.value) for scheme in ("twin", "stack", "video", "v4l2", "libcamera"))
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


# --- camera files ---
# Photographs and videos as cameras; whatever a user can get wrong about them is one line.


def test_lens_positions_are_the_photographs_in_order_of_focus(stack):
    camera = open_stack(stack)
    assert camera.positions == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2])
    assert camera.focus_range() == (0, 4, 1)
    assert camera.set_focus(3) == 3
    assert camera.read().image[0, 0, 2] == 24  # the scene's red tells the position, 8 each


def test_grey_photographs_come_in_three_channels(tmp_path):
    rows = ["file,focus_position"]
    for index in range(3):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((16, 24), 50 * index, np.uint8))
        rows.append(f"{index}.png,{index}")
    (tmp_path / "positions.csv").write_text("\ufeff" + "\r\n".join(rows), encoding="utf-8")  # as spreadsheets write it
    camera = open_stack(tmp_path)
    camera.set_focus(2)
    assert np.array_equal(camera.read().image, np.full((16, 24, 3), 100, np.uint8))


def test_a_directory_that_is_not_there(tmp_path):
    with pytest.raises(CameraError, match="no such directory"):
        open_stack(tmp_path / "none")


def test_without_positions_the_columns_are_named(stack):
    (stack / "positions.csv").unlink()
    with pytest.raises(CameraError, match=r"positions\.csv is missing; .* file,focus_position"):
        open_stack(stack)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no column file and focus_position"),
        ("file,focus\n0.png,1\n", "no column focus_position"),
        ("file,focus_position\n0.png,1\n1.png,far\n2.png,3\n", "line 3: focus_position 'far'"),
        ("file,focus_position\n0.png,1\n1.png,nan\n2.png,3\n", "line 3: focus_position 'nan'"),
        ("file,focus_position\n0.png,1\n1.png\n2.png,3\n", "line 3: focus_position ''"),
        ("file,focus_position\n0.png,1\n9.png,2\n2.png,3\n", "line 3: there is no file '9.png'"),
        ("file,focus_position\n0.png,1\n,2\n2.png,3\n", "line 3: there is no file ''"),
        ("file,focus_position\n0.png,1\n1.png,2\n", "2 photographs"),
        ("file,focus_position\n0.png,1\n1.png,2\n2.png,1.0\n", "0.png and 2.png have the same focus_position"),
    ],
)
def test_positions_that_cannot_be_used(stack, text, says):
    (stack / "positions.csv").write_text(text)
    with pytest.raises(CameraError) as caught:
        open_stack(stack)
    assert says in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_positions_as_editors_and_spreadsheets_write_them(stack, encoding, mark):
    path = stack / "positions.csv"
    wanted = open_stack(stack).positions
    lines = [line.split(",") for line in path.read_text().splitlines()]
    if mark != ",":
        lines[1:] = [[name, position.replace(".", ",")] for name, position in lines[1:]]
    path.write_text("\n".join(mark.join(cells) for cells in lines), encoding=encoding)
    assert open_stack(stack).positions == wanted


def test_a_photograph_has_one_row(stack):
    path = stack / "positions.csv"
    name = path.read_text().splitlines()[1].split(",")[0]
    path.write_text(path.read_text() + f"{name},777\n")
    with pytest.raises(CameraError, match=f"{name} stands in more than one row; give each row its own photograph"):
        open_stack(stack)


def test_positions_that_are_no_text(stack):
    (stack / "positions.csv").write_bytes(b"\xff\xff\x00\x01")
    with pytest.raises(CameraError, match="cannot be read as a table"):
        open_stack(stack)


def test_a_corrupt_photograph(stack):
    whole = (stack / "2.png").read_bytes()
    (stack / "2.png").write_bytes(whole[: len(whole) // 2])
    camera = open_stack(stack)
    camera.set_focus(2)
    with pytest.raises(CameraError, match=r"2\.png: not an image"):
        camera.read()
    camera.set_focus(3)
    assert camera.read().image.shape == (64, 96, 3)


def test_a_photograph_that_has_gone_and_is_back(stack):
    camera = open_stack(stack)
    camera.set_focus(2)
    (stack / "2.png").rename(stack / "away.png")
    with pytest.raises(CameraGone, match=r"2\.png: the photograph has gone"):
        camera.read()
    (stack / "away.png").rename(stack / "2.png")
    assert camera.read().image[0, 0, 2] == 16


def test_a_photograph_of_another_size(stack):
    cv2.imwrite(str(stack / "3.png"), np.zeros((10, 20, 3), np.uint8))
    camera = open_stack(stack)
    camera.set_focus(3)
    with pytest.raises(CameraError, match=r"3\.png: 20x10 pixels, but 0\.png has 96x64"):
        camera.read()


def test_video_time_is_the_files_and_ends_with_it(video):
    camera = open_video(video)
    assert [camera.read().t_ns for _ in range(8)] == [40_000_000 * n for n in range(8)]
    with pytest.raises(CameraGone, match="end of the video after 8 frames"):
        camera.read()
    camera.close()


def test_what_is_no_video(tmp_path):
    with pytest.raises(CameraError, match="no such file"):
        open_video(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(CameraError, match="not a video"):
        open_video(tmp_path / "text.mp4")


# --- what is plugged in ---

LISTED = """\
Deep Webcam
  at        /dev/video7, fake, usb-0000:00:14.0-1
  format    YUYV 96x64 30/s, 1280x960 5/s
  format    MJPG 96x64 30/s, 1280x960 30/s
  pictures  96x64 YUYV, 30/s
  focus     0 to 20 in steps of 5
  exposure  can be set, 10 ms now
  stamps    exposure-start
  warning   it has no control of gain; what changes by itself in a sweep spoils its peak
  write     camera = "v4l2:Deep Webcam"
Deep Webcam
  refused   /dev/video8: gives film alone (H264), no whole pictures; use its node of YUYV or MJPG, or another camera
imx708
  pictures  640x480, 30/s
  focus     0 to 30 in steps of 3
  exposure  can be set, 8 ms now
  stamps    exposure-start
  write     camera = "libcamera:0"
"""


def list_them(monkeypatch, capsys, *found):
    monkeypatch.setattr("hw.camera.plugged_in", lambda: [one for some in found for one in some])
    monkeypatch.setattr("sys.argv", ["aucamp", "calibrate", "cameras"])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code or 0, capsys.readouterr()


def test_what_is_plugged_in_is_listed_with_the_address_to_write(computer, device, pi, monkeypatch, capsys):
    film, about, locked = (FakeCamera(f"/dev/video{k}", computer.clock) for k in (8, 9, 10))
    film.formats = {fourcc("H264"): {(96, 64): 30}}
    about.capabilities = v4l2_node.CAP_STREAMING
    computer.there |= {camera.path: camera for camera in (film, about)}
    found = v4l2.plugged_in(computer.system, computer.clock)
    code, said = list_them(monkeypatch, capsys, found, libcamera.plugged_in(pi.clock))
    assert (code, said.out) == (0, LISTED)
    assert not device.opened and device.value(v4l2_node.EXPOSURE_AUTO) == 3
    locked.forbidden = True
    computer.there = {locked.path: locked}
    code, said = list_them(monkeypatch, capsys, v4l2.plugged_in(computer.system, computer.clock))
    assert code == 1 and "refused   /dev/video10: you may not open it; join its group" in said.out


def test_two_of_one_name_are_listed_by_their_ports(computer):
    other = FakeCamera("/dev/video8", computer.clock)
    other.bus, other.ranges = "usb-0000:00:14.0-2", True
    computer.there[other.path] = other
    found = v4l2.plugged_in(computer.system, computer.clock)
    assert [one.address for one in found] == ["v4l2:usb-0000:00:14.0-1", "v4l2:usb-0000:00:14.0-2"]
    assert all(("format", "YUYV 96x64 30/s, 1280x960 5/s") in one.facts for one in found)
    for one in found:
        computer.open(one.address.partition(":")[2]).close()


def test_nothing_plugged_in_is_one_line_and_no(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "picamera2", None)
    code, said = list_them(monkeypatch, capsys, libcamera.plugged_in())
    assert (code, said.out) == (1, "")
    assert said.err.startswith("aucamp: no camera is plugged in;") and said.err.count("\n") == 1
