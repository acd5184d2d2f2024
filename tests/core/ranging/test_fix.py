"""A measurement's place in the world, and its covariance against draws of every error that it counts."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.attitude import DEPTH_NOISE_M, LEVEL_NOISE_RAD
from agent.core.config import CAREFUL, Body, Pose, Target
from agent.core.estimation.track import FixedLagFilter, Held, swimming
from agent.core.ranging import fix
from agent.core.ranging.camera_model import (
    Calibration,
    CameraFit,
    Eye,
    FocusFit,
    apply,
    at_lens_position,
    camera_pose,
    centre_behind_skin_m,
    pixel,
    to_camera,
    to_world,
)
from agent.core.ranging.fix import (
    TAU_OF_GAP,
    TAU_S,
    Fix,
    NoRange,
    Outline,
    OwnPose,
    Range,
    carried,
    distance,
    focus_range,
    fuse,
    kappa,
    locate,
    longest_gap_s,
    sight_line,
    size_range,
)
from agent.core.ranging.focus import UNKNOWN_SAG, as_on_axis, lens_position, share_at
from tests import known_lens

BALL = Target(radius_m=0.07, radius_sigma_m=0.0003)
FOCUS = replace(known_lens.FITTED, noise=0.7)
CAMERA = replace(
    known_lens.CAMERA,
    bend=0.39,
    ahead_m=-0.0017,
    lens=300.0,
    breathing=4.2e-5,
    scale_covariance=(4e-8, -2.5e-8, 4e-8),
    noise_px=0.3,
    noise_deg=0.05,
)
KNOWN = Calibration(robot="r1", made="", source="", focus=FOCUS, camera=CAMERA)
DRAWS = 1_000


def eye(pan=12.0, tilt=-7.0, pose=(0.3, 0.25, 34.0)):
    x, y, yaw = pose
    place = Pose(x_m=x, y_m=y, yaw_deg=yaw)
    return camera_pose(place, Body(camera_m=(0.10, 0.02, -0.01)), 0.4, 2.0, -3.0, pan, tilt, 0.5)


def seen(here: Eye, d: float, off: tuple[float, float]) -> tuple[Outline, float, np.ndarray]:
    """Outline, peak and true place of a ball `d` from where rays meet, at slopes `off` from the axis."""
    m = np.array([*off, 1.0]) / math.sqrt(off[0] ** 2 + off[1] ** 2 + 1.0)
    in_camera = d * m + [0.0, 0.0, CAMERA.ahead_m]
    skin = d
    for _ in range(30):
        skin = d - centre_behind_skin_m(skin, BALL.radius_m)
    rho = lens_position(FOCUS, as_on_axis(skin * m[2] + CAMERA.ahead_m, share_at(CAMERA, m[2])))
    reported = round(rho)
    camera = at_lens_position(CAMERA, reported)
    radius_px = camera.f_px * math.asin(BALL.radius_m / d)
    outline = Outline(pixel(camera, tuple(in_camera)), radius_px, 1.0, reported)
    return outline, rho, np.array(here.position_m) + np.array(here.rotation) @ in_camera


@pytest.mark.parametrize("cue", ["focus", "size", "both"])
@pytest.mark.parametrize(("d", "off"), [(0.3, (0.0, 0.0)), (0.55, (0.1, -0.06)), (1.2, (-0.2, 0.1))])
def test_every_cue_returns_to_the_point(cue, d, off):
    here = eye()
    outline, rho, truth = seen(here, d, off)
    assert locate(KNOWN, here, outline, rho, 0.3, BALL, cue).position_m == pytest.approx(tuple(truth), abs=1e-9)
    assert to_camera(here, tuple(truth))[2] > 0.2


def matrix(six):
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def root(covariance):
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def turn(axis, rad):
    """Rotation about a unit vector."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(rad) * k + (1 - math.cos(rad)) * k @ k


def turned(here: Eye, rotation, about) -> Eye:
    about = np.array(about)
    place = about + rotation @ (np.array(here.position_m) - about)
    return Eye(tuple(place), tuple(map(tuple, rotation @ np.array(here.rotation))), here.body_m)


def drawn(seed, errors):
    """(DRAWS, errors) of standard deviation one, whose own covariance is not another by chance: what is linear in them,
    nearly all here, then has its covariance exactly."""
    found = np.random.default_rng(seed).normal(0, 1, (DRAWS, errors))
    found -= found.mean(axis=0)
    return found @ np.linalg.inv(np.linalg.cholesky(np.cov(found.T))).T


def agree(ours, draws):
    """Every variance, and every covariance that matters, to 2 percent."""
    found = np.cov(draws.T)
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        off = abs(ours[i, j] - found[i, j])
        assert off <= 0.02 * (abs(found[i, j]) if abs(found[i, j]) > 0.4 * scale[i, j] else scale[i, j]), (i, j)


CASES = [("focus", 0.35, (0.0, 0.0)), ("size", 0.5, (0.12, -0.1)), ("both", 0.3, (0.05, 0.05))]


@pytest.mark.parametrize(("cue", "d", "off"), CASES)
def test_random_covariance_is_that_of_draws(cue, d, off):
    here = eye()
    outline, rho, _ = seen(here, d, off)
    ours = locate(KNOWN, here, outline, rho, 1.1, BALL, cue)
    s_px = math.hypot(CAMERA.noise_px, fix.CENTRE_NOISE_PX)
    gimbal, right, down = math.radians(CAMERA.noise_deg), *np.array(here.rotation).T[:2]
    places = []
    for e in drawn(1, 9):
        level = turn((1, 0, 0), LEVEL_NOISE_RAD * e[6]) @ turn((0, 1, 0), LEVEL_NOISE_RAD * e[7])
        there = turned(here, level, here.body_m)
        there = turned(there, turn(right, gimbal * e[0]) @ turn(down, gimbal * e[1]), there.position_m)
        there = there._replace(position_m=tuple(np.add(there.position_m, (0.0, 0.0, DEPTH_NOISE_M * e[8]))))
        u, v = outline.centre_px
        look = outline._replace(
            centre_px=(u + s_px * e[2], v + s_px * e[3]), radius_px=outline.radius_px + fix.EDGE_NOISE_PX * e[4]
        )
        places.append(fixed_weights(there, look, rho + 1.1 * e[5], cue, ours))
    agree(matrix(ours.random_m2), np.array(places))


@pytest.mark.parametrize(("cue", "d", "off"), CASES)
def test_systematic_covariance_is_that_of_draws(cue, d, off):
    here = eye()
    outline, rho, _ = seen(here, d, off)
    ours = locate(KNOWN, here, outline, rho, 1.1, BALL, cue)
    of_focus, (ff, fa, aa) = root(matrix(FOCUS.covariance)), CAMERA.scale_covariance
    of_scale = root(np.array([[ff, fa], [fa, aa]]))
    look_up = math.asin(here.rotation[2][2])
    lens_sigma = FOCUS.width * math.hypot(UNKNOWN_SAG * math.sin(look_up), fix.WARMTH)
    angles = np.radians([CAREFUL.attitude_deg, CAREFUL.attitude_deg, CAREFUL.heading_deg])
    place = np.array([CAREFUL.place_m, CAREFUL.place_m, CAREFUL.height_m])
    places = []
    for e in drawn(2, 14):
        rotation = turn((1, 0, 0), angles[0] * e[0]) @ turn((0, 1, 0), angles[1] * e[1])
        there = turned(here, rotation @ turn((0, 0, 1), angles[2] * e[2]), here.body_m)
        there = there._replace(position_m=tuple(np.array(there.position_m) + place * e[3:6]))
        a, b, c = of_focus @ e[6:9]
        focus = replace(FOCUS, u_inf_m=FOCUS.u_inf_m + a, b_m=FOCUS.b_m + b, rho0=FOCUS.rho0 + c)
        grown, ahead = of_scale @ e[9:11]
        camera = replace(CAMERA, f_px=CAMERA.f_px * (1 + grown), ahead_m=CAMERA.ahead_m + ahead)
        look = outline._replace(radius_px=outline.radius_px + fix.EDGE_BIAS_PX * e[12])
        known = replace(KNOWN, focus=focus, camera=camera)
        places.append(fixed_weights(there, look, rho + lens_sigma * e[13], cue, ours, known))
    agree(matrix(ours.systematic_m2), np.array(places))


def fixed_weights(here, outline, rho, cue, ours: Fix, known=KNOWN, ball=BALL):
    """The place from both cues with the weights that they had without the error."""
    if cue != "both":
        return locate(known, here, outline, rho, 1.1, ball, cue).position_m
    focus, size = (np.array(locate(known, here, outline, rho, 1.1, ball, c).position_m) for c in ("focus", "size"))
    return ours.focus_share * focus + (1 - ours.focus_share) * size


def test_beyond_the_pole_only_the_size_tells():
    outline, _, truth = seen(eye(), 0.6, (0.0, 0.0))
    for cue in ("focus", "both"):
        refused = locate(KNOWN, eye(), outline, 90.0, 0.3, BALL, cue)
        assert isinstance(refused, NoRange) and "beyond" in refused.reason
    assert locate(KNOWN, eye(), outline, 90.0, 0.3, BALL, "size").position_m == pytest.approx(tuple(truth))


def test_a_robot_that_swims_puts_its_own_pose_in_place_of_the_survey():
    here, xx, rad = eye(), CAREFUL.place_m**2, math.radians(CAREFUL.heading_deg) ** 2
    outline, rho, _ = seen(here, 0.5, (0.1, 0.05))
    survey, none = (xx, 0.0, 0.0, xx, 0.0, rad), (0.0,) * 6
    moored, as_moored, swims = (
        locate(KNOWN, here, outline, rho, 1.1, BALL, "both", own)
        for own in (None, OwnPose(none, survey, 3.0), OwnPose(survey, none, 3.0))
    )
    assert as_moored.systematic_m2 == pytest.approx(moored.systematic_m2) and as_moored.random_m2 == moored.random_m2
    lost = np.subtract(moored.systematic_m2, swims.systematic_m2)
    assert np.subtract(swims.random_m2, moored.random_m2) == pytest.approx(3.0 * lost)  # kappa times as much


# --- own pose ---
# An uncertain pose in what is said of a target: derivatives by differences, kappa by the sum whose limit it is.

P = (4e-6, 1e-6, 2e-6, 9e-6, -3e-6, 2.5e-5)


def full(symmetric):
    xx, xy, xz, yy, yz, zz = symmetric
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def target(pose):
    """Where a robot at (x, y, psi) would say that a thing is which its camera has at the same place."""
    x, y, psi = map(float, pose)
    at = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
    eye = camera_pose(at, Body(camera_m=(0.1, 0.02, -0.01)), 0.3, 1.5, -2.0, 20.0, -15.0, 0.6)
    return np.array(to_world(eye, (0.05, 0.10, 0.70)))


def test_an_uncertain_pose_is_carried_to_the_target() -> None:
    pose, h = np.array([0.6, 0.8, 0.7]), 1e-6
    J = np.stack([(target(pose + d) - target(pose - d)) / (2 * h) for d in h * np.eye(3)], axis=1)
    arm = tuple((target(pose) - [0.6, 0.8, 0.3]).tolist())
    np.testing.assert_allclose(full(carried(arm, P)), J @ full(P) @ J.T, atol=1e-13)


@pytest.mark.parametrize("dt_s", [0.2, 1.0, 3.0])
def test_kappa_is_what_n_samples_lose_by_being_alike(dt_s) -> None:
    """The variance of the mean of n AR(1) samples, summed up, against its closed form."""
    gap_s = 2.0
    phi, worse = math.exp(-dt_s / (TAU_S + TAU_OF_GAP * gap_s)), kappa(dt_s, gap_s)
    for n in (1, 7, 60):
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        summed = np.sum(phi**lag) / n  # n Var(mean) / P
        assert summed == pytest.approx(worse - 2.0 * phi * (1.0 - phi**n) / (n * (1.0 - phi) ** 2))
        assert summed <= worse
    assert summed > 0.85 * worse


def test_samples_far_apart_are_independent_and_gaps_make_them_alike() -> None:
    assert kappa(60.0, 0.2) == pytest.approx(1.0)
    assert kappa(1.0, 4.0) > kappa(1.0, 0.2) > 1.0


def test_gaps_are_those_of_the_last_seconds() -> None:
    s = 1_000_000_000
    assert longest_gap_s([], 100 * s) == pytest.approx(10.0)
    assert longest_gap_s([80 * s, 93 * s, 94 * s, 98 * s], 100 * s) == pytest.approx(4.0)
    assert longest_gap_s([91 * s, 92 * s, 93 * s, 94 * s, 95 * s], 100 * s) == pytest.approx(5.0)


# --- sight line ---
# A frame as a bearing: the line of sight against plain geometry, its covariance against draws of what it errs by.

SIGHT_LINE_BALL, BODY = Target(radius_m=0.07), Body(camera_m=(0.10, 0.02, -0.01))
SIGHT_LINE_CAMERA = replace(known_lens.CAMERA, bend=0.39, ahead_m=-0.0017)
THERE, GIMBAL_RAD = (1.1, 0.9, 0.25), math.radians(0.3)
EXACT = OwnPose((0.0,) * 6, (0.0,) * 6, 1.0)
T_NS, TANK_M = 10**18, (2.0, 1.5, 0.6)


def sight_line_eye(dx=0.0, dy=0.0, dyaw=0.0, turned=(0.0, 0.0)):
    place = Pose(x_m=0.4 + dx, y_m=0.5 + dy, yaw_deg=34.0 + math.degrees(dyaw))
    pan, tilt = 2.0 + math.degrees(turned[0]), -4.0 + math.degrees(turned[1])
    return camera_pose(place, BODY, 0.3, 2.0, -3.0, pan, tilt, 0.6)


def outline(here, at=THERE, **more):
    return Outline(pixel(SIGHT_LINE_CAMERA, to_camera(here, at)), None, 1.0, None, **more)


def sight_line_seen(of, by, believed=THERE, own=EXACT, sized=True):
    return sight_line(SIGHT_LINE_CAMERA, by, of, SIGHT_LINE_BALL, own, GIMBAL_RAD, believed, T_NS, TANK_M, sized)


def test_the_line_goes_through_the_target_and_says_nothing_along_it() -> None:
    here = sight_line_eye()
    axis = np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    origin = np.array(here.position_m) + SIGHT_LINE_CAMERA.ahead_m * axis
    for believed in (THERE, (1.2, 1.0, 0.26), None):
        found = sight_line_seen(outline(here), here, believed)
        along = (np.array(found.x_m) - origin) / np.linalg.norm(np.array(found.x_m) - origin)
        assert along == pytest.approx((THERE - origin) / np.linalg.norm(THERE - origin), abs=1e-7)
        towards = along if believed is None else (believed - origin) / np.linalg.norm(believed - origin)
        assert np.linalg.norm(matrix(found.information) @ towards) < 1e-6 * np.trace(matrix(found.information))
    at_range = np.linalg.norm(np.array(sight_line_seen(outline(here), here, None).x_m) - origin)
    assert at_range == pytest.approx(1.0), "nobody knows its range"


def test_a_balls_size_says_how_far_it_is_where_it_may() -> None:
    here = sight_line_eye()
    d = np.linalg.norm(np.array(to_camera(here, THERE)) - [0.0, 0.0, SIGHT_LINE_CAMERA.ahead_m])
    of = outline(here)._replace(radius_px=SIGHT_LINE_CAMERA.f_px * math.asin(0.07 / d), radius_sigma_px=0.5)
    far = (2.0, 1.8, 0.25)  # where it is believed to be does not matter then
    sized, plain = sight_line_seen(of, here, far), sight_line_seen(of, here, far, sized=False)
    assert sized.x_m == pytest.approx(THERE, abs=1e-4)
    assert math.dist(plain.x_m, THERE) > 0.5
    along = 1.0 / math.sqrt(np.linalg.eigvalsh(matrix(sized.information))[0])
    by_edge = 0.5 * d / (SIGHT_LINE_CAMERA.f_px * math.tan(math.asin(0.07 / d)))
    assert by_edge < along < 1.4 * by_edge, "the rest is the ball's own tolerance and the picture's scale"


def test_what_is_hidden_of_a_creature_widens_its_line() -> None:
    here, fish = sight_line_eye(), Target(detector="creature", length_m=0.15)
    d = np.linalg.norm(np.array(to_camera(here, THERE)) - [0.0, 0.0, SIGHT_LINE_CAMERA.ahead_m])
    whole_px = 0.15 * SIGHT_LINE_CAMERA.f_px / d

    def sigma_m(shown: float, target: Target = fish) -> float:
        of = outline(here, size_px=(shown * whole_px, 0.2 * shown * whole_px))
        found = sight_line(SIGHT_LINE_CAMERA, here, of, target, EXACT, 0.0, THERE, T_NS, TANK_M, sized=False)
        return 1.0 / math.sqrt(np.linalg.eigvalsh(matrix(found.information))[2])

    assert sigma_m(1.0) == pytest.approx(0.03 * 0.15, rel=0.06), "it bends"
    assert sigma_m(0.6) == pytest.approx(sigma_m(1.0), rel=1e-3), "aslant as well"
    assert sigma_m(0.1) == pytest.approx(0.25 * 0.15, rel=0.03), "a tail beside a stone"
    assert sigma_m(0.1, Target(detector="box")) < 0.2 * sigma_m(0.1), "of unknown length: by what shows"


def test_a_creatures_height_says_a_little_of_how_far_it_is_and_nothing_across() -> None:
    here, fish = sight_line_eye(), Target(detector="creature", length_m=0.15)
    origin = np.array(here.position_m) + SIGHT_LINE_CAMERA.ahead_m * np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    d = float(np.linalg.norm(THERE - origin))
    high_px = 0.3 * 0.15 * SIGHT_LINE_CAMERA.f_px / (1.3 * d)  # it seems to be 1.3 times as far as it is
    for believed, long_px in ((THERE, 20.0), (THERE, 90.0), (None, 40.0)):  # from its head, its side
        of = outline(here, size_px=(long_px, high_px))
        found = sight_line(SIGHT_LINE_CAMERA, here, of, fish, EXACT, GIMBAL_RAD, believed, T_NS, TANK_M)
        plain = sight_line(
            SIGHT_LINE_CAMERA, here, of, fish, EXACT, GIMBAL_RAD, believed or found.x_m, T_NS, TANK_M, sized=False
        )
        along = (THERE - origin) / d
        assert np.array(found.x_m) - origin == pytest.approx(1.3 * d * along, rel=0.01)
        weight = matrix(found.information) - matrix(plain.information)
        assert weight == pytest.approx(np.outer(along, along) / (0.3**2 * 10 * (1.3 * d) ** 2), abs=0.05)
    low = outline(here, size_px=(20.0, 0.25 * high_px))  # a fin is all that is found of it
    found = sight_line(SIGHT_LINE_CAMERA, here, low, fish, EXACT, GIMBAL_RAD, None, T_NS, TANK_M)
    assert np.array(found.x_m) - origin == pytest.approx(1.2 * along, rel=0.01), "no target is found farther than that"
    small_m = (1.2, 1.0, 0.6)
    found = sight_line(SIGHT_LINE_CAMERA, here, low, fish, EXACT, GIMBAL_RAD, None, T_NS, small_m)
    plain = sight_line(SIGHT_LINE_CAMERA, here, low, fish, EXACT, GIMBAL_RAD, None, T_NS, small_m, sized=False)
    assert found == plain, "a range that leads out of the tank says nothing; the way across does"
    same = sight_line(
        SIGHT_LINE_CAMERA,
        here,
        outline(here, size_px=(9.0, 9.0)),
        Target(detector="box"),
        EXACT,
        0.0,
        THERE,
        T_NS,
        TANK_M,
    )
    assert abs(along @ matrix(same.information) @ along) < 1e-6, "of a box nobody knows the size"
    cut = outline(
        here,
        size_px=(40.0, 2.1 * min(outline(here).centre_px[1], SIGHT_LINE_CAMERA.height_px - outline(here).centre_px[1])),
    )
    cut = sight_line(SIGHT_LINE_CAMERA, here, cut, fish, EXACT, GIMBAL_RAD, THERE, T_NS, TANK_M)
    assert abs(along @ matrix(cut.information) @ along) < 1e-6, "what the edge of the picture cuts off may be any size"


def test_which_side_it_shows_is_known_where_its_speed_is() -> None:
    here, fish = sight_line_eye(), Target(detector="creature", length_m=0.15, speed_m_s=0.15, turn_s=2.0)
    origin = np.array(here.position_m) + SIGHT_LINE_CAMERA.ahead_m * np.array(apply(here.rotation, (0.0, 0.0, 1.0)))
    along = (THERE - origin) / np.linalg.norm(THERE - origin)
    ahead, aside = 0.15 * along, 0.15 * np.array([-along[1], along[0], 0.0])
    of = outline(here, size_px=(40.0, 30.0))

    def line(velocity):
        told = None if velocity is None else tuple(velocity)
        return sight_line(SIGHT_LINE_CAMERA, here, of, fish, EXACT, 0.0, THERE, T_NS, TANK_M, velocity_m_s=told)

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
    found = sight_line_seen(outline(sight_line_eye()), sight_line_eye(), own=own)
    information = matrix(found.information)
    values, across = np.linalg.eigh(information)
    errors = []
    for _ in range(1500):
        pose = math.sqrt(3.0) * sigma * rng.normal(size=3) + stays * rng.normal(size=3)
        truly = sight_line_eye(*pose, turned=GIMBAL_RAD * rng.normal(size=2))
        errors.append(np.array(sight_line_seen(outline(truly), sight_line_eye(), own=own).x_m) - THERE)
    drawn = across[:, 1:].T @ np.cov(np.array(errors).T) @ across[:, 1:]
    # What the camera's pixels and the body's level add is not drawn, and is a tenth of it.
    assert 0.75 < np.trace(drawn @ np.diag(values[1:])) / 2.0 < 1.05


@pytest.mark.parametrize(("straight", "fair"), [(True, True), (False, False)])
def test_many_frames_from_one_place_do_not_know_the_range(straight, fair) -> None:
    """straight: taken across where the target is believed to be; else across each ray, which errs."""
    rng, here, held = np.random.default_rng(5), sight_line_eye(), []
    for k in range(40):
        truly = sight_line_eye(turned=GIMBAL_RAD * rng.normal(size=2))
        found = sight_line_seen(outline(truly), here, THERE if straight else None, sized=False)
        information = matrix(found.information)
        t_ns = T_NS + k * 50_000_000
        held.append(Held(t_ns, found.information, tuple((information @ found.x_m).tolist())))
    track = FixedLagFilter(swimming(1e-3, 2.0), (3.0, 2.0, 0.6)).run(held, held[-1].t_ns, held[-1].t_ns)
    sure_m = math.sqrt(np.linalg.eigvalsh(matrix(track.A))[-1])
    assert (sure_m > 0.25) == fair
    assert (abs(math.dist(track.x_m, THERE)) < 2.0 * sure_m) == fair


# --- size cue ---
# Range from a ball's outline, and what focus and size say together.

SIZE_CUE_BALL = Target(radius_m=0.07, radius_sigma_m=0.0)
SIZE_CUE_CAMERA = CameraFit(
    width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5, lens=300.0, breathing=4.2e-5
)
SIZE_CUE_FOCUS = FocusFit(
    u_inf_m=0.0,
    b_m=136.0,
    rho0=100.0,
    covariance=(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0),
    noise=0.7,
    width=90.0,
    lowest=215,
    highest=720,
    r2=1.0,
    rmse_m=0.001,
    held_out_rmse_m=0.001,
)


def size_cue_outline(d, lens_position=300.0, share=1.0):
    f_px = SIZE_CUE_CAMERA.f_px * (1 + SIZE_CUE_CAMERA.breathing * (lens_position - SIZE_CUE_CAMERA.lens))
    return Outline((319.5, 239.5), f_px * math.asin(0.07 / d), share, lens_position)


@pytest.mark.parametrize("d", [0.3, 0.5, 1.2])
@pytest.mark.parametrize("lens_position", [200.0, 300.0, 800.0])
def test_the_cone_gives_the_distance_of_the_centre_at_every_lens_position(d, lens_position):
    assert size_range(SIZE_CUE_CAMERA, size_cue_outline(d, lens_position), SIZE_CUE_BALL).distance_m == pytest.approx(
        d, rel=1e-12
    )
    if lens_position != 300.0:
        unaware = replace(SIZE_CUE_CAMERA, breathing=0.0)
        assert abs(size_range(unaware, size_cue_outline(d, lens_position), SIZE_CUE_BALL).distance_m - d) > 0.003 * d


def test_half_a_pixel_costs_what_the_geometry_says():
    """s_d = d^2 / (f R) s_r for a small ball."""
    at = size_range(SIZE_CUE_CAMERA, size_cue_outline(1.0), SIZE_CUE_BALL)
    assert math.sqrt(at.systematic_m2) == pytest.approx(1.0 / (1169 * 0.07) * fix.EDGE_BIAS_PX, rel=0.01)
    assert math.sqrt(at.random_m2) == pytest.approx(1.0 / (1169 * 0.07) * fix.EDGE_NOISE_PX, rel=0.01)


def test_an_edge_that_vision_is_unsure_of_counts_as_such():
    plain, sure, unsure = (
        size_range(SIZE_CUE_CAMERA, size_cue_outline(1.0)._replace(radius_sigma_px=px), SIZE_CUE_BALL)
        for px in (None, 0.02, 3.0)
    )
    assert sure == plain, "never surer than the twin has shown"
    assert math.sqrt(unsure.systematic_m2) == pytest.approx(1.0 / (1169 * 0.07) * 3.0, rel=0.01)
    assert (unsure.distance_m, unsure.random_m2) == (plain.distance_m, plain.random_m2)
    doubtful = size_cue_outline(1.0, share=0.5)._replace(radius_sigma_px=0.02)
    assert size_range(SIZE_CUE_CAMERA, doubtful, SIZE_CUE_BALL) == sure, (
        "how sure it is that it is a ball says nothing of its size"
    )


def test_part_of_an_outline_a_rough_ball_and_a_rough_scale_are_worth_less():
    whole = size_range(SIZE_CUE_CAMERA, size_cue_outline(0.4), SIZE_CUE_BALL)
    assert size_range(SIZE_CUE_CAMERA, size_cue_outline(0.4, share=0.5), SIZE_CUE_BALL).random_m2 == pytest.approx(
        8.0 * whole.random_m2
    )
    rough = size_range(
        SIZE_CUE_CAMERA, size_cue_outline(0.4), replace(SIZE_CUE_BALL, radius_sigma_m=0.0007)
    )  # one percent
    assert rough.shared_m2 == pytest.approx(0.004**2, rel=1e-9) and rough.systematic_m2 == whole.systematic_m2
    scaled = size_range(
        replace(SIZE_CUE_CAMERA, scale_covariance=(1e-6, 0.0, 0.0)), size_cue_outline(0.4), SIZE_CUE_BALL
    )
    assert scaled.systematic_m2 - whole.systematic_m2 == pytest.approx(0.0004**2, rel=1e-9)


def test_both_are_weighed_by_the_inverse_of_their_variance():
    a, b = Range(0.500, 9e-6, 7e-6, 1.0), Range(0.503, 1e-6, 3e-6, 0.0)
    both = fuse(a, b)
    assert both.distance_m == pytest.approx((0.500 / 16 + 0.503 / 4) / (1 / 16 + 1 / 4))
    assert both.variance_m2 == pytest.approx(1e-6 / (1 / 16 + 1 / 4))
    assert both.random_m2 == pytest.approx(0.04 * 9e-6 + 0.64 * 1e-6)
    assert both.focus_share == pytest.approx(0.2)


def test_a_gross_disagreement_is_said_and_not_averaged():
    wrong_ball = Target(radius_m=0.09, radius_sigma_m=0.0)
    focus = focus_range(
        SIZE_CUE_FOCUS, SIZE_CUE_CAMERA, (319.5, 239.5), lens_position(SIZE_CUE_FOCUS, 0.43), 0.5, SIZE_CUE_BALL
    )
    refused = distance(KNOWN, size_cue_outline(0.5), lens_position(SIZE_CUE_FOCUS, 0.43), 0.5, wrong_ball, "both", 0.0)
    assert isinstance(refused, NoRange) and "radius_m" in refused.reason and "\n" not in refused.reason
    together = distance(
        KNOWN, size_cue_outline(0.5), lens_position(SIZE_CUE_FOCUS, 0.43), 0.5, SIZE_CUE_BALL, "both", 0.0
    )
    assert together.distance_m == pytest.approx(0.5, abs=0.003)
    assert together.variance_m2 < focus.variance_m2


def test_a_lens_that_looks_down_is_trusted_less():
    level, down = (
        focus_range(
            SIZE_CUE_FOCUS,
            SIZE_CUE_CAMERA,
            (319.5, 239.5),
            lens_position(SIZE_CUE_FOCUS, 0.5),
            0.5,
            SIZE_CUE_BALL,
            tilt,
        )
        for tilt in (0.0, -0.6)
    )
    slope = SIZE_CUE_FOCUS.b_m / (lens_position(SIZE_CUE_FOCUS, 0.5) - SIZE_CUE_FOCUS.rho0) ** 2
    sag_m = slope * UNKNOWN_SAG * SIZE_CUE_FOCUS.width * math.sin(0.6)
    assert down.systematic_m2 - level.systematic_m2 == pytest.approx(sag_m**2, rel=1e-6)
    assert down.distance_m == level.distance_m and np.isfinite(down.random_m2)


def test_of_a_fixed_focus_a_ball_is_ranged_by_its_size_and_a_thing_in_a_box_by_its_length_or_not_at_all() -> None:
    fixed, here = replace(KNOWN, focus=None), eye()
    ball = Outline((320.0, 240.0), 120.0, 1.0, None)
    assert locate(fixed, here, ball, None, 0.0, BALL) == locate(KNOWN, here, ball, 400.0, 1.0, BALL, "size")
    box = Outline((320.0, 240.0), None, 1.0, None, (117.0, 60.0))
    known = distance(fixed, box, None, 0.0, Target(detector="box", length_m=0.05), "both", 0.0)
    assert known.distance_m == pytest.approx(0.05 * at_lens_position(CAMERA, None).f_px / 117.0)
    unknown = locate(fixed, here, box, None, 0.0, Target(detector="box"))
    along = apply(here.rotation, (0.0, 0.0, 1.0))
    stays = full(unknown.systematic_m2)
    assert math.sqrt(along @ stays @ np.array(along)) == pytest.approx(fix.FARTHEST_M / math.sqrt(12.0), rel=0.01)
    assert math.sqrt(np.linalg.eigvalsh(stays + full(unknown.random_m2))[1]) < 0.05  # across the ray it is known
