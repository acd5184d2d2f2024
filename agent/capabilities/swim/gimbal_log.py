"""Where the camera's gimbal pointed at a given time of the last seconds, and how sure that is.

Tags tell the camera's heading whatever the gimbal does, so a frame that was exposed while the gimbal settles says as
well as any where the robot is, and its yaw as well as the gimbal is known. Servos do not say where they are: what
counts is when they were told (control/pointing.py), first to a little below the goal, then to the goal; or each step
to another angle (control/servo_path.py).
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.core.config import Body
from agent.core.control.pointing import APPROACH_NS, LAG_NS, PLAY_US, Pointing, ServoPath, Stand
from agent.core.ranging.camera_model import CameraFit, gimbal_deg
from agent.core.step_transaction import Revertible

TURNS = 16  # that are remembered: more than a key frame's four seconds hold
REST_NS = 250_000_000  # after the last leg, which is short and takes up the play. (A sweep waits longer, for the body.)


class Gimbal(NamedTuple):
    deg: tuple[float, float]  # pan and tilt as the servos really do them
    rests: bool  # False: it settles still, and may be off by some tenths of a degree
    tracks: bool = False  # it goes with a target, and its play is taken up to no side
    lag_sigma_deg: float = 0.0  # and while it turns, by what its servos' lag leaves open


class Turn(NamedTuple):
    """What the gimbal was told once."""

    told_ns: int
    leg_ns: int  # when the last leg begins, from below the goal
    goal_us: tuple[int, int]


class GimbalLog(Revertible):
    """Of one robot's camera."""

    def __init__(self, camera: CameraFit, body: Body) -> None:
        self._camera, self._body = camera, body
        self._turns: deque[Turn] = deque(maxlen=TURNS)
        self._path, self._tracked = ServoPath(), False

    def add(self, pointing: Pointing) -> None:
        """Take note of where it is told to turn now."""
        if pointing.goal_us is None:
            return
        if pointing.tracks:
            if not self._tracked:
                self._path.begin(self._turns[-1].goal_us if self._turns else pointing.goal_us)
            self._path.add(pointing.told_ns, pointing.goal_us)
        elif not self._turns or self._turns[-1].told_ns != pointing.told_ns:
            turn = Turn(pointing.told_ns, pointing.last_leg_ns, pointing.goal_us)
            self._turns.append(turn)
        self._tracked = pointing.tracks

    def at(self, t_ns: int) -> Gimbal | None:
        """None: it was on its way, or that was too long ago."""
        turn = next((turn for turn in reversed(self._turns) if turn.told_ns <= t_ns), None)
        stand = self._path.at(t_ns)
        if stand is not None and (turn is None or stand.told_ns > turn.told_ns):
            return self._on_path(stand)
        return None if turn is None else self._in(turn, t_ns)

    def _on_path(self, stand: Stand) -> Gimbal | None:
        """Where it had come to on its way from set-point to set-point."""
        if math.isinf(stand.sigma_us):
            return None
        sigma_deg = stand.sigma_us / self._body.servo_us_per_deg
        return Gimbal(gimbal_deg(self._camera, self._body, stand.us), False, True, sigma_deg)

    def _in(self, turn: Turn, t_ns: int) -> Gimbal | None:
        pan_us, tilt_us = turn.goal_us
        if t_ns < turn.leg_ns:
            begins_ns, pan_us, tilt_us = turn.leg_ns - APPROACH_NS, pan_us - PLAY_US, tilt_us - PLAY_US
        else:
            begins_ns = turn.leg_ns
        if t_ns < begins_ns + LAG_NS:
            return None
        return Gimbal(gimbal_deg(self._camera, self._body, (pan_us, tilt_us)), t_ns >= turn.leg_ns + REST_NS)
