"""Corners from edges: exact on drawn edges, alike however blurred, and none where the edges do not show them."""

import cv2
import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.perception.tags import fit_corners, fit_line, light_of_bytes, module_px, to_pixels, to_slopes
from tests.perception.landmarks.printed import WALL, bend, corner_slopes, photograph, tag_light, turned

CAMERA = CameraFit(width_px=280, height_px=240, f_px=1184.0, cx_px=90.0, cy_px=150.0, bend=0.39)
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
        light = np.full((CAMERA.height_px, CAMERA.width_px), WALL)
        tag_light(CAMERA, 0, rotation, middle, light)
        out.append((light, bend(CAMERA, corner_slopes(rotation, middle))))
    return out


def roughly(corners_px, off_px=1.0):
    """As a detector gives them: drawn inwards."""
    away = corners_px - corners_px.mean(axis=0)
    return corners_px - off_px * away / np.hypot(away[:, :1], away[:, 1:])


def errors_px(image, truth_px, gamma=2.2):
    """(4, 2) of the corners found, None if none were."""
    found = fit_corners(np.ascontiguousarray(image[..., 1]), light_of_bytes(gamma), roughly(truth_px), CAMERA)
    return None if found is None else to_pixels(CAMERA, found.slopes) - truth_px


@pytest.mark.parametrize("blur_px", BLURS_PX)
def test_without_noise_corners_are_exact_at_every_blur(tags, blur_px):
    for light, truth_px in tags:
        assert np.abs(errors_px(photograph(light, blur_px), truth_px)).max() < 0.05


def test_rough_corners_may_be_off_by_most_of_a_module():
    """Where the edge's gradient lies half outside of where it is looked for, it is looked for again."""
    light, place = np.full((CAMERA.height_px, CAMERA.width_px), WALL), (turned(10, 55, 5), (0.02, -0.02, 1.0))
    tag_light(CAMERA, 0, *place, light)
    truth_px = bend(CAMERA, corner_slopes(*place))
    module = module_px(truth_px)
    assert 4.0 < module < 8.0
    rough_px, gamma = truth_px + 0.7 * module * np.array([[1, 0], [-1, 1], [-1, 0], [1, -1]]), light_of_bytes(2.2)
    found = fit_corners(np.ascontiguousarray(photograph(light, 2.0)[..., 1]), gamma, rough_px, CAMERA)
    assert found is not None and np.abs(to_pixels(CAMERA, found.slopes) - truth_px).max() < 0.05


def test_a_near_tag_may_be_far_out_of_focus():
    """Modules of 22 px and a blur of 18: edges are looked for as far as the border reaches."""
    light, place = np.full((CAMERA.height_px, CAMERA.width_px), WALL), (turned(0, 0, 2), (0.0227, -0.0136, 0.538))
    tag_light(CAMERA, 0, *place, light)
    assert np.abs(errors_px(photograph(light, 18.0), bend(CAMERA, corner_slopes(*place)))).max() < 0.05


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
    found = fit_corners(plane, light_of_bytes(2.2), roughly(truth_px), CAMERA)
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
    assert np.allclose(to_pixels(CAMERA, to_slopes(CAMERA, px)), px, atol=1e-6)
