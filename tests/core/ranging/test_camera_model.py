"""Geometry against plain matrices, its inverses, and the ball's skin against a ray-by-ray average."""

import math

import msgspec
import numpy as np
import pytest
import tomli_w
from msgspec.structs import replace

from agent.core.config import Body, ConfigError, Pose, dump, read_toml
from agent.core.ranging.camera_model import (
    BodyFit,
    Calibration,
    FieldFit,
    at_lens_position,
    camera_pose,
    centre_behind_skin_m,
    gimbal_deg,
    load_calibration,
    look_at,
    pixel,
    ray,
    servos_us,
    to_camera,
)
from tests import known_lens

BODY = Body(camera_m=(0.10, 0.02, -0.01))
POSE = Pose(x_m=0.3, y_m=0.25, yaw_deg=34.0)
CAMERA = replace(known_lens.CAMERA, pan_zero_deg=0.9, tilt_zero_deg=-0.7, pan_gain=1.01, tilt_gain=0.99)
BENT = replace(CAMERA, bend=0.39, ahead_m=-0.0017, lens=300.0, breathing=4.2e-5)


def rotation(axis, deg):
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


def eye(pan=12.0, tilt=-7.0, roll=2.0, pitch=-3.0):
    return camera_pose(POSE, BODY, 0.4, roll, pitch, pan, tilt, 0.5)


def test_camera_pose_is_the_product_of_the_rotations():
    world_body = rotation("z", 34) @ rotation("y", -3) @ rotation("x", 2)
    gimbal_camera = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    expected = world_body @ rotation("z", 12) @ rotation("y", 7) @ gimbal_camera
    assert np.allclose(eye().rotation, expected, atol=1e-14)
    assert np.allclose(eye().position_m, np.array([0.3, 0.25, 0.1]) + world_body @ BODY.camera_m, atol=1e-14)


def test_a_point_on_the_left_is_left_in_the_image_and_a_high_one_is_up():
    level = camera_pose(Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0), Body(camera_m=(0.0, 0.0, 0.0)), 0.4, 0, 0, 0, 0, 0.5)
    u, v = pixel(CAMERA, to_camera(level, (1.0, 0.1, 0.2)))
    assert u < CAMERA.cx_px and v < CAMERA.cy_px
    panned = camera_pose(Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0), Body(camera_m=(0.0, 0.0, 0.0)), 0.4, 0, 0, 5, 5, 0.5)
    u2, v2 = pixel(CAMERA, to_camera(panned, (1.0, 0.1, 0.2)))
    assert u2 > u and v2 > v


def test_a_level_body_s_camera_looks_up_by_its_tilt_and_one_upright_by_a_right_angle():
    assert eye(tilt=-7.0, roll=0.0, pitch=0.0).tilt_rad == pytest.approx(math.radians(-7.0))
    upright = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, math.nextafter(1.0, 2.0)))  # as products round
    assert eye()._replace(rotation=upright).tilt_rad == math.pi / 2.0


@pytest.mark.parametrize("angles", [(0.0, 0.0), (-60.0, 20.0), (44.4, -51.0)])
def test_servo_pulses_invert_the_gimbal_angles(angles):
    back = gimbal_deg(CAMERA, BODY, servos_us(CAMERA, BODY, *angles))
    assert back == pytest.approx(angles, abs=0.5 / BODY.servo_us_per_deg * 1.02)  # half a microsecond


def test_servo_pulses_stop_at_the_limits():
    assert servos_us(CAMERA, BODY, 400.0, -400.0) == (2500, round(1500 - 60 * BODY.servo_us_per_deg))


def test_look_at_brings_the_point_onto_the_axis():
    point = (0.76, 0.56, 0.07)
    pan, tilt = look_at(point, POSE, BODY, 0.4, 2.0, -3.0, 0.5)
    x, y, z = to_camera(camera_pose(POSE, BODY, 0.4, 2.0, -3.0, pan, tilt, 0.5), point)
    assert abs(x) < 1e-12 and abs(y) < 1e-12 and z > 0.3


def test_pixel_inverts_ray():
    assert pixel(CAMERA, ray(CAMERA, (17.25, 401.5))) == pytest.approx((17.25, 401.5), abs=1e-9)
    assert math.hypot(*ray(CAMERA, (17.25, 401.5))) == pytest.approx(1.0, abs=1e-15)
    assert pixel(CAMERA, (0.1, 0.1, -1.0)) is None


@pytest.mark.parametrize("distance", [0.25, 0.46, 1.2])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_skin_correction_against_a_ray_by_ray_average(distance, share):
    radius = 0.07
    edge = share * math.tan(math.asin(radius / distance))
    y, x = np.mgrid[-1:1:801j, -1:1:801j] * edge
    m = np.stack([x, y, np.ones_like(x)], axis=-1)[np.hypot(x, y) <= edge]
    mm = (m * m).sum(axis=-1)
    depth = (distance - np.sqrt(distance**2 - mm * (distance**2 - radius**2))) / mm  # parameter at z = 1
    skin = 1 / np.mean(1 / depth)
    assert centre_behind_skin_m(skin, radius, share) == pytest.approx(distance - skin, abs=2e-5)


def test_behind_a_flat_port_pixel_still_inverts_ray():
    for px in ((5.0, 470.0), (319.5, 239.5), (600.0, 20.0)):
        x, y, z = (2.0 * c for c in ray(BENT, px))
        assert pixel(BENT, (x, y, z + BENT.ahead_m)) == pytest.approx(px, abs=1e-6)


def test_the_bend_is_that_of_a_flat_port():
    n, slope = 1.333, 0.2
    in_air = n * slope / math.sqrt(1.0 - (n * n - 1.0) * slope**2)  # Snell for slopes
    paraxial = n * slope
    bent = replace(CAMERA, bend=(n * n - 1.0) / 2.0)
    u, _ = pixel(bent, (slope, 0.0, 1.0))
    assert (u - bent.cx_px) / (bent.f_px * slope) == pytest.approx(in_air / paraxial, abs=1e-3)


def test_the_picture_grows_with_the_lens_position():
    assert at_lens_position(BENT, None) == BENT and at_lens_position(CAMERA, 700.0) == CAMERA
    grown = at_lens_position(BENT, 700.0)
    assert grown.f_px == pytest.approx(1169.0 * (1 + 400 * 4.2e-5), rel=1e-12)
    assert at_lens_position(grown, 300.0).f_px == pytest.approx(1169.0, rel=1e-12)


def numbers(value, path=()):
    """Where the numbers of a file are."""
    if isinstance(value, dict | list):
        parts = value.items() if isinstance(value, dict) else enumerate(value)
        return [found for name, child in parts for found in numbers(child, (*path, name))]
    return [path] if isinstance(value, int | float) else []


FIELD = FieldFit(right=9.0, down=-5.0, curved=80.0, covariance=(0.1,) * 6)
WHOLE = Calibration(
    robot="r1",
    made="2026-01-01",
    source="a test",
    focus=replace(known_lens.FITTED, sag=1.0, sag_sigma=0.5, field=FIELD),
    camera=replace(CAMERA, covariance=(0.0,) * 55),
    body=BodyFit(
        mass_kg=5.0, drag=2.0, drag2=20.0, inertia_kgm2=0.05, turn_drag=0.02, turn_drag2=0.1, lag_s=0.1,
        sigma=(0.01,) * 7, misfit=1.0, fixes=100,
    ),
)  # fmt: skip


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 1e300])
def test_no_number_of_a_calibration_may_be_odd(tmp_path, odd: float) -> None:
    path = tmp_path / "r1.toml"
    path.write_text(dump(WHOLE))
    assert load_calibration(path) == WHOLE
    places = numbers(read_toml(path))
    assert len(places) > 100
    for place in places:
        data = read_toml(path)
        *above, last = place
        there = data
        for name in above:
            there = there[name]
        there[last] = odd
        damaged = tmp_path / "damaged.toml"
        damaged.write_text(tomli_w.dumps(data))
        with pytest.raises(ConfigError) as error:
            load_calibration(damaged)
        key = ".".join(str(name) for name in place if isinstance(name, str))
        assert str(error.value).startswith(f"{damaged}: key '{key}") and "\n" not in str(error.value)


@pytest.mark.parametrize(("key", "value"), [("u_inf_m", 0.5), ("b_m", 0.0), ("f_px", 1e-9), ("width_px", 0)])
def test_what_no_camera_can_be_is_refused(tmp_path, key: str, value: float) -> None:
    data = msgspec.to_builtins(WHOLE)
    table = "focus" if key in data["focus"] else "camera"
    data[table][key] = value
    (tmp_path / "r1.toml").write_text(tomli_w.dumps(data))
    with pytest.raises(ConfigError, match=rf"r1\.toml: key '{table}.*{key}|r1\.toml: key '{table}': `{key}` is 0"):
        load_calibration(tmp_path / "r1.toml")
