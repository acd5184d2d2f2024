"""`aucamp enhance --evaluate RAW REFERENCE`: figures of merit of every way, picture by picture, against references.

Protocol: pictures of the same name (their endings may differ), shrunk to 256x256 by area, enhanced there, clipped and
rounded to 8 bits. PSNR over the three colours together; SSIM of the grey pictures, window 11, sigma 1.5; UCIQE and
UIQM of the enhanced picture alone. `--native` enhances at the picture's own size and compares there.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agent.config import ConfigError
from agent.enhance_source import pictures, read
from agent.enhancement.metrics import Quality, judge
from agent.launch import with_bar
from agent.perception.enhance import Enhancer, Variant, enhancer
from agent.perception.grey_world import Image, classic, local_contrast, white_balance

SIZE = (256, 256)
Ways = dict[str, Callable[[Image], Image]]
Figures = dict[str, dict[str, Quality]]  # picture -> way -> figures


def run(
    raw: Path, reference: Path, variant: Variant, weights: Path | None, native: bool, console: Console
) -> tuple[Figures, int]:
    """Print the tables; the figures, and exit code 1 if a picture was skipped."""
    pairs = paired(raw, reference)
    way = enhancer(variant, weights)
    if way.why:
        console.print(f"{way.variant}: {way.why}")
    figures, problems = with_bar(console, "evaluate", lambda show: evaluate(pairs, ways(way, weights), native, show))
    if figures:
        console.print(table(figures, way.variant))
        console.print(means(figures))
    for problem in problems:
        console.print(f"skipped: {problem}")
    return figures, 1 if problems else 0


def ways(way: Enhancer, weights: Path | None) -> Ways:
    """What `way` is set beside: doing nothing, the simple ways, and the network in full and fast."""
    known: Ways = {"identity": lambda image: image, "grey-world": white_balance, "CLAHE": local_contrast}
    known["classic"] = classic
    if way.variant != "classic":
        known |= {"plain": enhancer("plain", weights).apply, "fast": enhancer("fast", weights).apply}
    return {**known, way.variant: way.apply}


def paired(raw: Path, reference: Path) -> list[tuple[Path, Path]]:
    """Files of the two folders with the same name; ConfigError unless there are some."""
    by_name = {path.stem: path for path in pictures(reference)}
    pairs = [(path, by_name[path.stem]) for path in pictures(raw) if path.stem in by_name]
    if not pairs:
        raise ConfigError(f"{raw} and {reference}: no two pictures of the same name; give folders that belong together")
    return pairs


def evaluate(
    pairs: list[tuple[Path, Path]], ways: Ways, native: bool, show: Callable[[int, int], None]
) -> tuple[Figures, list[str]]:
    figures: Figures = {}
    problems = []
    for done, (path, wanted) in enumerate(pairs, start=1):
        try:
            image, target = read(path), read(wanted)
        except ConfigError as error:
            problems.append(str(error))
        else:
            size = (target.shape[1], target.shape[0]) if native else SIZE
            image, target = (
                np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA), np.uint8) for p in (image, target)
            )
            figures[path.stem] = {name: judge(way(image), target) for name, way in ways.items()}
        show(done, len(pairs))
    return figures, problems


def table(figures: Figures, variant: str) -> Table:
    shown = Table(title=f"picture by picture: {variant}")
    for column in ("picture", "PSNR dB", "SSIM", "UCIQE", "UIQM"):
        shown.add_column(column, justify="left" if column == "picture" else "right")
    for name, by_way in figures.items():
        shown.add_row(name, *cells(np.array(by_way[variant])))
    return shown


def means(figures: Figures) -> Table:
    shown = Table(title=f"means over {len(figures)} pictures")
    for column in ("way", "PSNR dB", "SSIM", "UCIQE", "UIQM"):
        shown.add_column(column, justify="left" if column == "way" else "right")
    for way in next(iter(figures.values())):
        shown.add_row(way, *cells(np.mean([by_way[way] for by_way in figures.values()], axis=0)))
    return shown


def cells(quality: np.ndarray) -> list[str]:
    return [f"{quality[0]:.2f}", *(f"{value:.3f}" for value in quality[1:])]
