"""Which solid of a scene is which target of a fleet, and what colour it has in a frame."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, Target
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.scene import generator, load_scene, scene_of, target_solids

FLEET = load_fleet(fleet_file("two_balls"))
SCENE = load_scene("two_balls")
FILE = Path("fleet.toml")


def test_targets_are_found_by_their_colours() -> None:
    found = target_solids(FLEET, SCENE, FILE)
    assert {name: solid.position_m for name, solid in found.items()} == {
        "ball": (0.55, 0.66, 0.07),
        "buoy": (0.92, 0.45, 0.05),
    }


def test_a_thing_in_a_box_is_known_by_its_name() -> None:
    fleet = replace(FLEET, target={"rock": Target(detector="box", picture="rock.png", box=(0, 0, 9, 9))})
    named = replace(SCENE.solid[2], name="rock")
    assert target_solids(fleet, SCENE, FILE) == {}
    assert target_solids(fleet, replace(SCENE, solid=(named, SCENE.solid[3])), FILE) == {"rock": named}
    with pytest.raises(ConfigError, match="has 2 times a solid called rock; give each a name of its own"):
        target_solids(fleet, replace(SCENE, solid=(named, named)), FILE)


@pytest.mark.parametrize(("name", "copies", "count"), [("tank", 1, 0), ("two_balls", 2, 2)])
def test_none_or_two_of_a_colour_is_a_mistake(name: str, copies: int, count: int) -> None:
    scene = load_scene(name)
    with pytest.raises(ConfigError, match=f"has {count} times a (red|green) ball; take another colour"):
        target_solids(FLEET, replace(scene, solid=scene.solid * copies), FILE)


def test_each_ball_has_its_colour_in_the_frame() -> None:
    lens = draw_lens(SCENE.camera, generator(0, "r1", "lens"))
    painter = Painter(SCENE, FLEET.tank, FLEET.water.refractive_index, lens, 0, "r1")
    painter.prepare()
    for solid, strongest in zip(SCENE.solid[:2], (2, 1), strict=True):  # of blue, green, red
        eye_m = np.array(solid.position_m) - (0.0, 0.4, 0.0)
        towards_y = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: right, down, forward
        image = painter.frame(Eye(eye_m, towards_y), lens.at_rest_m)
        height, width = image.shape[:2]
        middle = image[height // 2 - 20 : height // 2 + 20, width // 2 - 20 : width // 2 + 20].mean(axis=(0, 1))
        assert middle.argmax() == strongest
        assert middle[strongest] > 1.3 * np.delete(middle, strongest).max()


def test_the_water_is_that_of_the_fleet_file() -> None:
    murky = replace(FLEET, water=replace(FLEET.water, kind="turbid"))
    assert scene_of(murky) == replace(SCENE, water=replace(SCENE.water, preset="turbid"))
    assert scene_of(FLEET) == SCENE
