"""Range from a ball's outline, and what focus and size say together."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Target
from agent.core.ranging import fix
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit
from agent.core.ranging.fix import NoRange, Outline, Range, distance, focus_range, fuse, size_range
from agent.core.ranging.focus import UNKNOWN_SAG, lens_position

BALL = Target(radius_m=0.07, radius_sigma_m=0.0)
CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5, lens=300.0, breathing=4.2e-5)
FOCUS = FocusFit(
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
KNOWN = Calibration(robot="r1", made="", source="", focus=FOCUS, camera=CAMERA)


def outline(d, lens_position=300.0, share=1.0):
    f_px = CAMERA.f_px * (1 + CAMERA.breathing * (lens_position - CAMERA.lens))
    return Outline((319.5, 239.5), f_px * math.asin(0.07 / d), share, lens_position)


@pytest.mark.parametrize("d", [0.3, 0.5, 1.2])
@pytest.mark.parametrize("lens_position", [200.0, 300.0, 800.0])
def test_the_cone_gives_the_distance_of_the_centre_at_every_lens_position(d, lens_position):
    assert size_range(CAMERA, outline(d, lens_position), BALL).distance_m == pytest.approx(d, rel=1e-12)
    if lens_position != 300.0:
        unaware = replace(CAMERA, breathing=0.0)
        assert abs(size_range(unaware, outline(d, lens_position), BALL).distance_m - d) > 0.003 * d


def test_half_a_pixel_costs_what_the_geometry_says():
    """s_d = d^2 / (f R) s_r for a small ball."""
    at = size_range(CAMERA, outline(1.0), BALL)
    assert math.sqrt(at.systematic_m2) == pytest.approx(1.0 / (1169 * 0.07) * fix.EDGE_BIAS_PX, rel=0.01)
    assert math.sqrt(at.random_m2) == pytest.approx(1.0 / (1169 * 0.07) * fix.EDGE_NOISE_PX, rel=0.01)


def test_an_edge_that_vision_is_unsure_of_counts_as_such():
    plain, sure, unsure = (
        size_range(CAMERA, outline(1.0)._replace(radius_sigma_px=px), BALL) for px in (None, 0.02, 3.0)
    )
    assert sure == plain, "never surer than the twin has shown"
    assert math.sqrt(unsure.systematic_m2) == pytest.approx(1.0 / (1169 * 0.07) * 3.0, rel=0.01)
    assert (unsure.distance_m, unsure.random_m2) == (plain.distance_m, plain.random_m2)
    doubtful = outline(1.0, share=0.5)._replace(radius_sigma_px=0.02)
    assert size_range(CAMERA, doubtful, BALL) == sure, "how sure it is that it is a ball says nothing of its size"


def test_part_of_an_outline_a_rough_ball_and_a_rough_scale_are_worth_less():
    whole = size_range(CAMERA, outline(0.4), BALL)
    assert size_range(CAMERA, outline(0.4, share=0.5), BALL).random_m2 == pytest.approx(8.0 * whole.random_m2)
    rough = size_range(CAMERA, outline(0.4), replace(BALL, radius_sigma_m=0.0007))  # one percent
    assert rough.systematic_m2 - whole.systematic_m2 == pytest.approx(0.004**2, rel=1e-9)
    scaled = size_range(replace(CAMERA, scale_covariance=(1e-6, 0.0, 0.0)), outline(0.4), BALL)
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
    focus = focus_range(FOCUS, CAMERA, (319.5, 239.5), lens_position(FOCUS, 0.43), 0.5, BALL)
    refused = distance(KNOWN, outline(0.5), lens_position(FOCUS, 0.43), 0.5, wrong_ball, "both", 0.0)
    assert isinstance(refused, NoRange) and "radius_m" in refused.reason and "\n" not in refused.reason
    together = distance(KNOWN, outline(0.5), lens_position(FOCUS, 0.43), 0.5, BALL, "both", 0.0)
    assert together.distance_m == pytest.approx(0.5, abs=0.003)
    assert together.variance_m2 < focus.variance_m2


def test_a_lens_that_looks_down_is_trusted_less():
    level, down = (
        focus_range(FOCUS, CAMERA, (319.5, 239.5), lens_position(FOCUS, 0.5), 0.5, BALL, tilt) for tilt in (0.0, -0.6)
    )
    slope = FOCUS.b_m / (lens_position(FOCUS, 0.5) - FOCUS.rho0) ** 2
    sag_m = slope * UNKNOWN_SAG * FOCUS.width * math.sin(0.6)
    assert down.systematic_m2 - level.systematic_m2 == pytest.approx(sag_m**2, rel=1e-6)
    assert down.distance_m == level.distance_m and np.isfinite(down.random_m2)
