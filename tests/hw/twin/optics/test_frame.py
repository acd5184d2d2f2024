"""Frames and depths of the tank, against geometry done another way."""

import cv2
import numpy as np
import pytest

from agent.core.config import Tank
from hw.twin.optics.image_formation import apparent_m
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import HULL_RADII_M, Chessboard, Eye, Hull
from hw.twin.optics.shade import draw_water, transmission_and_veil
from hw.twin.scene import Scene, SceneWater, Solid, generator, load_scene

N = 1.333
LENS = draw_lens("imx519_640", generator(0, "r1", "lens"))
PINHOLE = LENS._replace(port_gap_m=0.0, k1=0.0, k2=0.0)
BALL = np.array([0.76, 0.56, 0.07])
START = np.array([0.38, 0.31, 0.10])


def painter_of(scene=None, lens=LENS, n=N, robot="r1"):
    painter = Painter(scene or load_scene("tank"), Tank(), n, lens, 0, robot)
    painter.prepare()
    return painter


@pytest.fixture(scope="module")
def painter():
    return painter_of()


def look(position_m, target):
    forward = np.asarray(target, float) - position_m
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Eye(np.asarray(position_m, float), np.column_stack([right, np.cross(forward, right), forward]))


def sharp_at(depth_m, lens=LENS):
    return lens.image_m(1 / apparent_m(depth_m, N, lens.port_gap_m))


def facing(eye, distance_m, **changes):
    """A board square to the camera, its x to the right of the picture and its y up."""
    right, down, forward = np.asarray(eye.rotation).T
    return Chessboard(eye.position_m + distance_m * forward, np.column_stack([right, -down, -forward]), **changes)


AHEAD = look(START, BALL)
EMPTY = look(np.array([0.75, 0.6, 0.25]), [1.5, 0.6, 0.25])


def snell_ray(lens, n, v, i, j):
    """Origin on the port and unit direction in the water, by angles and in float64."""
    x, y = (i - lens.centre_px[0]) * lens.pixel_m / v, (j - lens.centre_px[1]) * lens.pixel_m / v
    r2 = x * x + y * y
    x, y = (c * (1 + lens.k1 * r2 + lens.k2 * r2 * r2) for c in (x, y))
    angle = np.arctan(np.hypot(x, y))
    round_axis = np.arctan2(y, x)
    in_water = np.arcsin(np.sin(angle) / n)
    direction = [np.sin(in_water) * np.cos(round_axis), np.sin(in_water) * np.sin(round_axis), np.cos(in_water)]
    return np.array([x, y, 1]) * lens.port_gap_m, np.array(direction)


def test_wall_straight_ahead_has_its_distance_everywhere():
    depth = painter_of(Scene(name="bare")).depth(EMPTY, LENS.at_rest_m)
    assert depth.dtype == np.float32
    assert abs(depth[120:360, :] - 0.75).max() < 1e-4


@pytest.mark.parametrize(("lens", "n"), [(PINHOLE, 1.0), (LENS, N)])
def test_depth_of_the_ball_is_where_its_ray_meets_the_sphere(lens, n):
    v = lens.at_position_m(400)
    depth = painter_of(lens=lens, n=n).depth(AHEAD, v)
    centre = np.asarray(AHEAD.rotation).T @ (BALL - AHEAD.position_m)
    for i, j in [(320, 240), (250, 200), (390, 330), (200, 240), (320, 120)]:
        origin, direction = snell_ray(lens, n, v, i, j)
        along = direction @ (centre - origin)
        miss = np.linalg.norm(origin + along * direction - centre)
        hit = origin + (along - np.sqrt(0.07**2 - miss**2)) * direction
        assert depth[j, i] == pytest.approx(hit[2], abs=1e-4)


def test_hull_stands_where_it_is_put_and_hides_what_is_behind(painter):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    hull = Hull(START + 0.30 * AHEAD.rotation[:, 2], turn)
    i, j = (round(c) for c in LENS.centre_px)
    axis = turn.T @ AHEAD.rotation[:, 2] / HULL_RADII_M  # in units in which the hull is a unit sphere
    expected = 0.30 - 1 / np.linalg.norm(axis)  # the axis passes through its centre
    assert painter.depth(AHEAD, LENS.at_rest_m, hulls=(hull,))[j, i] == pytest.approx(expected, abs=1e-4)
    assert painter.depth(AHEAD, LENS.at_rest_m)[j, i] > 0.36


def test_picture_is_upright_and_not_mirrored(painter):
    image = painter.frame(AHEAD, sharp_at(0.39))[..., ::-1].astype(float)
    red = image[..., 0] > 1.3 * image[..., 1:].max(-1)
    assert red.mean() > 0.2
    rows, cols = np.nonzero(red)
    assert abs(cols.mean() - 320) < 12
    aside = painter.frame(look(START, BALL - 0.06 * AHEAD.rotation[:, 0]), sharp_at(0.39))[..., ::-1].astype(float)
    cols = np.nonzero(aside[..., 0] > 1.3 * aside[..., 1:].max(-1))[1]
    assert cols.mean() > 380  # looking to its left, the ball is on the right
    above = painter.frame(look(START, BALL + np.array([0, 0, 0.06])), sharp_at(0.39))[..., ::-1].astype(float)
    assert np.nonzero(above[..., 0] > 1.3 * above[..., 1:].max(-1))[0].mean() > rows.mean() + 60


def test_magnification_follows_the_image_distance():
    ball = Solid(kind="ball", position_m=tuple(BALL), radii_m=(0.07, 0.07, 0.07))
    bare, alone = painter_of(Scene(name="bare")), painter_of(Scene(name="alone", solid=(ball,)))
    area = [(alone.depth(AHEAD, v) < bare.depth(AHEAD, v) - 1e-3).sum() for v in (4.25e-3, 4.50e-3)]
    assert np.sqrt(area[1] / area[0]) == pytest.approx(4.50 / 4.25, rel=3e-3)


def test_chessboard_has_its_corners_and_its_scale():
    painter = painter_of(Scene(name="bare"), lens=PINHOLE)
    distance_m, v = 0.75, sharp_at(0.75, PINHOLE)
    eye = look(np.array([0.3, 0.6, 0.25]), [1.5, 0.6, 0.25])
    grey = cv2.cvtColor(painter.frame(eye, v, chessboard=facing(eye, distance_m)), cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (14, 9), None)
    assert found
    corners = corners.reshape(9, 14, 2)
    assert corners.mean((0, 1)) == pytest.approx(PINHOLE.centre_px, abs=0.3)
    # a flat port magnifies off the axis; the middle squares have the paraxial scale n v / p
    middle = np.linalg.norm(corners[4, 7] - corners[4, 6])
    assert middle == pytest.approx(N * v / PINHOLE.pixel_m * 0.02 / distance_m, rel=0.015)


def test_board_ends_at_its_size(painter):
    eye = look(np.array([0.3, 0.6, 0.25]), [1.5, 0.6, 0.25])
    depth = painter.depth(eye, LENS.at_rest_m, chessboard=facing(eye, 0.75, size_m=(0.20, 0.10)))
    rows, cols = np.nonzero(depth < 0.751)
    aspect = (np.ptp(cols) + 1) / (np.ptp(rows) + 1)
    assert aspect == pytest.approx(2, rel=0.02)
    assert depth[rows, cols] == pytest.approx(0.75, abs=1e-4)


@pytest.mark.parametrize("lens_position", [150, 400, 700, 1000])
def test_part_of_a_frame_equals_the_frame_there(painter, lens_position):
    v = LENS.at_position_m(lens_position)
    x, y, w, h = roi = (171, 83, 205, 190)
    part = painter.frame(AHEAD, v, roi=roi, tick=3).astype(int)
    crop = painter.frame(AHEAD, v, tick=3)[y : y + h, x : x + w].astype(int)
    assert part.shape == (h, w, 3)
    # SIMD and the rest of a row round differently in the last bit of a float32
    assert abs(part - crop).max() <= 1
    assert (part != crop).mean() < 1e-3
    assert abs(painter.depth(AHEAD, v, roi=roi) - painter.depth(AHEAD, v)[y : y + h, x : x + w]).max() < 1e-5


def test_part_outside_the_frame_is_refused(painter):
    with pytest.raises(ValueError, match="not inside the frame of 640x480"):
        painter.frame(AHEAD, LENS.at_rest_m, roi=(600, 0, 100, 100))


def test_bytes_depend_on_seed_robot_and_tick_alone(painter):
    roi, v = (200, 150, 120, 90), LENS.at_position_m(300)
    first = painter.frame(AHEAD, v, roi=roi, tick=7)
    other = painter.frame(AHEAD, v, roi=roi, tick=8)
    painter.frame(EMPTY, LENS.at_rest_m)
    assert np.array_equal(painter.frame(AHEAD, v, roi=roi, tick=7), first)
    assert np.array_equal(painter_of().frame(AHEAD, v, roi=roi, tick=7), first)
    assert (other != first).mean() > 0.5
    assert (painter_of(robot="r2").frame(AHEAD, v, roi=roi, tick=7) != first).mean() > 0.5


def test_noise_is_a_photon_count_s(painter):
    """Two ticks of one still view: the variance of linear light is I / 4000 + 0.004^2 plus rounding to bytes."""
    v, roi = LENS.at_position_m(1000), (240, 0, 160, 60)
    frames = np.stack([painter.frame(EMPTY, v, roi=roi, tick=t) for t in range(40)]) / 255
    light = frames**2.2
    mean = light.mean(0)
    rounding = (2.2 * mean ** (1.2 / 2.2) / 255) ** 2 / 12
    expected = mean / 4000 + 0.004**2 + rounding
    assert light.var(0, ddof=1).mean() == pytest.approx(expected.mean(), rel=0.05)


def test_the_same_board_is_dimmer_in_water_by_what_water_takes():
    scene = Scene(name="bare", water=SceneWater(preset="turbid"))
    painter = painter_of(scene, lens=PINHOLE)
    eye = look(np.array([0.15, 0.6, 0.25]), [1.5, 0.6, 0.25])
    water = draw_water(scene.water, generator(0, "water"))
    levels = []
    for distance_m in (0.3, 0.9):
        image = painter.frame(eye, sharp_at(distance_m, PINHOLE), chessboard=facing(eye, distance_m))
        levels.append((image[160:320, 240:400] / 255.0) ** 2.2)
    (t_near, t_far), _ = transmission_and_veil(water, np.array([0.3, 0.9]))
    # contrast, unlike brightness, owes nothing to the veil
    contrast = [np.ptp(cv2.blur(level, (9, 9))[10:-10, 10:-10], axis=(0, 1)) for level in levels]
    assert contrast[1] / contrast[0] == pytest.approx(t_far / t_near, rel=0.1)


def tenengrad(image):
    y = image @ [0.114, 0.587, 0.299]
    smooth_y, smooth_x = y[:-2] + 2 * y[1:-1] + y[2:], y[:, :-2] + 2 * y[:, 1:-1] + y[:, 2:]
    gx, gy = smooth_y[:, 2:] - smooth_y[:, :-2], smooth_x[2:] - smooth_x[:-2]
    return gx**2 + gy**2


@pytest.mark.parametrize("distance_m", [0.30, 0.45, 0.80])
def test_clarity_of_the_ball_peaks_once_and_where_it_is(painter, distance_m):
    """A full sweep over the inner disc of the ball: one summit, at the image distance of the surface there."""
    back = (START - BALL) / np.linalg.norm(START - BALL)
    eye = look(BALL + (distance_m + 0.07) * back, BALL)
    half = int(0.3 * 0.07 / (distance_m + 0.07) * 1169)
    roi = (320 - half, 240 - half, 2 * half, 2 * half)

    def clarity(lens_positions):
        frames = (painter.frame(eye, LENS.at_position_m(p), roi=roi, tick=int(p)) for p in lens_positions)
        return np.array([tenengrad(frame).mean() for frame in frames])

    sweep = np.arange(0, 1024, 31)
    curve = clarity(sweep)
    top = int(curve.argmax())
    assert curve.max() > 3 * curve[[0, -1]].max()
    assert np.all(np.diff(curve[: top + 1]) > -0.02 * curve.max())  # but for noise, up to the summit and down
    assert np.all(np.diff(curve[top:]) < 0.02 * curve.max())

    around = np.arange(sweep[top] - 64, sweep[top] + 65, 8)
    a, b, _ = np.polyfit(around - sweep[top], np.log(clarity(around)), 2)
    depth_m = float(painter.depth(eye, sharp_at(distance_m), roi=roi).mean())
    expected = (sharp_at(depth_m) - LENS.at_rest_m) / LENS.per_position_m
    assert a < 0
    assert sweep[top] - b / (2 * a) == pytest.approx(expected, abs=3)
