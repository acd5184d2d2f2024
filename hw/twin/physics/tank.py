"""The water and what moves in it: every robot as a rigid body with six degrees of freedom, 500 steps a second.

(M_RB + M_A) nu' + C(nu) nu + (D_l + D_q |nu|) nu + g(R) = thrust + mooring + tether + contact + push, after Fossen,
Handbook of Marine Craft Hydrodynamics; where there is a current, nu is through the water. Drag is signed: the paper's
k v^2 drives a body that moves backwards. Semi-implicit Euler: velocities first, then the pose with the new velocities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.messages import Vector
from hw.compiled import compiled
from hw.firmware.bus import NO_GRAVITY
from hw.firmware.wire import NO_RATE
from hw.twin.physics.body import (
    F_MAX_N,
    cross,
    lagged_thrust_n,
    motor_deg_after,
    shaft_deg_after,
    static_thrust_n,
    to_body,
    to_world,
    turned,
)
from hw.twin.physics.forces import (
    GRAVITY_M_S2,
    add_contacts,
    add_force,
    add_lines,
    add_stirred_water,
    add_thrust,
    add_water,
    add_weight,
)
from hw.twin.physics.sensors import LATE_SAMPLES, NOISE_M
from hw.twin.scene import Current, Pull, generator

STEP_S = 0.002  # 20 times shorter than the fastest lag, that of the servos
STEPS_PER_TICK = 5
TICK_NS = 10_000_000  # the firmware's 100 Hz
TICK_S = TICK_NS * 1e-9
BLOCK = 256  # samples of noise drawn at a time: a tick costs no call into the generators

# One record per robot, all that moves. World: origin at the lower left corner of the tank's floor, z up.
STATE = np.dtype(
    [
        ("position_m", "f8", 3),
        ("quaternion", "f8", 4),  # w, x, y, z; body -> world
        ("velocity_m_s", "f8", 3),  # body frame
        ("rates_rad_s", "f8", 3),  # body frame
        ("thrust_n", "f8", 8),
        ("thrust_loss", "f8"),  # share that is missing because the battery sags
        ("motor_deg", "f8", 4),  # servos: camera pan, camera tilt, lamp pan, lamp tilt
        ("shaft_deg", "f8", 4),  # what they carry, behind the play of the gears
        ("held", "i8"),  # 1: in the hands of the crew
        ("push_n", "f8", 3),  # world frame
        ("push_at_m", "f8", 3),  # body frame
        ("push_s", "f8"),  # time left
        ("stirred", "i8"),  # 1: the water flows, the tether drags or is pulled; 0 leaves this out
        ("water_m_s", "f8", 3),  # current, world frame, and how it speeds up
        ("water_m_s2", "f8", 3),
        ("pull_n", "f8", 3),  # at the tether, world frame
    ],
    align=True,
)


@compiled()
def advance(
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pulses_us: NDArray[np.float64],
    nominal_deg: NDArray[np.float64],
    size_m: NDArray[np.float64],
    surface_m: float,
    dt_s: float,
    steps: int,
) -> None:
    """Move all robots on by `steps` steps of dt_s, in place.

    bodies (n,) BODY, states (n,) STATE, pulses_us (n, 8) to the thrusters (0: no pulses), nominal_deg (n, 4) to the
    servos, size_m (3,) of the tank, surface_m height of the water surface above its floor.
    """
    robots = states.shape[0]
    wrench = np.zeros((robots, 6))
    for _ in range(steps):
        wrench[:] = 0.0
        for i in range(robots):
            body, s = bodies[i], states[i]
            for k in range(8):
                gain = body.thrust_gain[k] * (1.0 - s.thrust_loss)
                target = static_thrust_n(pulses_us[i, k], body.neutral_us[k], gain)
                s.thrust_n[k] = lagged_thrust_n(s.thrust_n[k], target, body.thrust_lag_s[k], dt_s)
            for k in range(4):
                s.motor_deg[k] = motor_deg_after(
                    s.motor_deg[k],
                    nominal_deg[i, k],
                    body.servo_gain[k],
                    body.servo_zero_deg[k],
                    body.servo_low_deg[k],
                    body.servo_high_deg[k],
                    dt_s,
                )
                s.shaft_deg[k] = shaft_deg_after(s.shaft_deg[k], s.motor_deg[k])
            if s.held:
                continue
            q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
            p = (s.position_m[0], s.position_m[1], s.position_m[2])
            v = (s.velocity_m_s[0], s.velocity_m_s[1], s.velocity_m_s[2])
            w = (s.rates_rad_s[0], s.rates_rad_s[1], s.rates_rad_s[2])
            v_world = to_world(q, v)
            if s.stirred:
                add_stirred_water(body, s, q, v, w, dt_s, wrench[i])
            else:
                add_water(body, v, w, wrench[i])
            add_weight(body, p[2], q, surface_m, wrench[i])
            add_thrust(body, s.thrust_n, wrench[i])
            add_lines(body, p, q, v_world, w, wrench[i])
            add_contacts(states, i, q, v, v_world, w, size_m, wrench[i])
            if s.push_s > 0:
                push = (s.push_n[0], s.push_n[1], s.push_n[2])
                add_force(wrench[i], to_body(q, push), (s.push_at_m[0], s.push_at_m[1], s.push_at_m[2]))
                s.push_s -= dt_s
        for i in range(robots):
            body, s = bodies[i], states[i]
            if s.held:
                continue
            for k in range(3):
                s.velocity_m_s[k] += dt_s * wrench[i, k] / (body.mass_kg + body.added_kg[k])
                inertia = body.inertia_kgm2[k] + body.added_inertia_kgm2[k]
                s.rates_rad_s[k] += dt_s * wrench[i, 3 + k] / inertia
            q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
            moved = to_world(q, (s.velocity_m_s[0], s.velocity_m_s[1], s.velocity_m_s[2]))
            q = turned(q, (s.rates_rad_s[0], s.rates_rad_s[1], s.rates_rad_s[2]), dt_s)
            for k in range(3):
                s.position_m[k] += dt_s * moved[k]
            for k in range(4):
                s.quaternion[k] = q[k]


def push(state: np.void, force_n: Vector, point_m: Vector, for_s: float) -> None:
    """Push one robot: a world-frame force at a body-frame point, from the next step on."""
    state["push_n"], state["push_at_m"], state["push_s"] = force_n, point_m, for_s


# --- plant ---


class Plant(NamedTuple):
    """What an experiment decides about one robot, instead of chance; the defaults leave it as it is drawn."""

    mass_scale: float = 1.0  # on all that resists acceleration, added mass with it; it stays as buoyant as it was
    lag_s: float | None = None  # of every thruster; None: drawn about 0.10 s
    f_max_n: float = F_MAX_N  # thrust at 1900 us
    noise_m: float = NOISE_M  # standard deviation of one pressure sample
    late_samples: int = LATE_SAMPLES  # from the water to the firmware
    dynamic_pressure: float = 1.0  # share of the stagnation pressure that the sensors see


def set_body(body: NDArray[np.void], plant: Plant) -> None:
    """Impose a plant on a drawn record () BODY."""
    for name in ("mass_kg", "displaced_kg", "added_kg", "inertia_kgm2", "added_inertia_kgm2"):
        body[name] *= plant.mass_scale
    if plant.lag_s is not None:
        body["thrust_lag_s"] = plant.lag_s
    body["thrust_gain"] *= plant.f_max_n / F_MAX_N
    body["stagnation"] = plant.dynamic_pressure


# --- flow: water that flows and tethers that pull, as random processes with streams of their own ---
#
# The current is one velocity everywhere, walls or not: its constant part, and in x and y a gust that comes and goes
# (Ornstein-Uhlenbeck, GUST_S). Water has mass: it follows both with a lag, so that its acceleration, which pushes a
# hull as hard as it pushes the water that the hull displaces, is finite.

GUST_S = 4.0  # correlation time of what drives the gust; assumed
LAG_S = 1.0  # of the water behind it, and behind a current that is changed; assumed


class Flow:
    """The current of a tank and the pull at each robot's tether; `tick` writes both into the robots' states."""

    def __init__(self, seed: int, robots: Sequence[str], current: Current, pull: Pull) -> None:
        self.active = bool(any(current.velocity_m_s) or current.gust_m_s or pull.force_n)  # else `tick` does nothing
        self._mean_m_s = np.array(current.velocity_m_s)
        self._now_m_s = self._mean_m_s.copy()
        self._usual, self._left_s = pull, np.full(len(robots), math.inf)
        # One process a row, in x and y: what drives the gust, and the pull at each robot. The lag weakens the former.
        self._rngs = [generator(seed, "gust"), *(generator(seed, robot, "pull") for robot in robots)]
        self._noise, self._drawn = np.zeros((BLOCK, len(self._rngs), 2)), 0
        self._x = np.zeros((len(self._rngs), 2))
        self._kept, self._gain = np.zeros((len(self._rngs), 1)), np.zeros((len(self._rngs), 1))
        self._wander(0, current.gust_m_s * math.sqrt((GUST_S + LAG_S) / GUST_S), GUST_S)
        for i in range(len(robots)):
            self._wander(1 + i, pull.force_n / math.sqrt(2), pull.correlation_s)

    @property
    def velocity_m_s(self) -> Vector:
        """Of the water now."""
        x, y, z = self._now_m_s.tolist()
        return x, y, z

    def set_current(self, velocity_m_s: Vector) -> None:
        """Another constant part from now on."""
        self._mean_m_s, self.active = np.array(velocity_m_s), True

    def pull(self, robot: int, pull: Pull, for_s: float) -> None:
        """Another pull at one tether, for so long."""
        self._wander(1 + robot, pull.force_n / math.sqrt(2), pull.correlation_s)
        self._left_s[robot] = for_s
        self.active = True

    def tick(self, states: NDArray[np.void]) -> None:
        """What flows and pulls in the next tick."""
        for robot in np.flatnonzero(self._left_s <= 0).tolist():
            self.pull(robot, self._usual, math.inf)
        self._left_s -= TICK_S
        if self._drawn % BLOCK == 0:
            for i, rng in enumerate(self._rngs):
                self._noise[:, i] = rng.standard_normal((BLOCK, 2))
        self._x = self._kept * self._x + self._gain * self._noise[self._drawn % BLOCK]
        self._drawn += 1
        speeding_m_s2 = (self._mean_m_s - self._now_m_s) / LAG_S
        speeding_m_s2[:2] += self._x[0] / LAG_S
        states["stirred"] = 1
        states["water_m_s"], states["water_m_s2"] = self._now_m_s, speeding_m_s2
        states["pull_n"][:, :2] = self._x[1:]
        self._now_m_s += speeding_m_s2 * TICK_S

    def _wander(self, row: int, sigma: float, correlation_s: float) -> None:
        """Let a row be an Ornstein-Uhlenbeck process; exact, so that sigma holds whatever the step."""
        kept = math.exp(-TICK_S / correlation_s)
        self._kept[row], self._gain[row] = kept, sigma * math.sqrt(1 - kept * kept)


# --- yaw gyro: an ICM-42688-P lying flat in the hull, 100 readings a second ---
#
# Figures of its data sheet (TDK InvenSense DS-000347): noise, zero offset and its drift with temperature, error of
# scale. How straight it is mounted, what the thrusters shake and how fast the offset wanders are estimates.

ZERO_DEG_S = 0.5  # standard deviation of the offset
SCALE = 0.005  # and of the scale
MOUNTED_RAD = math.radians(1.0)  # and of either tilt of its axis, by which it hears roll and pitch
LOW_PASS_HZ = 25.0  # as the firmware sets it
FOLLOWS = 1.0 - math.exp(-2.0 * math.pi * LOW_PASS_HZ * TICK_S)  # share of a change that has passed after a reading
NOISE_DEG_S = math.hypot(0.0028 * math.sqrt(LOW_PASS_HZ), 0.05)  # of one reading: its own, and the thrusters'
WALK_DEG_S = 0.002  # per root second, of the offset: 0.005 deg/s for each kelvin by which it warms
FULL_SCALE_CDEG_S = 25_013

# Its accelerometer, in thousandths of gravity, of 4 g full scale: zero offsets of the data sheet; what thrusters shake
# is an estimate.
OFFSET_MG, SHAKE_MG, FULL_SCALE_MG = 20.0, 20.0, 4000.0


class Gyros:
    """The gyros of a fleet, where it has them; each robot's errors come from a stream of its own."""

    def __init__(self, seed: int, robots: Sequence[str], fitted: bool) -> None:
        self._rngs = [generator(seed, robot, "gyro") for robot in robots] if fitted else []
        rows = [(rng.normal(0, ZERO_DEG_S), rng.normal(0, SCALE), *rng.normal(0, MOUNTED_RAD, 2)) for rng in self._rngs]
        errors = np.array(rows).reshape(-1, 4)
        self._zero_deg_s, scale, about = errors[:, 0].copy(), errors[:, 1], errors[:, 2:]
        self._axes = np.column_stack([about, 1.0 + scale])  # (n, 3), body frame
        self._passed_deg_s = np.zeros(len(self._rngs))
        self._draws = np.zeros((BLOCK, len(self._rngs), 2))
        self._drawn = 0
        self._robots = list(robots)
        self._failed: dict[int, int] = {}  # what broken ones say
        self._told = [NO_RATE] * len(robots)
        self._shakes = [generator(seed, robot, "accelerometer") for robot in robots] if fitted else []
        self._offset_mg = np.array([rng.normal(0, OFFSET_MG, 3) for rng in self._shakes]).reshape(-1, 3)
        self._before_m_s: NDArray[np.float64] | None = None

    def gravity_mg(self, states: NDArray[np.void]) -> list[tuple[int, int]]:
        """What each accelerometer says a tick after the last, upwards and level; NO_GRAVITY where none answers."""
        if not self._shakes:
            return [NO_GRAVITY] * len(self._robots)
        says = []
        for i, (state, rng) in enumerate(zip(states, self._shakes, strict=True)):
            q, v, w = (tuple(state[name].tolist()) for name in ("quaternion", "velocity_m_s", "rates_rad_s"))
            before_m_s = v if self._before_m_s is None else self._before_m_s[i]
            speeding_m_s2 = (np.array(v) - before_m_s) / TICK_S + cross(w, v)
            mg = 1000.0 * (np.array(to_body(q, (0.0, 0.0, 1.0))) + speeding_m_s2 / GRAVITY_M_S2)
            mg = np.clip(mg + self._offset_mg[i] + rng.normal(0, SHAKE_MG, 3), -FULL_SCALE_MG, FULL_SCALE_MG)
            failed = self._failed.get(i) == NO_RATE
            says.append(NO_GRAVITY if failed else (round(mg[2]), round(math.hypot(mg[0], mg[1]))))
        self._before_m_s = states["velocity_m_s"].copy()
        return says

    def read(self, rates_rad_s: NDArray[np.float64]) -> list[int]:
        """What each says a tick after the last: hundredths of a degree a second, NO_RATE of a robot without one.

        rates_rad_s: (n, 3), body frame.
        """
        if not self._rngs:
            return self._told
        if self._drawn % BLOCK == 0:
            self._draws[:] = np.stack([rng.standard_normal((BLOCK, 2)) for rng in self._rngs], axis=1)
        noise, walk = self._draws[self._drawn % BLOCK].T
        self._drawn += 1
        self._zero_deg_s += WALK_DEG_S * math.sqrt(TICK_S) * walk
        turning_deg_s = np.degrees((self._axes * rates_rad_s).sum(axis=1))
        self._passed_deg_s += FOLLOWS * (turning_deg_s - self._passed_deg_s)
        says = np.rint(100.0 * (self._passed_deg_s + self._zero_deg_s + NOISE_DEG_S * noise))
        told = np.clip(says, -FULL_SCALE_CDEG_S, FULL_SCALE_CDEG_S).astype(int).tolist()
        self._told = [self._failed.get(i, rate) for i, rate in enumerate(told)]
        return self._told

    def fail(self, robot: str, stuck: bool) -> None:
        """It does not answer any more, or repeats its last reading."""
        i = self._robots.index(robot)
        self._failed[i] = self._told[i] if stuck else NO_RATE
