"""`aucamp enhance --evaluate RAW REFERENCE`: how good every way to enhance is, picture by picture, against references.

Protocol: pictures of the same name (their endings may differ), scaled to 256x256 by area or as `--size` says, enhanced
there, clipped and rounded to 8 bits. PSNR over the three colours together; SSIM of the grey pictures, window 11,
sigma 1.5; UCIQE and UIQM of the enhanced picture alone. Hue kept: of the pixels that are warm and vivid in the
reference, those that have its hue (`kept_warm`). Made worse: pictures with a PSNR 0.3 dB below that of the raw one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import (
    Enhancer,
    Image,
    Variant,
    clahe,
    classic,
    enhancer,
    shipped_files,
    shipped_weights,
    white_balance,
)
from agent.process.command import Progress, with_bar
from agent.tools.enhance import Size, paired, read_pair

# --- warm colours ---
# Whether warm colours stay warm: of the pixels that are red to yellow and vivid, how many still are.
#
# A red buoy that comes out olive costs a picture hardly a tenth of a decibel, and its finder everything. Hue and
# chroma are CIELAB's. Pictures are (height, width, 3) uint8, blue green red.

Mask = NDArray[np.bool_]

WARM_DEG = (0.0, 110.0)  # hue: sRGB's red lies at 40 degrees, orange at 70, yellow at 103; crimson is the lower end
VIVID = 30.0  # chroma from which a colour is vivid: sand and rock of 108 real references have less, but for 1 %
PALE = 10.0  # chroma below which nothing is left of it
NEAR_DEG = 25.0  # hue may move by: half of the way from red to yellow is 30


class Kept(NamedTuple):
    """Of `pixels` that are warm and vivid, `kept` are still warm."""

    pixels: int
    kept: int


def kept_hue(image: Image, reference: Image) -> Kept:
    """Kept: some chroma is left, and the hue lies within NEAR_DEG of the reference's."""
    hue, chroma = _hue_chroma(image)
    wanted, _ = _hue_chroma(reference)
    where = warm(reference)
    apart = np.abs((hue - wanted + 180) % 360 - 180)
    return _count(where, (apart <= NEAR_DEG) & (chroma >= PALE))


def kept_warm(image: Image, before: Image, where: Mask) -> Kept:
    """Where there is no reference: of the pixels of `where` that are warm in `before`, those still warm in `image`."""
    return _count(where & warm(before), warm(image, PALE))


def warm(image: Image, least_chroma: float = VIVID) -> Mask:
    """(height, width) of the pixels whose hue is from red to yellow."""
    hue, chroma = _hue_chroma(image)
    return np.asarray((hue >= WARM_DEG[0]) & (hue <= WARM_DEG[1]) & (chroma >= least_chroma))


def _count(where: Mask, good: Mask) -> Kept:
    return Kept(int(where.sum()), int((where & good).sum()))


def _hue_chroma(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Degrees 0 to 360, and chroma."""
    lab = cv2.cvtColor(image.astype(np.float32) / np.float32(255), cv2.COLOR_BGR2LAB)
    a, b = lab[:, :, 1], lab[:, :, 2]
    return np.asarray(np.degrees(np.arctan2(b, a)) % 360, np.float32), np.asarray(np.hypot(a, b), np.float32)


# --- quality of a picture ---
# How good a picture is: PSNR, SSIM and warm colours against a reference, UCIQE and UIQM without one.
#
# Pictures are (height, width, 3) uint8, blue green red. PSNR is one figure over all three colours, SSIM is taken on
# grey: other programs take the mean over colours, or stretch the output first, and print other numbers. UCIQE and
# UIQM depend on scales which their papers leave open; compare them within one table only.

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


# --- summary of several ways ---
# Several enhancements side by side: means over the pictures, colours kept, and how many pictures were made worse.

WORSE_DB = 0.3  # below the picture as it was: less is not seen


class Summary(NamedTuple):
    """Means over the pictures; `hue_kept` over their warm and vivid pixels together, not a number where none is."""

    psnr_db: float
    ssim: float
    uciqe: float
    uiqm: float
    hue_kept: float
    made_worse: float  # share of the pictures


def summary(after: Sequence[Quality], before: Sequence[Quality]) -> Summary:
    """`before`: the figures of the pictures as they were, in the same order."""
    psnr_db, ssim, uciqe, uiqm = np.mean([q[:4] for q in after], axis=0).tolist()
    worse = np.mean([ours.psnr_db < theirs.psnr_db - WORSE_DB for ours, theirs in zip(after, before, strict=True)])
    return Summary(psnr_db, ssim, uciqe, uiqm, hue_kept(after), float(worse))


def hue_kept(figures: Sequence[Quality]) -> float:
    """Share of the pixels that are warm and vivid in the references; not a number where none is."""
    pixels = sum(q.warm.pixels for q in figures)
    return sum(q.warm.kept for q in figures) / pixels if pixels else math.nan


def table(rows: Mapping[str, Summary], title: str) -> Table:
    """A line for each way."""
    shown = Table(title=title)
    for column in ("way", "PSNR dB", "SSIM", "UCIQE", "UIQM", "hue kept", "made worse"):
        shown.add_column(column, justify="left" if column == "way" else "right")
    for way, s in rows.items():
        shown.add_row(way, *cells(s[:4]), percent(s.hue_kept), percent(s.made_worse))
    return shown


def cells(figures: Sequence[float]) -> list[str]:
    """PSNR, SSIM, UCIQE and UIQM of one line."""
    return [f"{figures[0]:.2f}", *(f"{value:.3f}" for value in figures[1:])]


def percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.0f} %"


# --- evaluation ---

OWN_SIZE = "own"  # as --size: each picture as large as it is
LEAST_PX = 16  # a side; SSIM's window has 11

Ways = dict[str, Callable[[Image], Image]]
Figures = dict[str, dict[str, Quality]]  # picture -> way -> figures


def run(
    raw: Path, reference: Path, variant: Variant, weights: Path | None, size: str, console: Console
) -> tuple[Figures, int]:
    """Print the tables; the figures, and exit code 1 if a picture was skipped. Raises ConfigError."""
    wanted = parse_size(size)
    pairs, alone = paired(raw, reference)
    way = enhancer(variant, weights, budget_ms=None)
    if way.why:
        console.print(f"{way.variant}: {way.why}")
    figures, problems = with_bar(console, "evaluate", lambda show: evaluate(pairs, ways(way, weights), wanted, show))
    if figures:
        console.print(picture_table(figures, judged(way, weights)))
        console.print(table(means(figures), f"means over {len(figures)} pictures, by {way.variant}"))
    for problem in [*alone, *problems]:
        console.print(f"skipped: {problem}")
    return figures, 1 if problems or alone else 0


def ways(way: Enhancer, weights: Path | None) -> Ways:
    """What the way called judged(...) is set beside: doing nothing, the simple ways, all weights that are shipped, and
    the judged ones in full."""
    known: Ways = {"identity": lambda image: image, "grey-world": white_balance, "CLAHE": clahe}
    known["classic"] = classic
    if way.variant != "classic":
        known |= {name: enhancer(way.variant, file).apply for name, file in shipped_files().items()}
        known[f"{judged(way, weights)}, plain"] = enhancer("plain", weights).apply
    return {**known, judged(way, weights): way.apply}


def judged(way: Enhancer, weights: Path | None) -> str:
    """Name of the weights that were asked for; of the way, where it has none."""
    if way.variant == "classic":
        return way.variant
    return weights.name if weights else shipped_weights().stem


def parse_size(text: str) -> Size | None:
    """WIDTHxHEIGHT, or None for OWN_SIZE. Raises ConfigError."""
    if text == OWN_SIZE:
        return None
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= LEAST_PX):
        raise ConfigError(f"--size {text}: write WIDTHxHEIGHT such as 640x480, {LEAST_PX} at least, or {OWN_SIZE}")
    return int(width), int(height)


def evaluate(
    pairs: list[tuple[Path, Path]], ways: Ways, size: Size | None, show: Progress
) -> tuple[Figures, list[str]]:
    """Figures of each pair, and a line for each that cannot be compared."""
    figures: Figures = {}
    problems = []
    for done, (path, wanted) in enumerate(pairs, start=1):
        try:
            image, target = read_pair(path, wanted, size)
        except ConfigError as error:
            problems.append(str(error))
        else:
            figures[path.stem] = {name: judge(way(image), target) for name, way in ways.items()}
        show(done, len(pairs))
    return figures, problems


def picture_table(figures: Figures, way: str) -> Table:
    """One way, picture by picture."""
    shown = Table(title=f"picture by picture: {way}")
    for column in ("picture", "PSNR dB", "SSIM", "UCIQE", "UIQM", "hue kept"):
        shown.add_column(column, justify="left" if column == "picture" else "right")
    for name, by_way in figures.items():
        shown.add_row(name, *cells(by_way[way][:4]), percent(hue_kept([by_way[way]])))
    return shown


def means(figures: Figures) -> dict[str, Summary]:
    """Each way, over all pictures."""
    by_way = {way: [of[way] for of in figures.values()] for way in next(iter(figures.values()))}
    return {way: summary(found, by_way["identity"]) for way, found in by_way.items()}
