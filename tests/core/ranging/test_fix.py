"""A measurement's place in the world, and its covariance against draws of every error that it counts."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Body, Pose, Target
from agent.core.ranging import fix
from agent.core.ranging.camera_model import (
    Calibration,
    Eye,
    at_lens_position,
    camera_pose,
    centre_behind_skin_m,
    pixel,
    to_camera,
)
from agent.core.ranging.fix import Fix, NoRange, Outline, OwnPose, locate
from agent.core.ranging.focus import UNKNOWN_SAG, lens_position
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
DRAWS = 8_000  # a variance is then known to 1.6 percent


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
    rho = lens_position(FOCUS, skin * m[2] + CAMERA.ahead_m)
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


def agree(ours, draws):
    """Every variance, and every covariance that matters, to 5 percent."""
    found = np.cov(draws.T)
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        off = abs(ours[i, j] - found[i, j])
        assert off <= 0.05 * (abs(found[i, j]) if abs(found[i, j]) > 0.4 * scale[i, j] else scale[i, j]), (i, j)


CASES = [("focus", 0.35, (0.0, 0.0)), ("size", 0.5, (0.12, -0.1)), ("both", 0.3, (0.05, 0.05))]


@pytest.mark.parametrize(("cue", "d", "off"), CASES)
def test_random_covariance_is_that_of_draws(cue, d, off):
    rng, here = np.random.default_rng(1), eye()
    outline, rho, _ = seen(here, d, off)
    ours = locate(KNOWN, here, outline, rho, 1.1, BALL, cue)
    s_px = math.hypot(CAMERA.noise_px, fix.CENTRE_NOISE_PX)
    gimbal, right, down = math.radians(CAMERA.noise_deg), *np.array(here.rotation).T[:2]
    places = []
    for e in rng.normal(0, 1, (DRAWS, 6)):
        there = turned(here, turn(right, gimbal * e[0]) @ turn(down, gimbal * e[1]), here.position_m)
        u, v = outline.centre_px
        look = outline._replace(
            centre_px=(u + s_px * e[2], v + s_px * e[3]), radius_px=outline.radius_px + fix.EDGE_NOISE_PX * e[4]
        )
        places.append(fixed_weights(there, look, rho + 1.1 * e[5], cue, ours))
    agree(matrix(ours.random_m2), np.array(places))


@pytest.mark.parametrize(("cue", "d", "off"), CASES)
def test_systematic_covariance_is_that_of_draws(cue, d, off):
    rng, here = np.random.default_rng(2), eye()
    outline, rho, _ = seen(here, d, off)
    ours = locate(KNOWN, here, outline, rho, 1.1, BALL, cue)
    of_focus, (ff, fa, aa) = root(matrix(FOCUS.covariance)), CAMERA.scale_covariance
    of_scale = root(np.array([[ff, fa], [fa, aa]]))
    look_up = math.asin(here.rotation[2][2])
    lens_sigma = FOCUS.width * math.hypot(UNKNOWN_SAG * math.sin(look_up), fix.WARMTH)
    angles = np.radians([fix.LEVEL_SIGMA_DEG, fix.LEVEL_SIGMA_DEG, fix.HEADING_SIGMA_DEG])
    place = np.array([fix.PLACE_SIGMA_M, fix.PLACE_SIGMA_M, fix.HEIGHT_SIGMA_M])
    places = []
    for e in rng.normal(0, 1, (DRAWS, 14)):
        rotation = turn((1, 0, 0), angles[0] * e[0]) @ turn((0, 1, 0), angles[1] * e[1])
        there = turned(here, rotation @ turn((0, 0, 1), angles[2] * e[2]), here.body_m)
        there = there._replace(position_m=tuple(np.array(there.position_m) + place * e[3:6]))
        a, b, c = of_focus @ e[6:9]
        focus = replace(FOCUS, u_inf_m=FOCUS.u_inf_m + a, b_m=FOCUS.b_m + b, rho0=FOCUS.rho0 + c)
        grown, ahead = of_scale @ e[9:11]
        camera = replace(CAMERA, f_px=CAMERA.f_px * (1 + grown), ahead_m=CAMERA.ahead_m + ahead)
        ball = replace(BALL, radius_m=BALL.radius_m + BALL.radius_sigma_m * e[11])
        look = outline._replace(radius_px=outline.radius_px + fix.EDGE_BIAS_PX * e[12])
        known = replace(KNOWN, focus=focus, camera=camera)
        places.append(fixed_weights(there, look, rho + lens_sigma * e[13], cue, ours, known, ball))
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
    here, xx, rad = eye(), fix.PLACE_SIGMA_M**2, math.radians(fix.HEADING_SIGMA_DEG) ** 2
    outline, rho, _ = seen(here, 0.5, (0.1, 0.05))
    survey, none = (xx, 0.0, 0.0, xx, 0.0, rad), (0.0,) * 6
    moored, as_moored, swims = (
        locate(KNOWN, here, outline, rho, 1.1, BALL, "both", own)
        for own in (None, OwnPose(none, survey, 3.0), OwnPose(survey, none, 3.0))
    )
    assert as_moored.systematic_m2 == pytest.approx(moored.systematic_m2) and as_moored.random_m2 == moored.random_m2
    lost = np.subtract(moored.systematic_m2, swims.systematic_m2)
    assert np.subtract(swims.random_m2, moored.random_m2) == pytest.approx(3.0 * lost)  # kappa times as much
