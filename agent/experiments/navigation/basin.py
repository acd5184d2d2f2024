"""The basin of this experiment: 3 x 2 m, tags of 8 cm every 25 cm on the floor and in two rows on each wall."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agent.core.config import Behaviour, Face, Fleet, Landmarks, Look, Navigation, Pose, Robot, Tag, Tank, Target, Twin
from agent.core.messages import Vector

TANK = Tank(size_m=(3.0, 2.0, 0.8), surface_m=0.6)
TAG_M, PITCH_M, ROWS_M = 0.08, 0.25, (0.15, 0.40)  # rows: heights on the walls
DEPTH_M = 0.30
FLOOR_LOOK = Look(tilt_deg=-40.0)  # at the floor half a metre ahead: a whole tag nearly always, and points to follow
BALL = Target(radius_m=0.07)
TURN_S = 3.0  # for which what swims keeps a course, by its fleet file


def tags() -> tuple[Tag, ...]:
    """All of them, as surveyed. Each is turned otherwise than those beside it."""
    length_m, breadth_m, _ = TANK.size_m
    along_x, along_y = (np.arange(PITCH_M, side_m - 0.1, PITCH_M) for side_m in (length_m, breadth_m))
    places: list[tuple[Face, Vector]] = [("floor", (float(x), float(y), 0.0)) for x in along_x for y in along_y]
    for z in ROWS_M:
        places += [(face, (float(x), at, z)) for face, at in _faces("y0", "y1", breadth_m) for x in along_x]
        places += [(face, (at, float(y), z)) for face, at in _faces("x0", "x1", length_m) for y in along_y]
    return tuple(
        Tag(id=k, face=face, position_m=at_m, turn_deg=15.0 * (k % 5)) for k, (face, at_m) in enumerate(places)
    )


def _faces(near: Face, far: Face, at_m: float) -> tuple[tuple[Face, float], tuple[Face, float]]:
    return (near, 0.0), (far, at_m)


def fleet(robots: Mapping[str, Robot], seed: int, ball: Target = BALL) -> Fleet:
    """Robots in the basin, and a ball; seed: of the twin's world."""
    return Fleet(
        fleet="navigation",
        tank=TANK,
        target={"ball": ball},
        landmarks=Landmarks(size_m=TAG_M, tag=tags()),
        navigation=Navigation(),
        robot=dict(robots),
        twin=Twin(seed=seed, scene="swim"),
    )


def robot(
    name: str, pose: Pose, behaviour: Behaviour | None = None, look: Look = FLOOR_LOOK, neighbours: tuple[str, ...] = ()
) -> Robot:
    """One of them; its devices are never opened."""
    return Robot(
        neighbours=neighbours,
        listen=f"tcp/127.0.0.1:{17400 + int(name[1:])}",
        serial=f"twin:{name}",
        camera=f"twin:{name}",
        pose=pose,
        depth_m=DEPTH_M,
        look=look,
        calibration=f"{name}.toml",
        behaviour=behaviour,
    )
