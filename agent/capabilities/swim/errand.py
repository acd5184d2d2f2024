"""What a robot does about a target by name: what it needs to know for that, and where its camera looks meanwhile."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.capabilities.swim.barrier import SIGMAS, TARGET_M, Disc, Planar
from agent.capabilities.swim.behaviour import Progress, effective
from agent.capabilities.swim.neighbours import Neighbours
from agent.capabilities.swim.search import Hunt
from agent.capabilities.swim.surroundings import Surroundings, velocity_m_s
from agent.core.config import Behaviour, Fleet, Follow, Pose, Search, Survey
from agent.core.control.search_pattern import Roam, all_around, spiral
from agent.core.control.target_search import Seek
from agent.core.estimation.protocols import dynamics, pursued
from agent.core.ranging.camera_model import Calibration
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetEstimate

SCREEN_NS = 6_000_000_000  # remembered for so long: where exactly it is nobody knows, and a fish swims on
SCREENS_APART_M, MOST_SCREENS = 0.1, 8


class Screen(NamedTuple):
    """Something that hid the target, about there."""

    at_m: Planar
    since_ns: int


class Errand(Revertible):
    """Of one robot, between steps; of a behaviour that is about no target it knows nothing."""

    def __init__(self, fleet: Fleet, calibration: Calibration) -> None:
        assert fleet.navigation is not None
        self._fleet, self._camera, self._swims = fleet, calibration.camera, pursued(fleet)
        self._speed_m_s = fleet.navigation.limits.speed_m_s
        self.around: Surroundings | None = None
        self.station: tuple[Planar, float] | None = None  # where a survey looks from; by whoever chooses views
        self._screens: deque[Screen] = deque(maxlen=MOST_SCREENS)
        self.does: Behaviour | None = None  # what is in effect now: Follow may be searching, or waiting

    def heed(
        self,
        what: Behaviour,
        progress: Progress | None,
        target: TargetEstimate | None,
        neighbours: Neighbours,
        seek: Seek,
        depth_m: float,
        now_ns: int,
    ) -> None:
        """Once a step, before the camera is told where to look; depth_m: where the robot hovers."""
        self.does = what
        if isinstance(what, Survey):
            self.around = Surroundings(self._fleet.tank.size_m[:2], self._speed_m_s, station=self.station)
            return
        if not isinstance(what, Follow | Search):
            self.around, seek.roam = None, None
            return
        around = Surroundings(
            self._fleet.tank.size_m[:2],
            self._speed_m_s,
            target=target,
            swims=what.target in self._swims,
            sees=seek.sees(what.target, now_ns),
            robots_m=tuple(disc.at_m for disc in neighbours.discs(now_ns)),
            screens_m=tuple(screen.at_m for screen in self._screens_of(now_ns)),
        )
        does = self.does = effective(what, Hunt() if progress is None else progress.hunt, around, now_ns)
        if not isinstance(does, Search):
            seek.roam = None
        elif seek.roam is None:
            seek.roam = self._roam(does, target, seek.pose, depth_m, now_ns)
        self.around = around._replace(
            looks=seek.roam is not None and target is not None and seek.roam.spirals,
            fellows_m=neighbours.doing(kind(does), what.target, now_ns),
        )

    def _roam(self, what: Search, target: TargetEstimate | None, pose: Pose, depth_m: float, now_ns: int) -> Roam:
        surface_m = self._fleet.tank.surface_m
        around = all_around(self._camera, self._fleet.body, depth_m, surface_m)
        if target is None or what.target in self._swims:  # its gaze goes all around at once (control/scan.py)
            return Roam(what.target, (), around, now_ns)
        speed_m_s = dynamics(self._fleet.target[what.target]).first_speed_m_s
        return Roam(what.target, spiral(self._camera, _reach_deg(target, speed_m_s, pose, now_ns)), around, now_ns)

    def hidden(self, from_m: Planar, at_m: Planar, now_ns: int) -> None:
        """Nothing of the target at at_m is to be seen from there: something unknown is half way, or about."""
        x, y = 0.5 * (from_m[0] + at_m[0]), 0.5 * (from_m[1] + at_m[1])
        if all(math.dist((x, y), screen.at_m) > SCREENS_APART_M for screen in self._screens_of(now_ns)):
            self._screens.append(Screen((x, y), now_ns))

    def _screens_of(self, now_ns: int) -> list[Screen]:
        return [screen for screen in self._screens if now_ns - screen.since_ns < SCREEN_NS]

    def disc(self, now_ns: int) -> Disc | None:
        """The target, to keep clear of. Nobody flees from where it only may be."""
        if self.around is None or (target := self.around.target) is None:
            return None
        at_m, velocity = target.x_m[:2], velocity_m_s(target, now_ns)
        return Disc(at_m, TARGET_M, velocity, strays_m=SIGMAS * target.sigma_m, flees=self.around.swims)


def about(what: Behaviour) -> str | None:
    """The name of the target that it is about."""
    return what.target if isinstance(what, Follow | Search) else None


def kind(what: Behaviour) -> str:
    """As the fleet file calls it."""
    return str(what.__struct_config__.tag)


def _reach_deg(target: TargetEstimate, speed_m_s: float, pose: Pose, now_ns: int) -> float:
    """How far beside its last place a target may be seen by now: two sigma, and what it may have gone meanwhile."""
    gone_m = speed_m_s * (now_ns - target.seen_ns) * 1e-9
    distance_m = math.hypot(target.x_m[0] - pose.x_m, target.x_m[1] - pose.y_m)
    return math.degrees(math.atan2(2.0 * target.sigma_m + gone_m, distance_m))
