"""Growing surveys of one basin: time and memory of their reconstruction, and what time grows as."""

from __future__ import annotations

import math
import multiprocessing
import pickle
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from agent.clock.machine import processor_s
from agent.core.config import Tank
from agent.core.ranging.focus import lens_position, phase_sigma
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.reconstruction.drawn_scene import FOCUS
from agent.experiments.reconstruction.render import camera_of, noisy, rotation_of_view, view_from
from agent.experiments.reconstruction.score import distances_to, off_mm
from agent.experiments.still_camera import WATER_INDEX, TankView
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction import surfels
from agent.reconstruction.export import export
from agent.reconstruction.fusion import CELL_M, build, fuse
from agent.reconstruction.mesh import mesh_of
from agent.reconstruction.plane_sweep import COMPARED, neighbours
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.views import (
    BLOCKS_ACROSS,
    MOST_SPREAD,
    Camera,
    Floats,
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


def stops(seed: int, count: int = MOST) -> list[TankView]:
    """The first `count` keyframes, in the order in which they are taken: robots take theirs in turn."""
    rng, found = generator(seed, "reconstruction", "stops"), list[TankView]()
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
        found.append(TankView(place, yaw + float(sway[0]), TILT_DEG + float(sway[1])))
    return found[:count]


# --- keyframes: pictures by the twin's painter, depths drawn about what its ray caster says ---
# Nothing is swept. A block's depth is the mean of what it truly sees, by 1/z, with the error of the lens position
# that focus would say it has, and goes through the calibration and `focus_map` as a sweep's does. A block has none
# that sees two depths or what is out of reach; of the others some have no texture.

SENSOR = "crop_1280"  # a preset of hw.twin.optics.lens
SHARP_M = 1.0  # where the lens is focused: at what it looks at
NEAREST_M, FARTHEST_M = 0.15, 1.6  # what a sweep reaches
SHOWS = 0.9  # of the blocks have texture enough for a peak


def drawn_views(seed: int, count: int) -> Iterator[View]:
    """The first `count` keyframes of one basin, one after the other."""
    scene = basin(seed)
    cameras = [BasinCamera(scene, seed, robot) for robot in ROBOTS[:count]]
    for n, stop in enumerate(stops(seed, count)):
        yield cameras[n % len(ROBOTS)].view(stop, n)


class BasinCamera:
    """One robot's camera, whose pixels are as large as those that pictures are reduced to."""

    def __init__(self, scene: Scene, seed: int, robot: str) -> None:
        self._robot, self._whole = robot, draw_lens(SENSOR, generator(seed, robot, "lens"))
        self._times, self._block = reduction(self._whole.width), self._whole.width // BLOCKS_ACROSS // 2 * 2
        lens = coarser(self._whole, self._times)
        self._image_m = lens.image_m(WATER_INDEX / SHARP_M)
        self._fit = camera_of(lens, (self._image_m - lens.at_rest_m) / lens.per_position_m)
        self._rng = generator(seed, robot, "drawn depths")
        tank = Tank(size_m=SIZE_M, surface_m=SURFACE_M)
        self._painter = Painter(scene, tank, WATER_INDEX, lens, seed, robot)
        self._painter.prepare()

    def view(self, stop: TankView, n: int) -> View:
        """The survey's keyframe of that number."""
        fit, eye = self._fit, Eye(stop.position_m, rotation_of_view(stop.yaw_deg, stop.tilt_deg))
        camera = Camera(fit.f_px, fit.cx_px, fit.cy_px, fit.bend, fit.ahead_m, fit.width_px, fit.height_px)
        picture = linear(self._painter.frame(eye, self._image_m, tick=n), fit.gamma)
        depth = self.focus(self._painter.depth(eye, self._image_m).astype(float))
        return view_from(stop, self._robot, n // len(ROBOTS), camera, picture, depth)

    def focus(self, truth_m: Floats) -> FocusMap:
        """What a sweep would say of these depths (height, width)."""
        side = self._block / self._times
        rows, cols = self._whole.height // self._block, self._whole.width // self._block
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
        reason = np.where(shows, Reason.ACCEPTED, Reason.NO_TEXTURE).astype(np.uint8).reshape(rows, cols)
        ones = np.ones((rows, cols))
        grid = GridPeaks(peaks.reshape(rows, cols), sigma * ones, FOCUS.width * ones, ones, reason).ranged(FOCUS)
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
COMPILED_CELL_M = 0.02  # of a first, small reconstruction, which is not timed: kernels are compiled by it


def keep(views: Iterable[View], folder: Path) -> None:
    """One file a view, in order: all of them at once do not have to fit this process's memory."""
    for n, view in enumerate(views):
        (folder / f"{n:04d}.pickle").write_bytes(pickle.dumps(view))


def kept(folder: Path, count: int) -> list[View]:
    """The first `count` of them."""
    return [pickle.loads((folder / f"{n:04d}.pickle").read_bytes()) for n in range(count)]


def measured(folder: Path, count: int, seed: int) -> Row:
    """The first `count` keyframes of a folder as `aucamp reconstruct` goes through them, in a process that does nothing
    else: poses that are off are refined; of exact ones a surface is made, a PLY file beside them, and surfels."""
    processes = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=processes) as pool:
        return pool.submit(_measure, folder, count, seed).result()


def _measure(folder: Path, count: int, seed: int) -> Row:
    """Seconds are of the processor, of compiled code."""
    _compile(folder, seed)
    views = kept(folder, count)
    believed = noisy(views, seed)
    start = processor_s()
    refined = refine(believed)
    refined_s = processor_s()
    mesh_of(fuse(stacked(views, 0), CELL_M))
    focused_s = processor_s()
    built = build(views, CELL_M, True, _silent)
    export("ply", built.views, built.mesh, CELL_M, folder)
    built_s = processor_s()
    surfels.learnt(built.views, built.mesh, CELL_M, _silent)
    learnt_s, peak_mb = processor_s(), _peak_mb()
    step = max(1, len(built.mesh.vertices_m) // SAMPLED)
    off, _ = distances_to(built.mesh.vertices_m[::step], np.array([*SIZE_M[:2], SURFACE_M]), basin(seed).solid)
    return {
        "keyframes": count,
        "compared": int((neighbours(stacked(views, 0)).of[:, :COMPARED] >= 0).sum()),
        "refine_s": refined_s - start,
        "focus_s": focused_s - refined_s,
        "surface_s": built_s - focused_s,
        "image_s": learnt_s - built_s,
        "peak_mb": peak_mb,
        "median_mm": 1e3 * float(np.median(off)),
        "refined_mm": off_mm(refined.views, views),
    }


def _compile(folder: Path, seed: int) -> None:
    """All of it once, coarsely, with a few keyframes."""
    few = kept(folder, 3)
    refine(noisy(few, seed))
    built = build(few, COMPILED_CELL_M, True, _silent)
    surfels.learnt(built.views, built.mesh, COMPILED_CELL_M, _silent)


def _peak_mb() -> float:
    """Largest resident memory of this process so far. A process that was started by a larger one may be told that one's
    by getrusage, so Linux is asked for what this program alone has used."""
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(float(line.split()[1]) for line in status if line.startswith("VmHWM:")) * 1024.0 / MB


def _silent(done: int, total: int, what: str = "") -> None:
    """Progress that is not shown."""


# --- the claim ---

SCENE = 45  # keyframes of a scene of a small tank


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    most: int = MOST  # keyframes of the largest survey; the others have a half and a quarter of them


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each number of keyframes: the first ones of one survey."""
    counts = (
        [settings.most // 4, settings.most // 2, settings.most] if case == "survey" else [min(SCENE, settings.most)]
    )
    with TemporaryDirectory() as name:
        folder = Path(name)
        keep(drawn_views(seed, max(counts)), folder)
        return [measured(folder, count, seed) for count in counts]


def summary(rows: Rows) -> dict[str, Value]:
    """Seconds and errors are those of the largest survey; powers are least squares of logarithms.

    A survey's first keyframes are near its rim, where fewer others look at the same: over few keyframes time grows
    faster than they do, until nearly all have as many neighbours as are asked. Pairs that are compared tell that apart
    from work that would go on growing.
    """
    found: dict[str, Value] = {}
    if scenes := rows.get("scene"):
        for key in ("focus_s", "surface_s", "image_s"):
            found[f"scene_{key}"] = max(row[key] for row in scenes)
    if surveys := rows.get("survey"):
        most = max(row["keyframes"] for row in surveys)
        for key in ("surface_s", "image_s", "refine_s", "median_mm", "refined_mm"):
            found[key] = max(row[key] for row in surveys if row["keyframes"] == most)
        found["peak_mb"] = max(row["peak_mb"] for row in surveys)
        found["power_pairs"] = power(surveys, "compared")
        found["power_keyframes"] = power(surveys, "keyframes")
    return found


def power(rows: Sequence[Row], of: str) -> float | None:
    """p of seconds ~ amounts^p; None where fewer than two tell it."""
    told = [(row[of], row["surface_s"]) for row in rows if row[of]]
    if len(told) < 2:
        return None
    amounts, seconds = np.log(told).T
    return float(np.polyfit(amounts, seconds, 1)[0])


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("scene", "survey"),
    quick={"most": 12},
    measured_on="this machine",
    figures=(
        Figure("scene_focus_s", "45 keyframes: surface by focus alone", "s", most=10.0),
        Figure("scene_surface_s", "45 keyframes: by focus and plane sweep", "s", most=90.0),
        Figure("scene_image_s", "45 keyframes: surfels on it", "s", most=300.0),
        Figure("peak_mb", "500 keyframes: memory", "MB", most=4000.0),
        Figure("surface_s", "500 keyframes: surface by focus and plane sweep", "s"),
        Figure("median_mm", "500 keyframes: its median error", "mm"),
        Figure("image_s", "500 keyframes: surfels on it", "s"),
        Figure("refine_s", "500 keyframes: poses that are off, refined", "s"),
        Figure("refined_mm", "500 keyframes: they are off then, mean", "mm"),
        # Each keyframe is compared with five others at most. 1 is what is asked for; times of a machine that does
        # other things, too, scatter by some per cent, of which 5 % over four times as many keyframes are 0.035 of it.
        Figure("power_pairs", "time grows as pairs of pictures to the power of", most=1.05),
        Figure("power_keyframes", "time grows as keyframes to the power of"),
    ),
    seeds=1,
    alone=True,
    explanation="""Seven robots survey a basin of 10 x 6 m with stones, balls and boxes on its floor. Pictures are
        painted, depths drawn with the error that focus says it has. Each number of keyframes, 125, 250 and 500, is
        reconstructed in a process of its own. Seconds are those of the processor, of compiled code.""",
)
