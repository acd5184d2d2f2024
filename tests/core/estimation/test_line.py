"""Lines that matrices of rank 2 leave, and what the tank says of the way along them."""

import math

import numpy as np
import pytest

from agent.core.estimation.track import chord, line, placed
from agent.core.linear_algebra import apply, inverse, upper
from agent.core.target_state import bearing

TANK_M = (3.0, 2.0, 0.5)


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def seen(origin_m, direction, range_m=0.8, **keywords):
    """(Lam, eta)"""
    one = bearing(origin_m, direction, range_m, 0.003, 0, **keywords)
    return one.information, apply(one.information, one.x_m)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.3, -0.8, 0.1), (0.0, 0.05, 1.0), (-1.0, 2.0, -0.5)])
def test_a_bearing_knows_what_is_across_and_nothing_along(direction) -> None:
    pose_m2 = (4e-6, 1e-6, 0.0, 9e-6, 0.0, 1e-6)
    origin, n = np.array((0.5, 0.4, 0.2)), np.array(direction) / np.linalg.norm(direction)
    information, vector = seen(tuple(origin), direction, pose_m2=pose_m2)
    E = np.linalg.svd(n[None])[2][1:].T  # other unit vectors than the code's
    V = (0.003 * 0.8) ** 2 * np.eye(2) + E.T @ full(pose_m2) @ E
    np.testing.assert_allclose(full(information), E @ np.linalg.inv(V) @ E.T, atol=1e-9 * information[0])
    assert inverse(information) is None
    of = line(information, vector)
    assert abs(np.dot(of.along, n)) == pytest.approx(1.0, abs=1e-12)
    assert np.cross(np.array(of.foot_m) - origin, n) == pytest.approx(0, abs=1e-9)
    with_range, _ = seen(tuple(origin), direction, pose_m2=pose_m2, range_sigma_m=0.1)
    along = np.outer(n, n)
    of_a_place = (0.003 * 0.8) ** 2 * (np.eye(3) - along) + 0.01 * along + full(pose_m2)
    np.testing.assert_allclose(full(with_range), np.linalg.inv(of_a_place), rtol=1e-7, atol=1e-6 * information[0])


def test_the_direction_of_a_bearing_without_range_is_the_believed_one_if_that_is_near() -> None:
    for way, believed, expected in (
        ((1.0, 0.01, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((1.0, 1.0, 0.0), (0.5, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0)),
    ):
        information, vector = seen((0.5, 0.4, 0.2), way, believed=believed)
        assert line(information, vector).along == pytest.approx(expected, abs=1e-9)
        placed, _ = seen((0.5, 0.4, 0.2), way, believed=believed, range_sigma_m=0.1)
        np.testing.assert_allclose(full(placed) @ way, 100.0 * np.array(way), atol=1e-6 * information[0])


def test_what_is_less_or_more_than_a_line_is_none() -> None:
    information, vector = seen((0.5, 0.4, 0.2), (1.0, 0.2, 0.0))
    x, y, z = vector
    assert line(information, (x + 0.1, y + 0.02, z)) is None  # it claims to know how far along
    assert line((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) is None  # a plane
    with pytest.raises(ValueError, match="a direction and a range"):
        bearing((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.003, 0)


def test_the_chord_is_where_the_line_is_in_the_box() -> None:
    information, vector = seen((0.5, 0.5, 0.2), (1.0, 1.0, 0.0))
    of = line(information, vector)
    ends = chord(of, (0.0, 0.0, 0.0), TANK_M)
    points = [np.array(of.foot_m) + s * np.array(of.along) for s in ends]
    np.testing.assert_allclose(sorted(map(tuple, points)), [(0.0, 0.0, 0.2), (2.0, 2.0, 0.2)], atol=1e-9)
    assert chord(of, (0.0, 1.5, 0.0), (1.0, 2.0, 0.5)) is None
    assert chord(of, (0.0, 0.0, 0.3), TANK_M) is None


def test_a_first_bearing_is_placed_on_the_middle_of_its_chord() -> None:
    information, vector = placed(*seen((0.5, 1.0, 0.2), (1.0, 0.0, 0.0)), TANK_M)
    covariance = inverse(information)
    assert apply(covariance, vector) == pytest.approx((1.5, 1.0, 0.2), abs=1e-6)
    assert covariance[0] == pytest.approx(3.0**2 / 12)
    assert covariance[3] == pytest.approx(0.0024**2)
    outside = placed(*seen((0.5, 2.1, 0.2), (1.0, 0.0, 0.0)), TANK_M)  # by a tenth of a metre
    assert apply(inverse(outside[0]), outside[1]) == pytest.approx((1.5, 2.1, 0.2), abs=1e-6)


def test_two_bearings_that_are_nearly_one_are_placed_in_the_tank() -> None:
    (a, x), (b, y) = seen((0.5, 1.0, 0.2), (1.0, 0.0, 0.0)), seen((0.5, 1.0, 0.2), (1.0, 1e-5, 0.0))
    both = upper(full(a) + full(b))
    information, vector = placed(both, tuple(p + q for p, q in zip(x, y, strict=True)), TANK_M)
    covariance = inverse(information)
    assert covariance[0] == pytest.approx(3.0**2 / 12, rel=1e-3)
    assert apply(covariance, vector)[1:] == pytest.approx((1.0, 0.2), abs=1e-4)
