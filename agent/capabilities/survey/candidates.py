"""Views that a robot might take next, and which of them it takes.

They are drawn from the robot's name and the number of its next keyframe, not from chance: a replay draws the same. Of
those that promise alike the first is taken. What others claim is added to the map first: nobody goes to see what a
neighbour is about to see.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from agent.capabilities.survey.cast import Beam, beam, expected, gain
from agent.capabilities.survey.grid import Grid
from agent.capabilities.survey.rays import quaternion
from agent.capabilities.swim.barrier import Planar
from agent.core.capability_messages import Lens, View, place_of
from agent.core.config import Body, Pose
from agent.core.linear_algebra import wrap
from agent.core.ranging.camera_model import camera_pose

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
    best: Best | None,
    candidate: Candidate,
    by: Ahead,
    allowed: Callable[[Candidate], bool] = lambda _: True,
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
