"""How the robots of a dive begin: bodies drawn, put where the crew really puts them, held until they are armed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Fleet
from hw.twin.physics.body import BODY, draw_body
from hw.twin.physics.plant import Plant, set_body
from hw.twin.physics.rotation import quaternion
from hw.twin.physics.tank import STATE
from hw.twin.scene import StartSigma, put_off


def launch(
    fleet: Fleet, robots: Sequence[str], plants: Sequence[Plant], sigma: StartSigma
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """(n,) BODY and (n,) STATE of the robots, each with what its plant overrides."""
    bodies, states = np.zeros(len(robots), BODY), np.zeros(len(robots), STATE)
    for i, name in enumerate(robots):
        pose, depth_m = fleet.robot[name].pose, fleet.robot[name].depth_m
        x_m, y_m, yaw_deg = put_off(sigma, (pose.x_m, pose.y_m, pose.yaw_deg), fleet.twin.seed, name)
        start = (x_m, y_m, fleet.tank.surface_m - depth_m, yaw_deg)
        bodies[i] = draw_body(fleet.twin.seed, name, start, fleet.tank, fleet.body)
        set_body(bodies[i], plants[i])
    states["held"] = 1
    states["position_m"] = bodies["home_m"]
    states["quaternion"] = [quaternion(0.0, 0.0, yaw) for yaw in bodies["home_yaw_rad"]]
    states["motor_deg"] = states["shaft_deg"] = bodies["servo_zero_deg"]
    return bodies, states
