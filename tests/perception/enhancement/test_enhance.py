from typing import NamedTuple

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import (
    DUE_NS,
    OLD_NS,
    SHARE,
    Colours,
    Enhancer,
    OnDemandEnhancer,
    apply_colours,
    classic,
    enhance,
    enhancer,
    estimate_colours,
    guided_filter,
    needs_nothing,
    red_share,
    white_balance,
)
from hw.camera.camera import Frame, Roi
from tests.perception.painted import ball_frame
from tests.places import shared

MATRIX = np.array([[1.1, 0.1, -0.1], [0.0, 0.8, 0.2], [-0.2, 0.3, 1.2]], np.float32)


def scene(size=(480, 640)):
    """Texture, a ramp and sharp edges, 20 to 200 grey levels."""
    rng = np.random.default_rng(3)
    image = cv2.GaussianBlur(rng.normal(110, 160, (*size, 3)), (0, 0), 3.0) + np.linspace(-30, 30, size[1])[:, None]
    cv2.rectangle(image, (200, 100), (330, 260), (40, 60, 180), -1)
    return np.clip(image, 20, 200).astype(np.uint8)


def matrix(small):
    return (small.astype(np.float32) / 255) @ MATRIX.T + np.float32(0.05)


def wanted(image):
    return np.clip(255 * (image / 255 @ MATRIX.T + 0.05), 0, 255)


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def test_one_matrix_for_all_pixels_is_found_again():
    image = scene()
    assert psnr(apply_colours(estimate_colours(image, matrix), image), wanted(image)) > 45


def test_edges_stay_as_sharp_as_in_the_frame():
    image = scene()
    out = apply_colours(estimate_colours(image, matrix), image)
    small = cv2.resize(image, (192, 144), interpolation=cv2.INTER_AREA)
    blurred = np.clip(255 * cv2.resize(matrix(small), (640, 480), interpolation=cv2.INTER_LINEAR), 0, 255)
    edge = np.s_[100:261, 195:205]
    assert psnr(out[edge], wanted(image)[edge]) > psnr(blurred[edge], wanted(image)[edge]) + 10


def test_a_part_is_the_same_as_in_the_whole_frame():
    image = scene()
    colours = estimate_colours(image, lambda small: cv2.GaussianBlur(matrix(small), (0, 0), 9.0))
    whole = apply_colours(colours, image)
    assert np.array_equal(apply_colours(colours, image[96:200, 64:320], (64, 96)), whole[96:200, 64:320])


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (2, 3), (700, 3)])
def test_small_and_thin_pictures(size):
    image = scene()[: size[0], : size[1]]
    image = np.resize(image, (*size, 3)).astype(np.uint8)
    out = apply_colours(estimate_colours(image, matrix), image)
    assert out.shape == image.shape
    assert psnr(out, wanted(image)) > 30


def test_a_plain_picture_takes_the_networks_colour_without_noise():
    guide = np.full((20, 30, 3), 0.5, np.float32)
    affine = guided_filter(guide, np.full((20, 30, 3), 0.7, np.float32))
    assert np.allclose(np.einsum("hwoi,hwi->hwo", affine[..., :3], guide) + affine[..., 3], 0.7, atol=1e-4)


def test_glitter_on_blue_water_does_not_come_out_red():
    """A balance of the whole picture takes the sea's blue for a tint, and paints what is white pink."""
    image = np.full((60, 80, 3), (140, 130, 30), np.uint8)
    image[:4] = (200, 190, 120)
    pink = apply_colours(Colours(affine := whitened(image), (80, 60)), image)[:4].reshape(-1, 3).mean(0)
    white = apply_colours(estimate_colours(image, grey_world), image)
    assert pink[2] > pink[:2].max() + 30
    assert white[:4, :, 2].mean() <= white[:4, :, :2].mean((0, 1)).max() + 1
    assert red_share(image / np.float32(255), affine) < 0.9


@pytest.mark.parametrize("ball", [(20, 40, 220), (30, 210, 220)])
def test_the_brightest_thing_keeps_its_red(ball):
    image = np.full((60, 80, 3), (120, 110, 30), np.uint8)
    image[20:30, 30:40] = ball
    assert red_share(image / np.float32(255), whitened(image)) == 1


def grey_world(small):
    guide = small.astype(np.float32) / 255
    return np.clip(guide * (0.5 / guide.mean((0, 1))), 0, 1)


def whitened(image):
    """(h, w, 3, 4) the same balance everywhere."""
    affine = np.zeros((*image.shape[:2], 3, 4), np.float32)
    affine[:, :, range(3), range(3)] = 0.5 * 255 / image.mean((0, 1))
    return affine


def test_a_cast_is_taken_out():
    frame = ball_frame((0.0, 0.0, 1.0)).astype(float) * (1.0, 0.9, 0.55)
    before, after = frame.mean(axis=(0, 1)), white_balance(frame.astype(np.uint8)).mean(axis=(0, 1))
    assert np.ptp(before) > 25
    assert np.ptp(after) < 3


def test_a_plane_without_light_is_not_blown_up_to_noise():
    frame = np.full((60, 80, 3), 100, np.uint8)
    frame[:, :, 2] = 4
    assert white_balance(frame)[:, :, 2].max() == 10  # 2.5 times, no more


def test_a_veil_is_lifted():
    veiled = (0.3 * ball_frame((0.0, 0.0, 1.0)) + 130).astype(np.uint8)
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).std() for image in (veiled, classic(veiled))]
    assert grey[1] > 1.5 * grey[0]


def test_shape_and_type_stay_and_the_input_is_left_alone():
    frame = ball_frame((0.0, 0.0, 1.0))
    kept = frame.copy()
    out = classic(frame)
    assert out.shape == frame.shape and out.dtype == np.uint8
    assert np.array_equal(frame, kept)


WHOLE = (64, 48)
IMAGE = np.full((48, 64, 3), 60, np.uint8)
PART = Roi(16, 8, 24, 16)


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def doubling(clock, cost_s=0.04):
    """An estimate that takes `cost_s` and doubles all values."""
    affine = np.zeros((3, 4, 3, 4), np.float32)
    affine[..., :3] = 2 * np.eye(3)

    def estimate(image):
        clock.now_s += cost_s
        return Colours(affine, (image.shape[1], image.shape[0]))

    return Enhancer("fast", lambda image: image, estimate)


ALL = Roi(0, 0, *WHOLE)


def frame(t_ns, roi=ALL):
    return Frame(t_ns, 0, IMAGE[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width], roi)


def test_parts_of_later_frames_use_the_colours_of_a_whole_one():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert (enhancer.view(frame(0), WHOLE) == 120).all()
    spent_s = clock.now_s
    assert (enhancer.view(frame(DUE_NS * 4, PART), WHOLE) == 120).all()
    assert enhancer.view(frame(DUE_NS * 4, PART), WHOLE).shape == (16, 24, 3)
    assert clock.now_s == spent_s
    assert (enhancer.frames, enhancer.raw) == (3, 0)


def test_without_young_colours_a_frame_is_raw_and_counted():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert (enhancer.view(frame(0, PART), WHOLE) == 60).all()
    enhancer.view(frame(1), WHOLE)
    assert (enhancer.view(frame(OLD_NS + 2, PART), WHOLE) == 60).all()
    assert (enhancer.frames, enhancer.raw) == (3, 2)


def test_estimates_keep_to_their_share_of_a_core():
    """An estimate of a second on a busy machine: the next one is made when four have passed."""
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock, 1.0), clock)
    spent_s, started_s = 0.0, clock.now_s
    for k in range(200):
        before_s = clock.now_s
        enhancer.view(frame(k * DUE_NS), WHOLE)
        spent_s += clock.now_s - before_s
        clock.now_s += DUE_NS / 1e9
    assert 0 < spent_s <= SHARE * (clock.now_s - started_s) + 1.0
    assert enhancer.raw < 150


def test_the_classic_way_needs_no_estimate():
    enhancer = OnDemandEnhancer(Enhancer("classic", lambda image: image + 1))
    assert (enhancer.view(frame(0, PART), WHOLE) == 61).all()
    assert enhancer.raw == 0 and not enhancer.wants_whole(0)


def test_one_frame_for_two_targets_counts_once():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    one = frame(0)
    assert enhancer.view(one, WHOLE) is enhancer.view(one, WHOLE)
    assert enhancer.frames == 1


class Seen(NamedTuple):
    value: int
    score: float


def seen_from(least, score):
    """Finds something in pictures of at least this brightness."""
    return lambda image: Seen(int(image[0, 0, 0]), score) if image[0, 0, 0] >= least else None


def test_what_the_raw_frame_shows_costs_nothing():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert enhancer.look(seen_from(50, 0.1), frame(0), WHOLE) == (60, 0.1)
    assert clock.now_s == 100.0 and not enhancer.wants_whole(2 * OLD_NS)


def test_what_it_does_not_show_is_looked_for_in_the_enhanced_one():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert enhancer.look(seen_from(100, 0.1), frame(0), WHOLE) == (120, 0.1)
    assert enhancer.look(seen_from(200, 1.0), frame(2), WHOLE) is None


def test_whole_frames_are_wanted_while_colours_are_needed_and_old():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    enhancer.look(seen_from(100, 1.0), frame(0), WHOLE)
    assert enhancer.wants_whole(OLD_NS) and not enhancer.wants_whole(2)
    enhancer.look(seen_from(50, 1.0), frame(OLD_NS), WHOLE)
    assert not enhancer.wants_whole(OLD_NS)


# --- what needs nothing ---


def in_air():
    """Red to blue things over a grey floor."""
    image = np.full((240, 320, 3), 110, np.uint8)
    for k, colour in enumerate([(30, 30, 220), (30, 160, 230), (200, 60, 30), (240, 240, 240), (10, 10, 10)]):
        cv2.circle(image, (40 + 60 * k, 120), 25, colour, -1)
    return image


def test_a_picture_as_in_air_is_left_as_it_is_and_under_water_it_is_not():
    image = in_air()
    assert needs_nothing(image) == 1.0
    assert np.array_equal(apply_colours(estimate_colours(image, matrix), image), image)
    assert np.array_equal(enhancer("classic").apply(image), image)
    under = (image * [0.9, 0.8, 0.3]).astype(np.uint8)
    assert needs_nothing(under) == 0.0
    assert np.array_equal(enhancer("classic").apply(under), classic(under))


def test_blue_water_with_no_warm_thing_in_it_is_not_taken_for_air():
    image = in_air()
    image[:, :, 2] = np.minimum(image[:, :, 2], 0.8 * np.maximum(image[:, :, 0], image[:, :, 1])).astype(np.uint8)
    assert needs_nothing(image) == 0.0


def test_a_burnt_out_sky_over_green_water_says_nothing_of_it():
    image = (in_air() * [0.5, 0.8, 0.2]).astype(np.uint8)
    image[:60] = 255
    assert needs_nothing(image) == 0.0
    assert needs_nothing(np.full_like(image, 255)) == 1.0  # nothing can be brought back


def test_pools_seen_with_the_sky_above_are_not_left_alone():
    try:
        folder = shared("real_water", "balls")
    except ConfigError as absent:
        pytest.skip(str(absent))
    assert max(needs_nothing(cv2.imread(str(path))) for path in sorted(folder.glob("*.jpg"))) == 0.0


def test_real_pictures_that_need_it_are_told_from_those_that_do_not():
    """None of the raw pictures that people have made better is left alone; nine in ten of what they made of them is."""
    try:
        folder = shared("underwater_pairs")
    except ConfigError as absent:
        pytest.skip(str(absent))
    raw, made = ([cv2.imread(str(path)) for path in sorted((folder / sub).iterdir())] for sub in ("raw", "reference"))
    assert max(map(needs_nothing, raw)) == 0.0
    assert np.mean([needs_nothing(image) == 1.0 for image in made]) >= 0.9


def test_blue_water_that_needs_nothing_stays_blue():
    try:
        folder = shared("real_water", "failing", "enhance")
    except ConfigError as absent:
        pytest.skip(str(absent))
    raw, reference = (cv2.imread(str(folder / f"709_{which}.png")) for which in ("raw", "reference"))
    assert psnr(enhance(raw), reference) > psnr(raw, reference) - 0.3
