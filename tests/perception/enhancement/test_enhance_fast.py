import cv2
import numpy as np
import pytest

from agent.perception.enhancement.enhance import Colours, apply_colours, estimate_colours, guided_filter, red_share

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
