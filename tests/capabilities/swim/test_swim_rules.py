"""Fleet files of robots that swim: each mistake is one line that names the file, the key and the remedy."""

import pytest

from agent.core.config import ConfigError, dump
from agent.robot.fleet_reader import load_fleet, with_behaviour
from tests.places import ROOT

SWIM, TANK = ((ROOT / "agent" / "fleets" / name).read_text() for name in ("swim.toml", "tank.toml"))
R1 = "pose = { x_m = 0.60, y_m = 0.50, yaw_deg = 30.0 }"


def load(tmp_path, text):
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def behaviour(what):
    return R1, f"{R1}\nbehaviour = {{ {what} }}"


@pytest.mark.parametrize(
    "what",
    [
        'kind = "hold"',
        'kind = "turn", yaw_deg = 400.0',
        'kind = "goto", x_m = 0.20, y_m = 1.80, depth_m = 0.5',
        'kind = "orbit", x_m = 1.5, y_m = 1.0, radius_m = 0.8, speed_m_s = -0.1',
        'kind = "follow", target = "ball", standoff_m = 0.7, search = true',
        'kind = "search", target = "ball", lane_m = 0.5',
    ],
)
def test_a_behaviour_survives_a_round_trip(tmp_path, what) -> None:
    fleet = load(tmp_path, SWIM.replace(*behaviour(what)))
    assert fleet.robot["r1"].behaviour is not None and fleet.robot["r2"].behaviour is None
    assert load(tmp_path, dump(fleet)) == fleet


LANDMARKS = SWIM[SWIM.index("[landmarks]") : SWIM.index("[robot.r1]")]
MISTAKES = {
    "moored and told to swim": (
        SWIM,
        (*behaviour('kind = "hold"'), "[navigation]", ""),
        ("'robot.r1.behaviour'", "moored", "add a table [navigation]"),
    ),
    "no landmarks": (SWIM, (LANDMARKS, ""), ("'navigation'", "add a table [landmarks]")),
    "a pose at a wall": (
        SWIM,
        ("x_m = 0.60, y_m = 0.50", "x_m = 0.60, y_m = 0.19"),
        ("'robot.r1.pose'", "(0.60, 0.19)", "0.2 m from a wall", "another place"),
    ),
    "a goal at the far wall": (
        SWIM,
        behaviour('kind = "goto", x_m = 2.9, y_m = 1.0'),
        ("'robot.r1.behaviour'", "(2.90, 1.00)", "from a wall"),
    ),
    "a goal below the floor": (
        SWIM,
        behaviour('kind = "goto", x_m = 1.0, y_m = 1.0, depth_m = 0.51'),
        ("'robot.r1.behaviour'", "0.51 m is below the floor", "0.5 m deep"),
    ),
    "an orbit through a wall": (
        SWIM,
        behaviour('kind = "orbit", x_m = 1.5, y_m = 1.0, radius_m = 0.81'),
        ("'robot.r1.behaviour'", "(0.69, 0.19)", "from a wall"),
    ),
    "an orbit through the other one": (
        SWIM,
        behaviour('kind = "orbit", x_m = 1.5, y_m = 1.1, radius_m = 0.75'),
        ("'robot.r1.behaviour'", "(2.25, 1.85)", "from a wall"),
    ),
    "an orbit faster than it may swim": (
        SWIM,
        behaviour('kind = "orbit", x_m = 1.5, y_m = 1.0, radius_m = 0.5, speed_m_s = -0.3'),
        ("'robot.r1.behaviour'", "0.3 m/s", "limits.speed_m_s, 0.25", "slower"),
    ),
    "nobody to follow": (
        SWIM,
        behaviour('kind = "follow", target = "fish", standoff_m = 0.7'),
        ("'robot.r1.behaviour'", "no target 'fish'", "the file has ball"),
    ),
    "nearer than anybody comes": (
        SWIM,
        behaviour('kind = "follow", target = "ball", standoff_m = 0.35'),
        ("'robot.r1.behaviour.standoff_m'", "> 0.35", "correct"),
    ),
    "farther than the tank is long": (
        SWIM,
        behaviour('kind = "follow", target = "ball", standoff_m = 1.4'),
        ("'robot.r1.behaviour'", "1.4 m does not fit", "1.30 or less"),
    ),
    "a search faster than it may swim": (
        SWIM,
        behaviour('kind = "search", target = "ball", speed_m_s = 0.3'),
        ("'robot.r1.behaviour'", "0.3 m/s", "slower"),
    ),
    "two goals in one place": (
        SWIM,
        (
            *behaviour('kind = "goto", x_m = 2.0, y_m = 1.0'),
            'camera = "twin:r2"',
            'camera = "twin:r2"\nbehaviour = { kind = "goto", x_m = 2.0, y_m = 1.3 }',
        ),
        ("'robot.r2.behaviour'", "0.30 m from 'r1'", "move one of them"),
    ),
    "two in one place": (
        SWIM,
        ("x_m = 2.40, y_m = 0.50", "x_m = 0.90, y_m = 0.50"),
        ("'robot.r2.pose'", "0.30 m from 'r1'", "move one of them"),
    ),
    "a kind that nobody knows": (SWIM, behaviour('kind = "dance"'), ("'robot.r1.behaviour.kind'", "dance", "correct")),
    "too fast": (SWIM, ("[navigation]", "[navigation]\nlimits = { speed_m_s = 2.0 }"), ("speed_m_s'", "<= 0.5")),
    "moored robots do not swim": (
        TANK,
        ('serial = "twin:r1"', 'serial = "twin:r1"\nbehaviour = { kind = "turn", yaw_deg = 90.0 }'),
        ("'robot.r1.behaviour'", "remove the behaviour"),
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake(tmp_path, mistake) -> None:
    text, changes, expected = MISTAKES[mistake]
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(tmp_path / "fleet.toml"))
    for part in expected:
        assert part in message, message


TOLD = {
    '{ kind = "follow", target = "fish", standoff_m = 0.7 }': "key 'robot.r1.behaviour': no target 'fish'",
    "{ kind = follow }": "not valid TOML",
    '{ kind = "hold" }\nfleet = "other"': "unknown key `fleet`",
    '{ kind = "goto", x_m = 1.0 }': "key 'behaviour': required key `y_m` is missing; add it",
}


def test_a_behaviour_of_the_command_line_is_checked_as_that_of_a_file(tmp_path) -> None:
    fleet = load(tmp_path, SWIM)
    told = with_behaviour(fleet, "r1", '{ kind = "search", target = "ball" }')
    assert told == load(tmp_path, SWIM.replace(*behaviour('kind = "search", target = "ball"')))
    for text, expected in TOLD.items():
        with pytest.raises(ConfigError) as caught:
            with_behaviour(fleet, "r1", text)
        message = str(caught.value)
        assert message.startswith("--behaviour") and expected in message


def test_moored_robots_may_stand_at_a_wall_and_close_together(tmp_path) -> None:
    moored = SWIM.replace("[navigation]", "").replace("x_m = 0.60, y_m = 0.50", "x_m = 0.05, y_m = 0.05")
    assert load(tmp_path, moored.replace("x_m = 2.40, y_m = 0.50", "x_m = 0.25, y_m = 0.05")).navigation is None
