"""What a swimming robot knows of where it is, between steps: landmarks in, poses at any time of the last seconds out.

Until landmarks have said once where it is, it knows nothing: the fleet file's pose is where it shall be, not where it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.kernel.config import Fleet, Pose
from agent.kernel.control.attitude import Attitude
from agent.kernel.messages import Symmetric, Vector
from agent.kernel.navigation.body_model import Hull, Wrench
from agent.kernel.navigation.event_ring import EventRing, asked, fix
from agent.kernel.navigation.first_fix import first_fix
from agent.kernel.navigation.layout import markers
from agent.kernel.navigation.pose_filter import Belief, Drift, begin
from agent.kernel.navigation.projection import view
from agent.kernel.navigation.tag_fix import Map, TagFix, tag_fix
from agent.kernel.navigation.tag_priors import priors
from agent.kernel.ranging.calibration import CameraFit
from agent.kernel.step_io import SeenTags

STILL: Wrench = (0.0, 0.0, 0.0)
SURE_M, SURE_DEG = 0.015, 1.0  # beyond this it is worth a look at landmarks
LOST_M, LOST_DEG = 0.15, 10.0  # and beyond this it does not know where it is


class Whereabouts(NamedTuple):
    """A robot's pose at one moment; covariances of (x, y, yaw), m and rad."""

    pose: Pose
    velocity: Vector  # m/s, m/s, rad/s, world frame
    fluctuates: Symmetric
    stays: Symmetric  # the same whenever the same landmarks are seen

    @property
    def place_sigma_m(self) -> float:
        return math.sqrt(self.fluctuates[0] + self.fluctuates[3])

    @property
    def yaw_sigma_deg(self) -> float:
        return math.degrees(math.sqrt(self.fluctuates[5]))

    def within(self, place_m: float, yaw_deg: float) -> bool:
        return self.place_sigma_m <= place_m and self.yaw_sigma_deg <= yaw_deg


class Localizer:
    """Of one robot."""

    def __init__(self, fleet: Fleet, camera: CameraFit) -> None:
        assert fleet.landmarks is not None  # a rule of the fleet file
        self._camera, self._body, self._surface_m = camera, fleet.body, fleet.tank.surface_m
        self._map = Map(fleet.landmarks, markers(fleet.landmarks))
        self.hull = Hull()
        self._ring: EventRing | None = None
        self._asked = STILL
        self.refused = ""  # why the newest frame with landmarks gave no pose

    def see(self, frame: SeenTags, level: Attitude, gimbal_deg: tuple[float, float]) -> None:
        """The landmarks of a frame, exposed while the gimbal was at rest at those angles."""
        if not frame.tags:
            return
        of = view(self._camera, self._body, self._surface_m, frame.focus)
        before = None if self._ring is None else self._ring.at(frame.t_ns)
        if self._ring is None:
            found = first_fix(of, priors(level, gimbal_deg, 0.0, turning=False), self._map, frame.tags)
        elif before is None:
            return  # a frame from before what is still remembered
        else:
            known = priors(level, gimbal_deg, math.hypot(before.x[3], before.x[4]), turning=False)
            found = tag_fix(of, known, self._map, frame.tags, before.pose)
        if not isinstance(found, TagFix):
            self.refused = found.reason
            return
        self.refused = ""
        pose = found.theta[0], found.theta[1], found.theta[2]
        if self._ring is None:
            self._ring = EventRing(begin(frame.t_ns, pose, found.fluctuates, found.stays), self.hull, Drift())
        else:
            self._ring.add(fix(frame.t_ns, pose, found.fluctuates, found.stays))

    def sent(self, wrench: Wrench, now_ns: int) -> None:
        """What the thrusters are asked for from now on; zeros while motors may not turn."""
        if wrench != self._asked and self._ring is not None:
            self._ring.add(asked(now_ns, wrench))
            self._asked = wrench

    def advance(self, now_ns: int) -> None:
        """Let go of what is old."""
        if self._ring is not None:
            self._ring.advance(now_ns)

    def at(self, t_ns: int) -> Whereabouts | None:
        """Where it was or is; None: nobody knows."""
        belief = self.belief(t_ns)
        return None if belief is None else whereabouts(belief)

    def belief(self, t_ns: int) -> Belief | None:
        """The same with all that the filter has."""
        return None if self._ring is None else self._ring.at(t_ns)


def whereabouts(belief: Belief) -> Whereabouts:
    x, y, psi = belief.pose
    pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
    return Whereabouts(pose, (belief.x[3], belief.x[4], belief.x[5]), belief.covariance, belief.stays)
