"""What a robot's camera would tell of a ball: outline, and clarity at each lens position of a sweep, never rendered.

What it errs by is what the kernel is told that it errs by: the picture by its noise; the lens by its calibration's
covariance and noise, drawn once, and for each sweep; so that a measurement is as good as it says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Fleet
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit, FocusFit, centre_behind_skin_m, pixel
from agent.core.ranging.fix import CENTRE_NOISE_PX
from agent.core.step_io import Sighting, SweepPlan
from agent.experiments.navigation.planar_body import RING_M
from hw.twin.devices.camera_device import look
from hw.twin.history import RobotPose
from hw.twin.scene import generator

# What the bench finds of a robot of the twin, rounded.
FOCUS = FocusFit(
    u_inf_m=0.0012,
    b_m=136.5,
    rho0=91.7,
    covariance=(6.0357e-07, -4.6495e-04, 5.7052e-04, 0.36813, -0.46705, 0.62577),
    noise=0.4,
    width=119.0,
    lowest=208,
    highest=717,
    r2=0.999,
    rmse_m=0.008,
    held_out_rmse_m=0.008,
)
RADIUS_SIGMA_PX = 0.2
BALL_FARTHEST_M = 1.6
OUTLINE = 24  # points of it that are looked at
CIRCLE = tuple((math.cos(2.0 * math.pi * k / OUTLINE), math.sin(2.0 * math.pi * k / OUTLINE)) for k in range(OUTLINE))


BallPath = Callable[[int], Vector]  # where it is at a time, ns


class Pillar(NamedTuple):
    """Upright, from the floor to the surface."""

    x_m: float
    y_m: float
    radius_m: float


def ring(robot: RobotPose) -> Pillar:
    """A robot as what hides things."""
    x, y, _ = robot.position_m.tolist()
    return Pillar(x, y, RING_M)


class DrawnTarget:
    """One robot's view of one target; path: where that lies, or its path."""

    def __init__(self, fleet: Fleet, path: Vector | BallPath) -> None:
        self._target, self._path, self._frames = next(iter(fleet.target)), path, 0

    def sight(
        self,
        pose: RobotPose,
        t_ns: int,
        plan: SweepPlan | None = None,
        index: int = -1,
        before: Sequence[Pillar] = (),
    ) -> Sighting:
        """The newest frame; plan, index: at which position of which sweep. before: what may be before the target, and
        hides it where its middle is behind."""
        self._frames += 1
        sweep = 0 if plan is None else plan.sweep
        self._begins(sweep)
        at_m = self._path(t_ns) if callable(self._path) else self._path
        x, y, _ = pose.position_m.tolist()
        hidden = any(hides(pillar, (x, y), at_m) for pillar in before)
        lens_position = None if plan is None else plan.focus[index]
        shows = None if hidden else self._shows(pose, t_ns, at_m, lens_position)
        frame = Sighting(
            t_ns=t_ns,
            frame=self._frames,
            sweep=sweep,
            index=index,
            focus=lens_position,
            target=self._target,
            found=shows is not None,
        )
        return frame if shows is None else msgspec.structs.replace(frame, **shows)

    def unseen(self, t_ns: int) -> Sighting:
        """The newest frame, of a camera that is covered."""
        self._frames += 1
        return Sighting(t_ns=t_ns, frame=self._frames, target=self._target, found=False)

    def _begins(self, sweep: int) -> None:
        """Asked of each frame, whether it shows anything or not; 0: no sweep."""

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        """What a Sighting says of a target that is there with nothing before it; None: it is not found."""
        raise NotImplementedError


class DrawnBall(DrawnTarget):
    """A ball; ball_m: where it lies, or its path."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit, ball_m: Vector | BallPath) -> None:
        super().__init__(fleet, ball_m)
        target = fleet.target[self._target]
        assert target.radius_m is not None  # a ball
        self._rng = generator(fleet.twin.seed, name, "drawn ball")
        self._radius_m = target.radius_m
        self._camera, self._camera_m = camera, fleet.body.camera_m
        xx, xy, xz, yy, yz, zz = FOCUS.covariance
        covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self._lens = np.array([FOCUS.u_inf_m, FOCUS.b_m, FOCUS.rho0]) + self._rng.multivariate_normal(
            np.zeros(3), covariance
        )
        self.shown = 1.0  # of its outline, or it is not found
        self._shift, self._sweep = 0.0, 0

    def _begins(self, sweep: int) -> None:
        if sweep != self._sweep:
            self._sweep, self._shift = sweep, float(self._rng.normal(0.0, FOCUS.noise))

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        seen = self._outline(pose, at_m)
        if seen is None:
            return None
        centre_px, radius_px, peak = seen
        return {
            "centre_px": centre_px,
            "radius_px": radius_px,
            "clarity": None if lens_position is None else _clarity(lens_position - peak - self._shift),
            "area_px": math.pi * (0.5 * radius_px) ** 2,
            "score": 1.0,
            "radius_sigma_px": RADIUS_SIGMA_PX,
        }

    def _outline(self, pose: RobotPose, ball_m: Vector) -> tuple[tuple[float, float], float, float] | None:
        """Centre and radius in the picture, px, and the lens position at which it is sharpest; None: not in sight."""
        eye, _ = look(pose, self._camera_m)
        way: NDArray[np.float64] = (np.array(ball_m) - np.asarray(eye.position_m)) @ np.asarray(eye.rotation)
        x, y, z = way.tolist()
        centre = pixel(self._camera, (x, y, z))
        distance_m = math.hypot(x, y, z - self._camera.ahead_m)
        if centre is None or not self._radius_m < distance_m < BALL_FARTHEST_M:
            return None
        noise_px = math.hypot(self._camera.noise_px, CENTRE_NOISE_PX)
        u, v = (float(value) for value in np.array(centre) + self._rng.normal(0.0, noise_px, 2))
        radius_px = self._camera.f_px * math.tan(math.asin(self._radius_m / distance_m))
        width, height = self._camera.width_px, self._camera.height_px
        if self.shown * OUTLINE > sum(
            0.0 < u + radius_px * x < width and 0.0 < v + radius_px * y < height for x, y in CIRCLE
        ):
            return None
        skin_m = distance_m - self._radius_m
        for _ in range(5):
            skin_m = distance_m - centre_behind_skin_m(skin_m, self._radius_m)
        u_inf, b, rho0 = self._lens
        peak = rho0 + b / (skin_m * z / distance_m - u_inf)
        return (u, v), radius_px + float(self._rng.normal(0.0, RADIUS_SIGMA_PX)), float(peak)


def hides(pillar: Pillar, from_m: tuple[float, float], ball_m: Vector) -> bool:
    """As seen from above: all hover at one depth, the ball a little below."""
    way = ball_m[0] - from_m[0], ball_m[1] - from_m[1]
    to = pillar.x_m - from_m[0], pillar.y_m - from_m[1]
    along = (to[0] * way[0] + to[1] * way[1]) / (way[0] * way[0] + way[1] * way[1])
    return 0.0 < along < 1.0 and math.hypot(to[0] - along * way[0], to[1] - along * way[1]) < pillar.radius_m


def _clarity(from_peak: float) -> float:
    """The curve of a lens so many positions away from its peak."""
    return 100.0 + 900.0 / (1.0 + (from_peak / FOCUS.width) ** 2)
