"""One tick of the whole fleet: what the boards command moves the robots, and what the water then is they read.

Also where everything that goes wrong is set off, by an event of the scene file or by a call from a test.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence

import numpy as np

from agent.config import ConfigError, Fleet
from agent.messages import Vector
from hw.twin.battery import OPEN_V, current_a, supply_v, thrust_loss
from hw.twin.body import BODY, draw_body
from hw.twin.boot import Act
from hw.twin.devices import PATIENCE_S, Board
from hw.twin.event import Event
from hw.twin.faults import Faults
from hw.twin.history import History
from hw.twin.plant import Plant, set_body
from hw.twin.rotation import quaternion
from hw.twin.scene import Waves
from hw.twin.sensors import PA_PER_M, PressureSensors, water_pressure_pa
from hw.twin.tank import STATE, STEP_S, STEPS_PER_TICK, TICK_NS, advance, push
from hw.twin.waves import add_waves

LOCK_STEP_S = 5.0  # in virtual time a firmware that is silent for longer is taken for dead
LATE_S = 0.1  # a tick that is later is an overrun: the machine cannot keep up


class Dive:
    """All robots of a fleet in one tank, and its clock: start_ns + ticks * 10 ms.

    `plants` overrides what is drawn for the robots that it names. Raises ConfigError for an event whose robot does
    not dive.
    """

    def __init__(
        self,
        fleet: Fleet,
        robots: Sequence[str],
        start_ns: int,
        *,
        plants: Mapping[str, Plant] | None = None,
        waves: Waves | None = None,
        events: Sequence[Event] = (),
    ) -> None:
        seed, surface_m = fleet.twin.seed, fleet.tank.surface_m
        self.robots = list(robots)
        self.bodies = np.zeros(len(robots), BODY)
        self.states = np.zeros(len(robots), STATE)
        rows = [(plants or {}).get(name, Plant()) for name in robots]
        for i, name in enumerate(robots):
            pose, depth_m = fleet.robot[name].pose, fleet.robot[name].depth_m
            start = (pose.x_m, pose.y_m, surface_m - depth_m, pose.yaw_deg)
            self.bodies[i] = draw_body(seed, name, start, fleet.tank, fleet.body)
            set_body(self.bodies[i], rows[i])
        self.states["held"] = 1
        self.states["position_m"] = self.bodies["home_m"]
        self.states["quaternion"] = [quaternion(0.0, 0.0, yaw) for yaw in self.bodies["home_yaw_rad"]]
        self.states["motor_deg"] = self.states["shaft_deg"] = self.bodies["servo_zero_deg"]

        self.sensors = PressureSensors(seed, self.robots, [p.noise_m for p in rows], [p.late_samples for p in rows])
        self.tare_pa = self.sensors.tare_pa()
        self.faults = Faults(len(robots))
        self.battery_v = np.full(len(robots), OPEN_V)  # without load
        self.boards: list[Board] = []
        self.history = History(len(robots), start_ns)
        self.ticks = 0
        self._start_ns = start_ns
        self._mounting = fleet.body
        self._size_m, self._surface_m = np.array(fleet.tank.size_m), surface_m
        self._waves = waves or Waves()
        self._pulses_us = np.zeros((len(robots), 8))  # no pulses before a board drives its pins
        self._nominal_deg = np.zeros((len(robots), 4))
        self._water_pa = np.zeros((len(robots), 4))
        self._events = sorted(events, key=lambda event: event.at_s, reverse=True)  # the next is the last
        for event in events:
            if event.robot not in robots:
                names = ", ".join(robots)
                raise ConfigError(f"event at {event.at_s} s: no robot '{event.robot}' dives; name one of {names}")
        self._measure()

    @property
    def now_ns(self) -> int:
        return self._start_ns + self.ticks * TICK_NS

    def tick(self, patience_s: float) -> None:
        """Take the answers to the last tick, move on by 10 ms with them, and send the next tick.

        The 10 ms that an answer acts in begin at the tick it answers, in lock-step as at the wall clock.
        """
        for i, board in enumerate(self.boards):
            act = board.act(patience_s)
            if act is not None:
                self._obey(i, act)
            elif not board.driving:
                self._pulses_us[i] = 0.0
        while self._events and self._events[-1].at_s * 1e9 <= self.ticks * TICK_NS:
            self._events.pop().strike(self)
        self.move()
        for i, board in enumerate(self.boards):
            board.tick(
                self.ticks * TICK_NS // 1000,
                self._readings_pa[i],
                self.faults.answered[i],
                round(self._supply_v[i] * 1000),
                round(self._drawn_a[i] * 100),
                self.faults.leak[i],
            )

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
        t_s = self.ticks * TICK_NS * 1e-9
        self.history.append(self.states)
        water_pressure_pa(self.bodies, self.states, self._surface_m, self._water_pa)
        if self._waves.amplitude_m:
            add_waves(self._waves, self._size_m[0], self._surface_m, t_s, self.bodies, self.states, self._water_pa)
        self._readings_pa = self.faults.spoil(self.sensors.sample(self._water_pa, t_s)).tolist()
        drawn_a = current_a(self.states["thrust_n"])
        supply = supply_v(self.battery_v, drawn_a)
        self.states["thrust_loss"] = thrust_loss(supply)
        self._drawn_a, self._supply_v = drawn_a.tolist(), supply.tolist()

    def _obey(self, i: int, act: Act) -> None:
        self._pulses_us[i] = act.pulses_us
        for k, servo_us in enumerate(act.servos_us):
            if servo_us:  # a servo without pulses stays where it is
                centred_us = servo_us - self._mounting.servo_centre_us
                self._nominal_deg[i, k] = centred_us / self._mounting.servo_us_per_deg
        if act.armed:
            self.states[i]["held"] = 0  # the crew lets go, once

    # --- what goes wrong, from now on -----------------------------------------------------------------------------

    def push(self, robot: str, force_n: Vector, point_m: Vector, for_s: float) -> None:
        """Push a robot: world-frame force at a body-frame point."""
        push(self.states[self._index(robot)], force_n, point_m, for_s)

    def kill_sensor(self, robot: str, sensor: int) -> None:
        """Pressure sensor 1 to 4 answers no more."""
        self.faults.kill(self._index(robot), sensor)

    def stick_sensor(self, robot: str, sensor: int) -> None:
        """It repeats its last reading."""
        self.faults.stick(self._index(robot), sensor)

    def shift_sensor(self, robot: str, sensor: int, offset_m: float) -> None:
        """It reads so much too deep."""
        self.faults.shift(self._index(robot), sensor, offset_m * PA_PER_M)

    def mend_sensor(self, robot: str, sensor: int) -> None:
        self.faults.mend(self._index(robot), sensor)

    def leak(self, robot: str) -> None:
        """Water at the probe in the hull."""
        self.faults.leak[self._index(robot)] = True

    def set_battery(self, robot: str, volts: float) -> None:
        """Open-circuit voltage of the pack."""
        self.battery_v[self._index(robot)] = volts

    def scale_thruster(self, robot: str, thruster: int, gain: float) -> None:
        """Thruster 1 to 8 gives so many times what it gave; 0: dead."""
        self.bodies[self._index(robot)]["thrust_gain"][thruster - 1] *= gain

    def unplug(self, robot: str, for_s: float) -> None:
        """Pull the serial cable."""
        self.boards[self._index(robot)].unplug(round(for_s * 1e6))

    def cut_power(self, robot: str, for_s: float) -> None:
        """Of board and thrusters."""
        self.boards[self._index(robot)].cut_power(round(for_s * 1e6))

    def hang_firmware(self, robot: str) -> None:
        """Stop its process, until the watchdog resets it."""
        self.boards[self._index(robot)].hang()

    def _index(self, robot: str) -> int:
        return self.robots.index(robot)


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
        for board in dive.boards:
            if board.overdue:
                raise TimeoutError(f"the firmware of {board.robot} did not answer for {LOCK_STEP_S} s")
