import cv2
import numpy as np
import pytest

from agent.tools.evaluate_enhance import judge, psnr, ssim, uciqe, uiqm


def picture() -> np.ndarray:
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (9, 12, 3), dtype=np.uint8)
    return cv2.resize(coarse, (96, 72), interpolation=cv2.INTER_CUBIC)


def test_psnr_of_a_known_error():
    grey = np.full((4, 5, 3), 100, np.uint8)
    assert psnr(grey, grey + np.uint8(10)) == pytest.approx(20 * np.log10(25.5))
    assert psnr(grey, grey) == float("inf")


def test_ssim_agrees_with_scikit_image():
    metrics = pytest.importorskip("skimage.metrics", reason="scikit-image is not installed")
    image = picture()
    worse = cv2.GaussianBlur(image, (0, 0), 2) // 2 + np.uint8(40)
    theirs = metrics.structural_similarity(
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
        cv2.cvtColor(worse, cv2.COLOR_BGR2GRAY),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    assert ssim(image, worse) == pytest.approx(theirs, abs=1e-3)
    assert ssim(image, image) == 1.0


def test_a_veil_lowers_every_figure():
    image = picture()
    veiled = (0.4 * image + 100).astype(np.uint8)
    assert uciqe(veiled) < 0.8 * uciqe(image)
    assert uiqm(veiled) < 0.8 * uiqm(image)


def test_the_smallest_picture_has_figures_and_sizes_must_agree():
    dot = np.full((1, 1, 3), 7, np.uint8)
    assert judge(dot, dot).ssim == 1.0
    with pytest.raises(ValueError, match="against reference"):
        judge(dot, picture())
