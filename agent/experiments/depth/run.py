"""`aucamp experiment depth`: whole views in blocks, how far each block is, against the twin's own depth.

The lens is calibrated first, against a flat wall at measured distances, with the sweep and the blocks that measure
later. Then four views of the tank, each swept once; the three ways to take a peak share their sweeps and their
blocks, so that nothing but the peak differs. Last a ball, alone, at three distances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.config import Cues
from agent.depth_sweep import SWEEP_STEPS, DepthMap, clarity_of, measure
from agent.experiments.consistency import robot_measurements
from agent.experiments.depth_figure import draw
from agent.experiments.result import make_room, write_result
from agent.experiments.still import StillCamera, View
from agent.experiments.wall import BLOCK_PX, SAG_M, WALL_M, WALL_REPEATS, breathing, calibrate, frames, positions
from agent.perception.clarity import grid
from agent.perception.enhance import enhance
from agent.ranging.calibration import Calibration, CameraFit
from agent.ranging.depth_of_field import depth_of_field_in_water_m
from agent.ranging.focus import Array, Method
from agent.ranging.sag import at_tilt
from hw.camera import Image
from hw.twin.lens import PRESETS

Progress = Callable[[int, int], None]  # sweeps done, sweeps in all

SENSORS = ("crop_1280", "imx519_640")  # the finer one first: the targets are for it
METHODS: tuple[Method, ...] = ("matched", "parabola", "argmax")
QUALITY = 0.998  # of a block's peak: leaves out most blocks astride an edge in depth, and few others
RANGES_M = ((0.0, 0.6), (0.6, 1.0), (1.0, 1.5), (0.0, 1.5))
TARGETS_MM = {(0.0, 1.5): 12.0, (0.0, 0.6): 3.0}
FLAT = 0.2  # of the range: a block whose depth spreads less, 5 to 95 percent, has one depth that can be called its own

VIEWS = (
    View((0.30, 0.25, 0.12), 34.0, -8.0),  # the ball half a metre away, the corner behind it
    View((0.62, 0.28, 0.10), 62.0, -4.0),  # the ball close
    View((0.20, 0.85, 0.25), 8.0, -18.0),  # the stone, and the floor from near to far
    View((0.75, 0.85, 0.20), 20.0, -10.0),  # the wall, at an angle
)
WATER = 1.333  # refractive index
BALL_M, BALL_PLACES = (0.3, 0.5, 1.0), 4  # camera to the ball's centre, and from how many sides each
SPOT_PX, PORT_M = 2.5, 0.005  # blur that a colour sensor cannot tell from a point; lens to window


class Taken(NamedTuple):
    """One sweep over one view, and the truth for its blocks; arrays (rows, cols), metres."""

    view: int
    focus: Array
    images: list[Image]
    growth: float
    truth_m: Array  # harmonic mean of the z-depths in the block: blocks are sharp at their mean vergence
    flat: NDArray[np.bool_]


def depth(seed: int, out: Path, progress: Progress) -> dict[str, Any]:
    """Run all of it in world `seed`; writes result.json and the figures into `out`, returns result.json's content.

    Raises ConfigError where `out` holds a result already.
    """
    make_room(out)
    each = WALL_REPEATS * len(WALL_M) + 2 * len(SAG_M) + len(VIEWS) + len(BALL_M) * BALL_PLACES
    done = 0
    progress(done, len(SENSORS) * each)

    def step() -> None:
        nonlocal done
        done += 1
        progress(done, len(SENSORS) * each)

    result: dict[str, Any] = {"schema": 1, "source": "twin", "seed": seed, "block_px": BLOCK_PX, "steps": SWEEP_STEPS}
    result |= {"quality": QUALITY, "cases": [], "calibration": [], "enhanced": [], "balls": []}
    for sensor in SENSORS:
        camera = StillCamera(sensor, seed)
        camera.prepare()
        growth = breathing(camera)
        fit = calibrate(camera, growth, step)
        known = Calibration(robot="r1", made="", source="wall", focus=fit, camera=nominal(camera))
        figures = {"noise": fit.noise, "held_out_rmse_mm": 1e3 * fit.held_out_rmse_m, "growth": growth, "sag": fit.sag}
        result["calibration"].append({"sensor": sensor, **figures})
        taken = []
        for k in range(len(VIEWS)):
            taken.append(take(camera, k, growth))
            step()
        maps = {method: [map_of(one, known, method) for one in taken] for method in METHODS}
        for method in METHODS:
            result["cases"] += rows(sensor, method, taken, maps[method], maps["matched"])
        fixed = [map_of(one._replace(growth=0.0), known, "matched") for one in taken]
        result["cases"] += rows(sensor, "matched", taken, fixed, fixed, grid="fixed")
        result["enhanced"].append({"sensor": sensor, **enhanced_shift(taken, maps["matched"], known)})
        for k, one in enumerate(taken):
            draw(maps["matched"][k], one.truth_m, out / f"depth_{sensor}_{k + 1}.png")
        result["balls"] += balls(sensor, seed, step)
    result["missed"] = missed(result["cases"])
    write_result(out, result)
    return result


def nominal(camera: StillCamera) -> CameraFit:
    """The pinhole that the data sheet of this camera gives, in water: enough to find a ball."""
    return pinhole(*camera.size, WATER * camera.lens.focal_m / camera.lens.pixel_m)


def pinhole(width: int, height: int, f_px: float) -> CameraFit:
    return CameraFit(width_px=width, height_px=height, f_px=f_px, cx_px=(width - 1) / 2, cy_px=(height - 1) / 2)


def take(camera: StillCamera, k: int, growth: float) -> Taken:
    camera.view = VIEWS[k]
    images, focus = frames(camera), np.array(positions(camera), float)
    pixels = camera.truth_m(float(focus[-1] if growth >= 0 else focus[0]))  # blocks are squares in the largest picture
    rows, cols = (len(grid(size, BLOCK_PX)) - 1 for size in pixels.shape)
    tiles = pixels[: rows * BLOCK_PX, : cols * BLOCK_PX].reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    blocks = tiles.transpose(0, 2, 1, 3).reshape(rows, cols, -1).astype(float)
    truth_m = 1.0 / (1.0 / blocks).mean(axis=-1)
    nearest, farthest = np.quantile(blocks, (0.05, 0.95), axis=-1)
    return Taken(k, focus, images, growth, truth_m, (farthest - nearest) / truth_m < FLAT)


def map_of(taken: Taken, known: Calibration, method: Method) -> DepthMap:
    tilt = math.radians(VIEWS[taken.view].tilt_deg)  # a robot knows it from gimbal and pressure
    known = replace(known, focus=at_tilt(known.focus, tilt))
    return measure(clarity_of(taken.images, taken.focus, BLOCK_PX, taken.growth), BLOCK_PX, known, method, QUALITY)


def rows(
    sensor: str, method: Method, taken: list[Taken], maps: list[DepthMap], gate: list[DepthMap], grid: str = "breathing"
) -> list[dict[str, Any]]:
    """The errors of one method in every range, over the blocks that `gate` accepts; all views together."""
    truth_m = np.concatenate([one.truth_m.ravel() for one in taken])
    flat = np.concatenate([one.flat.ravel() for one in taken])
    error_mm = 1e3 * (np.concatenate([ranges(one).ravel() for one in maps]) - truth_m)
    accepted = np.concatenate([(one.accepted & np.isfinite(ranges(one))).ravel() for one in gate])
    found = []
    for low, high in RANGES_M:
        within = (truth_m >= low) & (truth_m < high)
        counted = within & accepted & np.isfinite(error_mm)
        e, f = error_mm[counted], error_mm[counted & flat]
        figures = {
            "mae_mm": mean(np.abs(e)),
            "median_mm": float(np.median(np.abs(e))) if e.size else None,
            "bias_mm": float(np.median(e)) if e.size else None,
            "flat_mae_mm": mean(np.abs(f)),
        }
        share = float(counted.sum() / max(within.sum(), 1))
        case = {"sensor": sensor, "peak": method, "range_m": [low, high], **figures, "accepted": share}
        found.append({**case, "blocks": int(counted.sum()), "flat_blocks": int((counted & flat).sum()), "grid": grid})
    return found


def mean(values: Array) -> float | None:
    return float(values.mean()) if values.size else None


def ranges(one: DepthMap) -> Array:
    assert one.range_m is not None  # it was measured with a calibration
    return one.range_m


def enhanced_shift(taken: list[Taken], raw: list[DepthMap], known: Calibration) -> dict[str, float]:
    """How far the peaks move, in sweep steps, when clarity is taken on the enhanced picture instead of the raw one."""
    step, shifts, error_mm = float(np.diff(taken[0].focus).mean()), [], []
    for one, before in zip(taken, raw, strict=True):
        after = map_of(one._replace(images=[enhance(image) for image in one.images]), known, "matched")
        both = before.accepted & after.accepted
        shifts.append((after.position - before.position)[both] / step)
        error_mm.append([1e3 * np.abs(ranges(m) - one.truth_m)[both] for m in (before, after)])
    shift = np.concatenate(shifts)
    return {
        "shift_median_steps": float(np.median(np.abs(shift))),
        "shift_p95_steps": float(np.quantile(np.abs(shift), 0.95)),
        "shift_mean_steps": float(shift.mean()),
        "raw_mae_mm": float(np.nanmean(np.concatenate([e[0] for e in error_mm]))),
        "enhanced_mae_mm": float(np.nanmean(np.concatenate([e[1] for e in error_mm]))),
    }


def balls(sensor: str, seed: int, step: Callable[[], None]) -> list[dict[str, Any]]:
    """The ball alone at three distances, calibrated as a robot is: with focus alone, with size alone, with both.

    Errors are those of the camera's own range; `depth_of_field_m` is what one frame alone could tell, for spots of
    SPOT_PX pixels.
    """
    lens, found = PRESETS[sensor], []
    for distance_m in BALL_M:
        taken = []
        for one in robot_measurements(seed, BALL_PLACES, sensor, distance_m):
            taken.append(one)
            step()
        spot_m = SPOT_PX * lens.pixel_m
        field_m = depth_of_field_in_water_m(distance_m, lens.focal_m, lens.f_number, spot_m, WATER, PORT_M)
        for cue in get_args(Cues):
            good = [one[cue] for one in taken if "range_mm" in one[cue]]
            refused = sorted({one[cue]["refused"] for one in taken if "refused" in one[cue]})
            errors_mm = [one["range_mm"] for one in good]
            found.append(
                {
                    "sensor": sensor,
                    "distance_m": distance_m,
                    "cues": cue,
                    "errors_mm": errors_mm,
                    "rms_mm": rms(errors_mm),
                    "sigma_mm": rms([one["range_sigma_mm"] for one in good]),
                    "refused": refused,
                    "depth_of_field_m": field_m if math.isfinite(field_m) else None,
                }
            )
    return found


def rms(values: list[float]) -> float | None:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else None


def missed(cases: list[dict[str, Any]]) -> list[str]:
    """Targets of the finer sensor that are not reached."""
    found = []
    for case in cases:
        limit = TARGETS_MM.get((case["range_m"][0], case["range_m"][1]))
        if case["sensor"] == SENSORS[0] and case["peak"] == "matched" and case["grid"] == "breathing" and limit:
            value = case["mae_mm"]
            if value is None or value > limit:
                found.append(f"{case['sensor']} {case['range_m']} m: mean error {value} mm > {limit} mm")
    return found
