"""Tags that the lens shows too blurred do not count, whatever the picture says."""

import math

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.projection import WIDTH_PX, readable, view
from agent.capabilities.swim.tag_fix import tag_fix
from agent.core.config import Body
from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.core.step_io import SeenTag
from agent.perception.tags import to_pixels, to_slopes
from tests.capabilities.swim.tank_with_tags import MAP, VIEW, priors, sight
from tests.known_lens import PLAIN

SIZE_M, SIDE_PX = 0.08, 80.0
AWAY_M = SIZE_M * VIEW.f_px / SIDE_PX
SHARP = lens_position(PLAIN, AWAY_M)


def tag(wide_px: float, high_px: float) -> SeenTag:
    u, v = wide_px / VIEW.f_px, high_px / VIEW.f_px
    return SeenTag(3, ((0.0, 0.0), (u, 0.0), (u, v), (0.0, v)), min(wide_px, high_px), 0.0, True)


TAG = tag(SIDE_PX, SIDE_PX)
MODULE = PLAIN.width * (SIDE_PX / 8) / WIDTH_PX  # so far off focus the blur is a module wide, lens positions


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_tag_counts_until_its_blur_is_a_module_wide(way) -> None:
    assert readable([TAG], SIZE_M, PLAIN, SHARP + 0.99 * way * MODULE) == [TAG]
    assert readable([TAG], SIZE_M, PLAIN, SHARP + 1.01 * way * MODULE) == []


def test_how_far_a_tag_is_goes_by_the_side_that_it_does_not_show_aslant() -> None:
    aslant = tag(SIDE_PX, 0.25 * SIDE_PX)
    assert readable([aslant], SIZE_M, PLAIN, SHARP) == [aslant]
    assert readable([aslant], SIZE_M, PLAIN, SHARP + 0.3 * MODULE) == [], "its modules are narrow one way"
    c, s = 0.5 * SIDE_PX / VIEW.f_px, 0.1 * SIDE_PX / VIEW.f_px  # the same, one corner ahead
    turned = SeenTag(3, ((0.0, -s), (c, 0.0), (0.0, s), (-c, 0.0)), VIEW.f_px * math.hypot(c, s), 0.0, True)
    farther = lens_position(PLAIN, AWAY_M * math.sqrt(2.0))
    assert readable([turned], SIZE_M, PLAIN, farther) == [turned]


def test_nothing_is_left_out_where_nobody_knows_the_lens() -> None:
    assert readable([TAG], SIZE_M, PLAIN, None) == [TAG]


def test_what_no_lens_position_shows_sharp_does_not_count() -> None:
    near, fit = tag(1e5, 1e5), replace(PLAIN, u_inf_m=0.01)
    assert readable([near], SIZE_M, fit, SHARP) == []


# --- lens errors ---
# What a calibration has wrong, as it comes through a fix: against fixes with one wrong number at a time.

THETA = (1.1, 0.9, 0.6, 0.3, 0.01, -0.02, 0.3, -0.5)


def full(symmetric):
    a, b, c, d, e, f = symmetric
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def test_it_is_what_another_calibration_would_have_made_of_the_same_pixels() -> None:
    names = ("f_px", "bend", "cx_px", "cy_px", "ahead_m", "breathing", "pan_zero_deg", "tilt_zero_deg")
    names = (*names, "pan_gain", "tilt_gain")
    rng, theta = np.random.default_rng(7), THETA
    sigma = np.array([3e-4, 0.01, 0.5, 0.8, 3e-4, 1e-7, 0.03, 0.05, 1e-3, 1e-3])
    mixed = sigma[:, None] * (np.eye(10) + 0.5 * rng.standard_normal((10, 10)))
    covariance = mixed @ mixed.T
    body, focus = Body(camera_m=VIEW.arm_m), 500.0
    known = CameraFit(
        width_px=640, height_px=480, f_px=VIEW.f_px, cx_px=320.0, cy_px=240.0, bend=0.39, ahead_m=VIEW.ahead_m
    )
    at_lens = at_lens_position(known, focus)
    tags, before = sight(theta), priors(theta)
    pixels = [to_pixels(at_lens, np.array(tag.corners)) for tag in tags]

    def fixed(camera):
        of = view(camera, body, VIEW.surface_m, focus)
        slopes = [to_slopes(at_lens_position(camera, focus), px) for px in pixels]
        told = [
            SeenTag(tag.id, tuple(map(tuple, corners.tolist())), tag.size_px, tag.rho_px, True)
            for tag, corners in zip(tags, slopes, strict=True)
        ]
        pan, tilt = before.pan.value, before.tilt.value
        pan = np.radians(camera.pan_zero_deg) + camera.pan_gain * pan
        tilt = np.radians(camera.tilt_zero_deg) + camera.tilt_gain * tilt
        turned = before._replace(pan=before.pan._replace(value=pan), tilt=before.tilt._replace(value=tilt))
        return tag_fix(of, turned, MAP, told, theta[:3])

    def wrong(name, by):
        value = getattr(known, name)
        return msgspec.structs.replace(known, **{name: value * np.exp(by) if name == "f_px" else value + by})

    gains = [
        np.subtract(fixed(wrong(name, h)).theta, fixed(wrong(name, -h)).theta)[:3] / (2 * h)
        for name, h in zip(names, 0.1 * sigma, strict=True)
    ]
    says = fixed(msgspec.structs.replace(known, covariance=tuple(covariance[np.triu_indices(10)].tolist())))
    expected = np.transpose(gains) @ covariance @ gains
    np.testing.assert_allclose(
        full(says.stays) - full(fixed(known).stays), expected, rtol=0.03, atol=0.01 * np.diag(expected).min()
    )
    np.testing.assert_allclose(full(says.fluctuates), full(fixed(known).fluctuates), rtol=1e-9)
