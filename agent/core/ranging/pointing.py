"""Camera gimbal: where to point, how to get there, where the servos stand meanwhile, and where to look for a target
that neighbours told of, or that no robot knows.

Cheap servos have play. Every final approach therefore comes from the low-pulse side, in use as in calibration, and
the play becomes part of the calibrated zero. Only a gimbal that tracks a target has no final approach.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.core.config import Body
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_transaction import Revertible

LOWEST_US, HIGHEST_US = 500, 2500  # pulses of a servo; told any other, a board leaves all servos where they are
PLAY_US = 25  # how far below the goal an approach starts: more than any servo's play
LAG_NS = 150_000_000  # after the time for a turn, a servo is there but for its play
APPROACH_NS = 300_000_000  # time for that first leg
SETTLE_NS = 450_000_000  # after the final command: lag, slew of small moves, and the body's own reaction
SLEW_US_PER_S = 2000.0  # a servo's slowest full-speed turn, to wait for long moves
FULL_TURN_US = 1000  # before the first goal it is not known where the servos stand
SEARCH_NS = 1_400_000_000  # how long a look in one direction lasts before the next
SEARCH_DEG = (  # around the told direction, (pan, tilt): near ones first
    (0.0, 0.0),
    (12.0, 0.0),
    (-12.0, 0.0),
    (0.0, 8.0),
    (0.0, -8.0),
    (24.0, 0.0),
    (-24.0, 0.0),
    (12.0, -8.0),
    (-12.0, -8.0),
    (36.0, 0.0),
    (-36.0, 0.0),
)


class Pointing(Revertible):
    """Pulses of the camera's pan and tilt servos over time."""

    def __init__(self) -> None:
        self.goal_us: tuple[int, int] | None = None
        self.last_leg_ns = 0  # when the approach to goal_us begins its last leg
        self.told_ns = 0  # when goal_us was set: frames exposed from then on are not of the goal before
        self.steady_from_ns = 0  # frames exposed later belong to goal_us
        self.tracks = False  # goal_us follows a target, step by step

    def aim(self, goal_us: tuple[int, int], now_ns: int) -> None:
        """Turn to a new goal; the same goal again changes nothing."""
        if goal_us == self.goal_us:
            return
        come_from_us = self.goal_us or (goal_us[0] - FULL_TURN_US, goal_us[1])
        travel_us = max(abs(a - b) for a, b in zip(goal_us, come_from_us, strict=True))
        travel_ns = round(travel_us / SLEW_US_PER_S * 1e9)
        self.told_ns = now_ns
        self.last_leg_ns = now_ns + travel_ns + APPROACH_NS
        self.steady_from_ns = self.last_leg_ns + SETTLE_NS
        self.goal_us, self.tracks = goal_us, False

    def track(self, goal_us: tuple[int, int], now_ns: int) -> None:
        """Set the goal of this step; the next step brings the next. No play is taken up, nothing is waited for."""
        if not self.tracks:
            self.last_leg_ns = self.steady_from_ns = now_ns
        self.goal_us, self.told_ns, self.tracks = goal_us, now_ns, True

    @property
    def nearly_from_ns(self) -> int:
        """Frames exposed later show what is at goal_us, PLAY_US aside: enough to see that there is nothing."""
        return self.last_leg_ns - APPROACH_NS + LAG_NS

    def servos_us(self, now_ns: int) -> tuple[int, int]:
        """What to command now. There must have been a goal."""
        assert self.goal_us is not None
        pan_us, tilt_us = self.goal_us
        return (pan_us - PLAY_US, tilt_us - PLAY_US) if now_ns < self.last_leg_ns else self.goal_us

    def steady(self, now_ns: int) -> bool:
        """Whether the gimbal rests at the goal."""
        return self.goal_us is not None and now_ns >= self.steady_from_ns


def reachable(goal_us: tuple[int, int]) -> tuple[int, int]:
    """The nearest pulses that an approach from below has room for."""
    pan_us, tilt_us = (min(max(pulse_us, LOWEST_US + PLAY_US), HIGHEST_US) for pulse_us in goal_us)
    return pan_us, tilt_us


class Search(Revertible):
    """Looks around a direction, one step of the pattern after the other, for ever."""

    def __init__(self) -> None:
        self._step = 0
        self._until_ns: int | None = None

    def offset_deg(self, steady: bool, now_ns: int) -> tuple[float, float]:
        """Pan and tilt to add to the told direction; time counts only while the gimbal is at rest."""
        if steady and self._until_ns is None:
            self._until_ns = now_ns + SEARCH_NS
        if self._until_ns is not None and now_ns >= self._until_ns:
            self._step, self._until_ns = self._step + 1, None
        return SEARCH_DEG[self._step % len(SEARCH_DEG)]

    def reset(self) -> None:
        self._step, self._until_ns = 0, None


def off_centre_px(centre_px: tuple[float, float], width_px: int, height_px: int) -> float:
    """How far a point of the image lies from its middle."""
    return math.hypot(centre_px[0] - width_px / 2, centre_px[1] - height_px / 2)


# --- servo model ---
# Where servos stand that get another angle at each step: behind their command, by their lag.
#
# dm/dt = (c - m) / tau,  |dm/dt| <= slew
#
# Between two set-points c is constant, so that m has a closed form: at full speed while |c - m| > slew tau, then
# (c - m) e^(-t/tau). Servos do not report where they are, and tau differs from one to the other: what it leaves open
# is its uncertainty times the rate.

# The delay through host and module, 20 ms at most each, and the lag of a small digital servo under a camera's load.
SERVO_LAG_S = 0.06
LAG_SIGMA_S = 0.025
THERE_US = 5.0  # half a degree: a jump is over
SETTLED = 4.0  # lags after which a jump is over, too, of a servo that turns on meanwhile
KEEP_NS = 6_000_000_000  # as long as poses are kept

Pulses = tuple[float, float]  # pan and tilt, us


class Stand(NamedTuple):
    """Where both servos stand at one moment."""

    told_ns: int  # when the set-point came that they are on the way to
    us: Pulses
    sigma_us: float  # what the lag leaves open, of the one that turns faster; inf after a jump: full speed is not known


class Leg(NamedTuple):
    """From one set-point to the next."""

    told_ns: int
    from_us: Pulses
    to_us: Pulses
    jumps_until_ns: int = 0  # a jump goes at full speed: until then a swift servo is there long before a slow one


class ServoModel(Revertible):
    """The set-points of the last seconds, and where the servos stand by them."""

    def __init__(self) -> None:
        self._legs: deque[Leg] = deque()

    def begin(self, at_us: Pulses) -> None:
        """Set where the servos stand when the next set-point comes."""
        self._legs.append(Leg(0, at_us, at_us))

    def add(self, told_ns: int, to_us: Pulses) -> None:
        """Take note of a set-point and when it was commanded. There must have been a `begin`."""
        last = self._legs[-1]
        here = last.from_us if last.told_ns == 0 else _both(last, told_ns)
        if last.told_ns == 0:
            self._legs.pop()
        still = _left_us(last.to_us, here) > THERE_US
        until_ns = last.jumps_until_ns if still and last.jumps_until_ns > told_ns else 0
        left_us = _left_us(to_us, here)
        if left_us > SLEW_US_PER_S * SERVO_LAG_S:
            until_ns = told_ns + round((left_us / SLEW_US_PER_S + SETTLED * SERVO_LAG_S) * 1e9)
        self._legs.append(Leg(told_ns, here, to_us, until_ns))
        while self._legs[0].told_ns < told_ns - KEEP_NS:
            self._legs.popleft()

    def at(self, t_ns: int) -> Stand | None:
        """Where the servos are; None: before the first set-point that is remembered."""
        for leg in reversed(self._legs):
            if 0 < leg.told_ns <= t_ns:
                here = _both(leg, t_ns)
                left_us = _left_us(leg.to_us, here)
                swift = t_ns < leg.jumps_until_ns and left_us > THERE_US
                return Stand(leg.told_ns, here, math.inf if swift else LAG_SIGMA_S * left_us / SERVO_LAG_S)
        return None


def _both(leg: Leg, t_ns: int) -> Pulses:
    seconds = (t_ns - leg.told_ns) * 1e-9
    return _after(leg.from_us[0], leg.to_us[0], seconds), _after(leg.from_us[1], leg.to_us[1], seconds)


def _left_us(to_us: Pulses, here_us: Pulses) -> float:
    return max(abs(c - m) for c, m in zip(to_us, here_us, strict=True))


def _after(from_us: float, to_us: float, seconds: float) -> float:
    way_us = to_us - from_us
    swift_s = max(abs(way_us) / SLEW_US_PER_S - SERVO_LAG_S, 0.0)  # at full speed
    if seconds <= swift_s:
        return from_us + math.copysign(SLEW_US_PER_S * seconds, way_us)
    left_us = abs(way_us) - SLEW_US_PER_S * swift_s
    return to_us - math.copysign(left_us * math.exp(-(seconds - swift_s) / SERVO_LAG_S), way_us)


# --- search pattern ---
# Where a camera looks for a target that no robot knows: outwards from where it was last, then all that the gimbal
# reaches, row by row, again and again. Neighbouring looks overlap, so that a target on the seam is whole in one.

Ways = tuple[tuple[float, float], ...]  # pan and tilt, degrees

FRAMES = 2  # without the target, after which the next look is due
BACK = 2  # looks, so that the next is the one before
OVERLAP_DEG = 8.0  # of neighbouring looks: as wide as a ball of 14 cm is at 1 m
NEAR_M = 0.8  # floor and surface are searched from there on; what is nearer was farther away before
PITCH = 0.8  # of the spiral, in views: from one turn to the next, and from look to look
WIDEST_DEG = 90.0  # of the spiral


class SearchPlan(NamedTuple):
    """The looks of one search."""

    target: str
    spiral: Ways  # offsets from where the target was last
    around: Ways  # by the gimbal's own angles


class SearchPattern(Revertible):
    """How far the looks of one search have come. `TargetSearch` (target_search.py) moves it on."""

    def __init__(self, target: str, spiral: Ways, around: Ways) -> None:
        self.target = target
        self._spiral, self._around = spiral, around
        self._step, self._empty = -1, FRAMES
        self.found = False  # in the newest frame of the newest look
        self._glimpse = False  # in any frame of it
        self._glimpsed = -1  # the last look for which it went back

    @property
    def spirals(self) -> bool:
        """It has not looked everywhere around the last place yet."""
        return max(self._step, 0) < len(self._spiral)

    @property
    def empty(self) -> bool:
        """Whether the newest frames of the newest look have shown that there is nothing."""
        return self._empty >= FRAMES

    def add_frame(self, found: bool) -> None:
        """Take note of a frame of the newest look."""
        self.found, self._empty = found, 0 if found else self._empty + 1
        self._glimpse |= found

    def advance(self) -> None:
        """On to the next look. After one that showed something and then no more, once back to the one before: the
        robot was turning, and has stopped."""
        back = BACK if self._glimpse and self._step > self._glimpsed else 0
        self._glimpsed = max(self._glimpsed, self._step) if self._glimpse else self._glimpsed
        self._step, self._empty, self.found, self._glimpse = max(self._step - back, -1) + 1, 0, False, False

    @property
    def offset_deg(self) -> tuple[float, float] | None:
        """To add to the direction of the last place; None: the spiral is over."""
        return self._spiral[max(self._step, 0)] if self._step < len(self._spiral) else None

    @property
    def way_deg(self) -> tuple[float, float]:
        """Pan and tilt after the spiral."""
        return self._around[max(self._step - len(self._spiral), 0) % len(self._around)]


def spiral(camera: CameraFit, reach_deg: float) -> Ways:
    """Offsets that grow to `reach_deg` of pan, as many views of tilt; one turn at least."""
    wide_deg, high_deg = view_deg(camera)
    most = max(min(reach_deg, WIDEST_DEG) / wide_deg, PITCH)  # views
    found, turn = [(0.0, 0.0)], 2.0 * math.pi
    while (r := PITCH * turn / (2.0 * math.pi)) <= most + 0.5 * PITCH:
        found.append((r * wide_deg * math.cos(turn), r * high_deg * math.sin(turn)))
        turn += PITCH / r
    return tuple(found)


def all_around(camera: CameraFit, body: Body, depth_m: float, surface_m: float) -> Ways:
    """The gimbal's whole pan, at as many tilts as it takes to see floor and surface; every other row backwards."""
    pans = _middles(*body.pan_limit_deg, _step_deg(view_deg(camera)[0]))
    rows = rows_deg(camera, body, depth_m, surface_m)
    return tuple((pan, tilt) for k, tilt in enumerate(rows) for pan in (pans if k % 2 == 0 else pans[::-1]))


def rows_deg(camera: CameraFit, body: Body, depth_m: float, surface_m: float) -> tuple[float, ...]:
    """Tilts, lowest first, at which looks show floor and surface and what is between them."""
    lowest = max(-math.degrees(math.atan2(surface_m - depth_m, NEAR_M)), body.tilt_limit_deg[0])
    highest = min(math.degrees(math.atan2(depth_m, NEAR_M)), body.tilt_limit_deg[1])
    return _middles(lowest, max(highest, lowest), _step_deg(view_deg(camera)[1]))


def view_deg(camera: CameraFit) -> tuple[float, float]:
    """How wide and how high the camera's view is, degrees."""
    wide, high = (2.0 * math.degrees(math.atan2(0.5 * px, camera.f_px)) for px in (camera.width_px, camera.height_px))
    return wide, high


def _step_deg(view: float) -> float:
    return max(view - OVERLAP_DEG, 0.5 * view)


def _middles(low: float, high: float, step: float) -> tuple[float, ...]:
    """Of as few equal parts from low to high as are no longer than a step."""
    count = max(math.ceil((high - low) / step), 1)
    return tuple(low + (k + 0.5) * (high - low) / count for k in range(count))
