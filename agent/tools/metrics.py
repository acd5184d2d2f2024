"""How good a picture is: PSNR, SSIM and warm colours against a reference, UCIQE and UIQM without one.

Pictures are (height, width, 3) uint8, blue green red. PSNR is one figure over all three colours, SSIM is taken on
grey: other programs take the mean over colours, or stretch the output first, and print other numbers. UCIQE and UIQM
depend on scales which their papers leave open; compare them within one table only.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.tools.warm import Kept, kept_hue

Image = NDArray[np.uint8]
Plane = NDArray[np.float64]

SSIM_TAPS, SSIM_SIGMA = 11, 1.5  # Wang et al. 2004
C1, C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2  # the same paper's, for 8 bits
BLOCK = 10  # px, side of UIQM's blocks
TRIMMED = 0.1  # of the pixels at either end do not vote in UIQM's colour


class Quality(NamedTuple):
    """The figures of one picture."""

    psnr_db: float
    ssim: float
    uciqe: float
    uiqm: float
    warm: Kept  # pixels that are warm and vivid in the reference, and those of them that have its hue


def judge(image: Image, reference: Image) -> Quality:
    """All figures of a picture; raises ValueError if the sizes differ."""
    if image.shape != reference.shape:
        raise ValueError(f"picture of {image.shape} against reference of {reference.shape}")
    return Quality(
        psnr(image, reference), ssim(image, reference), uciqe(image), uiqm(image), kept_hue(image, reference)
    )


def psnr(image: Image, reference: Image) -> float:
    """Peak signal to noise ratio in dB over all pixels and colours; infinite for equal pictures."""
    error = np.mean((image.astype(float) - reference) ** 2)
    return float("inf") if error == 0 else float(10 * np.log10(255**2 / error))


def ssim(image: Image, reference: Image) -> float:
    """Structural similarity of the grey pictures (Wang et al. 2004), without the rim where the window sticks out.

    Pictures smaller than the window are compared with the rim.
    """
    x, y = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(float) for picture in (image, reference))
    mx, my = _smooth(x), _smooth(y)
    xx, yy, xy = _smooth(x * x) - mx * mx, _smooth(y * y) - my * my, _smooth(x * y) - mx * my
    alike = (2 * mx * my + C1) * (2 * xy + C2) / ((mx * mx + my * my + C1) * (xx + yy + C2))
    rim = SSIM_TAPS // 2
    inside = alike[rim:-rim, rim:-rim]
    return float((inside if inside.size else alike).mean())


def uciqe(image: Image) -> float:
    """Spread of chroma, contrast of lightness, mean saturation (Yang and Sowmya 2015); CIELAB over 100."""
    lab = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_BGR2LAB).astype(float) / 100
    lightness, chroma = lab[:, :, 0], np.hypot(lab[:, :, 1], lab[:, :, 2])
    low, high = np.percentile(lightness, (1, 99))
    saturation = chroma / np.maximum(np.hypot(chroma, lightness), 1e-6)
    return float(0.4680 * chroma.std() + 0.2745 * (high - low) + 0.2576 * saturation.mean())


def uiqm(image: Image) -> float:
    """Colourfulness, sharpness and contrast (Panetta, Gao and Agaian 2016); block contrast without PLIP arithmetic."""
    blue, green, red = (image[:, :, c].astype(float) for c in range(3))
    edges = [_edges(plane) * plane for plane in (red, green, blue)]
    sharpness = sum(w * _log_ratio(plane) for w, plane in zip((0.299, 0.587, 0.114), edges, strict=True))
    contrast = _michelson_entropy(image.astype(float).mean(axis=2))
    return float(
        0.0282 * _colourfulness(red - green, (red + green) / 2 - blue) + 0.2953 * sharpness + 3.5753 * contrast
    )


def _smooth(plane: Plane) -> Plane:
    return np.asarray(cv2.GaussianBlur(plane, (SSIM_TAPS, SSIM_TAPS), SSIM_SIGMA), np.float64)


def _edges(plane: Plane) -> Plane:
    """Sobel magnitude, the strongest edge 255."""
    magnitude = np.hypot(cv2.Sobel(plane, cv2.CV_64F, 1, 0), cv2.Sobel(plane, cv2.CV_64F, 0, 1))
    return magnitude * (255 / max(float(magnitude.max()), 1e-6)) / 255


def _colourfulness(red_green: Plane, yellow_blue: Plane) -> float:
    means, variances = [], []
    for plane in (red_green, yellow_blue):
        values = np.sort(plane, axis=None)
        cut = int(TRIMMED * values.size)
        mean = values[cut : values.size - cut].mean()
        means.append(mean)
        variances.append(((values - mean) ** 2).mean())
    return float(-0.0268 * np.hypot(*means) + 0.1586 * np.sqrt(sum(variances)))


def _extremes(plane: Plane) -> tuple[Plane, Plane]:
    """Smallest and largest value of each block; a picture smaller than a block is one block."""
    h, w = min(BLOCK, plane.shape[0]), min(BLOCK, plane.shape[1])
    rows, columns = plane.shape[0] // h, plane.shape[1] // w
    blocks = plane[: rows * h, : columns * w].reshape(rows, h, columns, w)
    return blocks.min((1, 3)), blocks.max((1, 3))


def _log_ratio(plane: Plane) -> float:
    """EME: 2 mean(log(max / min)) over the blocks; those that reach zero count as flat."""
    low, high = _extremes(plane)
    good = (low > 0) & (high > 0)
    return float(2 * np.log(np.where(good, high, 1) / np.where(good, low, 1)).mean())


def _michelson_entropy(plane: Plane) -> float:
    """-mean(m log m) over the blocks, m = (max - min) / (max + min)."""
    low, high = _extremes(plane)
    m = (high - low) / np.maximum(high + low, 1e-6)
    return float(-(m * np.log(np.where(m > 0, m, 1))).mean())
