"""What a robot that swims is told to do, by its fleet file or by order, and how far it is with that."""

from __future__ import annotations

import math

from agent.capabilities.swim.barrier import Planar
from agent.capabilities.swim.behaviour import Progress, reference, start
from agent.capabilities.swim.pilot import Reference
from agent.capabilities.swim.surroundings import Surroundings
from agent.core.config import Behaviour, Hold, Robot
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.step_transaction import Revertible


class Task(Revertible):
    """Of one robot, between steps."""

    def __init__(self, robot: Robot) -> None:
        self._told = robot.behaviour or Hold()
        pose = robot.pose.x_m, robot.pose.y_m, math.radians(robot.pose.yaw_deg)
        self._home = pose if robot.behaviour is None else None  # what it holds; None: where it finds itself
        self.behaviour, self._to = self._told, self._home
        self.progress: Progress | None = None  # None: it has not begun
        self._before: Progress | None = None  # of what was done until then: the tether's turns go on

    def begin(self, behaviour: Behaviour, to: Vector | None = None) -> None:
        """Do that, from when and where it knows how it swims; to: what Hold holds, if not that place."""
        self.behaviour, self._to = behaviour, to
        self._before, self.progress = self.progress or self._before, None

    def resume(self) -> None:
        """Do what the fleet file says."""
        self.begin(self._told, self._home)

    def reference(
        self, pose: Vector, now_ns: int, watched_m: Planar | None, around: Surroundings | None, tank_m: Planar
    ) -> Reference:
        """Where the robot shall be now."""
        before = self.progress or start(pose, self._turned(pose), now_ns, self._to)
        to, self.progress = reference(self.behaviour, before, pose, now_ns, watched_m, around, tank_m)
        return to

    def _turned(self, pose: Vector) -> float:
        """By how much the body is turned since it was put into the water, rad."""
        return 0.0 if self._before is None else self._before.turned + wrap(pose[2] - self._before.heading)
