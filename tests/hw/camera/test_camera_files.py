"""Photographs and videos as cameras; whatever a user can get wrong about them is one line."""

import cv2
import numpy as np
import pytest

from hw.camera.camera import CameraError, CameraGone
from hw.camera.files import open_stack, open_video


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


def test_positions_that_are_no_text(stack):
    (stack / "positions.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(CameraError, match="cannot be read as CSV"):
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
