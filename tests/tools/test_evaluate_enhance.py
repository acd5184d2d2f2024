import cv2
import numpy as np
import pytest

from agent.tools.evaluate_enhance import hue_kept, judge, kept_hue, kept_warm, psnr, ssim, summary, uciqe, uiqm, warm


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


NAMED = {  # blue green red
    "red": (20, 20, 200), "orange": (20, 120, 230), "yellow": (20, 220, 230), "crimson": (60, 20, 180),
    "olive": (20, 110, 105), "green": (40, 160, 40), "chartreuse": (20, 220, 120), "blue": (200, 80, 20),
    "magenta": (180, 20, 180), "sand": (120, 140, 150), "grey": (90, 90, 90),
}  # fmt: skip


def plain(name: str) -> np.ndarray:
    return np.full((4, 5, 3), NAMED[name], np.uint8)


def test_red_to_yellow_is_warm_and_sand_green_and_violet_are_not():
    assert {name for name in NAMED if warm(plain(name)).all()} == {"red", "orange", "yellow", "crimson", "olive"}
    assert not any(warm(plain(name)).any() for name in ("green", "chartreuse", "blue", "magenta", "sand", "grey"))


@pytest.mark.parametrize(("was", "comes_out", "kept"), [
    ("orange", "orange", True), ("red", "yellow", False), ("orange", "olive", False),
    ("yellow", "chartreuse", False), ("yellow", "green", False), ("red", "grey", False), ("yellow", "blue", False),
])  # fmt: skip
def test_hue_is_kept_within_25_degrees_and_not_in_grey(was, comes_out, kept):
    assert kept_hue(plain(comes_out), plain(was)) == (20, 20 if kept else 0)


def test_hues_are_near_across_nought():
    crimson = cv2.cvtColor(np.array([[(50, 60, v)] for v in (2, -2)], np.float32), cv2.COLOR_LAB2BGR)
    below, above = (np.full((2, 2, 3), np.clip(c * 255, 0, 255)[0].round(), np.uint8) for c in crimson)
    assert kept_hue(above, below).kept == kept_hue(above, below).pixels == 4


def test_without_a_reference_only_what_was_warm_counts():
    image = np.hstack([plain("red"), plain("green"), plain("yellow")])
    where = np.ones(image.shape[:2], bool)
    where[:, :2] = False
    assert kept_warm(image, image, where) == (32, 32)
    assert kept_warm(np.hstack([plain("red"), plain("red"), plain("green")]), image, where) == (32, 12)


def test_pictures_made_worse_are_counted_and_pixels_are_pooled():
    reference = np.hstack([plain("red"), plain("grey")])
    raw, slightly, much = (reference - np.uint8(step) for step in (10, 10, 20))
    before = [judge(raw, reference)] * 2
    found = summary([judge(slightly, reference), judge(much, reference)], before)
    assert found.made_worse == 0.5 and found.hue_kept == 1.0
    assert np.isnan(hue_kept([judge(plain("grey"), plain("grey"))]))
