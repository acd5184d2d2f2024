"""docs/scenes.md says what a scene file can say, and all of it can be said."""

import re

from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import Dive
from hw.twin.scene import KINDS, SCENES, load_scene
from hw.twin.truth import target_solids
from tests.places import ROOT

PAGE = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
SWIM = ROOT / "tests" / "hw" / "twin" / "swim.toml"


def test_the_scene_of_the_page_is_one(tmp_path):
    text = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = load_scene(str(path))
    assert not [key for key in scene.__struct_fields__ if not re.search(rf"^\[*{key}\b", text, re.MULTILINE)]
    Dive(load_fleet(SWIM), ["r1", "r2", "r3"], 0, scene=scene).move()


def test_every_event_and_every_scene_is_on_the_page():
    assert not [kind for kind in KINDS if f"`{kind}`" not in PAGE]
    assert not [path.stem for path in SCENES.glob("*.toml") if f"`{path.stem}`" not in PAGE]


def test_the_scene_that_ships_suits_a_fleet_that_swims():
    fleet, scene = load_fleet(SWIM), load_scene("swim")
    (ball,) = target_solids(fleet, scene, SWIM).values()
    assert all(0 < place < size for place, size in zip(ball.position_m, fleet.tank.size_m, strict=True))
    dive = Dive(fleet, list(fleet.robot), 0, scene=scene)
    dive.states["held"] = 0
    for _ in range(200):
        dive.move()
    assert not dive.bodies["mooring"].any() and dive._flow.active
    assert (abs(dive.states["position_m"][:, :2] - dive.bodies["home_m"][:, :2]) > 1e-4).any(axis=1).all()
    assert [tag.id for tag in dive.stage.tags(0)] == [0, 1, 12, 211, 586]
