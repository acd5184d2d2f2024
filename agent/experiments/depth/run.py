"""Whole views in blocks, how far each block is, against the twin's own depth.

The lens is calibrated first, against a flat wall at measured distances, with the sweep and the blocks that measure
later. Then four views of the tank, each swept once; the three ways to take a peak share their sweeps and their
blocks, so that nothing but the peak differs. Last a ball, alone, at three distances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import Calibration, CameraFit
from agent.core.ranging.focus import Array, Method, at_tilt
from agent.experiments.choices import Sensor
from agent.experiments.depth.balls import BALL_M, BALL_PLACES, ball_rows
from agent.experiments.depth.wall import calibrate, sweeps_of_a_calibration
from agent.experiments.result import ExperimentResult, Row
from agent.experiments.still_camera import StillCamera
from agent.experiments.sweeps import BLOCK_PX, QUALITY, VIEWS, WATER_INDEX, SweptView, breathing, sweep_view, truth_on
from agent.perception.depth_peaks import each_part
from agent.perception.depth_sweep import MIN_QUALITY, SWEEP_STEPS, DepthMap, clarity_of, measure
from agent.perception.enhancement.enhance import enhance
from agent.process.command import Progress, step_by_step

SENSORS: tuple[Sensor, ...] = ("crop_1280", "imx519_640")  # the finer one first: the targets are for it
METHODS: tuple[Method, ...] = ("matched", "parabola", "argmax")
RANGES_M = ((0.0, 0.6), (0.6, 1.0), (1.0, 1.5), (0.0, 1.5))
TARGETS_MM = {(0.0, 1.5): 12.0, (0.0, 0.6): 3.0}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the world


class MeasuredView(NamedTuple):
    """One view by one sensor, the matched peak, beside the truth of what is said."""

    sensor: str
    number: int  # from 1
    depth_map: DepthMap
    truth_m: Array  # (rows, cols) of its parts


class Result(ExperimentResult, frozen=True, kw_only=True):
    """Errors of depth per sensor, way to take the peak and range; what enhancement would do; a ball's range."""

    schema: int = 1
    source: str = "twin"
    seed: int
    block_px: int = BLOCK_PX
    steps: int = SWEEP_STEPS
    quality: float = MIN_QUALITY
    cases: list[Row]
    calibration: list[Row]
    enhanced: list[Row]
    balls: list[Row]
    missed: list[str]
    shown: list[MeasuredView]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


class Findings(NamedTuple):
    """What one sensor gave, in the parts of the result."""

    cases: list[Row]
    calibration: Row
    enhanced: Row
    balls: list[Row]
    shown: list[MeasuredView]


def run(settings: Settings, progress: Progress) -> Result:
    """Measure with each sensor; progress counts sweeps."""
    each = sweeps_of_a_calibration() + len(VIEWS) + len(BALL_M) * BALL_PLACES
    step = step_by_step(progress, len(SENSORS) * each)
    found = [measure_with(sensor, settings.seed, step) for sensor in SENSORS]
    cases = [row for one in found for row in one.cases]
    return Result(
        seed=settings.seed,
        cases=cases,
        calibration=[one.calibration for one in found],
        enhanced=[one.enhanced for one in found],
        balls=[row for one in found for row in one.balls],
        missed=missed(cases),
        shown=[view for one in found for view in one.shown],
    )


def measure_with(sensor: Sensor, seed: int, step: Callable[[], None]) -> Findings:
    """Calibrate, sweep the views, then the ball; `step` is called after every sweep that counts."""
    camera = StillCamera(sensor, seed)
    camera.prepare()
    growth = breathing(camera)
    fit = calibrate(camera, growth, step)
    known = Calibration(robot="r1", made="", source="wall", focus=fit, camera=nominal_pinhole(camera))
    swept = []
    for view in VIEWS:
        swept.append(sweep_view(camera, view, growth))
        step()
    maps = {method: [map_of(one, known, method) for one in swept] for method in METHODS}
    fixed = [map_of(one._replace(growth=0.0), known, "matched", split=False) for one in swept]  # parts would disagree
    cases = [row for method in METHODS for row in error_rows(sensor, method, swept, maps[method])]
    calibration = {"noise": fit.noise, "held_out_rmse_mm": 1e3 * fit.held_out_rmse_m, "growth": growth, "sag": fit.sag}
    views = enumerate(zip(swept, maps["matched"], strict=True), start=1)
    return Findings(
        cases=cases + error_rows(sensor, "matched", swept, fixed, grid="fixed"),
        calibration={"sensor": sensor, **calibration},
        enhanced={"sensor": sensor, **enhanced_shift(swept, known)},
        balls=ball_rows(sensor, seed, step),
        shown=[MeasuredView(sensor, number, one, truth_on_parts(view, one)) for number, (view, one) in views],
    )


def nominal_pinhole(camera: StillCamera) -> CameraFit:
    """The pinhole that the data sheet of this camera gives, in water: enough to find a ball."""
    (width, height), f_px = camera.size, WATER_INDEX * camera.lens.focal_m / camera.lens.pixel_m
    return CameraFit(width_px=width, height_px=height, f_px=f_px, cx_px=(width - 1) / 2, cy_px=(height - 1) / 2)


def map_of(swept: SweptView, known: Calibration, method: Method, split: bool = True) -> DepthMap:
    """The depth of every block, with this way to take the peak; split: of its parts where it holds two depths."""
    tilt = math.radians(swept.view.tilt_deg)  # a robot knows it from gimbal and pressure
    clarity = clarity_of(swept.images, swept.lens_positions, BLOCK_PX, swept.growth, split=split)
    return measure(clarity, BLOCK_PX, at_tilt(known.focus, tilt), method, MIN_QUALITY if split else QUALITY)


def error_rows(
    sensor: str, method: Method, swept: list[SweptView], maps: list[DepthMap], grid: str = "breathing"
) -> list[Row]:
    """The errors of one method in every range, over all that has a range; all views together, all areas alike."""
    each = [view_errors(*one) for one in zip(swept, maps, strict=True)]
    truth_m, error_mm, flat = (np.concatenate(field) for field in zip(*each, strict=True))
    parts = maps[0].along ** 2
    rows = []
    for low, high in RANGES_M:
        within = (truth_m >= low) & (truth_m < high)
        counted = within & np.isfinite(error_mm)
        e, f = error_mm[counted], error_mm[counted & flat]
        figures = {
            "mae_mm": mean(np.abs(e)),
            "median_mm": float(np.median(np.abs(e))) if e.size else None,
            "bias_mm": float(np.median(e)) if e.size else None,
            "flat_mae_mm": mean(np.abs(f)),
        }
        share = float(counted.sum() / max(within.sum(), 1))
        case = {"sensor": sensor, "peak": method, "range_m": [low, high], **figures, "accepted": share}
        blocks, flats = (float(np.sum(one)) / parts for one in (counted, counted & flat))
        rows.append({**case, "blocks": blocks, "flat_blocks": flats, "grid": grid})
    return rows


def view_errors(swept: SweptView, found: DepthMap) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Truth in metres, error in millimetres (NaN: no range), and whether its block is flat: one value a part.

    A part stands for its block where that has one depth, so that errors count by the area that has them.
    """
    truth_m, measured_m = truth_on_parts(swept, found), found.range_on_parts()
    assert measured_m is not None  # it was measured with a calibration
    flat = each_part(swept.flat, found.along)
    return truth_m.ravel(), 1e3 * (measured_m - truth_m).ravel(), flat.ravel()


def truth_on_parts(swept: SweptView, found: DepthMap) -> Array:
    """True range (rows * along, cols * along) of what is said there: of the block, or of the part where it is split."""
    whole, of_blocks = (each_part(field, found.along) for field in (found.blocks.accepted, swept.truth_m))
    rows, cols = whole.shape
    return np.where(whole, of_blocks, truth_on(swept.pixels_m, rows, cols, BLOCK_PX / found.along))


def mean(values: Array) -> float | None:
    """None of nothing."""
    return float(values.mean()) if values.size else None


def ranges_m(depth_map: DepthMap) -> Array:
    """The range of every block, (rows, cols); NaN where there is none."""
    assert depth_map.blocks.range_m is not None  # it was measured with a calibration
    return depth_map.blocks.range_m


def enhanced_shift(swept: list[SweptView], known: Calibration) -> dict[str, float]:
    """How far the peaks move, in sweep steps, when clarity is taken on the enhanced picture instead of the raw one."""
    step, shifts, error_mm = float(np.diff(swept[0].lens_positions).mean()), [], []
    for one in swept:
        clear = one._replace(images=[enhance(image) for image in one.images])
        before, after = (map_of(view, known, "matched", split=False) for view in (one, clear))
        both = before.blocks.accepted & after.blocks.accepted
        shifts.append((after.blocks.lens_position - before.blocks.lens_position)[both] / step)
        error_mm.append([1e3 * np.abs(ranges_m(m) - one.truth_m)[both] for m in (before, after)])
    shift = np.concatenate(shifts)
    return {
        "shift_median_steps": float(np.median(np.abs(shift))),
        "shift_p95_steps": float(np.quantile(np.abs(shift), 0.95)),
        "shift_mean_steps": float(shift.mean()),
        "raw_mae_mm": float(np.nanmean(np.concatenate([e[0] for e in error_mm]))),
        "enhanced_mae_mm": float(np.nanmean(np.concatenate([e[1] for e in error_mm]))),
    }


def missed(cases: list[Row]) -> list[str]:
    """Targets of the finer sensor that are not reached."""
    found = []
    for case in cases:
        limit = TARGETS_MM.get((case["range_m"][0], case["range_m"][1]))
        if case["sensor"] == SENSORS[0] and case["peak"] == "matched" and case["grid"] == "breathing" and limit:
            value = case["mae_mm"]
            if value is None or value > limit:
                found.append(f"{case['sensor']} {case['range_m']} m: mean error {value} mm > {limit} mm")
    return found
