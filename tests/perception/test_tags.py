"""Which tags a frame shows, and that their first corner is the upper left one of the picture as it is published."""

import cv2
import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.step_io import SeenTags
from agent.perception.tags import (
    all_tags,
    find_tags,
    fit_corners,
    fit_line,
    light_of_bytes,
    module_px,
    seen_tags,
    to_pixels,
    to_slopes,
)
from tests.perception.printed import CODES, SIZE_M, WALL, bend, corner_slopes, modules, photograph, tag_light, turned

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
    truths = {3: (turned(20, 30, 80), (-0.07, 0.05, 0.55)), 1: (turned(-30, -10, -30), (0.09, -0.05, 0.7))}
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


# --- edges ---
# Corners from edges: exact on drawn edges, alike however blurred, and none where the edges do not show them.

EDGES_CAMERA = CameraFit(width_px=280, height_px=240, f_px=1184.0, cx_px=90.0, cy_px=150.0, bend=0.39)
# Modules of 17, 13 and 16 px, the last at the edge of a picture whose corners are bent by 4 px.
POSES = (
    (turned(0, 0, 3), (0.03, -0.015, 0.68)),
    (turned(35, -20, 20), (0.03, -0.015, 0.66)),
    (turned(-25, 15, -100), (0.05, -0.02, 0.62)),
)
BLURS_PX = (0.0, 3.0, 6.0, 9.0, 12.0)  # diameters


@pytest.fixture(scope="module")
def tags():
    """Linear light of each pose, and where its corners are, pixels."""
    out = []
    for rotation, middle in POSES:
        light = np.full((EDGES_CAMERA.height_px, EDGES_CAMERA.width_px), WALL)
        tag_light(EDGES_CAMERA, 0, rotation, middle, light)
        out.append((light, bend(EDGES_CAMERA, corner_slopes(rotation, middle))))
    return out


def roughly(corners_px, off_px=1.0):
    """As a detector gives them: drawn inwards."""
    away = corners_px - corners_px.mean(axis=0)
    return corners_px - off_px * away / np.hypot(away[:, :1], away[:, 1:])


def errors_px(image, truth_px, gamma=2.2):
    """(4, 2) of the corners found, None if none were."""
    found = fit_corners(np.ascontiguousarray(image[..., 1]), light_of_bytes(gamma), roughly(truth_px), EDGES_CAMERA)
    return None if found is None else to_pixels(EDGES_CAMERA, found.slopes) - truth_px


@pytest.mark.parametrize("blur_px", BLURS_PX)
def test_without_noise_corners_are_exact_at_every_blur(tags, blur_px):
    for light, truth_px in tags:
        assert np.abs(errors_px(photograph(light, blur_px), truth_px)).max() < 0.05


def test_rough_corners_may_be_off_by_most_of_a_module():
    """Where the edge's gradient lies half outside of where it is looked for, it is looked for again."""
    light, place = (
        np.full((EDGES_CAMERA.height_px, EDGES_CAMERA.width_px), WALL),
        (turned(10, 55, 5), (0.02, -0.02, 1.0)),
    )
    tag_light(EDGES_CAMERA, 0, *place, light)
    truth_px = bend(EDGES_CAMERA, corner_slopes(*place))
    module = module_px(truth_px)
    assert 4.0 < module < 8.0
    rough_px, gamma = truth_px + 0.7 * module * np.array([[1, 0], [-1, 1], [-1, 0], [1, -1]]), light_of_bytes(2.2)
    found = fit_corners(np.ascontiguousarray(photograph(light, 2.0)[..., 1]), gamma, rough_px, EDGES_CAMERA)
    assert found is not None and np.abs(to_pixels(EDGES_CAMERA, found.slopes) - truth_px).max() < 0.05


def test_a_near_tag_may_be_far_out_of_focus():
    """Modules of 22 px and a blur of 18: edges are looked for as far as the border reaches."""
    light, place = (
        np.full((EDGES_CAMERA.height_px, EDGES_CAMERA.width_px), WALL),
        (turned(0, 0, 2), (0.0227, -0.0136, 0.538)),
    )
    tag_light(EDGES_CAMERA, 0, *place, light)
    assert np.abs(errors_px(photograph(light, 18.0), bend(EDGES_CAMERA, corner_slopes(*place)))).max() < 0.05


@pytest.mark.parametrize("blur_px", BLURS_PX[::2])
def test_noise_moves_corners_little_and_in_no_direction(tags, blur_px):
    shapes, growths = [], []
    for light, truth_px in tags:
        away = truth_px - truth_px.mean(axis=0)
        for seed in range(3):
            error = errors_px(photograph(light, blur_px, noise=0.02, seed=seed), truth_px)
            shapes.append(error - error.mean(axis=0))
            growths.append((away * error).sum() / (away * away).sum())
    assert np.sqrt(np.mean(np.square(shapes))) < 0.15
    assert abs(np.mean(growths)) < 0.0005


def test_a_gamma_that_is_left_in_shows(tags):
    """Else nothing here would prove that light is made linear."""
    light, truth_px = tags[0]
    left_in = errors_px(photograph(light, 9.0), truth_px, gamma=1.0)
    assert np.sqrt(np.mean(left_in**2)) > 0.4
    half_wrong = errors_px(photograph(light, 9.0, gamma=1.8), truth_px, gamma=2.2)
    assert 0.05 < np.sqrt(np.mean(half_wrong**2)) < 0.5


@pytest.mark.parametrize("blur_px", [3.0, 6.0, 12.0])
def test_says_how_blurred(tags, blur_px):
    light, truth_px = tags[1]
    plane = np.ascontiguousarray(photograph(light, blur_px, noise=0.02)[..., 1])
    found = fit_corners(plane, light_of_bytes(2.2), roughly(truth_px), EDGES_CAMERA)
    assert found.blur_px == pytest.approx(blur_px, abs=0.5)


def test_what_lies_over_part_of_an_edge_is_left_out(tags):
    light, truth_px = tags[0]
    image = photograph(light, 3.0)
    corner, end = truth_px[0], truth_px[1]
    at = np.round(corner + 0.3 * (end - corner)).astype(int)
    image[at[1] - 25 : at[1] + 25, at[0] - 12 : at[0] + 12] = 10  # a cable in front
    assert np.abs(errors_px(image, truth_px)).max() < 0.1


def test_no_corners_where_an_edge_is_hidden_burnt_or_gone(tags):
    light, truth_px = tags[0]
    hidden = photograph(light, 3.0)
    top = truth_px[:2].mean(axis=0).astype(int)
    cv2.rectangle(hidden, (top[0] - 50, top[1] - 20), (top[0] + 50, top[1] + 20), (10, 10, 10), -1)
    assert errors_px(hidden, truth_px) is None
    burnt = photograph(np.where(light > 0.5, 1.5, light), 6.0)
    assert errors_px(burnt, truth_px) is None
    cut_off = photograph(light, 3.0)[: int(truth_px[:, 1].max()) + 5]
    assert errors_px(cut_off, truth_px) is None


def test_no_corners_where_the_border_is_blurred_into_the_code(tags):
    light, truth_px = tags[1]
    module = module_px(truth_px)
    assert np.abs(errors_px(photograph(light, 0.8 * module), truth_px)).max() < 0.15
    assert errors_px(photograph(light, 1.3 * module), truth_px) is None


def test_a_module_is_as_wide_as_it_is_crossed():
    rhombus = np.array([[0.0, 0.0], [80.0, 0.0], [120.0, 69.28], [40.0, 69.28]])
    assert module_px(rhombus) == pytest.approx(69.28 / 8)


def test_a_line_does_not_mind_outliers():
    rng = np.random.default_rng(4)
    t = np.linspace(-1.0, 1.0, 28)
    points = np.stack([0.3 + 0.6 * t, -0.1 - 0.8 * t], axis=-1) + rng.normal(0.0, 0.001, (28, 2))
    points[5] = np.nan
    points[[11, 20]] += 0.3
    inliers = np.isin(np.arange(28), (5, 11, 20), invert=True)
    line, off = np.empty(4), np.empty(28)
    fit_line(points, line, off, np.empty(28))
    # The same by singular values, of the points that are meant.
    along = np.linalg.svd(points[inliers] - points[inliers].mean(axis=0))[2][0]
    assert abs(line[2] * along[1] - line[3] * along[0]) < 0.001
    assert line[2] > 0.0 and np.isnan(off[5])
    assert np.abs(off[inliers]).max() < 0.004 and np.abs(off[[11, 20]]).min() > 0.3


def test_slopes_and_pixels_undo_each_other():
    px = np.array([[0.0, 0.0], [279.0, 239.0], [90.0, 150.0]])
    assert np.allclose(to_pixels(EDGES_CAMERA, to_slopes(EDGES_CAMERA, px)), px, atol=1e-6)


# --- pictures of any size ---


def wall_of_tags(width_px, height_px, side_px):
    """A picture with the tags of CODES in a row, each so large, a little blurred."""
    light = np.full((height_px, width_px), WALL)
    printed = (np.arange(round(side_px * 10 / 8)) * 10 / round(side_px * 10 / 8)).astype(int)
    for k, number in enumerate(CODES):
        tag = 0.03 + 0.67 * modules(number)[np.ix_(printed, printed)]
        top, left = height_px // 3, int((0.05 + 0.15 * k) * width_px)
        light[top : top + len(tag), left : left + len(tag)] = tag
    grey = cv2.GaussianBlur((255 * light ** (1 / 2.2)).astype(np.uint8), (0, 0), 0.5)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize(
    ("width_px", "height_px", "side_px"),
    [(640, 480, 20), (1280, 960, 24), (1920, 1080, 24), (1920, 1080, 160), (4000, 3000, 24), (4000, 3000, 400)],
)
def test_a_tag_has_as_many_pixels_in_a_large_picture_as_in_a_small_one(width_px, height_px, side_px):
    camera = CameraFit(
        width_px=width_px, height_px=height_px, f_px=width_px, cx_px=width_px / 2 - 0.5, cy_px=height_px / 2 - 0.5
    )
    found = find_tags(wall_of_tags(width_px, height_px, side_px), camera)
    assert [one.seen.id for one in found] == sorted(CODES)
    assert [one.seen.size_px for one in found] == pytest.approx([side_px] * len(CODES), rel=0.1)


def test_what_is_found_at_two_sizes_counts_once():
    """Tags of 200 px are found in the picture and in the one of half its size."""
    camera = CameraFit(width_px=1920, height_px=1080, f_px=1920, cx_px=959.5, cy_px=539.5)
    found = all_tags(wall_of_tags(1920, 1080, 200), camera)
    assert [one.seen.id for one in found] == sorted(CODES) and all(one.alone for one in found)
