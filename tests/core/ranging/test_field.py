"""A sensor that leans and a field that is curved: peaks aside are those on the axis, shifted."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Target
from agent.core.ranging.camera_model import CameraFit, FieldFit, at_lens_position, offset, on_sensor, pixel
from agent.core.ranging.fix import focus_range
from agent.core.ranging.focus import in_direction, lens_position, port_share, shift
from agent.perception.depth_peaks import z_depth
from tests.known_lens import FOCUS

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1166.0, cx_px=316.0, cy_px=243.0, bend=0.39)
FIELD = FieldFit(right=100.0, down=-30.0, curved=280.0, covariance=(1.0, 0.0, 0.0, 4.0, 0.0, 36.0))
LENS = replace(FOCUS, field=FIELD)
AXIS_PX, ASIDE_PX = (316.0, 243.0), (600.0, 60.0)
BOX = Target(length_m=0.2)


def test_a_lens_without_a_field_is_the_same_in_all_directions() -> None:
    assert in_direction(FOCUS, CAMERA, ASIDE_PX, 400.0) is FOCUS


def test_peaks_aside_lie_where_the_field_says() -> None:
    x, y = offset(CAMERA, ASIDE_PX)
    aside = in_direction(LENS, CAMERA, ASIDE_PX, 400.0)
    assert (x, y) == pytest.approx((284 / 1166, -183 / 1166))
    assert lens_position(aside, 0.8) - lens_position(LENS, 0.8) == pytest.approx(
        100 * x - 30 * y + 280 * (x * x + y * y)
    )
    assert in_direction(LENS, CAMERA, AXIS_PX, 400.0).rho0 == LENS.rho0


def test_a_range_aside_is_the_one_on_the_axis_and_no_surer() -> None:
    rho = lens_position(FOCUS, 0.8)
    moved = rho + shift(FIELD, offset(CAMERA, ASIDE_PX))
    flat = focus_range(FOCUS, CAMERA, ASIDE_PX, rho, 0.5, BOX)
    curved = focus_range(LENS, CAMERA, ASIDE_PX, moved, 0.5, BOX)
    assert flat is not None and curved is not None
    assert curved.distance_m == pytest.approx(flat.distance_m)
    assert z_depth(LENS, CAMERA, moved, ASIDE_PX) == pytest.approx(z_depth(FOCUS, CAMERA, rho, ASIDE_PX))
    assert curved.systematic_m2 > flat.systematic_m2 and curved.random_m2 == pytest.approx(flat.random_m2)
    wrong = focus_range(FOCUS, CAMERA, ASIDE_PX, moved, 0.5, BOX)
    assert wrong is not None and abs(wrong.distance_m / flat.distance_m - 1.0) > 0.1  # what it is for


def test_the_field_belongs_to_the_sensor_and_the_port_to_the_ray() -> None:
    """A picture grows as the lens moves: whichever picture of a sweep a pixel is counted in, the range is one."""
    breathing, rho, point_m = replace(CAMERA, breathing=3.5e-5, lens=290.0), 450.0, (0.19, -0.12, 0.8)
    ranges_m = []
    for lens in (0.0, 290.0, 450.0, 1000.0):
        camera = at_lens_position(breathing, lens)
        px = pixel(camera, point_m)
        assert px is not None
        z_m = z_depth(LENS, camera, rho, px)
        assert z_m is not None
        ranges_m.append(z_m)
        x, y = offset(at_lens_position(breathing, rho), pixel(at_lens_position(breathing, rho), point_m))  # type: ignore[arg-type]
        grown = at_lens_position(breathing, rho).f_px / at_lens_position(breathing, 0.0).f_px
        assert on_sensor(camera, px, rho) == pytest.approx((grown * x, grown * y))
    assert np.ptp(ranges_m) < 1e-9


def test_how_well_it_is_known_grows_with_the_distance_from_the_axis() -> None:
    x, y = offset(CAMERA, ASIDE_PX)
    *_, known = in_direction(LENS, CAMERA, ASIDE_PX, 400.0).covariance
    r2 = x * x + y * y
    assert known - LENS.covariance[5] == pytest.approx(x * x + 4.0 * y * y + 36.0 * r2 * r2)
    assert math.isclose(in_direction(LENS, CAMERA, AXIS_PX, 400.0).covariance[5], LENS.covariance[5])
    assert port_share(CAMERA, ASIDE_PX) < 1.0  # which is another thing, and is kept
