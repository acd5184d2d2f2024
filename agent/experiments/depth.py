"""Whole views in blocks, how far each block is, against the twin's own depth.

The lens is calibrated with the sweep and the blocks that measure later. The ways to take a peak share their sweeps and
their blocks, so that nothing but the peak differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position, on_sensor
from agent.core.ranging.focus import (
    Array,
    Method,
    TiltedPeak,
    as_on_axis,
    at_tilt,
    fit_peaks,
    port_share,
    shift,
    with_sag,
)
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.still_camera import (
    BLOCK_PX,
    VIEWS,
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
from agent.perception.clarity import grid
from agent.perception.depth_peaks import each_part, middle_px
from agent.perception.depth_sweep import MIN_QUALITY, DepthMap, clarity_of, measure, outward
from agent.tools.focus_calibration import Aside, FocusRow, fit_field, fit_focus
from hw.camera.camera import Roi

# --- calibration against a flat wall ---
# A wall square to the camera is all at one distance, so every block of the picture's middle measures the same: their
# median is one row of the calibration. Looking up and down at it tells the sag of the lens.

WALL_M = 1.0 / np.linspace(1.0 / 1.35, 1.0 / 0.22, 12)  # distances of the calibration, equal steps of 1/u
WALL_REPEATS = 3  # the lens comes back to 1.2 positions (rms) at each step, which is 12 mm at 1.25 m
SAG_M = (0.36, 0.40, 0.44)  # distances at which the wall is also seen from a camera that looks up and down
SAG_TILT_DEG = 15.0  # with all of the picture's middle still on the wall
FIELD_M = (0.35, 0.5)  # distances at which it fills the picture, and all of that is read
WALL_PX = 400  # side of the picture's middle that sees it


def calibrate(camera: StillCamera, growth: float, repeats: int = WALL_REPEATS) -> FocusFit:
    """The wall square to the camera at known distances, then looking up and down at it for the lens's sag."""
    seen, found = camera.seen(), list[FocusRow]()
    share = over_middle(camera, lambda px: port_share(seen, px))
    for u_m in np.repeat(WALL_M, repeats).tolist():
        peak = wall_peak(camera, facing_wall(u_m), growth)
        if peak is not None:
            found.append(FocusRow(as_on_axis(u_m, share), *peak))
    tilted = []
    for u_m in SAG_M:
        for tilt_deg in (-SAG_TILT_DEG, SAG_TILT_DEG):
            peak, tilt = wall_peak(camera, facing_wall(u_m, tilt_deg), growth), math.radians(tilt_deg)
            if peak is not None:
                tilted.append(TiltedPeak(as_on_axis(u_m / math.cos(tilt), share), peak[0], tilt))
    field = fit_field(fit_focus(found), wall_places(camera, growth))
    in_middle = over_middle(camera, lambda px: shift(field, on_sensor(seen, px, seen.lens)))
    fit = fit_focus([row._replace(rho=row.rho - in_middle) for row in found])
    return with_sag(replace(fit, field=field), tilted)


def wall_places(camera: StillCamera, growth: float) -> list[Aside]:
    """Peaks of the wall all over the picture, at two distances: what the lens does off its axis."""
    rho, places = np.array(lens_positions(camera), float), list[Aside]()
    for number, u_m in enumerate(FIELD_M):
        camera.view = facing_wall(u_m)
        taken = clarity_of(sweep(camera), rho, BLOCK_PX, growth)
        peaks = measure(taken, BLOCK_PX, None).blocks
        seen = at_lens_position(camera.seen(), float(rho[taken.reference]))
        ways = outward(taken, seen, *(grid(length, BLOCK_PX) for length in taken.sharp.shape[:2]))
        for row, col in np.argwhere(peaks.accepted):
            px, way = middle_px(int(row), int(col), BLOCK_PX), float(ways[row, col])
            peak, sigma = float(peaks.lens_position[row, col]), float(peaks.sigma[row, col])
            sharp_m = as_on_axis(u_m, port_share(seen, px, way))
            places.append(Aside(number, sharp_m, on_sensor(seen, px, peak), peak, sigma))
    return places


def wall_part(camera: StillCamera) -> Roi:
    """The picture's middle."""
    width, height = camera.size
    return Roi((width - WALL_PX) // 16 * 8, (height - WALL_PX) // 16 * 8, WALL_PX, WALL_PX)


def over_middle(camera: StillCamera, of_px: Callable[[tuple[float, float]], float]) -> float:
    """The median there, over the blocks, of something that differs from pixel to pixel."""
    part = wall_part(camera)
    middles = [(k + 0.5) * BLOCK_PX - 0.5 for k in range(WALL_PX // BLOCK_PX)]
    return float(np.median([of_px((part.x + x, part.y + y)) for x in middles for y in middles]))


def wall_peak(camera: StillCamera, view: TankView, growth: float) -> tuple[float, float] | None:
    """Median peak and half width of the blocks in the picture's middle, lens positions; None where none has a peak.

    A wall has no edges in depth for the strict gate to find: it would only take blocks away, nearly all of them at the
    near end, where peaks are widest.
    """
    middle = wall_part(camera)
    rho = np.array(lens_positions(camera), float)
    camera.view = view
    swept = clarity_of(sweep(camera, middle), rho, BLOCK_PX, growth)
    peaks = fit_peaks(rho, swept.clarity.reshape(len(rho), -1).T)
    good = peaks.accepted & (peaks.quality >= MIN_QUALITY)
    return (float(np.median(peaks.lens_position[good])), float(np.median(peaks.width[good]))) if good.any() else None


# --- depth of whole views, and its errors ---


def map_of(swept: SweptView, fit: FocusFit, seen: CameraFit, method: Method) -> DepthMap:
    """The depth of every block, with this way to take the peak, or of its parts where it holds two depths."""
    tilt = math.radians(swept.view.tilt_deg)  # a robot knows it from gimbal and pressure
    clarity = clarity_of(swept.images, swept.lens_positions, BLOCK_PX, swept.growth, split=True)
    return measure(clarity, BLOCK_PX, at_tilt(fit, tilt), method, MIN_QUALITY, seen)


def errors(swept: list[SweptView], maps: list[DepthMap]) -> dict[str, float | None]:
    """Mean absolute errors of all views together, and the share of their area that has a range.

    A part stands for its block where that has one depth, so that errors count by the area that has them.
    """
    both = [(truth_on_parts(*one), one[1].range_on_parts()) for one in zip(swept, maps, strict=True)]
    truth_m = np.concatenate([truth.ravel() for truth, _ in both])
    measured_m = np.concatenate([found.ravel() for _, found in both if found is not None])
    off_mm = 1e3 * np.abs(measured_m - truth_m)  # NaN: no range
    within, near = truth_m < FARTHEST_M, truth_m < NEAR_M
    counted = np.isfinite(off_mm)
    return {
        "mm": mean(off_mm[within & counted]),
        "near_mm": mean(off_mm[near & counted]),
        "told": float((within & counted).sum() / max(within.sum(), 1)),
    }


def truth_on_parts(swept: SweptView, found: DepthMap) -> Array:
    """True range (rows * along, cols * along) of what is said there: of the block, or of the part where it is split."""
    whole, of_blocks = (each_part(field, found.along) for field in (found.blocks.accepted, swept.truth_m))
    rows, cols = whole.shape
    return np.where(whole, of_blocks, truth_on(swept.pixels_m, rows, cols, BLOCK_PX / found.along))


def mean(values: Array) -> float | None:
    """None of nothing."""
    return float(values.mean()) if values.size else None


# --- the claim ---

# Preset, degrees by which the sensor leans, micrometres of curvature. The finer one first: the targets are for it.
SENSORS = {
    "crop-1280": ("crop_1280", 0.0, 0.0),
    "imx519-640": ("imx519_640", 0.0, 0.0),
    "imx519-leaning": ("imx519_640", 0.2, 6.0),
}
METHODS: tuple[Method, ...] = ("matched", "parabola", "argmax")
FLAT = "flat"  # matched, the field left out
NEAR_M, FARTHEST_M = 0.6, 1.5


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    repeats: int = WALL_REPEATS  # sweeps of each distance of the calibration
    views: int = len(VIEWS)


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One lens; a row for each way to take the peak. Raises Failed, CalibrationRefused."""
    sensor, sensor_tilt_deg, field_um = SENSORS[case]
    camera = StillCamera(sensor, seed, sensor_tilt_deg=sensor_tilt_deg, field_um=field_um)
    camera.prepare()
    growth = breathing(camera)
    fit = calibrate(camera, growth, settings.repeats)
    swept = [sweep_view(camera, view, growth) for view in VIEWS[: settings.views]]
    seen = camera.seen()
    ways = [{"way": way, **errors(swept, [map_of(one, fit, seen, way) for one in swept])} for way in METHODS]
    flat = replace(fit, field=None)
    return [*ways, {"way": FLAT, **errors(swept, [map_of(one, flat, seen, "matched") for one in swept])}]


def summary(rows: Rows) -> dict[str, Value]:
    """Means over the lenses of what each has."""
    found: dict[str, Value] = {}
    for case, of_case in rows.items():
        for way in (*METHODS, FLAT):
            for key in ("mm", "near_mm", "told"):
                values = [row[key] for row in of_case if row["way"] == way]
                scale = 100.0 if key == "told" else 1.0
                found[f"{case}_{way}_{key}"] = None if None in values or not values else scale * float(np.mean(values))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"repeats": 1, "views": 1},
    cases=tuple(SENSORS),
    measured_on="twin",
    figures=(
        Figure("crop-1280_matched_mm", "depth to 1.5 m, matched peaks, mean error", "mm", most=12.0),
        Figure("crop-1280_matched_near_mm", "the same nearer than 0.6 m", "mm", most=3.0),
        Figure("crop-1280_matched_told", "share of the area that has a depth", "%"),
        Figure("crop-1280_parabola_mm", "depth to 1.5 m by a log-parabola", "mm"),
        Figure("crop-1280_parabola_near_mm", "the same nearer than 0.6 m", "mm"),
        Figure("crop-1280_argmax_mm", "depth to 1.5 m by the largest sample, as in the paper", "mm"),
        Figure("crop-1280_argmax_near_mm", "the same nearer than 0.6 m", "mm"),
        Figure("imx519-640_matched_mm", "depth to 1.5 m with the coarser camera, matched peaks", "mm"),
        Figure("imx519-640_matched_near_mm", "the same nearer than 0.6 m", "mm"),
        Figure("imx519-640_matched_told", "share of the area that has a depth", "%"),
        Figure("imx519-leaning_matched_mm", "depth to 1.5 m, sensor leans by 0.2 degrees, field curved by 6 um", "mm"),
        Figure("imx519-leaning_matched_near_mm", "the same nearer than 0.6 m", "mm"),
        Figure("imx519-leaning_flat_mm", "depth to 1.5 m, the same lens taken for flat", "mm"),
        Figure("imx519-leaning_flat_near_mm", "the same nearer than 0.6 m", "mm"),
    ),
    explanation="""A lens of the twin is calibrated before a wall at known distances; then four views of the tank are
        swept in thirty steps. Errors are those of blocks of 50 x 50 pixels, and of the parts of those that are split,
        against the twin's own depth, by area. Each seed is another lens.""",
)
