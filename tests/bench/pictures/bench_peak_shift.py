"""How far the focus peak moves when clarity is taken on enhanced frames, in each kind of water.

The views of the claim `depth`, one sweep each in every kind of water. The same frames are measured raw and after each
way of enhancement, block by block, so nothing but the enhancement differs. What a shift means in millimetres is the
slope of the lens equation at the raw peak: no calibration takes part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import msgspec
import numpy as np

from agent.core.config import WaterKind
from agent.core.ranging.focus import Array
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.still_camera import (
    BLOCK_PX,
    QUALITY,
    VIEWS,
    StillCamera,
    SweptView,
    breathing,
    lens_positions,
    mm_per_position,
    sweep_view,
)
from agent.perception.depth_sweep import DepthMap, clarity_of, measure
from agent.perception.enhancement.enhance import apply_colours, classic, enhancer, missing, one_thread
from hw.camera.camera import Image
from hw.twin.scene import SceneWater, load_scene

Sweep = list[Image]  # in its order


WAYS = {
    "classic": "white balance and CLAHE",
    "plain": "network, whole",
    "fast": "network, fast way",
    "held": "fast way, colours of the first frame",
}


def ways(plain: bool) -> dict[str, Callable[[Sweep], Sweep]]:
    """Each enhances a whole sweep: classic, and the network's ways where it is installed."""
    found: dict[str, Callable[[Sweep], Sweep]] = {"classic": lambda sweep: [classic(image) for image in sweep]}
    if missing(None) is None:
        fast = enhancer("fast")
        estimate = fast.estimate
        assert estimate is not None  # of the fast way it never is

        def held(sweep: Sweep) -> Sweep:
            colours = estimate(sweep[0])
            return [apply_colours(colours, image) for image in sweep]

        found |= {"fast": lambda sweep: [fast.apply(image) for image in sweep], "held": held}
        if plain:
            whole = enhancer("folded")  # equals it to 1e-5
            found["plain"] = lambda sweep: [whole.apply(image) for image in sweep]
    return found


def block_peaks(swept: SweptView) -> DepthMap:
    """The peak of every block; without a calibration there are no distances."""
    clarity = clarity_of(swept.images, swept.lens_positions, BLOCK_PX, swept.growth)
    return measure(clarity, BLOCK_PX, None, "matched", QUALITY)


def shifts(raw: list[DepthMap], after: list[DepthMap], slope: list[Array], step: float) -> Row:
    """How far peaks moved, over the blocks that have one before and after; empty where none has.

    step: of the sweep, in lens positions; slope: mm per lens position.
    """
    both = [a.blocks.accepted & b.blocks.accepted for a, b in zip(raw, after, strict=True)]
    moved = np.concatenate(
        [(b.blocks.lens_position - a.blocks.lens_position)[m] for a, b, m in zip(raw, after, both, strict=True)]
    )
    if not len(moved):
        return {}
    shift_mm = np.abs(moved * np.concatenate([s[m] for s, m in zip(slope, both, strict=True)]))
    return {
        "mean_steps": float(moved.mean() / step),
        "median_steps": float(np.median(np.abs(moved)) / step),
        "median_mm": float(np.median(shift_mm)),
        "p95_mm": float(np.quantile(shift_mm, 0.95)),
    }


# --- the claim ---

SHIFTS = ("mean_steps", "median_steps", "median_mm", "p95_mm")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    sensor: str = "imx519_640"  # a preset of hw.twin.optics.lens
    views: int = len(VIEWS)  # how many of them
    plain: bool = True  # the whole network too, a second a frame


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Sweep the first views in one kind of water; a row for each way. Raises Failed."""
    one_thread()  # so that the network's sums come out the same
    water = SceneWater(preset=msgspec.convert(case, WaterKind))
    camera = StillCamera(settings.sensor, seed, scene=msgspec.structs.replace(load_scene("tank"), water=water))
    camera.prepare()
    growth = breathing(camera)
    swept = [sweep_view(camera, view, growth) for view in VIEWS[: settings.views]]
    raw = [block_peaks(one) for one in swept]
    step = float(np.diff(lens_positions(camera)).mean())
    slope = [mm_per_position(camera.lens, one.blocks.lens_position) for one in raw]
    rows: list[Row] = []
    for way, enhance in ways(settings.plain).items():
        after = [block_peaks(one._replace(images=enhance(one.images))) for one in swept]
        blocks = {"raw": count(raw), "enhanced": count(after)}
        rows.append({"way": way, **blocks, **shifts(raw, after, slope, step)})
    return rows


def count(maps: list[DepthMap]) -> int:
    """Blocks that have a peak."""
    return sum(int(one.blocks.accepted.sum()) for one in maps)


def summary(rows: Rows) -> dict[str, Value]:
    """Of each way, over all kinds of water: means of what each sweep of the views has."""
    found: dict[str, Value] = {}
    for way in WAYS:
        of_way = [row for of_case in rows.values() for row in of_case if row["way"] == way]
        if not of_way:
            continue  # the network is not installed
        found[f"{way}_kept"] = (
            100.0 * sum(row["enhanced"] for row in of_way) / max(sum(row["raw"] for row in of_way), 1)
        )
        for key in SHIFTS:
            values = [row[key] for row in of_way if key in row]
            found[f"{way}_{key}"] = float(np.mean(values)) if values else None
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"views": 1, "plain": False},
    cases=get_args(WaterKind),
    by_default=("tap", "turbid"),  # the network is slow, and water makes little difference
    measured_on="twin",
    figures=tuple(
        figure
        for way, words in WAYS.items()
        for figure in (
            Figure(f"{way}_kept", f"{words}: blocks with a peak, of those of raw frames", "%"),
            Figure(f"{way}_mean_steps", f"{words}: mean shift of the peak", "steps"),
            Figure(f"{way}_median_steps", f"{words}: shift without its sign, median block", "steps"),
            Figure(f"{way}_median_mm", f"{words}: in range, median block", "mm"),
            Figure(f"{way}_p95_mm", f"{words}: in range, 95 % of the blocks", "mm"),
        )
    ),
    seeds=5,
    explanation="""The lens is swept over four views of the tank in thirty steps, and the peak of each block of
        50 x 50 pixels is found in raw frames and in the same frames enhanced. What a shift means in range is the slope
        of the lens equation. Each seed is another lens.""",
)
