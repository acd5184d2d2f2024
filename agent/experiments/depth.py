"""Whole views in blocks, how far each block is, against the twin's own depth.

The lens is calibrated first, against a flat wall at measured distances, with the sweep and the blocks that measure
later. Then each of four views of the tank is swept once; the three ways to take a peak share their sweeps and their
blocks, so that nothing but the peak differs. Last comes a ball, alone, at three distances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, get_args

import msgspec
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table

from agent.core.config import Cues
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit
from agent.core.ranging.focus import Array, Method, TiltedPeak, at_tilt, depth_of_field_in_water_m, fit_peaks, with_sag
from agent.experiments.ball_measurements import ball_measurements
from agent.experiments.experiment import ExperimentResult, Figures, Row, Sensor
from agent.experiments.still_camera import (
    BLOCK_PX,
    QUALITY,
    VIEWS,
    WATER_INDEX,
    StillCamera,
    SweptView,
    TankView,
    breathing,
    facing_wall,
    lens_positions,
    sweep,
    sweep_view,
    truth_on,
)
from agent.perception.depth_peaks import each_part
from agent.perception.depth_sweep import MIN_QUALITY, SWEEP_STEPS, DepthMap, clarity_of, measure
from agent.perception.enhancement.enhance import enhance
from agent.process.command import Progress, step_by_step
from agent.tools.depth_map import draw_cells
from agent.tools.focus_calibration import FocusRow, fit_focus
from hw.camera.camera import Roi
from hw.twin.optics.lens import PRESETS

# --- one ball: its range from focus alone, from its apparent size alone, and from both ---

BALL_M, BALL_PLACES = (0.3, 0.5, 1.0), 4  # camera to the ball's centre, and from how many sides each
SPOT_PX, PORT_M = 2.5, 0.005  # blur that a colour sensor cannot tell from a point; lens to window


def ball_rows(sensor: str, seed: int, step: Callable[[], None]) -> list[Row]:
    """A row for each distance and each of the cues; the camera is calibrated as a robot's is.

    Errors are those of the camera's own range; `depth_of_field_m` is what one frame alone could tell, for spots of
    SPOT_PX pixels. `step` is called after each of len(BALL_M) * BALL_PLACES measurements.
    """
    lens, rows = PRESETS[sensor], []
    for distance_m in BALL_M:
        measured = []
        for one in ball_measurements(seed, BALL_PLACES, sensor, distance_m):
            measured.append(one)
            step()
        spot_m = SPOT_PX * lens.pixel_m
        field_m = depth_of_field_in_water_m(distance_m, lens.focal_m, lens.f_number, spot_m, WATER_INDEX, PORT_M)
        for cue in get_args(Cues):
            good = [one[cue] for one in measured if "range_mm" in one[cue]]
            errors_mm = [one["range_mm"] for one in good]
            rows.append(
                {
                    "sensor": sensor,
                    "distance_m": distance_m,
                    "cues": cue,
                    "errors_mm": errors_mm,
                    "rms_mm": rms(errors_mm),
                    "sigma_mm": rms([one["range_sigma_mm"] for one in good]),
                    "refused": sorted({one[cue]["refused"] for one in measured if "refused" in one[cue]}),
                    "depth_of_field_m": field_m if math.isfinite(field_m) else None,
                }
            )
    return rows


def rms(values: list[float]) -> float | None:
    """Root mean square; None of nothing."""
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else None


# --- calibration against a flat wall ---
# A wall square to the camera is all at one distance, so every block of the picture's middle measures the same: their
# median is one row of the calibration. Looking up and down at it tells the sag of the lens.

WALL_M = 1.0 / np.linspace(1.0 / 1.35, 1.0 / 0.22, 12)  # distances of the calibration, equal steps of 1/u
WALL_REPEATS = 3  # the lens comes back to 1.2 positions (rms) at each step, which is 12 mm at 1.25 m
SAG_M = (0.36, 0.40, 0.44)  # distances at which the wall is also seen from a camera that looks up and down
SAG_TILT_DEG = 15.0  # with all of the picture's middle still on the wall
WALL_PX = 400  # side of the picture's middle that sees it


def sweeps_of_a_calibration() -> int:
    """How often `calibrate` sweeps."""
    return WALL_REPEATS * len(WALL_M) + 2 * len(SAG_M)


def calibrate(camera: StillCamera, growth: float, step: Callable[[], None]) -> FocusFit:
    """The wall square to the camera at known distances, then looking up and down at it for the lens's sag."""
    found = []
    for u_m in np.repeat(WALL_M, WALL_REPEATS).tolist():
        peak = wall_peak(camera, facing_wall(u_m), growth)
        if peak is not None:
            found.append(FocusRow(u_m, *peak))
        step()
    tilted = []
    for u_m in SAG_M:
        for tilt_deg in (-SAG_TILT_DEG, SAG_TILT_DEG):
            peak, tilt = wall_peak(camera, facing_wall(u_m, tilt_deg), growth), math.radians(tilt_deg)
            if peak is not None:
                tilted.append(TiltedPeak(u_m / math.cos(tilt), peak[0], tilt))
            step()
    return with_sag(fit_focus(found), tilted)


def wall_peak(camera: StillCamera, view: TankView, growth: float) -> tuple[float, float] | None:
    """Median peak and half width of the blocks in the picture's middle, lens positions; None where none has a peak.

    A wall has no edges in depth for the strict gate to find: it would only take blocks away, nearly all of them at the
    near end, where peaks are widest.
    """
    width, height = camera.size
    middle = Roi((width - WALL_PX) // 16 * 8, (height - WALL_PX) // 16 * 8, WALL_PX, WALL_PX)
    rho = np.array(lens_positions(camera), float)
    camera.view = view
    swept = clarity_of(sweep(camera, middle), rho, BLOCK_PX, growth)
    peaks = fit_peaks(rho, swept.clarity.reshape(len(rho), -1).T)
    good = peaks.accepted & (peaks.quality >= MIN_QUALITY)
    return (float(np.median(peaks.lens_position[good])), float(np.median(peaks.width[good]))) if good.any() else None


# --- the experiment ---

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


# --- tables ---


def table(result: Result) -> Group:
    """Errors of depth, a ball's range, and a line for each sensor and each target that was missed."""
    return Group(
        cases_table(result.cases),
        balls_table(result.balls),
        *map(enhanced_line, result.enhanced),
        *(f"missed: {text}" for text in result.missed),
    )


def cases_table(cases: list[Row]) -> Table:
    """A line for each sensor, way to take the peak, and range."""
    shown = Table(title="depth from focus against the twin's truth")
    for column in ("sensor", "peak", "range m", "mean error mm", "median mm", "accepted"):
        shown.add_column(column, justify="left" if column in ("sensor", "peak") else "right")
    for case in cases:
        low, high = case["range_m"]
        errors = (case["mae_mm"], case["median_mm"])
        shown.add_row(
            case["sensor"],
            case["peak"] + (", grid not growing" if case["grid"] == "fixed" else ""),
            f"{low:g} to {high:g}",
            *(f"{v:.1f}" if v is not None else "-" for v in errors),
            f"{100 * case['accepted']:.0f} %",
        )
    return shown


def balls_table(balls: list[Row]) -> Table:
    """A line for each sensor, distance and cue."""
    shown = Table(title="one ball, range from focus, from size, and from both")
    for column in ("sensor", "range m", "cues", "rms error mm", "stated sigma mm", "measured", "depth of field mm"):
        shown.add_column(column, justify="left" if column in ("sensor", "cues", "measured") else "right")
    for ball in balls:
        count, refused, field_m = len(ball["errors_mm"]), ball["refused"], ball["depth_of_field_m"]
        shown.add_row(
            ball["sensor"],
            f"{ball['distance_m']:g}",
            ball["cues"],
            *("-" if ball[key] is None else f"{ball[key]:.2f}" for key in ("rms_mm", "sigma_mm")),
            f"{count}" if not refused else f"{count}; else: {refused[0]}",
            "infinite" if field_m is None else f"{1e3 * field_m:.0f}",
        )
    return shown


def enhanced_line(one: Row) -> str:
    """What clarity of enhanced pictures would cost with one sensor."""
    return (
        f"{one['sensor']}: clarity on the enhanced picture moves the peak by {one['shift_median_steps']:.2f} steps "
        f"in the median, {one['shift_p95_steps']:.2f} at 95 %, {one['shift_mean_steps']:+.2f} on average; "
        f"mean error {one['raw_mae_mm']:.1f} mm raw, {one['enhanced_mae_mm']:.1f} mm enhanced"
    )


# --- figures ---


def figures(result: Result) -> Figures:
    """One for each sensor and view."""
    for one in result.shown:
        yield f"depth_{one.sensor}_{one.number}.png", figure(one.depth_map, one.truth_m)


def figure(measured: DepthMap, truth_m: Array) -> Figure:
    """What is seen, what the blocks say, what is true, and the difference. Distances in metres on one scale, errors in
    millimetres; hatched: no distance."""
    range_m = measured.range_on_parts()
    assert range_m is not None  # it was measured with a calibration
    height, width = measured.sharp.shape[:2]
    drawn = Figure(figsize=(12.0, 0.8 + 10.0 * height / width), layout="constrained")
    (view, found), (true, wrong) = drawn.subplots(2, 2)
    view.imshow(measured.sharp[..., ::-1])
    view.set_title("each part from its sharpest frame")
    limits = float(truth_m.min()), float(truth_m.max())
    side = measured.block_px / measured.along
    draw_cells(found, range_m, side, "z-depth in metres", limits)
    found.set_title(f"from focus, {np.isfinite(range_m).mean():.0%} of the view; hatched: no distance")
    draw_cells(true, truth_m, side, "z-depth in metres", limits)
    true.set_title("truth of the twin")
    error_mm = 1e3 * (range_m - truth_m)
    draw_cells(wrong, error_mm, side, "error in mm", (-30.0, 30.0), "RdBu")
    miss_mm = np.abs(error_mm[np.isfinite(error_mm)])
    wrong.set_title(
        f"error: mean {miss_mm.mean():.1f} mm, median {np.median(miss_mm):.1f} mm" if miss_mm.size else "error"
    )
    for axes in (view, found, true, wrong):
        axes.set(xlim=(0, width), ylim=(height, 0), xlabel="x in px", ylabel="y in px")
    return drawn
