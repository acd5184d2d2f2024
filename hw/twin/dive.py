"""One tick of the whole fleet: what the boards command moves the robots, and what the water then is they read."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence

import numpy as np

from agent.config import Fleet
from agent.messages import Vector
from hw.twin.body import BODY, draw_body
from hw.twin.devices import PATIENCE_S, Act, Board
from hw.twin.history import History
from hw.twin.rotation import quaternion
from hw.twin.sensors import PressureSensors, water_pressure_pa
from hw.twin.tank import STATE, STEP_S, STEPS_PER_TICK, TICK_NS, advance, push

LOCK_STEP_S = 5.0  # in virtual time a firmware that is silent for longer is taken for dead
HANG_S = 0.5  # an ESC holds the last pulse for as long as this timer's output would
LATE_S = 0.1  # a tick that is later is an overrun: the machine cannot keep up


class Dive:
    """All robots of a fleet in one tank, and its clock: start_ns + ticks * 10 ms."""

    def __init__(self, fleet: Fleet, robots: Sequence[str], start_ns: int) -> None:
        seed, surface_m = fleet.twin.seed, fleet.tank.surface_m
        self.robots = list(robots)
        self.bodies = np.zeros(len(robots), BODY)
        self.states = np.zeros(len(robots), STATE)
        for i, name in enumerate(robots):
            pose, depth_m = fleet.robot[name].pose, fleet.robot[name].depth_m
            start = (pose.x_m, pose.y_m, surface_m - depth_m, pose.yaw_deg)
            self.bodies[i] = draw_body(seed, name, start, fleet.tank, fleet.body)
        self.states["held"] = 1
        self.states["position_m"] = self.bodies["home_m"]
        self.states["quaternion"] = [quaternion(0.0, 0.0, yaw) for yaw in self.bodies["home_yaw_rad"]]
        self.states["motor_deg"] = self.states["shaft_deg"] = self.bodies["servo_zero_deg"]

        self.sensors = PressureSensors(seed, self.robots)
        self.tare_pa = self.sensors.tare_pa()
        self.boards: list[Board] = []
        self.history = History(len(robots), start_ns)
        self.ticks = 0
        self._start_ns = start_ns
        self._mounting = fleet.body
        self._size_m, self._surface_m = np.array(fleet.tank.size_m), surface_m
        self._pulses_us = np.zeros((len(robots), 8))  # no pulses before a board drives its pins
        self._nominal_deg = np.zeros((len(robots), 4))
        self.heard = [0] * len(robots)  # tick of each board's last answer
        self._gone: set[str] = set()  # robots whose firmware ended
        self._water_pa = np.zeros((len(robots), 4))
        self._measure()

    @property
    def now_ns(self) -> int:
        return self._start_ns + self.ticks * TICK_NS

    def push(self, robot: str, force_n: Vector, point_m: Vector, for_s: float) -> None:
        """Push a robot from now on: world-frame force at a body-frame point."""
        push(self.states[self.robots.index(robot)], force_n, point_m, for_s)

    def tick(self, patience_s: float) -> None:
        """Take the answers to the last tick, move on by 10 ms with them, and send the next tick.

        The 10 ms that an answer acts in begin at the tick it answers, in lock-step as at the wall clock.
        """
        for i, board in enumerate(self.boards):
            prompt = self.heard[i] >= self.ticks - 1  # one that missed a tick is not waited for again
            act = board.act(patience_s if prompt else 0.0)
            if act is not None:
                self._obey(i, act)
            elif not board.alive:
                self._bury(i)
            elif (self.ticks - self.heard[i]) * TICK_NS > HANG_S * 1e9:
                self._pulses_us[i] = 0.0
        self.move()
        for board, pressure_pa in zip(self.boards, self._readings_pa, strict=False):
            board.tick(self.ticks * TICK_NS // 1000, pressure_pa)

    def move(self) -> None:
        """Physics and sensors alone."""
        advance(
            self.bodies,
            self.states,
            self._pulses_us,
            self._nominal_deg,
            self._size_m,
            self._surface_m,
            STEP_S,
            STEPS_PER_TICK,
        )
        self.ticks += 1
        self._measure()

    def _measure(self) -> None:
        self.history.append(self.states)
        water_pressure_pa(self.bodies, self.states, self._surface_m, self._water_pa)
        self._readings_pa = self.sensors.sample(self._water_pa, self.ticks * TICK_NS * 1e-9).tolist()

    def _obey(self, i: int, act: Act) -> None:
        self.heard[i] = self.ticks
        self._pulses_us[i] = act.pulses_us
        for k, servo_us in enumerate(act.servos_us):
            if servo_us:  # a servo without pulses stays where it is
                centred_us = servo_us - self._mounting.servo_centre_us
                self._nominal_deg[i, k] = centred_us / self._mounting.servo_us_per_deg
        if act.armed:
            self.states[i]["held"] = 0  # the crew lets go, once

    def _bury(self, i: int) -> None:
        self._pulses_us[i] = 0.0
        if self.robots[i] not in self._gone:
            self._gone.add(self.robots[i])
            sys.stderr.write(f"twin: the firmware of {self.robots[i]} has ended: {self.boards[i].last_words()}\n")


def run_at_wall_clock(dive: Dive, stop: threading.Event) -> int:
    """Tick with CLOCK_MONOTONIC until stopped; returns the overruns. No step is ever left out: time is caught up."""
    overruns = 0
    while not stop.is_set():
        ahead_s = (dive.now_ns + TICK_NS - time.monotonic_ns()) * 1e-9
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -LATE_S:
            overruns += 1
        dive.tick(PATIENCE_S)
    return overruns


def run_in_lock_step(dive: Dive, ticks: int) -> None:
    """Tick as fast as every firmware answers. Raises TimeoutError naming one that does not."""
    for _ in range(ticks):
        dive.tick(LOCK_STEP_S)
        for board, heard in zip(dive.boards, dive.heard, strict=True):
            if board.alive and heard < dive.ticks - 1:
                raise TimeoutError(f"the firmware of {board.robot} did not answer for {LOCK_STEP_S} s")
