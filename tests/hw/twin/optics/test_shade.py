"""What water takes from light, and what it adds."""

import numpy as np

from hw.twin.optics.shade import draw_water, transmission_and_veil
from hw.twin.scene import SceneWater, generator


def test_air_adds_and_takes_nothing():
    air = draw_water(SceneWater(preset="air"), generator(0, "water"))
    through, veil = transmission_and_veil(air, np.array([0.0, 0.5, 3.0]))
    assert np.array_equal(through, np.ones((3, 3)))
    assert not veil.any()


def test_tap_water_takes_red_and_adds_a_veil():
    for seed in range(20):
        water = draw_water(SceneWater(preset="tap"), generator(seed, "water"))
        through, veil = transmission_and_veil(water, np.array([0.0, 0.5, 1.5]))
        assert np.array_equal(through[0], np.ones(3))
        assert not veil[0].any()
        assert np.all(np.diff(veil, axis=0) > 0)
        blue, green, red = 1 - through[2]
        assert 0.25 < red < 0.55
        assert max(blue, green) < 0.2
        assert not np.allclose(water.direct, water.scatter)
