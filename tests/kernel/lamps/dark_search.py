"""Robots that swim in search of a ball in the dark, in virtual time: whole kernels, a drawn ball that is seen by light.

A frame shows the ball where the lamps that truly burn, from where they truly are and as they are truly aimed, make at
least SHOWS of all light that comes from its place the ball's own, by the kernel's own model of light: what the twin's
pictures show is what that limit was set by. Tags are seen while the robot's own lamp burns.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from agent.experiments.navigation import basin
from agent.experiments.navigation.bodies import START_NS, PlanarBodies
from agent.experiments.navigation.swimmers import Eyes, Swimmers
from agent.kernel.config import Fleet, Pose, Search
from agent.kernel.control.attitude import Attitude
from agent.kernel.lamps.aim import aim_of
from agent.kernel.lamps.search import SHOWS
from agent.kernel.lighting.information import worth
from agent.kernel.lighting.model import beam_share, pair
from agent.kernel.lighting.settings import Lighting
from agent.kernel.messages import Vector
from hw.twin.devices.camera_device import look
from hw.twin.scene import generator
from tests.kernel.lamps.lit_swarm import HARBOUR

RADIUS_M, FOCAL_PX = 0.07, 1169.0
IN_BEAM = 0.5  # of a lamp's light, and it counts
NEAR_M = 0.45  # of the ball, where nobody starts


class DarkEyes(Eyes):
    """One robot's camera."""

    world: DarkSearch

    def expose(self, bodies, name: str, step: int, sees_tags: bool) -> None:
        super().expose(bodies, name, step, self.world.powers[name] > 0.0)
        frame = self.coming[-1]
        seen = frame.sighting
        if seen is not None and seen.found and not self.world.shows(name):
            hidden = replace(seen, found=False, centre_px=None, radius_px=None, clarity=None, area_px=None, score=0.0)
            self.coming[-1] = frame._replace(sighting=hidden)


class DarkSearch(Swimmers):
    """Robots with lamps, each told to search."""

    def __init__(self, seed: int, lighting: Lighting = HARBOUR) -> None:
        fleet, self.ball_m = drawn_fleet(seed, lighting)
        bodies = PlanarBodies(fleet)
        super().__init__(fleet, bodies, self.ball_m)
        self.aim, self.lighting = aim_of(fleet, lighting), lighting
        self.powers = dict.fromkeys(fleet.robot, 0.0)
        for name in fleet.robot:
            eyes = self.eyes[name] = DarkEyes(fleet, name, bodies, self.ball_m)
            eyes.world = self
        self.first_s: float | None = None  # the ball in a frame
        self.measured_s: dict[str, float] = {}  # by each robot, for the first time, and by whose lamps
        self.by: dict[str, tuple[str, ...]] = {}
        self.looks = 0  # by lent light

    def step(self) -> None:
        super().step()
        self.powers = {name: outputs.set_point.light for name, outputs in self.outputs.items()}
        if self.first_s is None and any(s.found for inputs in self.inputs.values() for s in inputs.sightings):
            self.first_s = self.seconds
        for name, outputs in self.outputs.items():
            self.looks += sum("searches for" in line.text for line in outputs.log)
            if outputs.outcome and outputs.outcome.x_m is not None and name not in self.measured_s:
                self.measured_s[name] = self.seconds
                self.by[name] = tuple(outputs.outcome.lit or ())

    @property
    def seconds(self) -> float:
        return (self.now_ns - START_NS) * 1e-9

    def shows(self, name: str) -> bool:
        """Whether the light that there is shows the ball to that robot."""
        eye, _ = look(self.bodies.pose(name), self.fleet.body.camera_m)
        camera_m = _vector(eye.position_m)
        pairs = [
            pair(camera_m, self.ball_m, RADIUS_M, lamp_m, self.lighting)
            for other, power in self.powers.items()
            if power > 0.0 and (lamp_m := self._shines(other)) is not None
        ]
        if not pairs:
            return False
        return worth(pairs, math.dist(camera_m, self.ball_m), RADIUS_M, FOCAL_PX, 1.0).contrast >= SHOWS

    def _shines(self, name: str) -> Vector | None:
        """Where its lamp is, if that is aimed at the ball."""
        x, y, yaw = self.place(name)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(yaw))
        level = Attitude(basin.DEPTH_M, 0.0, 0.0)
        lamp_m = self.aim.place_m(pose, level)
        pan, tilt = (math.radians(deg) for deg in self.aim.deg(self.outputs[name].set_point.servos_us[2:]))
        aimed = np.array((math.cos(yaw + pan) * math.cos(tilt), math.sin(yaw + pan) * math.cos(tilt), math.sin(tilt)))
        way = np.array(self.ball_m) - lamp_m
        off = math.acos(min(max(float(aimed @ way) / float(np.linalg.norm(way)), -1.0), 1.0))
        return lamp_m if beam_share(off, math.radians(self.lighting.beam.half_deg)) > IN_BEAM else None


def drawn_fleet(seed: int, lighting: Lighting, robots: int = 3) -> tuple[Fleet, Vector]:
    """Robots at drawn places of the experiment's basin, and where the ball lies."""
    rng = generator(seed, "dark search")
    length, breadth, _ = basin.TANK.size_m
    ball_m = *(float(at) for at in rng.uniform((0.4, 0.4), (length - 0.4, breadth - 0.4))), RADIUS_M
    places: list[np.ndarray] = []
    while len(places) < robots:
        at = rng.uniform((0.35, 0.35), (length - 0.35, breadth - 0.35))
        if min([np.hypot(*(at - other)) for other in places], default=9.0) > 0.6 and _far(at, ball_m):
            places.append(at)
    names = [f"r{k + 1}" for k in range(robots)]
    told = {
        name: replace(
            basin.robot(
                name,
                Pose(x_m=float(x), y_m=float(y), yaw_deg=float(rng.uniform(-180.0, 180.0))),
                Search(target="ball"),
                neighbours=tuple(other for other in names if other != name),
            ),
            lamp=True,
        )
        for name, (x, y) in zip(names, places, strict=True)
    }
    return replace(basin.fleet(told, seed), lighting=lighting), ball_m


def _far(at: np.ndarray, ball_m: Vector) -> bool:
    return math.dist(at, ball_m[:2]) > NEAR_M


def _vector(at) -> Vector:
    x, y, z = (float(part) for part in at)
    return x, y, z
