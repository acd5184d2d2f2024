"""A frame as a bearing: the line of sight against plain geometry, its covariance against draws of what it errs by."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Body, Pose, Target
from agent.core.estimation.track import FixedLagFilter, Held, swimming
from agent.core.ranging.camera_model import apply, camera_pose, pixel, to_camera
from agent.core.ranging.fix import Outline, OwnPose, sight_line
from tests import known_lens

BALL, BODY = Target(radius_m=0.07), Body(camera_m=(0.10, 0.02, -0.01))
CAMERA = replace(known_lens.CAMERA, bend=0.39, ahead_m=-0.0017)
THERE, GIMBAL_RAD = (1.1, 0.9, 0.25), math.radians(0.3)
EXACT = OwnPose((0.0,) * 6, (0.0,) * 6, 1.0)
T_NS = 10**18


def eye(dx=0.0, dy=0.0, dyaw=0.0, turned=(0.0, 0.0)):
    place = Pose(x_m=0.4 + dx, y_m=0.5 + dy, yaw_deg=34.0 + math.degrees(dyaw))
    pan, tilt = 2.0 + math.degrees(turned[0]), -4.0 + math.degrees(turned[1])
    return camera_pose(place, BODY, 0.3, 2.0, -3.0, pan, tilt, 0.6)


def outline(here, at=THERE, **more):
    return Outline(pixel(CAMERA, to_camera(here, at)), None, 1.0, None, **more)


def matrix(six):
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def seen(of, by, believed=THERE, own=EXACT, sized=True):
    return sight_line(CAMERA, by, of, BALL, own, GIMBAL_RAD, believed, T_NS, 1.0, sized)


def test_the_line_goes_through_the_target_and_says_nothing_along_it() -> None:
    here = eye()
    axis = np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    origin = np.array(here.position_m) + CAMERA.ahead_m * axis
    for believed in (THERE, (1.2, 1.0, 0.26), None):
        found = seen(outline(here), here, believed)
        along = (np.array(found.x_m) - origin) / np.linalg.norm(np.array(found.x_m) - origin)
        assert along == pytest.approx((THERE - origin) / np.linalg.norm(THERE - origin), abs=1e-7)
        towards = along if believed is None else (believed - origin) / np.linalg.norm(believed - origin)
        assert np.linalg.norm(matrix(found.information) @ towards) < 1e-6 * np.trace(matrix(found.information))
    at_range = np.linalg.norm(np.array(seen(outline(here), here, None).x_m) - origin)
    assert at_range == pytest.approx(1.0), "nobody knows its range"


def test_a_balls_size_says_how_far_it_is_where_it_may() -> None:
    here = eye()
    d = np.linalg.norm(np.array(to_camera(here, THERE)) - [0.0, 0.0, CAMERA.ahead_m])
    of = outline(here)._replace(radius_px=CAMERA.f_px * math.asin(0.07 / d), radius_sigma_px=0.5)
    far = (2.0, 1.8, 0.25)  # where it is believed to be does not matter then
    sized, plain = seen(of, here, far), seen(of, here, far, sized=False)
    assert sized.x_m == pytest.approx(THERE, abs=1e-4)
    assert math.dist(plain.x_m, THERE) > 0.5
    along = 1.0 / math.sqrt(np.linalg.eigvalsh(matrix(sized.information))[0])
    by_edge = 0.5 * d / (CAMERA.f_px * math.tan(math.asin(0.07 / d)))
    assert by_edge < along < 1.4 * by_edge, "the rest is the ball's own tolerance and the picture's scale"


def test_what_is_hidden_of_a_creature_widens_its_line() -> None:
    here, fish = eye(), Target(detector="creature", length_m=0.15)
    d = np.linalg.norm(np.array(to_camera(here, THERE)) - [0.0, 0.0, CAMERA.ahead_m])
    whole_px = 0.15 * CAMERA.f_px / d

    def sigma_m(shown: float, target: Target = fish) -> float:
        of = outline(here, size_px=(shown * whole_px, 0.2 * shown * whole_px))
        found = sight_line(CAMERA, here, of, target, EXACT, 0.0, THERE, T_NS, 1.0, sized=False)
        return 1.0 / math.sqrt(np.linalg.eigvalsh(matrix(found.information))[2])

    assert sigma_m(1.0) == pytest.approx(0.03 * 0.15, rel=0.06), "it bends"
    assert sigma_m(0.6) == pytest.approx(sigma_m(1.0), rel=1e-3), "aslant as well"
    assert sigma_m(0.1) == pytest.approx(0.25 * 0.15, rel=0.03), "a tail beside a stone"
    assert sigma_m(0.1, Target(detector="box")) < 0.2 * sigma_m(0.1), "of unknown length: by what shows"


def test_a_creatures_height_says_a_little_of_how_far_it_is_and_nothing_across() -> None:
    here, fish = eye(), Target(detector="creature", length_m=0.15)
    origin = np.array(here.position_m) + CAMERA.ahead_m * np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    d = float(np.linalg.norm(THERE - origin))
    high_px = 0.3 * 0.15 * CAMERA.f_px / (1.3 * d)  # it seems to be 1.3 times as far as it is
    for believed, long_px in ((THERE, 20.0), (THERE, 90.0), (None, 40.0)):  # from its head, its side
        of = outline(here, size_px=(long_px, high_px))
        found = sight_line(CAMERA, here, of, fish, EXACT, GIMBAL_RAD, believed, T_NS, 1.0)
        plain = sight_line(CAMERA, here, of, fish, EXACT, GIMBAL_RAD, believed or found.x_m, T_NS, 1.0, sized=False)
        along = (THERE - origin) / d
        assert np.array(found.x_m) - origin == pytest.approx(1.3 * d * along, rel=0.01)
        weight = matrix(found.information) - matrix(plain.information)
        assert weight == pytest.approx(np.outer(along, along) / (0.2**2 * 5 * (1.3 * d) ** 2), abs=0.05)
    same = sight_line(
        CAMERA, here, outline(here, size_px=(9.0, 9.0)), Target(detector="box"), EXACT, 0.0, THERE, T_NS, 1.0
    )
    assert abs(along @ matrix(same.information) @ along) < 1e-6, "of a box nobody knows the size"
    cut = outline(
        here, size_px=(40.0, 2.1 * min(outline(here).centre_px[1], CAMERA.height_px - outline(here).centre_px[1]))
    )
    cut = sight_line(CAMERA, here, cut, fish, EXACT, GIMBAL_RAD, THERE, T_NS, 1.0)
    assert abs(along @ matrix(cut.information) @ along) < 1e-6, "what the edge of the picture cuts off may be any size"


def test_which_side_it_shows_is_known_where_its_speed_is() -> None:
    here, fish = eye(), Target(detector="creature", length_m=0.15, speed_m_s=0.15, turn_s=2.0)
    origin = np.array(here.position_m) + CAMERA.ahead_m * np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    along = (THERE - origin) / np.linalg.norm(THERE - origin)
    ahead, aside = 0.15 * along, 0.15 * np.array([-along[1], along[0], 0.0])
    of = outline(here, size_px=(40.0, 30.0))

    def line(velocity):
        told = None if velocity is None else tuple(velocity)
        return sight_line(CAMERA, here, of, fish, EXACT, 0.0, THERE, T_NS, 1.0, velocity_m_s=told)

    widths = [np.linalg.eigvalsh(matrix(line(way).information)) for way in (None, 0.3 * aside)]
    assert (widths[0] == widths[1]).all(), "one that hardly swims may face anywhere"
    across = [np.linalg.eigvalsh(matrix(line(way).information))[2] for way in (ahead, aside)]
    assert across[0] > 4.0 * across[1], "of its side, a part is hidden; head-on it is all there"
    turned = [aside + ahead * math.tan(0.5), aside]
    a, b = (np.linalg.eigvalsh(matrix(line(way).information))[2] for way in turned)
    assert a > b, "and the more so the more it may only have turned"


def test_its_covariance_is_that_of_draws() -> None:
    """Of the robot's pose, of what stays in it, and of the gimbal; across the line, in the robot's own belief."""
    rng, sigma, stays = np.random.default_rng(3), np.array([0.004, 0.006, 0.008]), np.array([0.003, 0.002, 0.004])
    own = OwnPose(tuple(np.diag(sigma**2)[np.triu_indices(3)]), tuple(np.diag(stays**2)[np.triu_indices(3)]), 3.0)
    found = seen(outline(eye()), eye(), own=own)
    information = matrix(found.information)
    values, across = np.linalg.eigh(information)
    errors = []
    for _ in range(1500):
        pose = math.sqrt(3.0) * sigma * rng.normal(size=3) + stays * rng.normal(size=3)
        truly = eye(*pose, turned=GIMBAL_RAD * rng.normal(size=2))
        errors.append(np.array(seen(outline(truly), eye(), own=own).x_m) - THERE)
    drawn = across[:, 1:].T @ np.cov(np.array(errors).T) @ across[:, 1:]
    # What the camera's pixels and the body's level add is not drawn, and is a tenth of it.
    assert 0.75 < np.trace(drawn @ np.diag(values[1:])) / 2.0 < 1.05


@pytest.mark.parametrize(("straight", "fair"), [(True, True), (False, False)])
def test_many_frames_from_one_place_do_not_know_the_range(straight, fair) -> None:
    """straight: taken across where the target is believed to be; else across each ray, which errs."""
    rng, here, held = np.random.default_rng(5), eye(), []
    for k in range(40):
        truly = eye(turned=GIMBAL_RAD * rng.normal(size=2))
        found = seen(outline(truly), here, THERE if straight else None, sized=False)
        information = matrix(found.information)
        t_ns = T_NS + k * 50_000_000
        held.append(Held(t_ns, found.information, tuple((information @ found.x_m).tolist())))
    track = FixedLagFilter(swimming(1e-3, 2.0), (3.0, 2.0, 0.6)).run(held, held[-1].t_ns, held[-1].t_ns)
    sure_m = math.sqrt(np.linalg.eigvalsh(matrix(track.A))[-1])
    assert (sure_m > 0.25) == fair
    assert (abs(math.dist(track.x_m, THERE)) < 2.0 * sure_m) == fair
