"""`[access]`: who looks and who orders, all links of one kind, and names that are one party's each."""

from pathlib import Path

import pytest

import agent
from agent.core.config import ConfigError, Fleet, dump
from agent.robot.fleet_reader import load_fleet

TANK = (Path(agent.__file__).parent / "fleets" / "tank.toml").read_text()
SECURED = TANK.replace("tcp/", "tls/") + '\n[access]\nkeys = "keys"\n'


def load(folder: Path, text: str) -> Fleet:
    path = folder / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def test_a_fleet_is_secured_when_every_robot_listens_on_tls(tmp_path: Path) -> None:
    assert not load(tmp_path, TANK).secured
    fleet = load(tmp_path, SECURED + 'consoles = ["ann", "bob"]\n')
    assert fleet.secured and fleet.access.consoles == ("ann", "bob")
    assert fleet.access.observers == ("recorder", "view", "router")
    assert load(tmp_path, dump(fleet)) == fleet


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TANK.replace("tcp/", "tls/"), "key 'access.keys': .* write keys = \"keys\", and make them with aucamp keys"),
        (SECURED.replace("tls/", "tcp/", 1), "key 'robot.r1.listen': open, while r2 listens on tls/; write all"),
        (SECURED.replace("tls/", "udp/", 1), "key 'robot.r1.listen': .* write tcp/HOST:PORT, or tls/HOST:PORT"),
        (SECURED.replace("127.0.0.1", "[::1]", 1), "key 'robot.r1.listen': no address of IPv6 can be dialled by TLS"),
        (SECURED + 'consoles = ["r2"]\n', "key 'access.consoles': 'r2' is a robot already; give each"),
        (SECURED + 'consoles = ["view"]\n', "key 'access.consoles': 'view' is an observer already; give each"),
        (SECURED + 'consoles = ["ann", "ann"]\n', "key 'access.consoles': 'ann' is a console already; give each"),
        (SECURED + 'observers = ["ca"]\n', "key 'access.observers': 'ca' is the name of the authority's files"),
        (SECURED.replace("r5", "ca"), "key 'robot.ca': is the name of the authority's files .* call the robot"),
        (SECURED + 'consoles = ["Ann!"]\n', "access.consoles"),
    ],
)
def test_what_is_wrong_is_one_line_that_says_what_to_change(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        load(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_an_open_fleet_may_call_a_robot_as_it_likes(tmp_path: Path) -> None:
    assert "view" in load(tmp_path, TANK.replace("r5", "view")).robot
