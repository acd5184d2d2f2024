"""How far the focus peak moves when clarity is taken on enhanced frames, in each kind of water.

The views of `aucamp experiment depth`, one sweep each in every kind of water. The same frames are measured raw and
after each way of enhancement, block by block, so nothing but the enhancement differs. What a shift means in
millimetres is the slope of the lens equation at the raw peak: no calibration takes part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np
from rich.table import Table

from agent.core.config import WaterKind
from agent.core.ranging.focus import Array
from agent.experiments.experiment import DEFAULT_SENSOR, WATERS, ExperimentResult, Row, Sensor
from agent.experiments.still_camera import (
    BLOCK_PX,
    QUALITY,
    VIEWS,
    WATER_INDEX,
    StillCamera,
    SweptView,
    breathing,
    lens_positions,
    sweep_view,
)
from agent.perception.depth_sweep import DepthMap, clarity_of, measure
from agent.perception.enhancement.enhance import apply_colours, classic, enhancer, missing
from agent.process.command import Progress, step_by_step
from hw.camera.camera import Image
from hw.twin.optics.lens import Lens
from hw.twin.scene import SceneWater, load_scene

Sweep = list[Image]  # in its order


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the world
    sensor: Sensor = DEFAULT_SENSOR
    waters: tuple[WaterKind, ...] = WATERS
    views: int = len(VIEWS)  # how many of them


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row in `cases` for each water and way to enhance."""

    schema: int = 1
    source: str = "twin"
    seed: int
    sensor: str
    views: int
    cases: list[Row]


class Way(NamedTuple):
    """One way to enhance a whole sweep."""

    name: str
    enhance: Callable[[Sweep], Sweep]


def ways() -> list[Way]:
    """Classic, and the network's ways where it is installed; `plain` is computed folded, which equals it to 1e-5."""
    found = [Way("classic", lambda sweep: [classic(image) for image in sweep])]
    if missing(None) is None:
        plain, fast = enhancer("folded"), enhancer("fast")
        estimate = fast.estimate
        assert estimate is not None  # of the fast way it never is

        def held(sweep: Sweep) -> Sweep:
            colours = estimate(sweep[0])
            return [apply_colours(colours, image) for image in sweep]

        found.append(Way("plain", lambda sweep: [plain.apply(image) for image in sweep]))
        found.append(Way("fast", lambda sweep: [fast.apply(image) for image in sweep]))
        found.append(Way("fast, colours of the first frame", held))
    return found


def run(settings: Settings, progress: Progress) -> Result:
    """Sweep the first views in each water; progress counts sweeps."""
    step = step_by_step(progress, len(settings.waters) * settings.views)
    views, by = VIEWS[: settings.views], ways()
    cases: list[Row] = []
    growth = None  # of the picture over a sweep: the lens's, whatever the water
    for water in settings.waters:
        scene = msgspec.structs.replace(load_scene("tank"), water=SceneWater(preset=water))
        camera = StillCamera(settings.sensor, settings.seed, scene=scene)
        camera.prepare()
        growth = breathing(camera) if growth is None else growth
        raw, after = [], {way.name: list[DepthMap]() for way in by}
        for view in views:
            swept = sweep_view(camera, view, growth)
            raw.append(block_peaks(swept))
            for way in by:
                after[way.name].append(block_peaks(swept._replace(images=way.enhance(swept.images))))
            step()
        between = float(np.diff(lens_positions(camera)).mean())
        slope = [mm_per_position(camera.lens, one.blocks.lens_position) for one in raw]
        for name, maps in after.items():
            cases.append({"water": water, "way": name, **shifts(raw, maps, slope, between)})
    return Result(seed=settings.seed, sensor=settings.sensor, views=len(views), cases=cases)


def block_peaks(swept: SweptView) -> DepthMap:
    """The peak of every block; without a calibration there are no distances."""
    clarity = clarity_of(swept.images, swept.lens_positions, BLOCK_PX, swept.growth)
    return measure(clarity, BLOCK_PX, None, "matched", QUALITY)


def mm_per_position(lens: Lens, lens_position: Array) -> Array:
    """|d range / d rho|, mm per lens position: vergence 1/f - 1/v, range = index / vergence under water."""
    v_m = lens.at_position_m(0.0) + lens.per_position_m * lens_position
    vergence = 1.0 / lens.focal_m - 1.0 / v_m
    return np.asarray(1e3 * WATER_INDEX / vergence**2 / v_m**2 * abs(lens.per_position_m), np.float64)


def shifts(raw: list[DepthMap], after: list[DepthMap], slope: list[Array], step: float) -> Row:
    """How far peaks moved, over the blocks that have one before and after.

    step: of the sweep, in lens positions; slope: mm per lens position.
    """
    both = [a.blocks.accepted & b.blocks.accepted for a, b in zip(raw, after, strict=True)]
    moved = np.concatenate(
        [(b.blocks.lens_position - a.blocks.lens_position)[m] for a, b, m in zip(raw, after, both, strict=True)]
    )
    shift_mm = np.abs(moved * np.concatenate([s[m] for s, m in zip(slope, both, strict=True)]))
    size = np.abs(moved) / step
    before = sum(int(a.blocks.accepted.sum()) for a in raw)
    counts = {"blocks_raw": before, "blocks": int(sum(b.blocks.accepted.sum() for b in after)), "common": len(size)}
    if not len(size):
        return counts
    return {
        **counts,
        "mean_steps": float(moved.mean() / step),
        "median_steps": float(np.median(size)),
        "p95_steps": float(np.quantile(size, 0.95)),
        "median_mm": float(np.median(shift_mm)),
        "p95_mm": float(np.quantile(shift_mm, 0.95)),
    }


# --- table ---

COLUMNS = {"mean_steps": "+.2f", "median_steps": ".2f", "p95_steps": ".2f", "median_mm": ".1f", "p95_mm": ".1f"}


def table(result: Result) -> Table:
    """Shifts of the peak: a line for each water and way to enhance."""
    shown = Table(title=f"{result.sensor}, {result.views} views: shift of the focus peak, enhanced against raw")
    for column in ("water", "way"):
        shown.add_column(column)
    for column in ("blocks, raw", "enhanced", "mean steps", "median", "95 %", "median mm", "95 %"):
        shown.add_column(column, justify="right")
    for case in result.cases:
        cells = (format(case[name], how) if name in case else "-" for name, how in COLUMNS.items())
        shown.add_row(case["water"], case["way"], str(case["blocks_raw"]), str(case["blocks"]), *cells)
    return shown
