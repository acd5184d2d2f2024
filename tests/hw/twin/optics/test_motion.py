"""Motion blur: an edge is smeared by as far as it moved, about where it was in the middle; what rests is as before."""

import math

import numpy as np
import pytest

from agent.core.config import Tag
from hw.twin.optics.image_formation import MOST, PART_PX, parts_of
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, Moment
from hw.twin.scene import Scene
from hw.twin.truth import surveyed_tag
from tests.hw.twin.optics.test_tags import FLEET, LENS, N, look, pixels, sharp_at

TAG = surveyed_tag(Tag(id=3, face="x1", position_m=(3.0, 1.0, 0.25)), 0.08)
AHEAD = look(np.array([2.55, 1.0, 0.25]), TAG.position_m)
V = sharp_at(0.45)
FOCAL_PX = N * V / LENS.pixel_m


def turned(share, angle_rad):
    """The camera ahead, yawed to the left by a share of an angle."""
    c, s = math.cos(share * angle_rad), math.sin(share * angle_rad)
    return AHEAD._replace(rotation=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ AHEAD.rotation)


@pytest.fixture(scope="module")
def painter():
    painter = Painter(Scene(name="bare"), FLEET.tank, N, LENS, 0, "r1")
    painter.prepare()
    return painter


def test_the_exposure_is_drawn_in_as_many_parts_as_its_motion_needs():
    def turn(angle_rad):
        return parts_of(lambda share: Moment(turned(share, angle_rad)), FOCAL_PX, 0.45)

    def way(metres):
        def shifted(share):
            return Moment(Eye(AHEAD.position_m + np.array((0, share * metres, 0)), AHEAD.rotation))

        return parts_of(shifted, FOCAL_PX, 0.45)

    def other(metres):
        def passing(share):
            return Moment(AHEAD, hulls=(Hull((2.0, 1.0 + share * metres, 0.25), np.eye(3)),))

        return parts_of(passing, FOCAL_PX, 0.45)

    assert turn(0.0) == way(0.0) == other(0.0) == 1
    assert turn(0.9 * PART_PX / FOCAL_PX) == 1
    assert turn(6.1 / FOCAL_PX) == 5
    assert turn(math.radians(3.0)) == MOST
    assert way(4.1 / FOCAL_PX * 0.45) == 3
    assert other(4.1 / FOCAL_PX * 0.41) == 3


def test_what_rests_keeps_its_bytes(painter):
    roi = (200, 150, 120, 90)
    moment = Moment(AHEAD, tags=(TAG,))
    still = painter.expose(moment, V, roi, 7)
    slowly = painter.expose(moment, V, roi, 7, lambda share: Moment(turned(share, 0.5 / FOCAL_PX), tags=(TAG,)))
    assert np.array_equal(still, slowly)


def test_an_edge_is_smeared_by_what_it_moved_about_its_middle(painter):
    """The black edge on the tag's right, in the middle of the picture's height."""
    moved_px = 9.0
    ((x, y),) = pixels(TAG.position_m + np.array([[0.0, -0.04, 0.0]]), AHEAD, V)
    roi = (round(x) - 20, round(y) - 30, 40, 60)

    def profile(during):
        image = painter.expose(Moment(AHEAD, tags=(TAG,)), V, roi, 0, during)
        return ((image[..., 1] / 255.0) ** 2.2).mean(0)

    still = profile(None)
    smeared = profile(lambda share: Moment(turned(share, moved_px / FOCAL_PX), tags=(TAG,)))
    middles, widths = [], []
    for light in (still, smeared):
        rise = light[1:] - light[:-1]
        rise[abs(np.arange(39) - 19.5) > 7] = 0
        columns = np.arange(39) + 0.5
        middles.append(np.sum(rise * columns) / rise.sum())
        widths.append(np.sum(rise * (columns - middles[-1]) ** 2) / rise.sum())
    assert middles[1] == pytest.approx(middles[0], abs=0.15)
    parts = math.ceil(moved_px / PART_PX)
    expected = moved_px**2 / 12 * (1 - 1 / parts**2)  # variance of `parts` equal steps over the way
    assert widths[1] - widths[0] == pytest.approx(expected, rel=0.15)
