"""`aucamp experiment peak-shift`: how far the focus peak moves when clarity is taken on enhanced frames, per water.

The views of `aucamp experiment depth`, one sweep each in every kind of water. The same frames are measured raw and
after each way of enhancement, block by block, so nothing but the enhancement differs. What a shift means in
millimetres is the slope of the lens equation at the raw peak: no calibration takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from agent.depth_sweep import DepthMap, clarity_of, measure
from agent.experiments.ball_views import WATERS, check_views
from agent.experiments.depth import QUALITY, VIEWS, WATER, Taken, take
from agent.experiments.result import make_room, write_result
from agent.experiments.still import StillCamera
from agent.experiments.wall import BLOCK_PX, breathing
from agent.launch import run_folder, with_bar
from agent.perception import fast_enhance
from agent.perception.enhance import enhancer, missing
from agent.perception.grey_world import classic
from agent.ranging.focus import Array
from hw.camera import Image
from hw.twin.lens import Lens
from hw.twin.scene import SceneWater, load_scene

COLUMNS = {"mean_steps": "+.2f", "median_steps": ".2f", "p95_steps": ".2f", "median_mm": ".1f", "p95_mm": ".1f"}

Progress = Callable[[int, int], None]  # sweeps measured, sweeps in all
Sweep = list[Image]


class Way(NamedTuple):
    name: str
    enhance: Callable[[Sweep], Sweep]  # a whole sweep, in its order


def ways() -> list[Way]:
    """Classic, and the network's ways where it is installed; `plain` is computed folded, which equals it to 1e-5."""
    found = [Way("classic", lambda sweep: [classic(image) for image in sweep])]
    if missing(None) is None:
        plain, fast = enhancer("folded"), enhancer("fast")
        estimate = fast.estimate
        assert estimate is not None  # of the fast way it never is

        def held(sweep: Sweep) -> Sweep:
            colours = estimate(sweep[0])
            return [fast_enhance.apply(colours, image) for image in sweep]

        found.append(Way("plain", lambda sweep: [plain.apply(image) for image in sweep]))
        found.append(Way("fast", lambda sweep: [fast.apply(image) for image in sweep]))
        found.append(Way("fast, colours of the first frame", held))
    return found


def peak_shift(
    seed: int,
    sensor: str,
    out: Path,
    progress: Progress,
    waters: Sequence[str] = WATERS,
    views: int = len(VIEWS),
    by: Sequence[Way] | None = None,
) -> dict[str, Any]:
    """Sweeps over `views` views in each water; writes result.json into `out` and returns its content.

    Raises ConfigError for a sensor or a water that does not exist, or where `out` holds a result already.
    """
    check_views(sensor, waters)
    make_room(out)
    by = ways() if by is None else by
    cases: list[dict[str, Any]] = []
    progress(0, len(waters) * views)
    growth = None  # of the picture over a sweep: the lens's, whatever the water
    for number, water in enumerate(waters):
        preset = msgspec.convert({"preset": water}, SceneWater)
        camera = StillCamera(sensor, seed, scene=msgspec.structs.replace(load_scene("tank"), water=preset))
        camera.prepare()
        growth = breathing(camera) if growth is None else growth
        taken, raw, after = [], [], {way.name: list[DepthMap]() for way in by}
        for k in range(views):
            taken.append(take(camera, k, growth))
            raw.append(blocks(taken[k]))
            for way in by:
                after[way.name].append(blocks(taken[k]._replace(images=way.enhance(taken[k].images))))
            progress(number * views + k + 1, len(waters) * views)
        step = float(np.diff(taken[0].focus).mean())
        slope = [mm_per_position(camera.lens, one.position) for one in raw]
        for name, maps in after.items():
            cases.append({"water": water, "way": name, **figures(raw, maps, slope, step)})
    result = {"schema": 1, "source": "twin", "seed": seed, "sensor": sensor, "views": views, "cases": cases}
    write_result(out, result)
    return result


def blocks(taken: Taken) -> DepthMap:
    return measure(clarity_of(taken.images, taken.focus, BLOCK_PX, taken.growth), BLOCK_PX, None, "matched", QUALITY)


def mm_per_position(lens: Lens, position: Array) -> Array:
    """|d range / d position|, mm per lens position: vergence 1/f - 1/v, range = index / vergence under water."""
    v_m = lens.at_position_m(0.0) + lens.per_position_m * position
    vergence = 1.0 / lens.focal_m - 1.0 / v_m
    return np.asarray(1e3 * WATER / vergence**2 / v_m**2 * abs(lens.per_position_m), np.float64)


def figures(raw: list[DepthMap], after: list[DepthMap], slope: list[Array], step: float) -> dict[str, Any]:
    """Over the blocks that have a peak before and after; `step` in lens positions, `slope` in mm per position."""
    both = [a.accepted & b.accepted for a, b in zip(raw, after, strict=True)]
    positions = np.concatenate([(b.position - a.position)[m] for a, b, m in zip(raw, after, both, strict=True)])
    shift_mm = np.abs(positions * np.concatenate([s[m] for s, m in zip(slope, both, strict=True)]))
    size = np.abs(positions) / step
    before = sum(int(a.accepted.sum()) for a in raw)
    counts = {"blocks_raw": before, "blocks": int(sum(b.accepted.sum() for b in after)), "common": len(size)}
    if not len(size):
        return counts
    return {
        **counts,
        "mean_steps": float(positions.mean() / step),
        "median_steps": float(np.median(size)),
        "p95_steps": float(np.quantile(size, 0.95)),
        "median_mm": float(np.median(shift_mm)),
        "p95_mm": float(np.quantile(shift_mm, 0.95)),
    }


def run(seed: int, sensor: str, out: Path | None, console: Console, waters: Sequence[str] | None) -> None:
    """Run the experiment into `out` or runs/<UTC> and print its table."""
    folder = run_folder(out)
    result = with_bar(console, "sweeps", lambda show: peak_shift(seed, sensor, folder, show, waters or WATERS))
    console.print(table(result))
    console.print(f"written to {folder}")


def table(result: dict[str, Any]) -> Table:
    shown = Table(title=f"{result['sensor']}, {result['views']} views: shift of the focus peak, enhanced against raw")
    for column in ("water", "way"):
        shown.add_column(column)
    for column in ("blocks, raw", "enhanced", "mean steps", "median", "95 %", "median mm", "95 %"):
        shown.add_column(column, justify="right")
    for case in result["cases"]:
        cells = (format(case[name], how) if name in case else "-" for name, how in COLUMNS.items())
        shown.add_row(case["water"], case["way"], str(case["blocks_raw"]), str(case["blocks"]), *cells)
    return shown
