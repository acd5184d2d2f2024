"""Depth across known edges: how many blocks with two depths are told one, and what is lost where there is no edge.

Limits were set on the first rows; of the pictures, it was chosen on those not called others what is asked of plain
parts, and the others were only counted afterwards. The shared pictures are left out where they are not. Without the
parts: how it was before blocks were split.
"""

from collections.abc import Iterable, Iterator

import cv2
import numpy as np

from agent.perception.depth_sweep import clarity_of, measure
from hw.camera.files import read_picture
from tests.bench.pictures.scenes import FRAMES, PHOTOGRAPHS, Stack, stacks
from tests.bench.pictures.score import Score, score
from tests.places import DATA

BLOCK_PX = 40  # of pictures of 400
PAIRS = (("pink", "leaves"), ("leaves", "pink"), ("fine", "coarse"), ("coarse", "leaves"))
PHOTOGRAPHED = {  # seeds and aperture
    "photographs": (range(20, 24), "disc"),
    "light_field": (range(30, 34), "views"),
    "other_photographs": (range(50, 56), "disc"),
    "other_light_fields": (range(60, 66), "views"),
}
REAL = {"bracket": DATA / "focal_stacks" / "bracket_simulated", "smooth": DATA / "real_water" / "stacks" / "cou_6"}


def run() -> dict[str, dict]:
    rows = rows_of("edges_tuned_on", made(0))
    rows |= rows_of("edges_other_seeds", made(10))
    if PHOTOGRAPHS.is_dir():
        for name, (seeds, aperture) in PHOTOGRAPHED.items():
            made_of = (s for seed in seeds for s in stacks("photograph", "photograph", seed, aperture))
            rows |= rows_of(f"edges_{name}", made_of)
    for name, folder in REAL.items():
        if folder.is_dir():
            rows |= rows_of(f"edges_{name}", [folder])
    return rows


def made(seed: int) -> Iterator[Stack]:
    for number, pair in enumerate(PAIRS):
        yield from stacks(*pair, seed + number)


def rows_of(name: str, sources: Iterable) -> dict[str, dict]:
    before, after = Score(), Score()
    for source in sources:
        images, positions, truth, edges, known = truth_of(source)
        span = float(np.ptp(positions))
        maps = (measure(clarity_of(images, positions, BLOCK_PX, 0.0, split=s), BLOCK_PX, None) for s in (False, True))
        old, new = (score(found, truth, edges, known, span) for found in maps)
        before, after = before + old, after + new
    rows = {}
    if after.across:
        rows = {
            f"{name}_blocks_told_one_depth": share(after.across_whole, after.across, before.across_whole),
            f"{name}_area_told_wrong": share(after.across_wrong, after.across, before.across_wrong),
            f"{name}_area_told": share(after.across_told, after.across, before.across_told),
            f"{name}_parts_wrong": row(after.across_parts_wrong / max(after.across_parts, 1), "of parts", "", None),
        }
    return rows | {
        f"{name}_no_edge_whole": share(after.plain_whole, after.plain, before.plain_whole),
        f"{name}_no_edge_area_told": share(after.plain_told, after.plain, before.plain_told),
        f"{name}_no_edge_area_wrong": share(after.plain_wrong, after.plain, before.plain_wrong),
    }


def truth_of(source) -> tuple:
    """Images, lens positions, truth, where it jumps, where it is known."""
    if isinstance(source, Stack):
        return source.images, np.arange(float(FRAMES)), source.truth, jumps(source.truth, 1.0), source.truth > 0
    table = [line.split(",") for line in (source / "positions.csv").read_text().split()[1:]]
    positions = np.array([float(position) for _, position in table])
    images = [read_picture(source / name, grey=True) for name, _ in table]
    with np.load(source / "truth.npz") as truth:
        depth, mask = truth["depth"].astype(float), truth["mask"]
    step = float(np.diff(positions).mean())
    if source.name == "cou_6":  # all of it is a surface, but near the border nobody says where
        return images, positions, depth, jumps(depth, 4 * step) & mask, mask
    there = np.where(mask, depth, np.nan)  # an object, and nothing behind it
    outline = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    return images, positions, there, jumps(depth, step) & mask | outline, np.ones(mask.shape, bool)


def jumps(depth: np.ndarray, least: float) -> np.ndarray:
    """Where depth changes by more than `least` from pixel to pixel."""
    return np.hypot(*np.gradient(depth)) > least / 2


def share(count: float, of: float, before: float) -> dict:
    return row(count / max(of, 1), "share", f"before: {before / max(of, 1):.3f}", count / before if before else None)


def row(value: float, unit: str, against: str, ratio: float | None) -> dict:
    return {"value": float(value), "unit": unit, "against": against, "ratio": None if ratio is None else float(ratio)}
