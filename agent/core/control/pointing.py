"""Camera gimbal: where to point, how to get there, and where to look for a target that was only told.

Cheap servos have play. Every final approach therefore comes from the low-pulse side, in use as in calibration, and
the play becomes part of the calibrated zero. Only a gaze that goes with a target (gaze.py) has no final approach.
"""

from __future__ import annotations

import math

from agent.core.savepoint import Revertible

LOWEST_US, HIGHEST_US = 500, 2500  # pulses of a servo; a board leaves all servos where they are that is told others
PLAY_US = 25  # how far below the goal an approach starts: more than any servo's play
LAG_NS = 150_000_000  # after the time for a turn, a servo is there but for its play
APPROACH_NS = 300_000_000  # time for that first leg
SETTLE_NS = 450_000_000  # after the final command: lag, slew of small moves, and the body's own reaction
SLEW_US_PER_S = 2000.0  # a servo's slowest full-speed turn, to wait for long moves
FULL_TURN_US = 1000  # before the first goal nobody knows where the servos stand
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
        self.tracks = False  # goal_us goes with a target, step by step

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
        """A set-point of now, the next one comes with the next step: no play is taken up, nothing is waited for."""
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
