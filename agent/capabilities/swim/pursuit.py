"""A target that swims, and that the robot's behaviour is about: frames give bearings instead of sweeps, and the camera
goes with it.

A sweep takes a second, in which a fish is elsewhere. So the newest frame of each short iteration is a sample, from
where the robot was and its camera looked at that moment; between landmarks and target the camera is the target's,
unless the robot knows too little of its own place (Swimmer.look_for_landmarks).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from agent.capabilities.swim.landmark_look import half_picture_deg
from agent.capabilities.swim.swimmer import Swimmer, pose_of
from agent.capabilities.swim.tag_fix import TURNING_DEG
from agent.core.attitude import Attitude, AttitudeLog, zeros
from agent.core.capability import CameraAct, Situation
from agent.core.config import Body, Fleet, Target
from agent.core.estimation.interface import Bearing, Posterior
from agent.core.estimation.protocols import dynamics, pursued
from agent.core.estimation.track import Dynamics, growth
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, camera_pose, look_at
from agent.core.ranging.fix import NEAREST_M, Outline, sight_line
from agent.core.ranging.pointing import SERVO_LAG_S, rows_deg
from agent.core.step_io import Sighting
from agent.core.step_transaction import Revertible

# --- gimbal track ---
# It goes with the target: ahead of where the target was last known to be, and, where the target is not seen, to and
# fro over all places where it may be.
#
# With x and C where it is believed to be and how well, u the level direction across the line of sight, and sigma^2 =
# u'Cu, the places to look at are
#
#     p(s) = x + s C u / sigma,   -2 <= s <= 2
#
# the mean of where it is, given how far beside x it is: for a target that one other robot sees, that robot's line of
# sight. Where all have lost it each takes those that are nearer to itself than to any other, and looks from end to
# end of them but for what its picture shows anyway. As long as the view is wider than all that, the gimbal rests: a
# camera that turned aside would miss what comes out from behind a stone.

LOST_NS = 400_000_000  # four frames without it
ELSEWHERE_NS = 200_000_000  # several steps
PERIOD_S = 1.6  # of the triangle, at least
SWIFTEST_DEG_S = 60.0  # neighbouring frames overlap by three quarters; faster, no tag says where it looks
SIGMAS = 2.0  # to either side
SHOWN_DEG = 7.0  # to either side of the gimbal, of a view of 30 degrees and a target that is whole in it


class GimbalTrack(Revertible):
    """Of one robot. share: of a period, by which its triangle is ahead of others'."""

    def __init__(self, share: float) -> None:
        self._share = self._phase = share
        self._since_ns: int | None = None  # of the newest frame that showed it, or of the first moment without
        self._asked_ns = 0

    def saw(self, t_ns: int) -> None:
        """A frame exposed then showed the target."""
        self._since_ns = t_ns if self._since_ns is None else max(self._since_ns, t_ns)

    def sees(self, now_ns: int) -> bool:
        return self._since_ns is not None and now_ns - self._since_ns <= LOST_NS

    def unseen_s(self, now_ns: int) -> float:
        """Since when it is lost; 0: it is not. Where it was not asked for a while the camera was elsewhere, and how
        long it did not see the target counts anew."""
        if self._since_ns is None or now_ns - self._asked_ns > ELSEWHERE_NS:
            self._since_ns, self._asked_ns = now_ns, now_ns
        return max((now_ns - self._since_ns - LOST_NS) * 1e-9, 0.0)

    def swing(self, half_deg: float, now_ns: int) -> float:
        """Between -1 and 1: to and fro over so much to either side, in the time that this takes. Asked in each step
        after `unseen_s`."""
        if self.sees(now_ns):
            self._phase = self._share
        else:
            period_s = max(PERIOD_S, 4.0 * half_deg / SWIFTEST_DEG_S)
            self._phase = math.fmod(self._phase + (now_ns - self._asked_ns) * 1e-9 / period_s, 1.0)
        self._asked_ns = now_ns
        return triangle(self._phase)


def triangle(periods: float) -> float:
    """Between -1 and 1, with a period of 1: 0 at 0 and 1/2, 1 at 1/4, -1 at 3/4."""
    return 1.0 - 4.0 * abs(math.fmod(periods + 0.25, 1.0) - 0.5)


def across(at_m: Vector, cov_m2: Symmetric, from_m: Vector) -> tuple[Vector, float]:
    """C u / sigma, m, u to the left as seen from there; and sigma as an angle, degrees."""
    x, y = at_m[0] - from_m[0], at_m[1] - from_m[1]
    far_m = max(math.hypot(x, y), 0.1)
    u, v = -y / far_m, x / far_m
    xx, xy, xz, yy, yz, _ = cov_m2
    way = xx * u + xy * v, xy * u + yy * v, xz * u + yz * v
    sigma_m = math.sqrt(max(u * way[0] + v * way[1], 1e-12))
    return (way[0] / sigma_m, way[1] / sigma_m, way[2] / sigma_m), math.degrees(math.atan2(sigma_m, far_m))


def own_part(
    at_m: Vector, step_m: Vector, here_m: Sequence[float], others_m: Sequence[Sequence[float]]
) -> tuple[float, float]:
    """From which s to which places are nearer to this robot than to any other, of at_m + s step_m; all of them where
    none is."""
    low, high = -SIGMAS, SIGMAS
    for x_m, y_m in others_m:
        dx, dy = x_m - here_m[0], y_m - here_m[1]
        slope = 2.0 * (step_m[0] * dx + step_m[1] * dy)
        room = x_m * x_m + y_m * y_m - here_m[0] * here_m[0] - here_m[1] * here_m[1]
        room -= 2.0 * (at_m[0] * dx + at_m[1] * dy)  # slope * s <= room
        if slope > 0.0:
            high = min(high, room / slope)
        elif slope < 0.0:
            low = max(low, room / slope)
        elif room < 0.0:
            high = low
    return (low, high) if low < high else (-SIGMAS, SIGMAS)


# --- scan ---
# It goes round all that the gimbal reaches, without rest: for a target that may be anywhere.
#
# Looks with rests between them (SearchPattern) take longer for one round than a fish stays where it is. This one passes
# at a rate at which neighbouring frames overlap, to and fro at one tilt after the other: every other time at the middle
# one, where most swims.

AWAY_NS = 200_000_000  # several steps
SCAN_ELSEWHERE_NS = 2_000_000_000  # longer than a look for landmarks: it begins anew


class Scan(Revertible):
    """Of one robot. share: of a round, by which it is ahead of others'."""

    def __init__(self, share: float) -> None:
        self._share = self._turn = share
        self._asked_ns = 0

    def way_deg(
        self, camera: CameraFit, body: Body, depth_m: float, surface_m: float, rests: bool, now_ns: int
    ) -> tuple[float, float]:
        """Pan and tilt of now. Asked in each step; while it is not, its time stands still. rests: where it is, for the
        target has just come into view."""
        low, high = body.pan_limit_deg
        rows = rows_deg(camera, body, depth_m, surface_m)
        since_ns, self._asked_ns = now_ns - self._asked_ns, now_ns
        if since_ns > SCAN_ELSEWHERE_NS:
            self._turn = self._share
        elif since_ns < AWAY_NS and not rests:
            self._turn += since_ns * 1e-9 * SWIFTEST_DEG_S / (2.0 * (high - low))
        swing = math.floor(2.0 * self._turn + 0.5)  # each from one end of the pan to the other
        middle = len(rows) // 2
        row = middle if swing % 2 == 0 else (swing // 2) % len(rows)
        return 0.5 * (low + high) + 0.5 * (high - low) * triangle(self._turn), rows[row]


# --- bearings, and where the camera looks ---

ALL_LOST_NS = 600_000_000  # three iterations in which no robot saw it
HIDDEN_S, HIDDEN_M = 0.3, 1.4  # after it is lost; farther away it may just not be made out
# Samples of one robot that a track of what swims remembers: (R dt / q)^(1/4) is about dt at 10 to 20 cm/s. What is
# alike in more of them does not count more often.
REMEMBERS = 2.0
# Of the picture's height, kept free beside a target that is not in its middle, for landmarks shall be in it, too: the
# target's rising and falling, and what its course and the servos are unsure of.
FREE_DEG, PITCHED = 1.5, 0.25  # of its length, by which it is higher or lower than its middle
ASIDE_STEP_DEG = 1.0  # in each step of 50 ms: slow enough that frames stay sharp
# Of the gimbal: the servos' lag, half of a step, and what a frame is known late of the gimbal's own doing.
AHEAD_S = SERVO_LAG_S + 0.05


class Pursuit(Revertible):
    """Of one robot, between steps; of one whose behaviour is about no target that swims it does nothing."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, swimmer: Swimmer, attitude: AttitudeLog
    ) -> None:
        robots = sorted(fleet.robot)
        self._fleet, self._calibration, self._swimmer, self._attitude = fleet, calibration, swimmer, attitude
        self._swims = {target: dynamics(fleet.target[target]) for target in pursued(fleet)}
        share = robots.index(name) / len(robots)
        self._gimbal_track, self._scan = GimbalTrack(share), Scan(share)
        self._newest: Sighting | None = None  # that showed the target since the last iteration
        self._aside_deg = 0.0  # by which the camera looks above the target

    def see(self, sightings: Sequence[Sighting]) -> None:
        for sighting in sightings:
            if sighting.found and sighting.target == self._swimmer.pursues:
                self._gimbal_track.saw(sighting.t_ns)
                self._newest = sighting

    @property
    def sighted(self) -> str | None:
        """The target of the newest frame that has given no bearing yet."""
        return None if self._newest is None else self._newest.target

    def bearing(self, target: str, belief: Callable[[], Posterior | None], now_ns: int) -> Bearing | None:
        """What the newest frame says of that target, once; None: none showed it, or where from is not known."""
        seen, self._newest = self._newest, None
        if seen is None or target != seen.target or seen.centre_px is None:
            return None
        level, gimbal = self._attitude.at(seen.t_ns), self._swimmer.gimbal.at(seen.t_ns)
        if level is None or gimbal is None:
            return None
        known = self._swimmer.localizer.of_sample(seen.t_ns, now_ns)
        if known is None:
            return None
        surface_m = self._fleet.tank.surface_m
        eye = camera_pose(pose_of(known[0]), self._fleet.body, *level, *gimbal.deg, surface_m)
        outline = Outline(seen.centre_px, seen.radius_px, seen.score, seen.focus, seen.size_px, seen.radius_sigma_px)
        believed, swims = belief(), self._swims[target]
        play_deg = 0.0 if gimbal.rests else TURNING_DEG
        # Of a pan that goes with the target it is in the yaw already, which the same camera has from landmarks.
        sigma_deg = math.hypot(0.0 if gimbal.tracks else play_deg, gimbal.lag_sigma_deg)
        return sight_line(
            self._calibration.camera,
            eye,
            outline,
            self._fleet.target[target],
            known[1]._replace(kappa=min(known[1].kappa, REMEMBERS)),
            math.radians(math.hypot(self._calibration.camera.noise_deg, sigma_deg)),
            None if believed is None else carried_on(believed, swims, seen.t_ns),
            seen.t_ns,
            self._fleet.tank.size_m,
            sized=self._fleet.ranging.cues != "focus",
            velocity_m_s=None if believed is None else believed.v_m_s,
            tilt_sigma_rad=math.radians(play_deg) if gimbal.tracks else 0.0,
            zeros=zeros(self._fleet.budget, self._attitude.on_s(seen.t_ns)),
        )

    def goes_with(self, situation: Situation) -> bool:
        """Whether the camera goes without rest, with the watched target or in search of it. A robot that does not know
        how it swims itself finds that out first."""
        knows = situation.target.believed is not None or self._swimmer.search is not None
        of_it = situation.watched == self._swimmer.pursues
        return of_it and not situation.camera.measuring and knows and self._swimmer.under_way

    def look(self, situation: Situation) -> CameraAct | None:
        """Point the camera at the watched target, or to and fro where it ought to be, or all around where no robot
        knows; None: it is not its turn."""
        now_ns, level = situation.now_ns, situation.level
        here = self._swimmer.localizer.at(now_ns)
        of, name = situation.target, situation.watched
        if name != self._swimmer.pursues or situation.camera.measuring:
            return None
        if here is None or level is None or not self.goes_with(situation):
            return None
        body, surface_m = self._fleet.body, self._fleet.tank.surface_m
        if of.believed is None or self._swimmer.search is not None:
            rests = self._gimbal_track.sees(now_ns)
            way_deg = self._scan.way_deg(self._calibration.camera, body, level.depth_m, surface_m, rests, now_ns)
            return CameraAct(way_deg, "track", name)
        x, y, psi = (at + AHEAD_S * v for at, v in zip(here.x[:3], here.x[3:6], strict=True))
        pose = pose_of(here._replace(x=(x, y, psi, *here.x[3:])))
        at_m = carried_on(of.believed, self._swims[name], now_ns + round(AHEAD_S * 1e9))
        lost = of.estimate is None or now_ns - of.estimate.seen_ns > ALL_LOST_NS
        at_m = self._searched(at_m, of.believed.cov_m2, (x, y, at_m[2]), lost, now_ns)
        pan, tilt = look_at(at_m, pose, body, *level, surface_m)
        eye_m = camera_pose(pose, body, *level, pan, tilt, surface_m).position_m
        far_m = max(math.dist(at_m, eye_m), NEAREST_M)
        self._look_beside((pan, tilt), far_m, of.believed, self._fleet.target[name], level, now_ns)
        return CameraAct((pan, tilt + self._aside_deg), "track", name)

    def _look_beside(
        self,
        way_deg: tuple[float, float],
        far_m: float,
        believed: Posterior,
        target: Target,
        level: Attitude,
        now_ns: int,
    ) -> None:
        """Look above or below a target that the camera sees, so that it shows landmarks beside it."""
        if not self._gimbal_track.sees(now_ns):
            self._aside_deg = 0.0
            return
        high_m = PITCHED * (target.length_m or 0.0) + (target.radius_m or 0.0)
        high_m += SIGMAS * math.sqrt(max(believed.cov_m2[5], 0.0))
        room_deg = half_picture_deg(self._calibration.camera)[1] - math.degrees(math.atan2(high_m, far_m)) - FREE_DEG
        wanted = self._swimmer.beside_deg(way_deg, room_deg, self._aside_deg, level, now_ns)
        self._aside_deg += min(max(wanted - self._aside_deg, -ASIDE_STEP_DEG), ASIDE_STEP_DEG)

    def _searched(self, at_m: Vector, cov_m2: Symmetric, here_m: Vector, lost_by_all: bool, now_ns: int) -> Vector:
        """Of all places where it may be the one to look at now: the middle one while the robot sees it. Where all have
        lost it each takes its part of them. A robot that knows well where others see it, and does not see it itself,
        has something in between."""
        unseen_s = self._gimbal_track.unseen_s(now_ns)
        if not unseen_s:
            self._gimbal_track.swing(0.0, now_ns)
            return at_m
        step_m, sigma_deg = across(at_m, cov_m2, here_m)
        low, high = own_part(at_m, step_m, here_m, self._swimmer.fellows_m if lost_by_all else ())
        low, high = low + SHOWN_DEG / sigma_deg, high - SHOWN_DEG / sigma_deg
        middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.0)
        if not lost_by_all and not half and unseen_s > HIDDEN_S and math.dist(at_m, here_m) < HIDDEN_M:
            self._swimmer.hidden(at_m, now_ns)
        swing = self._gimbal_track.swing(half * sigma_deg, now_ns)
        x, y, z = (at + (middle + half * swing) * way for at, way in zip(at_m, step_m, strict=True))
        return x, y, z


def carried_on(believed: Posterior, moves: Dynamics, t_ns: int) -> Vector:
    """Where it is at t_ns by what is believed of another moment, a little earlier or later."""
    if not believed.t_ns:
        return believed.x_m
    h_s = (t_ns - believed.t_ns) * 1e-9
    reach_s = math.copysign(growth(moves, abs(h_s)).reach_s, h_s)
    x, y, z = (at + reach_s * v for at, v in zip(believed.x_m, believed.v_m_s, strict=True))
    return x, y, z
