"""Robots that swim in the dark, in virtual time: whole kernels, a drawn target that is seen by light.

A frame shows the target where the lamps that truly burn, from where they truly are and as they are truly aimed, make at
least so much of all light that comes from its place the target's own, by the kernel's own model of light: what the
twin's pictures show is what these limits were set by. Tags are seen while the robot's own lamp burns.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from agent.capabilities.light.allocate import aim_of, worth
from agent.capabilities.light.model import beam_share, pair
from agent.core.attitude import Attitude
from agent.core.config import Fleet, Pose
from agent.core.messages import Vector
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, Bodies
from agent.experiments.navigation.swimmers import BallPath, Eyes, Swimmers
from hw.twin.camera_device import look

FOCAL_PX = 1169.0
IN_BEAM = 0.5  # of a lamp's light, and it counts


class DarkEyes(Eyes):
    """One robot's camera."""

    world: DarkWater

    def expose(self, bodies: Bodies, name: str, step: int, sees_tags: bool) -> None:
        super().expose(bodies, name, step, sees_tags and self.world.powers[name] > 0.0)
        frame = self.coming[-1]
        seen = frame.sighting
        if seen is not None and seen.found and not self.world.shows(name):
            hidden = replace(
                seen, found=False, centre_px=None, radius_px=None, size_px=None, clarity=None, area_px=None, score=0.0
            )
            self.coming[-1] = frame._replace(sighting=hidden)


class DarkWater(Swimmers):
    """Robots with lamps. path: where the target is; radius_m, plain: how large, and what share of light shows it."""

    def __init__(self, fleet: Fleet, bodies: Bodies, path: BallPath, radius_m: float, plain: float) -> None:
        super().__init__(fleet, bodies, path if fleet.target["ball"].radius_m else None)
        assert fleet.lighting is not None
        self.path, self._radius_m, self._plain = path, radius_m, plain
        self.aim, self.lighting = aim_of(fleet, fleet.lighting), fleet.lighting
        self.powers = dict.fromkeys(fleet.robot, 0.0)
        self.looks = 0  # by lent light
        for name in fleet.robot:
            eyes = DarkEyes(fleet, name, bodies, None)
            eyes.ball, eyes.world = self.eyes[name].ball, self
            self.eyes[name] = eyes

    def step(self) -> None:
        super().step()
        self.powers = {name: outputs.set_point.light for name, outputs in self.outputs.items()}
        self.looks += sum("searches for" in line.text for outputs in self.outputs.values() for line in outputs.log)

    @property
    def seconds(self) -> float:
        return (self.now_ns - START_NS) * 1e-9

    def shows(self, name: str) -> bool:
        """Whether the light that there is shows the target to that robot."""
        eye, _ = look(self.bodies.pose(name), self.fleet.body.camera_m)
        camera_m, target_m = _vector(eye.position_m), self.path(self.now_ns)
        pairs = [
            pair(camera_m, target_m, self._radius_m, lamp_m, self.lighting)
            for other, power in self.powers.items()
            if power > 0.0 and (lamp_m := self._shines(other, target_m)) is not None
        ]
        if not pairs:
            return False
        found = worth(pairs, math.dist(camera_m, target_m), self._radius_m, FOCAL_PX, 1.0)
        return found.contrast >= self._plain

    def off_deg(self, name: str, at_m: Vector) -> float:
        """By how much its camera's axis passes a place."""
        eye, _ = look(self.bodies.pose(name), self.fleet.body.camera_m)
        way = np.array(at_m) - np.array(eye.position_m)
        along = float(np.asarray(eye.rotation)[:, 2] @ way) / float(np.linalg.norm(way))
        return math.degrees(math.acos(min(max(along, -1.0), 1.0)))

    def _shines(self, name: str, target_m: Vector) -> Vector | None:
        """Where its lamp is, if that is aimed at the target."""
        x, y, yaw = self.place(name)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(yaw))
        lamp_m = self.aim.place_m(pose, Attitude(basin.DEPTH_M, 0.0, 0.0))
        pan, tilt = (math.radians(deg) for deg in self.aim.deg(self.outputs[name].set_point.servos_us[2:]))
        aimed = np.array((math.cos(yaw + pan) * math.cos(tilt), math.sin(yaw + pan) * math.cos(tilt), math.sin(tilt)))
        way = np.array(target_m) - lamp_m
        off = math.acos(min(max(float(aimed @ way) / float(np.linalg.norm(way)), -1.0), 1.0))
        return lamp_m if beam_share(off, math.radians(self.lighting.beam.half_deg)) > IN_BEAM else None


def _vector(at) -> Vector:
    x, y, z = (float(part) for part in at)
    return x, y, z
