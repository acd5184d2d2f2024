"""Defocus of given pictures, against what a disk does."""

import math

import numpy as np
import pytest

from hw.twin.optics.image_formation import (
    ROUND,
    apparent_m,
    blur,
    circle_gain,
    circles,
    margin,
    stretched,
    vergence,
)
from hw.twin.optics.lens import draw_lens
from hw.twin.scene import generator

LENS = draw_lens("imx519_640", generator(0, "r1", "lens"))
SIDE = 112


def spot(radius_px, y=SIDE // 2, x=SIDE // 2):
    """What one bright pixel becomes under a uniform circle."""
    picture = np.zeros((SIDE, SIDE, 3), np.float32)
    picture[y, x] = 1
    return blur(picture, np.full((SIDE, SIDE), radius_px, np.float32))[..., 0].astype(float)


def phases(radius_px):
    """The spot averaged over its places relative to the coarse grid, centred."""
    middle = SIDE // 2
    shifts = [(dy, dx) for dy in range(4) for dx in range(4)]
    return sum(np.roll(spot(radius_px, middle + dy, middle + dx), (-dy, -dx), (0, 1)) for dy, dx in shifts) / 16


@pytest.mark.parametrize("radius_px", [0.0, 0.2, 0.4, 0.7, 1.0, 1.7, 2.4, 3.0, 4.5, 7.0, 10.0, 13.5])
def test_energy_is_kept_and_the_second_moment_is_a_disk_s(radius_px):
    w = phases(radius_px)
    assert w.sum() == pytest.approx(1, abs=2e-3)
    offset = np.arange(SIDE) - SIDE // 2
    assert (w.sum(0) * offset).sum() == pytest.approx(0, abs=1e-3)
    assert (w.sum(0) * offset**2).sum() == pytest.approx(radius_px**2 / 4, rel=0.04, abs=1e-4)


def test_no_circle_no_change():
    picture = np.random.default_rng(0).random((48, 64, 3), dtype=np.float32)
    assert np.array_equal(blur(picture, np.zeros((48, 64), np.float32)), picture)


@pytest.mark.parametrize("radius_px", [2.4, 5.0, 8.0, 12.0])
def test_a_point_becomes_a_disk_of_the_circle_s_area(radius_px):
    """(sum w)^2 / sum w^2 is the area of a spot with a sharp edge, a little more with the soft edge of pixels."""
    w = phases(radius_px)
    assert 1.0 <= w.sum() ** 2 / (w**2).sum() / (math.pi * radius_px**2) < 1.16


def test_a_slowly_growing_circle_has_no_seam():
    """Where full sums hand over to half resolution a plain ramp must stay a ramp."""
    ramp = np.repeat(np.linspace(0, 1, 160, dtype=np.float32)[None, :, None], 96, 0).repeat(3, 2)
    radius = np.broadcast_to(np.linspace(0, 12, 160, dtype=np.float32), (96, 160)).copy()
    rim = margin(12.0)
    error = (blur(ramp, radius) - ramp)[rim:-rim, rim:-rim]
    assert abs(error).max() < 1e-3


def test_a_plain_picture_stays_plain_next_to_a_step_of_the_circle():
    radius = np.zeros((96, 96), np.float32)
    radius[:, 48:] = 9
    out = blur(np.full((96, 96, 3), 0.5, np.float32), radius)
    assert abs(out - 0.5).max() < 1e-4


def test_circle_is_the_thin_lens_one():
    """The bundle of width A from the image point v' leaves a disk A |v - v'| / v' on the sensor at v (ray diagram)."""
    v = LENS.at_position_m(300)
    for s in (0.15, 0.3, 0.6, 2.0):
        sharp_at = 1 / (1 / LENS.focal_m - 1 / s)
        diagram_px = LENS.aperture_m * abs(v - sharp_at) / sharp_at / LENS.pixel_m
        assert 2 * circle_gain(LENS, v) * abs(vergence(LENS, v) - 1 / s) == pytest.approx(diagram_px, rel=1e-9)


@pytest.mark.parametrize("gap_m", [0.0, 5e-3])
def test_sharp_exactly_where_the_vergences_meet(gap_m):
    lens, n = LENS._replace(port_gap_m=gap_m), 1.333
    for u in (0.2, 0.45, 1.2):
        v = lens.image_m(1 / apparent_m(u, n, gap_m))
        axis = round(lens.centre_px[0]), round(lens.centre_px[1])
        radius = np.array(
            [circles(np.full((1, 1), s * u, np.float32), lens, v, n, 14.0, axis).radius[0, 0] for s in (0.9, 1.0, 1.1)]
        )
        assert radius[1] < 1e-4
        assert radius[[0, 2]].min() > 0.05
    assert apparent_m(0.45, n, 0.0) == pytest.approx(0.45 / n)


def test_largest_circle_is_a_bound():
    found = circles(np.full((1, 1), 0.01, np.float32), LENS, LENS.at_rest_m, 1.333, 14.0, (0, 0))
    assert found.radius == pytest.approx(14.0)


def ellipse(away_px, around_px, towards_rad):
    """Radius and stretch of an ellipse with a half axis of `away_px` in a direction."""
    more = (away_px**2 - around_px**2) / 8
    stretch = more * np.cos(2 * towards_rad), more * np.sin(2 * towards_rad)
    return math.sqrt((away_px**2 + around_px**2) / 2), np.array(stretch, np.float32)


@pytest.mark.parametrize("away_px, around_px", [(1.3, 1.0), (0.2, 0.6), (3.0, 2.6), (5.4, 5.0), (10.5, 10.0)])
@pytest.mark.parametrize("towards_deg", [0.0, 30.0, 90.0, 155.0])
def test_a_point_becomes_an_ellipse_of_these_half_axes(away_px, around_px, towards_deg):
    radius_px, stretch = ellipse(away_px, around_px, math.radians(towards_deg))
    blurred = np.repeat(phases(radius_px)[..., None], 3, 2).astype(np.float32)
    out = np.empty((SIDE - 8, SIDE - 8, 3), np.float32)
    everywhere = np.full((SIDE, SIDE), radius_px, np.float32), np.broadcast_to(stretch, (SIDE, SIDE, 2)).copy()
    stretched(blurred, *everywhere, 4, 4, out)
    w, offset = out[..., 0].astype(float), np.arange(SIDE - 8) - (SIDE // 2 - 4)
    assert w.sum() == pytest.approx(1, abs=2e-3)
    askew = offset @ w @ offset
    covariance = np.array([[(w.sum(0) * offset**2).sum(), askew], [askew, (w.sum(1) * offset**2).sum()]])
    direction = np.array([math.cos(math.radians(towards_deg)), math.sin(math.radians(towards_deg))])
    along, across = direction @ covariance @ direction, np.array([-1, 1]) * direction[::-1]
    assert along - across @ covariance @ across == pytest.approx((away_px**2 - around_px**2) / 4, rel=0.03)
    assert np.trace(covariance) == pytest.approx(radius_px**2 / 2, rel=0.04)


def test_a_window_makes_rays_within_the_plane_of_incidence_meet_nearer():
    """Coddington's equations for a flat surface, by lengths along rays: both images of a point beside the axis."""
    lens, n, u = LENS._replace(port_gap_m=5e-3, k1=0.0, k2=0.0), 1.333, 0.4
    corner = round(lens.centre_px[0]) + 250, round(lens.centre_px[1])
    v, depth = lens.image_m(1 / apparent_m(u, n, 5e-3)), np.full((1, 1), u, np.float32)
    radius, stretch = (each[0, 0] for each in circles(depth, lens, v, n, 14.0, corner))
    air = math.atan((corner[0] - lens.centre_px[0]) * lens.pixel_m / v)
    water = math.asin(math.sin(air) / n)
    ray_m = (u - 5e-3) / math.cos(water)  # in water
    images_m = [5e-3 + math.cos(air) * ray_m / n * k for k in (1.0, (math.cos(air) / math.cos(water)) ** 2)]
    around, away = (circle_gain(lens, v) * (vergence(lens, v) - 1 / z_m) for z_m in images_m)
    expected = ellipse(away, around, math.atan2(corner[1] - lens.centre_px[1], corner[0] - lens.centre_px[0]))
    assert radius == pytest.approx(expected[0], rel=1e-3)
    assert stretch == pytest.approx(expected[1], rel=5e-3, abs=1e-4)
    assert stretch[0] > ROUND
