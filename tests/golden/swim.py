"""Golden cases of robots that swim, in the basin of the experiments: kernels around planar bodies and drawn cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from agent.core.config import Look, Navigation, Pose
from agent.core.step_io import SetPoint, Telemetry
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, STEP_NS, PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from tests.replay.step_box import Recorded, Said

STEPS_S = 10**9 // STEP_NS

ORDERS = (
    Said(8.0, "goto", {"x_m": 1.0, "y_m": 1.3, "depth_m": 0.25}),
    Said(12.0, "turn", {"yaw_deg": 0.0}),
    Said(14.0, "set", {"name": "speed_m_s", "value": 0.1}),
    Said(14.0, "orbit", {"x_m": 1.5, "y_m": 1.0, "radius_m": 0.6, "speed_m_s": 0.1}),
    Said(18.0, "trial", {"x_m": 1.4, "y_m": 0.7, "half_m": 0.3}),
    Said(22.0, "goto", {"x_m": 0.05, "y_m": 1.0}),
    Said(22.0, "goto", {"x_m": 1.0, "y_m": 1.0, "depth_m": 0.9}),
    Said(22.0, "follow", {"target": "wreck", "standoff_m": 0.5}),
    Said(22.0, "search", {"target": "ball", "speed_m_s": 2.0}),
    Said(22.0, "set", {"name": "speed_m_s", "value": 3.0}),
    Said(22.0, "survey"),
    Said(22.0, "hold", {"depth_m": 0.2}),
    Said(24.0, "resume"),
)


class GyroBodies(PlanarBodies):
    """Bodies whose control modules have a gyro."""

    def step(self, wanted: Mapping[str, SetPoint]) -> dict[str, tuple[Telemetry, ...]]:
        said = super().step(wanted)
        return {
            name: tuple(replace(each, rate_rad_s=float(self._bodies[name].speed[2])) for each in told)
            for name, told in said.items()
        }


def record(
    swimmers: Swimmers,
    out: Path,
    seconds: float,
    orders: Sequence[Said] = (),
    before: Callable[[float], None] = lambda at_s: None,
    robots: Sequence[str] = ("r1",),
) -> None:
    """Dive, and keep what these robots take in and give. before: called ahead of each step."""
    for name in robots:
        file, calibration = out / f"{name}.mcap", swimmers.calibrations[name]
        swimmers.agents[name] = Recorded(file, swimmers.fleet, name, calibration, START_NS, orders)
    for step in range(round(seconds * STEPS_S)):
        before(step / STEPS_S)
        swimmers.step()
    for name in robots:
        swimmers.agents[name].box.finish()


def swim(out: Path) -> None:
    """Two robots around a ball. r1 is sent about, and loses its landmarks."""
    names = ("r1", "r2")
    poses = (Pose(x_m=0.8, y_m=0.6, yaw_deg=40.0), Pose(x_m=2.2, y_m=1.4, yaw_deg=-150.0))
    robots = {
        name: basin.robot(name, pose, None, Look(tilt_deg=-15.0), tuple(other for other in names if other != name))
        for name, pose in zip(names, poses, strict=True)
    }
    fleet = replace(basin.fleet(robots, 5), navigation=Navigation(gyro=True))
    swimmers = Swimmers(fleet, GyroBodies(fleet), (1.5, 1.0, 0.07))

    def before(at_s: float) -> None:
        swimmers.follows_points = at_s < 9.0
        swimmers.sees_tags = lambda now_ns: not 26.0 <= at_s < 33.0

    record(swimmers, out, 37.0, ORDERS, before)
