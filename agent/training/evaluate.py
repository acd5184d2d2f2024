"""`aucamp enhance --evaluate RAW REFERENCE`: figures of merit of every way, picture by picture, against references.

Protocol: pictures of the same name (their endings may differ), scaled to 256x256 by area or as `--size` says, enhanced
there, clipped and rounded to 8 bits. PSNR over the three colours together; SSIM of the grey pictures, window 11,
sigma 1.5; UCIQE and UIQM of the enhanced picture alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from agent.kernel.config import ConfigError
from agent.perception.enhancement.enhance import Enhancer, enhancer
from agent.perception.enhancement.grey_world import Image, clahe, classic, white_balance
from agent.perception.enhancement.variants import Variant
from agent.pictures.pairs import Size, paired, read_pair
from agent.progress import Progress, with_bar
from agent.training.metrics import Quality, judge

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
        console.print(table(figures, way.variant))
        console.print(means(figures))
    for problem in [*alone, *problems]:
        console.print(f"skipped: {problem}")
    return figures, 1 if problems or alone else 0


def ways(way: Enhancer, weights: Path | None) -> Ways:
    """What `way` is set beside: doing nothing, the simple ways, and the network in full and fast."""
    known: Ways = {"identity": lambda image: image, "grey-world": white_balance, "CLAHE": clahe}
    known["classic"] = classic
    if way.variant != "classic":
        known |= {"plain": enhancer("plain", weights).apply, "fast": enhancer("fast", weights).apply}
    return {**known, way.variant: way.apply}


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


def table(figures: Figures, variant: str) -> Table:
    """One way, picture by picture."""
    shown = Table(title=f"picture by picture: {variant}")
    for column in ("picture", "PSNR dB", "SSIM", "UCIQE", "UIQM"):
        shown.add_column(column, justify="left" if column == "picture" else "right")
    for name, by_way in figures.items():
        shown.add_row(name, *cells(np.array(by_way[variant])))
    return shown


def means(figures: Figures) -> Table:
    """All ways, over all pictures."""
    shown = Table(title=f"means over {len(figures)} pictures")
    for column in ("way", "PSNR dB", "SSIM", "UCIQE", "UIQM"):
        shown.add_column(column, justify="left" if column == "way" else "right")
    for way in next(iter(figures.values())):
        shown.add_row(way, *cells(np.mean([by_way[way] for by_way in figures.values()], axis=0)))
    return shown


def cells(quality: np.ndarray) -> list[str]:
    """The four figures of one line."""
    return [f"{quality[0]:.2f}", *(f"{value:.3f}" for value in quality[1:])]
