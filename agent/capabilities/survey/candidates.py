"""Views that a robot might take next, and which of them it takes.

They are drawn from the robot's name and the number of its next keyframe, not from chance: a replay draws the same. Of
those that promise alike the first is taken. What others claim is added to the map first: no robot goes to see what a
neighbour is about to see.

Rays through the map tell what a view would show, and what lamps would have to light there.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import NamedTuple

from agent.capabilities.light.allocate import FrameScene, Spot
from agent.capabilities.survey.coverage_map import (
    ALONE_COS,
    FARTHEST_M,
    NEAREST_M,
    Grid,
    Slopes,
    along,
    expected_mm,
    information,
    is_inner,
    place_m,
    quaternion,
    rotation,
    slope,
)
from agent.capabilities.swim.barrier import Planar
from agent.core.capability_messages import Lens, View, place_of
from agent.core.config import Body, Pose
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.ranging.camera_model import camera_pose

# --- rays through the map ---
# What a camera would see from somewhere, by the map as it is: rays through cells that nothing is known to be in,
# until one that something is in, or a wall or the floor.

ACROSS, DOWN = 13, 10  # rays of a view: as many blocks stand for one
FAR = 1e9
ROUNDING_M = 1e-9  # a wall lies on the edge of a cell, and the ray ends before it is in none


class Beam(NamedTuple):
    """The rays of one camera, the same for each view."""

    slopes: Slopes
    worth: int  # blocks for which a ray stands, times 100


def beam(lens: Lens, rows: int) -> Beam:
    slopes = tuple(
        slope(lens, (i + 0.5) * lens.cols / ACROSS, (j + 0.5) * rows / DOWN) for j in range(DOWN) for i in range(ACROSS)
    )
    return Beam(slopes, max(round(100 * lens.cols * rows / (ACROSS * DOWN)), 1))


def expected(view: View, beam: Beam, grid: Grid, stops: Collection[int]) -> dict[int, int]:
    """Which cells a view would add how much to; what of them counts is for `gain` to say. stops: cells that no ray
    passes."""
    r, at = rotation(view.turn), place_m(view.place)
    found: dict[int, int] = {}
    for s in beam.slopes:
        hit = cast(at, along(r, s), grid, stops)
        if hit is None:
            continue
        number, z_m, cos = hit
        if NEAREST_M < z_m < FARTHEST_M and (weight := information(cos, expected_mm(z_m, view.sigma))):
            found[number] = found.get(number, 0) + weight * beam.worth // 100
    return found


def cast(at: Vector, way: Vector, grid: Grid, stops: Collection[int]) -> tuple[int, float, float] | None:
    """The first cell that stops a ray, its depth, and the cosine there; None: it leaves through the surface, or goes
    too far. way: world direction per metre of depth (Amanatides and Woo, A fast voxel traversal algorithm for ray
    tracing, Eurographics 1987)."""
    if not all(0.0 < p < size for p, size in zip(at, grid.size_m, strict=True)):
        return None
    cell_m, (nx, ny, _) = grid.cell_m, grid.shape
    steps, nexts, strides, ends, index = [], [], [], [], 0
    exit_z, exit_axis = FAR, 2
    for axis, (p, w, size, stride) in enumerate(zip(at, way, grid.size_m, (1, nx, nx * ny), strict=True)):
        k = min(int(p / cell_m), grid.shape[axis] - 1)
        index += k * stride
        step = 1 if w > 0.0 else -1
        if w == 0.0:
            nexts.append(FAR)
            ends.append(FAR)
        else:
            nexts.append(((k + (step > 0)) * cell_m - p) / w)
            ends.append(cell_m / abs(w))
            out = ((size if w > 0.0 else 0.0) - p) / w
            if out < exit_z:
                exit_z, exit_axis = out, axis
        steps.append(step)
        strides.append(step * stride)
    length = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    tx, ty, tz = nexts
    dx, dy, dz = ends
    sx, sy, sz = strides
    z, first = 0.0, index
    while True:
        if tx <= ty and tx <= tz:
            ahead, after, stride = tx, tx + dx, 0
        elif ty <= tz:
            ahead, after, stride = ty, ty + dy, 1
        else:
            ahead, after, stride = tz, tz + dz, 2
        if ahead >= exit_z - ROUNDING_M or ahead > FARTHEST_M:
            break
        if stride == 0:
            tx, index = after, index + sx
        elif stride == 1:
            ty, index = after, index + sy
        else:
            tz, index = after, index + sz
        z = ahead
        # On the floor and the walls the plane itself is what stops the ray: their cells are known to be there.
        if index in stops and index != first:
            return index, z, ALONE_COS
    if exit_z > FARTHEST_M or (exit_axis == 2 and steps[2] > 0):
        return None
    return index, exit_z, abs(way[exit_axis]) / length


def gain(adds: Mapping[int, int], grid: Grid, cells: Mapping[int, int]) -> int:
    """By how many wanted cells, in thousandths, a view brings the map nearer to what is wanted:
    sum of min((I + dI) / I_goal, 1) - min(I / I_goal, 1)."""
    total, goal = 0, grid.goal
    for number, weight in adds.items():
        if number in grid.wanted or is_inner(number, grid):
            have = cells.get(number, 0)
            total += min(have + weight, goal) - min(have, goal)
    return 1000 * total // goal


# --- candidates ---

CANDIDATES = 60
TILTS_DEG = (-55.0, 5.0)
STAY = 3  # every third of a robot that swims is from where it is: turning takes less time than swimming
GIMBAL_RAD = math.radians(50.0)  # to either side: beyond, the body turns after the gimbal
SWEEP_S = 5.0  # a view takes so long wherever it is
TURN_RAD_S, SWIM_M_S = 0.4, 0.12  # on the way, with what it takes to come to rest


class Station(NamedTuple):
    """Where a body stands, and how its camera is turned there."""

    place_m: Planar
    yaw: float  # rad
    pan_deg: float
    tilt_deg: float


class Candidate(NamedTuple):
    station: Station
    view: View
    seconds: float  # until it has been seen


class Where(NamedTuple):
    """What the draw goes by."""

    pose: Pose
    depth_m: float
    surface_m: float
    body: Body
    lens: Lens
    rows: int
    sigma: int  # of its blocks, as View has it
    room: tuple[Planar, Planar] | None  # lower and upper corner of where it may swim; None: it is moored


def drawn(where: Where, robot: str, number: int, k: int) -> Candidate:
    """The k-th candidate for that keyframe of that robot."""
    a, b, c, d = _shares(f"{robot} {number} {k}")
    low, high = (max(TILTS_DEG[0], where.body.tilt_limit_deg[0]), min(TILTS_DEG[1], where.body.tilt_limit_deg[1]))
    tilt, here = low + (high - low) * b, (where.pose.x_m, where.pose.y_m)
    yaw = math.radians(where.pose.yaw_deg)
    if where.room is None:
        left, right = where.body.pan_limit_deg
        station = Station(here, yaw, left + (right - left) * a, tilt)
    else:
        (x0, y0), (x1, y1) = where.room
        place = here if k % STAY == 0 else (x0 + (x1 - x0) * c, y0 + (y1 - y0) * d)
        bearing = 2.0 * math.pi * a - math.pi
        off = wrap(bearing - yaw)
        turned = yaw if abs(off) <= GIMBAL_RAD else wrap(bearing - math.copysign(GIMBAL_RAD, off))
        station = Station(place, turned, math.degrees(wrap(bearing - turned)), tilt)
    way = math.dist(here, station.place_m) / SWIM_M_S + abs(wrap(station.yaw - yaw)) / TURN_RAD_S
    return Candidate(station, view_of(station, where), SWEEP_S + way)


def view_of(station: Station, where: Where) -> View:
    """What the camera sees from there, of a body that hangs level."""
    (x, y), yaw_deg = station.place_m, math.degrees(station.yaw)
    pose = Pose(x_m=x, y_m=y, yaw_deg=yaw_deg)
    eye = camera_pose(pose, where.body, where.depth_m, 0.0, 0.0, station.pan_deg, station.tilt_deg, where.surface_m)
    return View(place_of(eye.position_m), quaternion(eye.rotation), where.lens, where.rows, where.sigma)


def with_claims(cells: Mapping[int, int], stops: frozenset[int], views: Iterable[View], grid: Grid) -> dict[int, int]:
    """The map as it will be when others have seen what they are about to see. What each adds goes by the map as it
    is, so that the order of the claims does not count."""
    found = dict(cells)
    for view in views:
        for number, weight in expected(view, beam(view.lens, view.rows), grid, stops).items():
            found[number] = found.get(number, 0) + weight
    return found


class Ahead(NamedTuple):
    """What a choice goes by: the same for all of its candidates."""

    grid: Grid
    cells: Mapping[int, int]  # the map with what others claim
    stops: frozenset[int]  # cells that no ray passes
    beam: Beam


def ahead(where: Where, grid: Grid, cells: Mapping[int, int], stops: frozenset[int], claims: Iterable[View]) -> Ahead:
    return Ahead(grid, with_claims(cells, stops, claims, grid), stops, beam(where.lens, where.rows))


class Best(NamedTuple):
    """The best of the candidates looked at so far."""

    candidate: Candidate
    gain: int  # thousandths of cells
    worth: int  # gain for each second


def better(
    best: Best | None, candidate: Candidate, by: Ahead, allowed: Callable[[Candidate], bool] = lambda _: True
) -> Best | None:
    """The better of the two; the first of equals, and nothing for what is not allowed or gains nothing."""
    if not allowed(candidate):
        return best
    view = candidate.view
    gains = gain(expected(view, by.beam, by.grid, by.stops), by.grid, by.cells)
    worth = int(1000 * gains / candidate.seconds)
    if gains <= 0 or (best is not None and worth <= best.worth):
        return best
    return Best(candidate, gains, worth)


def _shares(text: str) -> tuple[float, float, float, float]:
    """Four numbers from 0 to 1."""
    data = hashlib.sha256(text.encode()).digest()
    a, b, c, d = (int.from_bytes(data[8 * k : 8 * k + 4], "big") / 2.0**32 for k in range(4))
    return a, b, c, d


# --- what lamps would light ---
# What a view is expected to show, as spots for the rule that lends lamps: places, how they face, and what they count.
#
# Places are where rays end by the map as it is. Walls and the floor face as they do; a thing is taken to face the
# camera. A place whose cell is known well enough counts nothing, and so does one that is too far to count.

SPOTS_ACROSS, SPOTS_DOWN = 5, 4
ON_M = 1e-6  # of a wall or the floor: a ray ends there, but for rounding
AHEAD_M = 1.0  # where lamps aim of a view that is expected to show nothing


def frame_scene(view: View, grid: Grid, cells: Mapping[int, int], stops: frozenset[int]) -> FrameScene:
    """cells, stops: of the map (CoverageMap)."""
    r, at = rotation(view.turn), place_m(view.place)
    axis, worth = along(r, (0.0, 0.0)), view.lens.cols * view.rows / (SPOTS_ACROSS * SPOTS_DOWN)
    spots = []
    for j in range(SPOTS_DOWN):
        for i in range(SPOTS_ACROSS):
            s = slope(view.lens, (i + 0.5) * view.lens.cols / SPOTS_ACROSS, (j + 0.5) * view.rows / SPOTS_DOWN)
            way = along(r, s)
            if (hit := cast(at, way, grid, stops)) is None:
                continue
            number, z_m, _ = hit
            counts = NEAREST_M < z_m < FARTHEST_M and cells.get(number, 0) < grid.goal
            there = _further(at, way, z_m)
            spots.append(Spot(there, _normal(there, way, grid.size_m), worth if counts else 0.0))
    return FrameScene(at, axis, _middle(spots) or _further(at, axis, AHEAD_M), tuple(spots), view.lens.block)


def _middle(spots: list[Spot]) -> Vector | None:
    """Of those that count."""
    whole = sum(spot.blocks for spot in spots)
    if not whole:
        return None
    x, y, z = (sum(spot.blocks * spot.at_m[k] for spot in spots) / whole for k in range(3))
    return x, y, z


def _further(at: Vector, way: Vector, z_m: float) -> Vector:
    x, y, z = (p + z_m * w for p, w in zip(at, way, strict=True))
    return x, y, z


def _normal(at_m: Vector, way: Vector, size_m: Vector) -> Vector:
    for axis, (at, size) in enumerate(zip(at_m, size_m, strict=True)):
        out = 1.0 if at < ON_M else -1.0 if at > size - ON_M else 0.0
        if out:
            x, y, z = (out if k == axis else 0.0 for k in range(3))
            return x, y, z
    length = math.sqrt(sum(w * w for w in way))
    x, y, z = (-w / length for w in way)
    return x, y, z
