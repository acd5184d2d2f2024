"""The four pressure sensors of each robot (MS5837-02BA class), in pascals absolute, 100 samples a second; its battery's
probe.

p = p_atm + rho g depth + dynamic pressure + offset + drift + noise, rounded to the sensor's step, one sample late or
as many as a plant asks for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled
from hw.twin.physics.body import SENSOR_M, to_body, to_world
from hw.twin.physics.forces import GRAVITY_M_S2, WATER_KG_M3
from hw.twin.scene import Waves, generator

PA_PER_M = WATER_KG_M3 * GRAVITY_M_S2

ATMOSPHERE_PA, WEATHER_PA = 101_325.0, 500.0
OFFSET_M = 0.003  # largest, of either sign; the tare in air takes it out
DRIFT_M_S = 0.0005 / 60  # standard deviation of the rate at the start; a sensor that warms up
DRIFT_S = 600.0  # time constant of warming up
NOISE_M = 0.0005  # standard deviation of one sample
LATE_SAMPLES = 1  # a conversion is started in one tick and read in the next
STEP_PA = 1.6  # 0.016 mbar, the 02BA's noise-free resolution at its highest oversampling, from memory

TARE_SAMPLES = 200  # 2 s in the crew's hands
BLOCK = 256  # samples of noise drawn at a time: a tick costs no call into the generators

# Corner of the hull that each sensor sits at, in units of sensor_m: the thrusters' numbering.
CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def drifted_s(t_s: float) -> float:
    """For how many seconds of the drift at the start the drift until t_s counts."""
    return DRIFT_S * (1 - math.exp(-t_s / DRIFT_S))


def seems(too_deep_m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Of a robot whose four sensors read so much too deep: how much too deep it seems to be, and by how much a metre
    ahead of it, and to its left, seems to be lower than it is."""
    ahead, left = (too_deep_m @ CORNERS / (4.0 * SENSOR_M)).tolist()
    return float(too_deep_m.mean()), ahead, left


@compiled()
def water_pressure_pa(
    bodies: NDArray[np.void], states: NDArray[np.void], surface_m: float, pressure_pa: NDArray[np.float64]
) -> None:
    """Fill pressure_pa (n, 4) with what the water exerts above the atmosphere at each sensor."""
    for i in range(states.shape[0]):
        s, reach = states[i], bodies[i].sensor_m
        q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
        flow = to_body(q, (s.water_m_s[0], s.water_m_s[1], s.water_m_s[2]))
        v = (s.velocity_m_s[0] - flow[0], s.velocity_m_s[1] - flow[1], s.velocity_m_s[2] - flow[2])
        w = s.rates_rad_s
        for k in range(4):
            x, y = reach * CORNERS[k, 0], reach * CORNERS[k, 1]
            depth = surface_m - s.position_m[2] - to_world(q, (x, y, 0.0))[2]
            # Water that meets a corner head on is stopped there, water that leaves it pulls: coefficient from 1 to -1.
            u = (v[0] - w[2] * y, v[1] + w[2] * x, v[2] + w[0] * y - w[1] * x)
            speed = math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
            outward = (u[0] * CORNERS[k, 0] + u[1] * CORNERS[k, 1]) / math.sqrt(2.0)
            dynamic = 0.5 * WATER_KG_M3 * speed * outward * bodies[i].stagnation
            pressure_pa[i, k] = max(0.0, PA_PER_M * depth + dynamic) if depth > 0 else 0.0


class PressureSensors:
    """All sensors of the fleet; each robot's errors come from its own stream."""

    def __init__(
        self,
        seed: int,
        robots: list[str],
        noise_m: Sequence[float] | None = None,
        late_samples: Sequence[int] | None = None,
    ) -> None:
        """noise_m and late_samples: one per robot; without them all are NOISE_M and LATE_SAMPLES."""
        self._noise_m = [NOISE_M] * len(robots) if noise_m is None else list(noise_m)
        self._late = np.array([LATE_SAMPLES] * len(robots) if late_samples is None else late_samples)
        self._rngs = [generator(seed, robot, "pressure") for robot in robots]
        rows = [(rng.uniform(-OFFSET_M, OFFSET_M, 4), rng.normal(0, DRIFT_M_S, 4)) for rng in self._rngs]
        weather_pa = generator(seed, "weather").uniform(-WEATHER_PA, WEATHER_PA)
        self._still_pa = ATMOSPHERE_PA + weather_pa + PA_PER_M * np.array([offset for offset, _ in rows])
        self._drift_pa_s = PA_PER_M * np.array([drift for _, drift in rows])
        self._noise_pa = np.zeros((BLOCK, len(robots), 4))
        self._drawn = 0
        self._past_pa = np.repeat(self._read(np.zeros((len(robots), 4)), 0.0)[None], max(self._late, default=0) + 1, 0)
        self._newest = 0

    def tare_pa(self) -> NDArray[np.float64]:
        """(n, 4): what the crew found in air before the dive, the median of two seconds."""
        air_pa = np.zeros(self._still_pa.shape)
        return np.asarray(np.median([self._read(air_pa, 0.0) for _ in range(TARE_SAMPLES)], axis=0))

    def sample(self, water_pa: NDArray[np.float64], t_s: float) -> NDArray[np.float64]:
        """(n, 4) readings that arrive t_s into the dive: those of some samples before this one."""
        kept = len(self._past_pa)
        self._newest = (self._newest + 1) % kept
        self._past_pa[self._newest] = self._read(water_pa, t_s)
        return np.asarray(self._past_pa[(self._newest - self._late) % kept, np.arange(len(self._late))])

    def _read(self, water_pa: NDArray[np.float64], t_s: float) -> NDArray[np.float64]:
        if self._drawn % BLOCK == 0:
            for i, (rng, noise_m) in enumerate(zip(self._rngs, self._noise_m, strict=True)):
                self._noise_pa[:, i] = rng.normal(0, noise_m * PA_PER_M, (BLOCK, 4))
        noise_pa = self._noise_pa[self._drawn % BLOCK]
        self._drawn += 1
        drift_pa = self._drift_pa_s * drifted_s(t_s)
        return np.asarray(np.round((self._still_pa + drift_pa + water_pa + noise_pa) / STEP_PA) * STEP_PA)


# --- battery: a divider by 11 in front of a converter of 12 bits (hal_stm32), on a supply that ESCs shake ---

PROBE_STEP_MV = 36_300 / 4095
PROBE_NOISE_MV = 50.0  # standard deviation of one sample; assumed


class BatteryProbes:
    """One for each robot; each robot's noise comes from its own stream."""

    def __init__(self, seed: int, robots: list[str]) -> None:
        self._rngs = [generator(seed, robot, "battery") for robot in robots]
        self._noise_mv = np.zeros((BLOCK, len(robots)))
        self._drawn = 0

    def read_mv(self, supply_v: NDArray[np.float64]) -> list[int]:
        """What the boards are told of these voltages (n,)."""
        if self._drawn % BLOCK == 0:
            for i, rng in enumerate(self._rngs):
                self._noise_mv[:, i] = rng.normal(0, PROBE_NOISE_MV, BLOCK)
        mv = 1000.0 * supply_v + self._noise_mv[self._drawn % BLOCK]
        self._drawn += 1
        steps = np.rint(np.maximum(mv, 0.0) / PROBE_STEP_MV)
        return [int(told) for told in steps * PROBE_STEP_MV]


# --- waves: a standing wave along the tank, as the pressure sensors see it ---
#
# Linear theory, water of finite depth:
# p = rho g A cosh(k z) / cosh(k h) cos(k x) cos(omega t), k = m pi / L, omega^2 = g k tanh(k h), z above the floor
# (Dean and Dalrymple, Water Wave Mechanics, chapter 3). What the wave does to the hull is left out.


def add_waves(
    waves: Waves,
    length_m: float,
    surface_m: float,
    t_s: float,
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pressure_pa: NDArray[np.float64],
) -> None:
    """Add to pressure_pa (n, 4) what the wave of a tank `length_m` long in x exerts at t_s."""
    k = waves.mode * math.pi / length_m
    omega = math.sqrt(GRAVITY_M_S2 * k * math.tanh(k * surface_m))
    _add_wave(PA_PER_M * waves.amplitude_m * math.cos(omega * t_s), k, surface_m, bodies, states, pressure_pa)


@compiled()
def _add_wave(
    crest_pa: float,
    k: float,
    surface_m: float,
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pressure_pa: NDArray[np.float64],
) -> None:
    for i in range(states.shape[0]):
        s, reach = states[i], bodies[i].sensor_m
        q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
        for j in range(4):
            arm = to_world(q, (reach * CORNERS[j, 0], reach * CORNERS[j, 1], 0.0))
            x, z = s.position_m[0] + arm[0], s.position_m[2] + arm[2]
            if z < surface_m:
                pressure_pa[i, j] += crest_pa * math.cosh(k * z) / math.cosh(k * surface_m) * math.cos(k * x)
