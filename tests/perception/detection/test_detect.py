"""The ball is found where it is: off the axis, out of focus, cut off, in a part of a frame; and not where it is not."""

import math

import cv2
import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.dark_water import DarkWater, stand
from agent.perception.detection.colour import NAMED, Sample, exposed, sampled
from agent.perception.detection.detect import LIMIT, find_ball, find_balls, spots
from agent.perception.detection.detectors import BY_LAMPS
from tests.perception.painted import CAMERA, ball_frame, ball_light, defocus, expose, grain


def truth(centre_m, radius_m=0.07):
    x, y, z = centre_m
    px = (CAMERA.cx_px + CAMERA.f_px * x / z, CAMERA.cy_px + CAMERA.f_px * y / z)
    return px, CAMERA.f_px * math.asin(radius_m / math.hypot(x, y, z))


@pytest.mark.parametrize("centre_m", [(0.0, 0.0, 0.45), (0.12, 0.05, 1.0), (0.2, -0.12, 1.2)])
@pytest.mark.parametrize(("blur_px", "tolerance_px"), [(0.0, 1.0), (4.0, 1.5), (15.0, 3.0)])
def test_centre_and_radius(centre_m, blur_px, tolerance_px):
    ball = find_ball(ball_frame(centre_m, blur_px), CAMERA)
    (u, v), radius = truth(centre_m)
    assert ball is not None
    assert math.dist(ball.centre_px, (u, v)) < tolerance_px
    assert ball.radius_px == pytest.approx(radius, abs=tolerance_px)
    assert abs(ball.radius_px - radius) < 3.0 * ball.radius_sigma_px
    assert ball.score > 0.85


def test_the_centre_of_the_cone_is_not_the_centroid_of_the_image():
    centre_m = (0.157, 0.0, 0.9)
    frame = ball_frame(centre_m)
    ball = find_ball(frame, CAMERA)
    mask = frame[:, :, 2].astype(int) - frame[:, :, 1] > 40
    centroid_u = np.nonzero(mask)[1].mean()
    assert abs(ball.centre_px[0] - truth(centre_m)[0][0]) < 0.6
    assert centroid_u - truth(centre_m)[0][0] > 1.0


def test_a_ball_cut_off_by_the_frame():
    centre_m = (0.0, 0.10, 0.45)
    ball = find_ball(ball_frame(centre_m), CAMERA)
    assert math.dist(ball.centre_px, truth(centre_m)[0]) < 2.5
    whole = find_ball(ball_frame((0.0, 0.0, 0.45)), CAMERA)
    assert ball.score < whole.score and ball.radius_sigma_px > 1.2 * whole.radius_sigma_px


def test_part_of_a_frame_gives_pixels_of_the_whole():
    frame, whole = ball_frame((0.05, 0.02, 0.8), 2.0), None
    whole = find_ball(frame, CAMERA)
    part = find_ball(np.ascontiguousarray(frame[150:400, 240:520]), CAMERA, (240, 150))
    assert math.dist(part.centre_px, whole.centre_px) < 0.3
    assert part.radius_px == pytest.approx(whole.radius_px, abs=0.3)


def test_something_in_front_does_not_move_the_centre():
    frame = ball_frame((0.0, 0.0, 0.6))
    cv2.rectangle(frame, (150, 250), (300, 420), (90, 95, 90), -1)
    ball = find_ball(frame, CAMERA)
    assert math.dist(ball.centre_px, truth((0.0, 0.0, 0.6))[0]) < 1.5
    assert 0.5 < ball.score < 0.95


def wall(seed, tint=(1.0, 1.0, 1.0)):
    return expose(np.repeat((0.25 + 0.1 * grain((480, 640), seed))[..., None], 3, axis=-1) * tint, seed)


@pytest.mark.parametrize("tint", [(1.0, 1.0, 1.0), (1.0, 0.95, 0.8), (0.5, 0.9, 1.0), (0.02, 0.02, 0.02)])
def test_nothing_red_nothing_found(tint):
    assert find_ball(wall(1, tint), CAMERA) is None


@pytest.mark.parametrize("shape", ["rectangle", "triangle", "speck"])
def test_red_but_no_ball(shape):
    frame = wall(2)
    if shape == "rectangle":
        cv2.rectangle(frame, (200, 100), (520, 220), (40, 40, 190), -1)
    elif shape == "triangle":
        cv2.fillPoly(frame, [np.array([[100, 400], [500, 400], [300, 50]])], (40, 40, 190))
    else:
        cv2.circle(frame, (300, 200), 3, (40, 40, 190), -1)
    assert find_ball(frame, CAMERA) is None


def test_water_takes_red_and_adds_a_veil():
    light = 0.75 * ball_light((0.02, 0.03, 0.7)) * (1.0, 0.95, 0.7) + np.array([0.08, 0.08, 0.05])
    ball = find_ball(expose(defocus(light, 2.0), 4), CAMERA)
    assert math.dist(ball.centre_px, truth((0.02, 0.03, 0.7))[0]) < 1.0


def test_the_same_frame_gives_the_same_answer():
    frame = ball_frame((0.05, 0.02, 0.6), 6.0)
    assert find_ball(frame, CAMERA) == find_ball(frame.copy(), CAMERA)


def test_a_sliver_of_an_image_is_no_error():
    assert find_ball(np.zeros((10, 300, 3), np.uint8), CAMERA) is None


PLANES = {"red": (0, 1, 2), "green": (0, 2, 1), "yellow": (0, 2, 2)}  # of the red ball, for blue, green, red
WATERS = {"grey": (1.0, 1.0, 1.0), "green": (0.55, 0.9, 0.6), "yellow": (0.35, 0.9, 0.85), "blue": (1.0, 0.9, 0.6)}


@pytest.mark.parametrize("colour", PLANES)
@pytest.mark.parametrize("water", WATERS)
def test_each_colour_is_found_and_only_it_whatever_the_tint(colour, water):
    centre_m = (-0.04, 0.02, 0.8)
    veil = 0.08 * np.array(WATERS[water])
    frame = expose(defocus(ball_light(centre_m)[..., PLANES[colour]] * WATERS[water] + veil, 3.0), 4)
    found = {name: find_ball(frame, CAMERA, colour=name) for name in PLANES}
    assert math.dist(found[colour].centre_px, truth(centre_m)[0]) < 1.0
    assert [name for name, ball in found.items() if ball] == [colour]


def test_two_balls_of_two_colours():
    red, green = ball_light((-0.12, 0.0, 0.9)), ball_light((0.1, 0.03, 0.8))[..., PLANES["green"]]
    frame = expose(np.where((np.arange(640) < 320)[None, :, None], red, green), 4)
    for colour, centre_m in (("red", (-0.12, 0.0, 0.9)), ("green", (0.1, 0.03, 0.8))):
        ball = find_ball(frame, CAMERA, colour=colour)
        assert math.dist(ball.centre_px, truth(centre_m)[0]) < 1.0


def test_a_ball_that_overflows_the_frame():
    ball = find_ball(ball_frame((0.0, 0.0, 0.30), 2.0), CAMERA)  # 275 px: cut off above and below
    assert math.dist(ball.centre_px, truth((0.0, 0.0, 0.30))[0]) < 1.5
    assert ball.radius_px == pytest.approx(truth((0.0, 0.0, 0.30))[1], abs=1.5)


def test_less_than_a_third_of_the_outline_is_not_believed():
    assert find_ball(ball_frame((0.14, 0.0, 0.30)), CAMERA) is None


def test_a_large_frame_holds_a_large_ball():
    whole = ball_frame((0.0, 0.0, 0.34), 2.0)
    camera = CameraFit(width_px=1280, height_px=960, f_px=2 * CAMERA.f_px, cx_px=639.5, cy_px=479.5)
    ball = find_ball(cv2.resize(whole, (1280, 960)), camera)
    assert ball.radius_px == pytest.approx(2 * truth((0.0, 0.0, 0.34))[1], abs=3.0)  # 485 px


def test_a_grey_stone_nearer_than_the_tinted_wall_is_not_red():
    far, near = np.array([1.0, 0.95, 0.6]), np.array([1.0, 1.0, 0.9])  # of grey, seen through blue water
    hit = ball_light((0.05, 0.0, 0.6)) * (0.0, 0.0, 1.0)
    stone = (hit[..., 2] - 0.3)[..., None] * (1.0, 1.0, 1.0)
    rows, columns = np.mgrid[:480, :640]
    inside = ((columns - 400) ** 2 + (rows - 240) ** 2 < 130**2)[..., None]
    wall = np.repeat((0.3 + 0.08 * grain((480, 640), 5))[..., None], 3, axis=-1)
    frame = expose(np.where(inside, (0.3 + 0.2 * np.abs(stone)) * near, wall * far), 4)
    assert find_ball(frame, CAMERA) is None


def test_light_from_above_does_not_lift_the_centre_of_a_blurred_ball():
    centre_m = (0.0, 0.0, 0.9)
    shade = np.linspace(1.8, 0.2, 480)[:, None, None]
    ball = find_ball(expose(defocus(ball_light(centre_m) * shade, 10.0), 4), CAMERA)
    assert math.dist(ball.centre_px, truth(centre_m)[0]) < 0.45  # 0.7 without the correction for shading
    assert ball.radius_px == pytest.approx(truth(centre_m)[1], abs=0.7)


@pytest.mark.parametrize("radius_px", [8, 12])
def test_a_small_ball_beside_a_large_red_thing(radius_px):
    frame = wall(6)
    cv2.rectangle(frame, (20, 20), (240, 460), (40, 40, 190), -1)
    cv2.circle(frame, (300, 200), radius_px, (50, 50, 150), -1, cv2.LINE_AA)
    (ball,) = find_balls(cv2.GaussianBlur(frame, (0, 0), 1.0), CAMERA)
    assert math.dist(ball.centre_px, (300, 200)) < 0.5
    assert ball.radius_px == pytest.approx(radius_px + 0.5, abs=0.7)


def test_the_most_convincing_of_two_is_not_the_first_that_is_looked_at():
    frame = wall(7)
    cv2.circle(frame, (180, 240), 60, (30, 30, 220), -1, cv2.LINE_AA)
    cv2.rectangle(frame, (195, 160), (260, 320), (120, 120, 120), -1)  # hides a part of the redder one
    cv2.circle(frame, (460, 240), 60, (70, 70, 150), -1, cv2.LINE_AA)
    frame = cv2.GaussianBlur(frame, (0, 0), 1.0)
    balls = find_balls(frame, CAMERA)
    assert len(balls) == 2 and balls[0].score < 1.0
    assert find_ball(frame, CAMERA) == balls[0]
    assert math.dist(balls[0].centre_px, (460, 240)) < 1.0
    first, _ = spots(exposed(frame), NAMED["red"])[:2]
    assert math.dist(first.circle[:2], (180, 240)) < 30.0


def lit_circle(light, centre, radius_px):
    """What a port with a rim shows: nothing outside of a circle."""
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
    inside = (columns - centre[0]) ** 2 + (rows - centre[1]) ** 2 < radius_px**2
    return defocus(np.where(inside[..., None], light, 0.0004), 6.0)


@pytest.mark.parametrize("colour", PLANES)
def test_the_rim_of_a_port_is_no_ball(colour):
    tinted = np.repeat((0.25 + 0.05 * grain((480, 640), 5))[..., None], 3, axis=-1) * (0.7, 1.0, 0.3)
    assert find_ball(expose(lit_circle(tinted, (320, 240), 220), 2), CAMERA, colour=colour) is None


def test_a_ball_that_the_rim_cuts_off_is_found():
    frame = expose(lit_circle(ball_light((0.04, 0.0, 0.6)), (320, 240), 180), 2)
    assert math.dist(find_ball(frame, CAMERA).centre_px, truth((0.04, 0.0, 0.6))[0]) < 1.5


def test_a_burnt_out_top_does_not_shrink_the_ball():
    shade = np.where(np.mgrid[:480, :640][0] < 240, 8.0, 1.0)[..., None]
    light = ball_light((0.0, 0.0, 1.0))
    ball = find_ball(
        expose(defocus(np.where(light[..., 2:] > 1.5 * light[..., :1], light * shade, light), 3.0), 4), CAMERA
    )
    assert abs(ball.radius_px - truth((0.0, 0.0, 1.0))[1]) < min(0.05 * ball.radius_px, 3.0 * ball.radius_sigma_px)


def test_a_black_hole_has_no_colour():
    frame = wall(3, (1.0, 0.95, 0.5))
    cv2.circle(frame, (300, 200), 40, (8, 9, 10), -1)
    assert [name for name in ("red", "orange", "yellow", "green") if find_ball(frame, CAMERA, colour=name)] == []


def test_any_colour_by_sample():
    light = ball_light((0.0, 0.0, 0.8))
    blue, red = expose(light[..., ::-1], 4), expose(light, 4)
    model = sampled(Sample(blue[220:260, 300:340].reshape(-1, 3), blue[0]))
    assert find_ball(blue, CAMERA, colour=model) is not None and find_ball(red, CAMERA, colour=model) is None
    assert sampled(Sample(blue[0], blue[-1])) is None


# --- by lamps ---
# A ball in the dark by a lamp beside the camera: bright in its middle, dark at its rim: its edge looks soft.

FAR_M = 0.73


@pytest.fixture(scope="module", params=[2])
def frame(request: pytest.FixtureRequest) -> tuple[np.ndarray, CameraFit]:
    """Of a camera of that world in harbour water, by its own lamp, and the camera."""
    sea = DarkWater("harbour", request.param)
    sea.prepare()
    image = sea.painter.expose(sea.moment("r1", {"r1": stand(FAR_M, 0.0)}, ["r1"]), sea.sharp_m(FAR_M))
    lens = sea.lens
    f_px = 1.333 * sea.sharp_m(FAR_M) / lens.pixel_m
    centre = dict(zip(("cx_px", "cy_px"), lens.centre_px, strict=True))
    return image, CameraFit(width_px=lens.width, height_px=lens.height, f_px=f_px, bend=0.39, **centre)


def test_an_edge_that_is_soft_by_its_lamp_is_no_doubt_by_lamps(frame: tuple[np.ndarray, CameraFit]) -> None:
    image, camera = frame
    plain = find_ball(image, camera, limit=0.0)
    ball = find_ball(image, camera, limit=BY_LAMPS, by_lamps=True)
    assert ball is not None and plain is not None
    assert ball.score > LIMIT > plain.score
    assert ball.radius_px == pytest.approx(math.asin(0.07 / FAR_M) * camera.f_px, rel=0.04)
    assert math.dist(ball.centre_px, (camera.cx_px, camera.cy_px)) < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_veil_alone_is_no_ball(seed: int) -> None:
    veil = np.full((480, 640, 3), (0.10, 0.12, 0.11))
    assert find_ball(expose(veil, seed), CAMERA, limit=BY_LAMPS, by_lamps=True) is None
