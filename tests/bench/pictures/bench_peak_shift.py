"""How far the focus peak moves when clarity is taken on enhanced frames, in each kind of water.

The same frames are measured raw and after each way of enhancement, block by block, so nothing but the enhancement
differs. What a shift means in millimetres is the slope of the lens equation at the raw peak: no calibration takes part.
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
    "fast": "network, fast way",
    "held": "fast way, colours of the first frame",
}


def ways() -> dict[str, Callable[[Sweep], Sweep]]:
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
SENSOR = "imx519_640"


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    views: int = len(VIEWS)  # how many of them


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Sweep the first views in one kind of water; a row for each way. Raises Failed."""
    one_thread()  # so that the network's sums come out the same
    water = SceneWater(preset=msgspec.convert(case, WaterKind))
    camera = StillCamera(SENSOR, seed, scene=msgspec.structs.replace(load_scene("tank"), water=water))
    camera.prepare()
    growth = breathing(camera)
    swept = [sweep_view(camera, view, growth) for view in VIEWS[: settings.views]]
    raw = [block_peaks(one) for one in swept]
    step = float(np.diff(lens_positions(camera)).mean())
    slope = [mm_per_position(camera.lens, one.blocks.lens_position) for one in raw]
    rows: list[Row] = []
    for way, enhance in ways().items():
        after = [block_peaks(one._replace(images=enhance(one.images))) for one in swept]
        before, now = (sum(int(one.blocks.accepted.sum()) for one in maps) for maps in (raw, after))
        rows.append({"way": way, "raw": before, "enhanced": now, **shifts(raw, after, slope, step)})
    return rows


def summary(rows: Rows) -> dict[str, Value]:
    """Of each way, over all kinds of water: means of what each sweep of the views has."""
    found: dict[str, Value] = {}
    for way in WAYS:
        of_way = [row for of_case in rows.values() for row in of_case if row["way"] == way]
        if not of_way:
            continue  # the network is not installed
        raw, enhanced = (sum(row[key] for row in of_way) for key in ("raw", "enhanced"))
        found[f"{way}_kept"] = 100.0 * enhanced / max(raw, 1)
        for key in SHIFTS:
            values = [row[key] for row in of_way if key in row]
            found[f"{way}_{key}"] = float(np.mean(values)) if values else None
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"views": 1},
    cases=get_args(WaterKind),
    by_default=("tap", "turbid"),  # water makes little difference
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
