"""`aucamp enhance --evaluate RAW REFERENCE`: figures of merit of every way, picture by picture, against references.

Protocol: pictures of the same name (their endings may differ), scaled to 256x256 by area or as `--size` says, enhanced
there, clipped and rounded to 8 bits. PSNR over the three colours together; SSIM of the grey pictures, window 11,
sigma 1.5; UCIQE and UIQM of the enhanced picture alone. Hue kept: of the pixels that are warm and vivid in the
reference, those that have its hue (warm.py). Made worse: pictures with a PSNR 0.3 dB below that of the raw one.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import Enhancer, enhancer, shipped_files, shipped_weights
from agent.perception.enhancement.grey_world import Image, clahe, classic, white_balance
from agent.perception.enhancement.variants import Variant
from agent.process.command import Progress, with_bar
from agent.tools.metrics import Quality, judge
from agent.tools.pairs import Size, paired, read_pair
from agent.tools.summary import Summary, cells, hue_kept, percent, summary, table

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
