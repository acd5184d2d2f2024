"""A basin of 10 x 6 m with stones and other things on its floor, and where seven robots that survey it take keyframes.

Each robot has a lane along the basin. It stops every few decimetres and looks down to one side, ahead, to the other
side. All set out at one end, so that the first keyframes know one part of the basin as well as all know all of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec

from agent.core.config import Tank
from hw.twin.scene import Scene, Solid, generator, load_scene

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
