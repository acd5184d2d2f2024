"""Surfaces keep their texture while the lens moves: only its blur may change."""

import numpy as np

from agent.perception.clarity import tenengrad_blocks
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics import raycast
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.optics.shade import LOD_UP
from hw.twin.scene import generator, load_scene

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # camera axes as columns: looks along world x


def test_a_focus_sweep_does_not_switch_the_mip_level():
    fleet, scene, seed = load_fleet(shipped_fleet()), load_scene("tank"), 3
    lens = draw_lens("imx519_640", generator(seed, "r1", "lens"))._replace(f_number=1e6)  # everything is sharp
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, "r1")
    painter.prepare()
    nearest_m = lens.at_position_m(lens.highest)
    middle_m = 0.5 * (lens.at_rest_m + nearest_m)
    switch_m = float(LOD_UP) * raycast.WALL.texel_m * fleet.water.refractive_index * middle_m / lens.pixel_m
    eye = Eye((fleet.tank.size_m[0] - switch_m, 0.6, 0.25), AHEAD)
    centre = (240, 160, 160, 160)
    clarity = [
        tenengrad_blocks(painter.frame(eye, v_m, roi=centre), 160)[0, 0]
        for v_m in np.linspace(lens.at_rest_m, nearest_m, 6)
    ]
    assert np.ptp(clarity) < 0.1 * max(clarity)  # a level up or down is a third
