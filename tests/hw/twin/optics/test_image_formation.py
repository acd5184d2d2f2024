"""Defocus of given pictures, against what a disk does."""

import math

import numpy as np
import pytest

from hw.twin.optics.image_formation import apparent_m, blur, circle_gain, circles, margin, vergence
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
            [circles(np.full((1, 1), s * u, np.float32), lens, v, n, 14.0, axis)[0, 0] for s in (0.9, 1.0, 1.1)]
        )
        assert radius[1] < 1e-4
        assert radius[[0, 2]].min() > 0.05
    assert apparent_m(0.45, n, 0.0) == pytest.approx(0.45 / n)


def test_largest_circle_is_a_bound():
    assert circles(np.full((1, 1), 0.01, np.float32), LENS, LENS.at_rest_m, 1.333, 14.0, (0, 0)) == 14.0
