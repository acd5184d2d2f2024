"""A standing wave, as the sensors of a dive see it."""

import math

import numpy as np

from hw.twin.physics.sensors import PA_PER_M
from hw.twin.scene import Scene, Waves
from tests.hw.twin.stand_ins import boardless_dive


def test_a_wave_has_its_period_and_shows_less_at_depth():
    still, wavy = boardless_dive(), boardless_dive(scene=Scene(name="wavy", waves=Waves(amplitude_m=0.005)))
    off_pa = []
    for _ in range(400):
        for made in (still, wavy):
            made.move()
        off_pa.append(wavy._water_pa - still._water_pa)
    k = math.pi / 1.5
    omega = math.sqrt(9.81 * k * math.tanh(k * 0.5))  # 4.0 rad/s: the tank's first mode
    x_m, z_m = wavy.states["position_m"][:, 0], wavy.states["position_m"][:, 2]
    crest_pa = 0.005 * PA_PER_M * np.cosh(k * z_m) / np.cosh(k * 0.5) * np.cos(k * x_m)
    crest_pa *= math.cos(k * 0.13)  # what four sensors before and behind the middle see of it
    t_s = 0.01 * np.arange(1, 401)
    np.testing.assert_allclose(
        np.mean(off_pa, axis=2), np.outer(np.cos(omega * t_s), crest_pa), atol=0.005 * np.abs(crest_pa).max()
    )
