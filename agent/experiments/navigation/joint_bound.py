"""The joint filter's estimate from the notes of a run: fixes, odometry and samples made anew, at its own estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.plane_odometry import odometry
from agent.capabilities.swim.projection import View, view
from agent.capabilities.swim.tag_fix import Map, NoFix, Priors, TagFix, first_fix, priors, tag_fix, whole
from agent.core.config import Fleet, Pose
from agent.core.linear_algebra import ZERO
from agent.core.messages import Symmetric
from agent.core.ranging.camera_model import Calibration, camera_pose
from agent.core.ranging.fix import EXACT, Fix, Outline, locate
from agent.core.step_io import Flow, SeenTags
from agent.experiments.navigation.joint_filter import JointFilter
from agent.experiments.navigation.notes import Asked, Carriage, Measured, Sample


class KeyFrame(NamedTuple):
    """Points were found that later frames follow."""


ORDER = (Asked, SeenTags, Flow, Sample, KeyFrame)  # of one moment


def joint_filter_of(measured: Sequence[Measured], fleet: Fleet, known: Sequence[Calibration]) -> JointFilter:
    """The filter after all of that; known: of each robot."""
    keys = {(one.what.since_ns, one.robot) for one in measured if isinstance(one.what, Flow)}
    frames = [Measured(t_ns, robot, KeyFrame()) for t_ns, robot in sorted(keys)]
    replayed = Replayed(fleet, known)
    for one in sorted([*measured, *frames], key=lambda one: (one.t_ns, ORDER.index(type(one.what)), one.robot)):
        replayed.take(one)
    return replayed.joint


class Replayed:
    """A run as the joint filter has it."""

    def __init__(self, fleet: Fleet, known: Sequence[Calibration]) -> None:
        assert fleet.landmarks is not None
        self.joint = JointFilter(len(known))
        self._fleet, self._known = fleet, known
        self._map = Map(fleet.landmarks, markers(fleet.landmarks))
        self._stays: list[Symmetric] = [ZERO] * len(known)

    def take(self, one: Measured) -> None:
        i, joint = one.robot, self.joint
        if not joint.knows(i):
            if isinstance(one.what, SeenTags) and one.carriage is not None:
                self._begin(i, one.what, one.carriage)
            return
        joint.predict(i, one.t_ns)
        match one.what:
            case Asked():
                joint.ask(i, one.what.wrench)
            case KeyFrame():
                joint.keep_key(i, one.t_ns)
            case SeenTags() if one.carriage is not None:
                self._fix(i, one.what, one.carriage)
            case Flow() if one.carriage is not None and one.before is not None:
                self._flow(i, one.what, one.before, one.carriage)
            case Sample() if one.carriage is not None:
                self._sample(i, one.what, one.carriage)

    def _begin(self, i: int, frame: SeenTags, carriage: Carriage) -> None:
        found = first_fix(self._view(i), _priors(carriage, 0.0), self._map, frame.tags)
        if isinstance(found, TagFix):
            self.joint.begin(i, frame.t_ns, found.theta[:3], found.fluctuates)
            self._stays[i] = found.stays

    def _fix(self, i: int, frame: SeenTags, carriage: Carriage) -> None:
        before = _priors(carriage, self.joint.speed_m_s(i))
        found = tag_fix(self._view(i), before, self._map, frame.tags, self.joint.pose(i))
        if not isinstance(found, NoFix):
            self.joint.add_fix(i, found.theta[:3], found.fluctuates)
            self._stays[i] = found.stays

    def _flow(self, i: int, flow: Flow, then: Carriage, now: Carriage) -> None:
        start = whole(self.joint.key_pose(i), _priors(then, 0.0))
        end = whole(self.joint.pose(i), _priors(now, 0.0))
        tank = self._fleet.tank
        moved = odometry(self._view(i), start, end, flow.pairs, (*tank.size_m[:2], tank.surface_m), unsettled=0.0)
        if moved is not None:
            self.joint.add_flow(i, flow.since_ns, moved.pose, moved.covariance)

    def _sample(self, i: int, sample: Sample, carriage: Carriage) -> None:
        sighting, outcome, (level, gimbal) = *sample, carriage
        x, y, psi = self.joint.pose(i)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
        eye = camera_pose(pose, self._fleet.body, *level, *gimbal, self._fleet.tank.surface_m)
        assert sighting.centre_px is not None and outcome.lens_position is not None and outcome.sigma is not None
        outline = Outline(
            sighting.centre_px,
            sighting.radius_px,
            sighting.score,
            sighting.focus,
            sighting.size_px,
            sighting.radius_sigma_px,
        )
        ball = self._fleet.target[sighting.target]
        cues = self._fleet.ranging.cues
        seen = locate(
            self._known[i], eye, outline, outcome.lens_position, outcome.sigma, ball, cues, EXACT
        )  # its pose is in the state
        if isinstance(seen, Fix):
            self.joint.add_sample(i, seen, self._stays[i])

    def _view(self, i: int) -> View:
        return view(self._known[i].camera, self._fleet.body, self._fleet.tank.surface_m, None)


def _priors(carriage: Carriage, speed_m_s: float) -> Priors:
    level, gimbal_deg = carriage
    return priors(level, gimbal_deg, speed_m_s, turning=False)
