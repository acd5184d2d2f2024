"""The plant that the control law was tuned on: depth, roll and pitch of a 4 kg robot, its thrusters and sensors.

Not the twin's: three axes that do not couple, and a thruster curve read off the manufacturer's points at 12 V.
"""

from __future__ import annotations

import math

import numpy as np

MASS_KG, INERTIA_KGM2 = 8.0, 0.075  # with added mass and inertia
DRAG_DEPTH, DRAG_TILT = (3.0, 40.0), (0.03, 0.12)  # linear, quadratic
RIGHTING_NM = 4.0 * 9.81 * 0.01  # centre of buoyancy 1 cm above that of gravity
ARM_X_M, ARM_Y_M, SENSOR_M = 0.08, 0.06, 0.13
PA_PER_M = 9790.0
AIR_PA = 101325.0
DEAD_N = 0.05
PULSE_US = np.array([1100, 1200, 1300, 1400, 1464, 1536, 1600, 1700, 1800, 1900])
T200_N = np.array([-28.6, -19.0, -10.0, -3.2, 0.0, 0.0, 4.0, 12.4, 24.0, 36.4]) * (10.0 / 36.4)
STEPS = 5  # of 2 ms in a control cycle


class Plant:
    """State in metres down, radians, seconds. `push` is (force down N, roll moment Nm, pitch moment Nm)."""

    def __init__(self, seed: int, depth_m: float, lag_s: float = 0.10, inertia_factor: float = 1.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.position = np.array([depth_m, 0.0, 0.0])
        self.speed = np.zeros(3)
        self.thrust_n = np.zeros(4)
        self.push = np.zeros(3)
        self.lag_s = lag_s
        self.inertia = np.array([MASS_KG, INERTIA_KGM2, INERTIA_KGM2]) * inertia_factor
        self.tare_pa = AIR_PA + self.rng.uniform(-200.0, 200.0, 4)
        self._pa = self._sample()

    def step(self, pulses_us: list[int]) -> None:
        """One control cycle of 10 ms."""
        linear = np.array([DRAG_DEPTH[0], DRAG_TILT[0], DRAG_TILT[0]])
        quadratic = np.array([DRAG_DEPTH[1], DRAG_TILT[1], DRAG_TILT[1]])
        target = np.interp(pulses_us[:4], PULSE_US, T200_N)
        target[np.abs(target) < DEAD_N] = 0.0
        h = 0.01 / STEPS
        for _ in range(STEPS):
            self.thrust_n += (target - self.thrust_n) * (1 - math.exp(-h / self.lag_s))
            f1, f2, f3, f4 = self.thrust_n
            wrench = np.array([-(f1 + f2 + f3 + f4), ARM_Y_M * (f1 + f2 - f3 - f4), ARM_X_M * (-f1 + f2 + f3 - f4)])
            righting = np.array([0.0, *(-RIGHTING_NM * np.sin(self.position[1:]))])
            drag = linear * self.speed + quadratic * self.speed * np.abs(self.speed)
            self.speed += h * (wrench + self.push + righting - drag) / self.inertia
            self.position += h * self.speed

    def pressure_pa(self) -> list[float]:
        """The sensors, one sample late: 0.5 mm of white noise, rounded to 0.1 mm."""
        late, self._pa = self._pa, self._sample()
        return [float(p) for p in late]

    def pressure_mPa(self) -> list[int]:
        """The same as the firmware has it."""
        return [round(1000 * p) for p in self.pressure_pa()]

    def _sample(self) -> np.ndarray:
        depth, roll, pitch = self.position
        x = SENSOR_M * np.array([1, -1, -1, 1])
        y = SENSOR_M * np.array([1, 1, -1, -1])
        zeta = depth + x * math.sin(pitch) - y * math.sin(roll) * math.cos(pitch) + self.rng.normal(0, 0.0005, 4)
        return self.tare_pa + PA_PER_M * np.round(zeta, 4)
