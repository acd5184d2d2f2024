"""Which tags a frame shows, and that their first corner is the upper left one of the picture as it is published."""

import cv2
import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.step_io import SeenTags
from agent.perception.tags import find_tags, seen_tags
from tests.perception.landmarks.printed import (
    CODES,
    SIZE_M,
    WALL,
    bend,
    corner_slopes,
    modules,
    photograph,
    tag_light,
    turned,
)

CAMERA = CameraFit(
    width_px=320, height_px=240, f_px=600.0, cx_px=159.5, cy_px=119.5, bend=0.39, lens=300.0, breathing=2e-4
)
FLAT = turned(0, 0, 0)


def flat(number, size_px=80, margin_px=40):
    """A picture (n, n, 3) of a tag seen from in front, upright."""
    side = size_px // 8
    grid = np.kron(modules(number), np.ones((side, side)))
    return photograph(np.pad(0.03 + 0.67 * grid, margin_px, constant_values=WALL))


def scene_light(*tags, camera=CAMERA):
    """Linear light of tags (number, rotation, middle_m) before a wall."""
    light = np.full((camera.height_px, camera.width_px), WALL)
    for tag in tags:
        tag_light(camera, *tag, light)
    return light


def scene(*tags, blur_px=1.0):
    return photograph(scene_light(*tags), blur_px, noise=0.01)


def test_the_table_of_the_tests_is_the_published_one():
    """The first release of the library listed the same tag row by row, as 0xd5d628584."""
    rows = [int(bit) for bit in f"{0xD5D628584:036b}"]
    assert modules(0)[2:8, 2:8].astype(int).ravel().tolist() == rows


@pytest.mark.parametrize("turns", range(4))
def test_the_first_corner_is_the_upper_left_of_the_published_picture(turns):
    """np.rot90 turns anticlockwise, and corners go on clockwise."""
    image = np.ascontiguousarray(np.rot90(flat(0), turns))
    (found,) = find_tags(image, replace(CAMERA, bend=0.0))
    middle = (image.shape[0] - 1) / 2
    upright = middle + 40 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    expected = {0: [0, 1, 2, 3], 1: [3, 0, 1, 2], 2: [2, 3, 0, 1], 3: [1, 2, 3, 0]}[turns]
    assert np.abs(found.corners_px - upright[expected]).max() < 0.05


@pytest.mark.parametrize("number", CODES)
def test_ids_are_the_published_ones(number):
    (found,) = find_tags(flat(number), CAMERA)
    assert found.seen.id == number


@pytest.mark.parametrize("number", CODES)
def test_a_tag_in_a_mirror_is_none(number):
    assert not find_tags(np.ascontiguousarray(flat(number)[:, ::-1]), CAMERA)


def test_a_frame_with_several():
    truths = {
        3: (turned(20, 30, 80), (-0.07, 0.05, 0.55)),
        1: (turned(-30, -10, -30), (0.09, -0.05, 0.7)),
    }
    camera = at_lens_position(CAMERA, 500)
    light = scene_light(*((number, *place) for number, place in truths.items()), camera=camera)
    seen = seen_tags(photograph(light, 2.0, noise=0.01), CAMERA, 500, t_ns=7, frame=3)
    assert (seen.t_ns, seen.frame, seen.focus) == (7, 3, 500)
    assert [tag.id for tag in seen.tags] == [1, 3]
    for tag in seen.tags:
        slopes = corner_slopes(*truths[tag.id])
        px = bend(camera, slopes)
        assert tag.edges
        assert np.abs(np.array(tag.corners) - slopes).max() * camera.f_px < 0.1
        assert tag.size_px == pytest.approx(np.hypot(*(np.roll(px, -1, axis=0) - px).T).min(), abs=0.2)
        assert tag.rho_px == pytest.approx(np.hypot(*(px.mean(axis=0) - (159.5, 119.5))), abs=0.2)
    assert msgspec.json.decode(msgspec.json.encode(seen), type=SeenTags) == seen


def test_corners_are_those_at_the_frames_lens_position():
    """The picture is 6 % larger 300 positions on: the same pixels are other slopes."""
    image = scene((0, FLAT, (0.0, 0.0, 0.5)))
    here, there = (seen_tags(image, CAMERA, at, 0, 0).tags[0] for at in (300, 600))
    ratio = np.array(here.corners) / np.array(there.corners)
    assert ratio == pytest.approx(1.06, abs=0.002)


def test_of_two_with_one_id_neither_counts():
    left, right = (-0.07, 0.0, 0.6), (0.07, 0.0, 0.6)
    assert [one.seen.id for one in find_tags(scene((0, FLAT, left), (2, FLAT, right)), CAMERA)] == [0, 2]
    assert not find_tags(scene((0, FLAT, left), (0, FLAT, right)), CAMERA)


def test_a_grazing_view_does_not_count():
    """Across a diagonal, where the sine between edges falls fastest: 0.43 at 77 degrees and 0.61 at 70."""
    thin, wide = (scene((0, turned(deg, 0, 0) @ turned(0, 0, 45), (0.0, 0.0, 0.4)), blur_px=0.0) for deg in (77, 70))
    anything = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    assert anything.detectMarkers(thin)[1] is not None
    assert not find_tags(thin, CAMERA)
    assert len(find_tags(wide, CAMERA)) == 1


def test_without_edges_corners_are_searched_for_and_it_says_so():
    image = photograph(scene_light((0, FLAT, (0.0, 0.0, 0.6))) * 2.2, 2.0)  # burnt out
    (found,) = find_tags(image, CAMERA)
    assert not found.seen.edges and found.blur_px is None
    assert np.abs(found.corners_px - bend(CAMERA, corner_slopes(FLAT, (0.0, 0.0, 0.6)))).max() < 2.0


def test_other_gammas_are_the_calibrations():
    light = scene_light((0, turned(10, 20, 5), (0.0, 0.0, 0.45)))
    truth = bend(CAMERA, corner_slopes(turned(10, 20, 5), (0.0, 0.0, 0.45)))
    linear = photograph(light, 6.0, gamma=1.0)
    (right,) = find_tags(linear, replace(CAMERA, gamma=1.0))
    (wrong,) = find_tags(linear, CAMERA)
    assert np.abs(right.corners_px - truth).max() < 0.05 < 0.3 < np.abs(wrong.corners_px - truth).max()


def test_no_more_than_a_message_holds():
    """Sixty-six squares in one frame: the largest 64 are said."""
    wide = CameraFit(width_px=1100, height_px=620, f_px=900.0, cx_px=549.5, cy_px=309.5)
    numbers = [(row, column) for row in range(6) for column in range(11)]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image = np.full((620, 1100, 3), 200, np.uint8)
    for id_, (row, column) in enumerate(numbers):
        size = 56 if id_ < 2 else 64  # the first two are smaller
        tag = cv2.aruco.generateImageMarker(dictionary, id_, size)
        image[10 + 100 * row : 10 + 100 * row + size, 10 + 100 * column : 10 + 100 * column + size] = tag[..., None]
    seen = seen_tags(image, wide, None, 0, 0)
    assert [tag.id for tag in seen.tags] == list(range(2, 66))


def test_nothing_to_see():
    assert seen_tags(np.full((240, 320, 3), 90, np.uint8), CAMERA, None, 0, 0).tags == ()


def test_the_tags_of_the_tests_are_as_large_as_they_say():
    px = bend(replace(CAMERA, bend=0.0), corner_slopes(FLAT, (0.0, 0.0, 0.5)))
    assert np.ptp(px[:, 0]) == pytest.approx(600.0 * SIZE_M / 0.5)
