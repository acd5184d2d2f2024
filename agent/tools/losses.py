"""What training minimises: RGB + LAB + LCH + (1 - SSIM), as LU2Net's authors train (arXiv 2406.14973), and the colour
of warm things.

Left out is their fifth term, the distance of VGG-19 features: its ImageNet weights are not ours to ship. Cross
entropies are means over pixels, not sums, and count CROSS_ENTROPY: they start an order above the distances and would
drown them.

Pictures are (n, 3, h, w), red green blue, 0 to 1; all losses are scalars.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as fn

CROSS_ENTROPY = 0.05
WARM = 1.0  # weight of the colour of warm things: about a third of the loss while they come out wrong
DULL = 20.0  # chroma up to which a colour is not vivid; twice that it is wholly (sand and rock stay below 30)
YELLOW = -0.364  # a over b at the hue of 110 degrees, the end of what is warm (warm.py)
LEAST_WARM = 0.01  # share of the pixels: fewer warm ones count less
AB_LEVELS, AB_RANGE = 7, 80.0  # soft bins of CIELAB's a and b
HUES_RAD = (0.0, math.pi / 2, math.pi, 3 * math.pi / 2)
SHARP, PALE = 4.0, 5.0  # slope of the hue bins; chroma below which hue means little
TAPS, SIGMA = 11, 1.5  # SSIM's window (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2
# sRGB to XYZ over the white of D65 (IEC 61966-2-1).
TO_XYZ = ((0.4339, 0.3762, 0.1899), (0.2126, 0.7152, 0.0722), (0.0178, 0.1095, 0.8727))


def loss(output: Tensor, target: Tensor) -> Tensor:
    """The sum of the five terms."""
    ours, theirs = to_lab(output), to_lab(target)
    distance = (output - target).abs().mean() + WARM * warm_loss(ours, theirs)
    return distance + lab_loss(ours, theirs) + lch_loss(ours, theirs) + 1 - tensor_ssim(output, target)


def to_lab(rgb: Tensor) -> Tensor:
    """sRGB -> CIELAB, L 0 to 100; values outside 0 to 1 are clipped."""
    c = rgb.clamp(1e-4, 1)
    linear = torch.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)
    t = torch.einsum("ij,njhw->nihw", torch.tensor(TO_XYZ, device=rgb.device), linear)
    x, y, z = torch.where(t > 0.008856, t ** (1 / 3), 7.787 * t + 16 / 116).unbind(1)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], 1)


def lab_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in lightness, and cross entropy of softly binned a and b; both arguments CIELAB."""
    lightness = (ours[:, 0] - theirs[:, 0]).abs().mean() / 100
    centres = torch.linspace(-AB_RANGE, AB_RANGE, AB_LEVELS, device=ours.device).view(-1, 1, 1, 1, 1)
    width = 2 * AB_RANGE / (AB_LEVELS - 1)
    bins = [-(((lab[:, 1:] - centres) / width) ** 2) for lab in (ours, theirs)]  # (levels, n, 2, h, w)
    return lightness + CROSS_ENTROPY * _cross_entropy(*bins)


def lch_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in lightness and chroma, and cross entropy of softly binned hue; both arguments CIELAB."""
    lightness = (ours[:, 0] - theirs[:, 0]).abs().mean() / 100
    chroma = [(lab[:, 1:].square().sum(1) + 1e-2).sqrt() for lab in (ours, theirs)]
    bins = [
        torch.stack([SHARP * (lab[:, 1] * math.cos(h) + lab[:, 2] * math.sin(h)) / (c + PALE) for h in HUES_RAD])
        for lab, c in zip((ours, theirs), chroma, strict=True)
    ]
    return lightness + (chroma[0] - chroma[1]).abs().mean() / 100 + CROSS_ENTROPY * _cross_entropy(*bins)


def warm_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in colour where the target is red to yellow and vivid, both CIELAB; a buoy is few pixels, so it counts
    by itself."""
    a, b = theirs[:, 1], theirs[:, 2]
    share = (((a * a + b * b).sqrt() - DULL) / DULL).clamp(0, 1) * ((b > 0) & (a > YELLOW * b))
    apart = ((ours[:, 1:] - theirs[:, 1:]).square().sum(1) + 1e-2).sqrt() - 0.1
    return (share * apart).sum() / (share.sum() + LEAST_WARM * share.numel()) / 100


def tensor_ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean structural similarity over colours and pixels, where the window fits."""
    mx, my, xx, yy, xy = _smooth(torch.cat([x, y, x * x, y * y, x * y], 1)).chunk(5, 1)
    sx, sy, sxy = xx - mx * mx, yy - my * my, xy - mx * my
    return ((2 * mx * my + C1) * (2 * sxy + C2) / ((mx * mx + my * my + C1) * (sx + sy + C2))).mean()


def _smooth(x: Tensor) -> Tensor:
    t = torch.arange(TAPS, dtype=x.dtype, device=x.device) - TAPS // 2
    window = fn.softmax(-t * t / (2 * SIGMA**2), 0)
    c = x.shape[1]
    x = fn.conv2d(x, window.view(1, 1, -1, 1).expand(c, 1, -1, 1), groups=c)
    return fn.conv2d(x, window.view(1, 1, 1, -1).expand(c, 1, 1, -1), groups=c)


def _cross_entropy(ours: Tensor, theirs: Tensor) -> Tensor:
    """Mean over everything but axis 0, which holds the bins' logits; zero where both agree."""
    log_ours, log_theirs = fn.log_softmax(ours, 0), fn.log_softmax(theirs, 0)
    return (log_theirs.exp() * (log_theirs - log_ours)).sum(0).mean()
