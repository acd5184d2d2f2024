"""Every mistake in a fleet file is one line that names the file, the key and the remedy."""

from pathlib import Path

import pytest

import agent
from agent.config import ConfigError, dump, load_fleet

BALL = 'detector = "ball"\nradius_m = 0.07'
TANK = (Path(agent.__file__).parent / "fleets" / "tank.toml").read_text()


def load(tmp_path, text: str):
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def test_shipped_file_loads_and_survives_a_round_trip(tmp_path) -> None:
    fleet = load(tmp_path, TANK)
    assert list(fleet.robot) == ["r1", "r2", "r3", "r4", "r5"]
    assert load(tmp_path, dump(fleet)) == fleet


def test_a_fleet_may_look_for_several_things(tmp_path) -> None:
    fleet = load(tmp_path, (Path(agent.__file__).parent / "fleets" / "two_balls.toml").read_text())
    assert {name: target.colour for name, target in fleet.target.items()} == {"ball": "red", "buoy": "green"}
    assert load(tmp_path, dump(fleet)) == fleet


def test_files_of_a_target_lie_beside_the_fleet_file(tmp_path) -> None:
    fleet = load(tmp_path, TANK.replace(BALL, 'detector = "box"\npicture = "a/x.png"\nbox = [1, 2, 30, 40]'))
    target = fleet.target["ball"]
    assert target.picture == str(tmp_path / "a" / "x.png") and target.models is None and target.radius_m is None
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert load(elsewhere, dump(fleet)) == fleet


MISTAKES = {
    "unknown key": (("radius_m = 0.07", "radius_m = 0.07\nshape = 'round'"), "target", "shape", "remove"),
    "wrong type": (("radius_m = 0.07", "radius_m = 'big'"), "target", "float", "correct"),
    "missing key": (("radius_m = 0.07", ""), "target", "radius_m", "add"),
    "out of range": (("radius_m = 0.07", "radius_m = -1.0"), "target", "> 0", "correct"),
    "not a number": (("x_m = 0.30", "x_m = nan"), "robot.r1.pose", "finite", "correct"),
    "unknown neighbour": (
        ('neighbours = ["r2", "r3", "r4", "r5"]', 'neighbours = ["r9"]'),
        "r1.neighbours",
        "r9",
        "add",
    ),
    "one-sided": (('neighbours = ["r1", "r2", "r3", "r4"]', 'neighbours = ["r1"]'), "r5", "neighbours", "add"),
    "itself": (('["r2", "r3", "r4", "r5"]', '["r1"]'), "r1.neighbours", "itself", "remove"),
    "twice": (('["r2", "r3", "r4", "r5"]', '["r2", "r2", "r3", "r4", "r5"]'), "r1.neighbours", "twice", "remove"),
    "same port": (("127.0.0.1:17402", "127.0.0.1:17401"), "r2.listen", "r1", "own port"),
    "high port": (("127.0.0.1:17402", "127.0.0.1:40000"), "r2.listen", "40000", "32767"),
    "no endpoint": (("tcp/127.0.0.1:17402", "localhost"), "r2.listen", "localhost", "tcp/HOST:PORT"),
    "below the floor": (('serial = "twin:r1"', 'serial = "twin:r1"\ndepth_m = 0.9'), "r1.depth_m", "floor", "0.5"),
    "two of one colour": (
        ("[estimation]", "[target.fish]\nradius_m = 0.1\n[estimation]"),
        "key 'target.fish.colour'",
        "'ball' is red too",
        "own colour",
    ),
    "a box without a picture": (
        (BALL, 'detector = "box"\nbox = [1, 2, 30, 40]'),
        "target.ball",
        "`picture` is missing",
        "add",
    ),
    "a ball with a picture": (
        ("radius_m = 0.07", 'radius_m = 0.07\npicture = "x.png"'),
        "ball.picture",
        "only a box",
        "remove",
    ),
    "no box": ((BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 0, 40]'), "target.ball.box", "[x, y, width"),
    "three numbers": ((BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 3]'), "box", "length 4"),
    "size of a box": (
        (BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 3, 4]\n[ranging]\ncues = "size"\n'),
        "ranging.cues",
        "'ball' is not known",
        "'focus'",
    ),
    "no target": (('[target.ball]\ndetector = "ball"\nradius_m = 0.07', "[target]"), "key 'target'", "add a table"),
    "bad name": (('fleet = "tank"', 'fleet = "Tank 3"'), "fleet", "regex", "correct"),
    "not TOML": (('fleet = "tank"', "fleet = tank"), "fleet.toml", "not valid TOML", "line 4"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake(tmp_path, mistake: str) -> None:
    (old, new), *expected = MISTAKES[mistake]
    assert old in TANK
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, TANK.replace(old, new, 1))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(tmp_path / "fleet.toml"))
    for part in expected:
        assert part in message, message


def test_missing_file_and_directory(tmp_path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(ConfigError, match=str(path)):
            load_fleet(path)
