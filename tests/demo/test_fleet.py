"""Which robots dive in a demo, and what is refused before anything is made."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent.core.config import ConfigError, dump
from agent.demo.demo import demo, demo_fleet
from agent.process.command import fleet_file, shipped_fleet, shipped_names
from agent.robot.fleet_reader import load_fleet

TANK = shipped_fleet().read_text()
NO_TWIN = TANK.replace('camera = "twin:r2"', 'camera = "v4l2:/dev/video0"').replace('"twin:r2"', '"/dev/ttyACM0"')
FISH = fleet_file("fish").read_text()
EEL = FISH.replace("target.fish", "target.eel").replace('"fish", s', '"eel", s')
BOX = 'detector = "box"\npicture = "rock.png"\nbox = [0, 0, 9, 9]'
ROCK = TANK.replace("[target.ball]", "[target.rock]").replace('detector = "ball"\nradius_m = 0.07', BOX)
NETS = 'big.png"\nmodels = "nets'
STONE = '[[solid]]\nkind = "stone"\nname = "rock"\nposition_m = [1, 1, 0]\nradii_m = [1, 1, 1]'
SCENE = '\n[twin]\nscene = "SCENE"\n'


@pytest.mark.parametrize(
    ("name", "asked", "robots"),
    [
        ("tank", None, 3),
        ("tank", 5, 5),
        ("two_balls", None, 3),
        ("pair", None, 2),
        ("pair", 1, 1),
        ("five", None, 5),
        ("fish", 2, 2),
    ],
)
def test_all_robots_of_a_file_dive_and_three_of_the_tank(
    name: str, asked: int | None, robots: int, tmp_path: Path
) -> None:
    pair = dump(demo_fleet(2, "evidence", 0.0, 0, False, tmp_path))
    (tmp_path / "pair.toml").write_text(pair)
    (tmp_path / "five.toml").write_text(TANK)
    path = fleet_file(name) if name in shipped_names() else tmp_path / f"{name}.toml"
    fleet = demo_fleet(asked, "evidence", 0.0, 0, False, tmp_path, path)
    assert list(fleet.robot) == list(load_fleet(path).robot)[:robots]


def test_what_is_not_asked_for_is_as_the_file_has_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(dump(demo_fleet(2, "paper", 0.25, 7, True, tmp_path)))
    for asked, protocol, loss, seed in (
        ((None, None, None), "paper", 0.25, 7),
        (("evidence", 0.0, 0), "evidence", 0.0, 0),
    ):
        fleet = demo_fleet(None, *asked, None, tmp_path, path)
        assert (fleet.estimation.protocol, fleet.link.loss, fleet.link.loss_seed) == (protocol, loss, seed)
        assert (fleet.twin.seed, fleet.camera.enhance) == (seed, True)


@pytest.mark.parametrize(
    ("text", "robots", "message"),
    [
        (TANK, 9, r"--robots 9: my.toml has 5; choose 1 to 5"),
        (
            NO_TWIN,
            None,
            r"'robot.r2.serial': '/dev/ttyACM0' is not in the twin, .*; write \"twin:r2\" in",
        ),
        (NO_TWIN.replace("/dev/ttyACM0", "twin:r2"), None, r"'robot.r2.camera'"),
        (ROCK, None, r"'target.rock': nothing in scene 'tank' has this name, .* write name = \"rock\" under a"),
        (ROCK + SCENE, None, r"rock.png: no picture for target 'rock'"),
        (ROCK.replace("rock.png", "small.png") + SCENE, None, r"small.png: 2x1 pixels, the camera has 640x480"),
        (
            ROCK.replace("rock.png", 'big.png"\nmodels = "nets') + SCENE,
            None,
            r"nets.nanotrack_backbone_sim.onnx: no such",
        ),
        (EEL, None, r"'target.eel': nothing in scene 'fish'"),
        (FISH.replace("speed_m_s", "# ").replace("turn_s", "# "), None, r"'target.fish': it swims .* add `speed_m_s`"),
        (TANK + SCENE.replace("SCENE", "two"), None, "scene 'two': no such scene; give one of .*tank, two_balls"),
    ],
)
def test_what_cannot_dive_or_be_judged_is_one_line_and_leaves_nothing(
    text: str, robots: int | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'name = "rocks"\n[[solid]]\nkind = "stone"\nname = "rock"\nposition_m = [1, 1, 0]\nradii_m = [1, 1, 1]'
    )
    for name, shape in (("small.png", (1, 2, 3)), ("big.png", (480, 640, 3))):
        cv2.imwrite(str(tmp_path / name), np.zeros(shape, np.uint8))
    file = tmp_path / "my.toml"
    file.write_text(text.replace("SCENE", str(scene)))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(ConfigError, match=message) as caught:
        demo(robots, "evidence", 0.0, 0, 1.0, False, None, Console(file=io.StringIO()), str(file))
    assert "\n" not in str(caught.value)
    assert not list(Path().iterdir())


@pytest.mark.parametrize("name", ["none", "there/tank", ""])
def test_a_fleet_that_does_not_ship_is_told_which_do(name: str) -> None:
    with pytest.raises(ConfigError, match=f"--fleet {name}: no such fleet; give one of .*tank, two_balls"):
        fleet_file(name)
