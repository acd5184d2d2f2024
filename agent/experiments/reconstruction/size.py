"""Growing surveys of one basin: time and memory of their reconstruction, what time grows as, and targets missed."""

from __future__ import annotations

import math
import multiprocessing
import resource
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.clock.machine import processor_s
from agent.core.config import Tank
from agent.core.ranging.focus import lens_position, phase_sigma
from agent.experiments.experiment import Row, Sensor
from agent.experiments.navigation.swimmers import FOCUS
from agent.experiments.reconstruction.render import EXACT, camera_of, noisy, rotation_of_view
from agent.experiments.reconstruction.score import distances_to
from agent.experiments.still_camera import WATER_INDEX
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction import surfels
from agent.reconstruction.export import export
from agent.reconstruction.fusion import CELL_M, build
from agent.reconstruction.held_back import ImageModel, psnr_db
from agent.reconstruction.plane_sweep import COMPARED, neighbours
from agent.reconstruction.pose_evidence import apart, between, by_motion
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.run import figures_of
from agent.reconstruction.views import (
    BLOCKS_ACROSS,
    MOST_SPREAD,
    Camera,
    FocusMap,
    View,
    focus_map,
    linear,
    reduction,
    stacked,
)
from hw.twin.optics.lens import Lens, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.scene import Scene, Solid, generator, load_scene

# --- a basin of 10 x 6 m with things on its floor, and where seven robots take keyframes ---
# Each robot has a lane along the basin. It stops every few decimetres and looks down to one side, ahead, to the other
# side. All set out at one end, so that the first keyframes know one part of the basin as well as all know all of it.

SIZE_M, SURFACE_M = (10.0, 6.0, 1.6), 1.3
ROBOTS = tuple(f"r{k + 1}" for k in range(7))
MOST = 500  # keyframes of all robots
HEIGHT_M, SPREAD_M = 0.80, 0.05  # of a camera over the floor, and by how much a robot keeps it not
TILT_DEG, PANS_DEG = -50.0, (-35.0, 0.0, 35.0)
SWAY_DEG, DRIFT_M = 2.0, 0.05  # of where it looks, and of where it is, beside its lane
STONES, BALLS, BOXES = 36, 6, 6
RIM_M = 0.3  # from a wall to the first stop, and to the middle of things


class Stop(NamedTuple):
    """One keyframe: whose, from where, and which way the camera looks."""

    robot: str
    seq: int  # of the robot's own
    position_m: tuple[float, float, float]
    yaw_deg: float
    tilt_deg: float


def tank() -> Tank:
    return Tank(size_m=SIZE_M, surface_m=SURFACE_M)


def basin(seed: int) -> Scene:
    """The paper's scene in a larger tank, with what a draw puts on its floor; none of it lies in another."""
    rng, solids = generator(seed, "reconstruction", "basin"), list[Solid]()
    kinds = [*["stone"] * STONES, *["ball"] * BALLS, *["box"] * BOXES]
    while len(solids) < len(kinds):
        kind = kinds[len(solids)]
        x, y = (rng.uniform(RIM_M, length - RIM_M) for length in SIZE_M[:2])
        radii = tuple(rng.uniform(0.05, 0.20, 3).tolist())
        if kind == "ball":
            radii = (radii[0],) * 3
        if all(math.dist((x, y), s.position_m[:2]) > max(radii) + max(s.radii_m) + 0.02 for s in solids):
            high = radii[2] * (rng.uniform(0.4, 0.9) if kind == "stone" else 1.0)
            turn = (float(rng.uniform(0.0, 360.0)), 0.0, 0.0) if kind == "box" else (0.0, 0.0, 0.0)
            told = {"kind": kind, "position_m": (x, y, high), "radii_m": radii, "turn_deg": turn}
            solids.append(msgspec.convert(told, Solid))
    return msgspec.structs.replace(load_scene("tank"), solid=tuple(solids))


def stops(seed: int, count: int = MOST) -> list[Stop]:
    """The first `count` keyframes, in the order in which they are taken: robots take theirs in turn."""
    rng, found = generator(seed, "reconstruction", "stops"), list[Stop]()
    rounds, lane_m = -(-MOST // len(ROBOTS)), SIZE_M[1] / len(ROBOTS)
    places = -(-rounds // len(PANS_DEG))
    pace_m = (SIZE_M[0] - 2.0 * RIM_M) / (places - 1)
    for n in range(MOST):
        k, lane = divmod(n, len(ROBOTS))
        x, y, z = RIM_M + (k // len(PANS_DEG)) * pace_m, (lane + 0.5) * lane_m, HEIGHT_M
        off, sway = rng.normal(0.0, (DRIFT_M, DRIFT_M, SPREAD_M)).clip(-0.15, 0.15), rng.normal(0.0, SWAY_DEG, 2)
        # The first stops look back, so that the end where they set out is seen, too.
        yaw = PANS_DEG[k % len(PANS_DEG)] + (180.0 if k // len(PANS_DEG) < 2 else 0.0)
        place = (x + off[0], y + off[1], z + off[2])
        found.append(Stop(ROBOTS[lane], k, place, yaw + float(sway[0]), TILT_DEG + float(sway[1])))
    return found[:count]


# --- keyframes: pictures by the twin's painter, depths drawn about what its ray caster says ---
# Nothing is swept. A block's depth is the mean of what it truly sees, by 1/z, with the error of the lens position
# that focus would say it has, and goes through the calibration and `focus_map` as a sweep's does. A block has none
# that sees two depths or what is out of reach; of the others some have no texture.

SENSOR: Sensor = "crop_1280"
SHARP_M = 1.0  # where the lens is focused: at what it looks at
NEAREST_M, FARTHEST_M = 0.15, 1.6  # what a sweep reaches
SHOWS = 0.9  # of the blocks have texture enough for a peak
Floats = NDArray[np.float64]


def drawn_views(seed: int, count: int, step: Callable[[], None]) -> Iterator[View]:
    """The first `count` keyframes of one basin, one after the other; step: after each."""
    scene, cameras = basin(seed), dict[str, BasinCamera]()
    for tick, stop in enumerate(stops(seed, count)):
        if stop.robot not in cameras:
            cameras[stop.robot] = BasinCamera(scene, seed, stop.robot)
        yield cameras[stop.robot].view(stop, tick)
        step()


class BasinCamera:
    """One robot's camera, whose pixels are as large as those that pictures are reduced to."""

    def __init__(self, scene: Scene, seed: int, robot: str) -> None:
        whole = draw_lens(SENSOR, generator(seed, robot, "lens"))
        times = reduction(whole.width)
        self._times, self._block = times, whole.width // BLOCKS_ACROSS // 2 * 2
        self._full = whole.width, whole.height
        lens = coarser(whole, times)
        self._image_m = lens.image_m(WATER_INDEX / SHARP_M)
        fit = camera_of(lens, (self._image_m - lens.at_rest_m) / lens.per_position_m)
        self.gamma = fit.gamma
        self.camera = Camera(fit.f_px, fit.cx_px, fit.cy_px, fit.bend, fit.ahead_m, fit.width_px, fit.height_px)
        self._rng = generator(seed, robot, "drawn depths")
        self._painter = Painter(scene, tank(), WATER_INDEX, lens, seed, robot)
        self._painter.prepare()

    def view(self, stop: Stop, tick: int) -> View:
        rotation = rotation_of_view(stop.yaw_deg, stop.tilt_deg)
        eye = Eye(stop.position_m, rotation)
        truth = self._painter.depth(eye, self._image_m).astype(float)
        found = self.focus(truth)
        return View(
            robot=stop.robot,
            incarnation="",
            seq=stop.seq,
            camera=self.camera,
            rotation=rotation,
            position_m=np.array(stop.position_m),
            pose_covariance=EXACT,
            picture=linear(self._painter.frame(eye, self._image_m, tick=tick), self.gamma),
            depth_m=found.depth_m,
            sigma_m=found.sigma_m,
        )

    def focus(self, truth_m: Floats) -> FocusMap:
        """What a sweep would say of these depths (height, width)."""
        side = self._block / self._times
        rows, cols = self._full[1] // self._block, self._full[0] // self._block
        number = (np.arange(truth_m.shape[0]) // side)[:, None] * cols + np.arange(truth_m.shape[1]) // side
        inside = np.s_[: math.floor(rows * side), : math.floor(cols * side)]
        number, inverse = number[inside].astype(int).ravel(), (1.0 / truth_m[inside]).ravel()
        mean = np.bincount(number, inverse, rows * cols) / np.bincount(number, minlength=rows * cols)
        low, high = np.full(rows * cols, np.inf), np.zeros(rows * cols)
        np.minimum.at(low, number, inverse)
        np.maximum.at(high, number, inverse)
        z = 1.0 / mean
        shows = ((high - low) * z < MOST_SPREAD) & (z > NEAREST_M) & (z < FARTHEST_M)
        shows &= self._rng.random(len(z)) < SHOWS
        sigma = math.hypot(FOCUS.noise, phase_sigma(FOCUS.width, self._block * self._block))
        peaks = np.array([lens_position(FOCUS, float(one)) for one in z]) + self._rng.normal(0.0, sigma, len(z))
        shape = rows, cols
        reason = np.where(shows, Reason.ACCEPTED, Reason.NO_TEXTURE).astype(np.uint8).reshape(shape)
        everywhere = np.ones(shape)
        grid = GridPeaks(peaks.reshape(shape), sigma * everywhere, FOCUS.width * everywhere, everywhere, reason).ranged(
            FOCUS
        )
        found = DepthMap(self._block, grid, None, np.zeros((1, 1, 3), np.uint8), 0.0)
        return focus_map(found, FOCUS, self._times, truth_m.shape[::-1])


def coarser(lens: Lens, times: int) -> Lens:
    """The same lens before a sensor whose pixels are so many times as wide."""
    cx, cy = ((c - (times - 1) / 2.0) / times for c in lens.centre_px)
    return lens._replace(
        pixel_m=times * lens.pixel_m, width=lens.width // times, height=lens.height // times, centre_px=(cx, cy)
    )


# --- time and memory of one reconstruction, in a process of its own ---

SAMPLED = 50_000  # vertices that are held against the truth: one in so many
MB = 1e6
SHOWN = 20  # pictures are held against what surfels show
COMPILED_CELL_M = 0.02  # of a first, small reconstruction, which is not timed: kernels are compiled by it


def keep(views: Iterable[View], folder: Path) -> None:
    """One file a view, in order."""
    for n, view in enumerate(views):
        arrays: dict[str, Any] = {field.name: np.asarray(getattr(view, field.name)) for field in fields(view)}
        np.savez(folder / f"{n:04d}.npz", **arrays)


def kept(folder: Path, count: int) -> list[View]:
    """The first `count` of them."""
    return [_view(folder / f"{n:04d}.npz") for n in range(count)]


def _view(path: Path) -> View:
    with np.load(path) as file:
        told: dict[str, Any] = dict(file)
    width, height = told["camera"][5:].astype(int).tolist()
    f_px, cx_px, cy_px, bend, ahead_m = told["camera"][:5].tolist()
    told["camera"] = Camera(f_px, cx_px, cy_px, bend, ahead_m, width, height)
    return View(**{**told, "robot": str(told["robot"]), "incarnation": "", "seq": int(told["seq"])})


def measured(folder: Path, count: int, seed: int) -> Row:
    """The first `count` keyframes of a folder as `aucamp reconstruct` goes through them, in a process that does nothing
    else: poses that are off are refined; of exact ones a surface is made, a PLY file beside them, and surfels."""
    processes = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=processes) as pool:
        return pool.submit(_measure, folder, count, seed).result()


def _measure(folder: Path, count: int, seed: int) -> Row:
    _compile(folder, seed)
    views = kept(folder, count)
    refined = _refined(views, seed)
    start = processor_s()
    built = build(views, CELL_M, True, _silent)
    export("ply", built.views, built.mesh, CELL_M, folder)
    seconds = processor_s() - start
    surface_mb, figures = _peak_mb(), figures_of(built, ())
    compared = int((neighbours(stacked(views, 0)).of[:, :COMPARED] >= 0).sum())
    start = processor_s()
    model = surfels.learnt(built.views, built.mesh, CELL_M, _silent)
    image_s, peak_mb = processor_s() - start, _peak_mb()
    step = max(1, len(built.mesh.vertices_m) // SAMPLED)
    box = np.array([*SIZE_M[:2], SURFACE_M])
    off, _ = distances_to(built.mesh.vertices_m[::step], box, basin(seed).solid)
    return {
        "keyframes": count,
        "robots": len({view.robot for view in views}),
        "seconds": round(seconds, 1),
        "seconds_per_keyframe": round(seconds / count, 3),
        **refined,
        "image_seconds": round(image_s, 1),
        "image_db": round(_shown_db(model, views), 2),
        "surface_mb": round(surface_mb),
        "peak_mb": round(peak_mb),
        "triangles": len(built.mesh.faces),
        "median_mm": round(1e3 * float(np.median(off)), 3),
        "within_10mm": round(100.0 * float(np.mean(off < 0.01)), 1),
        "by_plane_sweep": round(100.0 * built.swept, 1),
        "area_m2": round(figures["area_m2"], 1),
        "compared": round(compared / count, 2),
    }


def _compile(folder: Path, seed: int) -> None:
    """All of it once, coarsely, with a few keyframes."""
    few = kept(folder, 3)
    refine(noisy(few, seed))
    built = build(few, COMPILED_CELL_M, True, _silent)
    surfels.learnt(built.views, built.mesh, COMPILED_CELL_M, _silent)


def _refined(views: list[View], seed: int) -> Row:
    """How long it takes to find poses that are as wrong as a survey by hand leaves them, and how far off they are then,
    the common motion taken off."""
    believed = noisy(views, seed)
    start = processor_s()
    found = refine(believed)
    seconds = processor_s() - start
    motions = [between(some, views) for some in (believed, found.views)]
    metres, radians = apart([by_motion(view, motions[1]) for view in found.views], views)
    before, _ = apart([by_motion(view, motions[0]) for view in believed], views)
    return {
        "refine_seconds": round(seconds, 2),
        "matches": found.matches,
        "believed_mm": round(1e3 * float(before.mean()), 2),
        "place_mm": round(1e3 * float(metres.mean()), 2),
        "turn_deg": round(float(np.degrees(radians.mean())), 3),
        "refine_mb": round(_peak_mb()),
    }


def _shown_db(model: ImageModel, views: list[View]) -> float:
    """Mean PSNR of some of the pictures that the surfels were fitted to: that nothing went wrong, no more."""
    some = views[:: max(1, len(views) // SHOWN)]
    return float(np.mean([psnr_db(model.look(view)[0], view.picture) for view in some]))


def _peak_mb() -> float:
    """Largest resident memory of this process so far. A process that was started by a larger one may be told that one's
    by getrusage, so Linux is asked for what this program alone has used."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024.0 / MB
    except OSError:
        pass
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / MB


def _silent(done: int, total: int, what: str = "") -> None:
    """Progress that is not shown."""


# --- the experiment ---

COUNTS = (125, 250, MOST)
MOST_MB = 4000.0
# Seconds grow as pairs of pictures that are compared to this power at most; each keyframe is compared with five others
# at most. 1 is what is asked for; times of a machine that does other things, too, scatter by some per cent, of which
# 5 % over four times as many keyframes are 0.035 of it.
MOST_POWER = 1.05


def size_parts(counts: Sequence[int] = COUNTS) -> int:
    """How often `size` says that something is done."""
    return max(counts) + len(counts)


def size(seed: int, step: Callable[[], None] = lambda: None, counts: Sequence[int] = COUNTS) -> list[Row]:
    """A row for each number of keyframes: the first ones of one survey. Each is made in a process of its own."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        keep(drawn_views(seed, max(counts), step), folder)
        rows = []
        for count in counts:
            rows.append({"seed": seed, **measured(folder, count, seed)})
            step()
    return rows


def power(rows: Sequence[Row], of: Callable[[Row], float], key: str = "seconds") -> float:
    """p of seconds ~ of(row)^p, least squares of logarithms."""
    amounts, seconds = np.log([of(row) for row in rows]), np.log([row[key] for row in rows])
    return float(np.polyfit(amounts, seconds, 1)[0])


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """The largest memory, and what time grows as: of keyframes, and of pairs of pictures that are compared.

    A survey's first keyframes are near its rim, where fewer others look at the same: over few keyframes time grows
    faster than they do, until nearly all have as many neighbours as are asked. Pairs tell that apart from work that
    would go on growing. Of poses corners that were found elsewhere do. Empty where nothing was measured.
    """
    if not rows:
        return {}
    return {
        "peak_mb": max(row["peak_mb"] for row in rows),
        "power_keyframes": round(power(rows, _keyframes), 3),
        "power_pairs": round(power(rows, _pairs), 3),
        "power_refine": round(power(rows, _keyframes, "refine_seconds"), 3),
        "power_matches": round(power(rows, _matches, "refine_seconds"), 3),
        "power_image": round(power(rows, _keyframes, "image_seconds"), 3),
    }


def missed_size(rows: Sequence[Row]) -> list[str]:
    """What is missed of 4 GB, and of time that grows no faster than the pictures that are compared."""
    found = [f"{row['keyframes']} keyframes: {row['peak_mb']:.0f} MB" for row in rows if row["peak_mb"] > MOST_MB]
    if rows and (grown := power(rows, _pairs)) > MOST_POWER:
        found.append(f"time grows as pairs of pictures^{grown:.2f}")
    return found


def _keyframes(row: Row) -> float:
    return float(row["keyframes"])


def _matches(row: Row) -> float:
    return float(row["matches"])


def _pairs(row: Row) -> float:
    return float(row["keyframes"] * row["compared"])
