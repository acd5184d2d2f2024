"""Every mistake in a fleet file is one line that names the file, the key and the remedy."""

import os
import time
import tracemalloc
from pathlib import Path
from typing import Literal

import pytest
from msgspec.structs import replace

import agent
from agent.core import config
from agent.core.codec import too_deep
from agent.core.config import (
    Budget,
    ConfigError,
    Fleet,
    Pose,
    Struct,
    Tank,
    Target,
    Twin,
    convert,
    dump,
    inside,
    read_toml,
    to_install,
    write_whole,
)
from agent.core.trust import common
from agent.robot.fleet_reader import load_fleet, with_behaviour
from tests.full_disk import room
from tests.places import ROOT

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


def test_tables_of_other_capabilities_survive_a_round_trip_as_they_are(tmp_path) -> None:
    fleet = load(tmp_path, TANK + "\n[extend.hum]\ntone_hz = 50\nin = { r1 = [1, 2.5], at = true }\n")
    assert fleet.extend == {"hum": {"tone_hz": 50, "in": {"r1": [1, 2.5], "at": True}}}
    assert load(tmp_path, dump(fleet)) == fleet
    assert "extend" not in dump(load(tmp_path, TANK))


@pytest.mark.parametrize(
    ("written", "send_hz", "validity_s"),
    [
        ('network = "satellite"', 5.0, 2.0),
        ('network = "satellite"\nsend_hz = 4.0', 4.0, 2.0),
        ('network = "wifi"', 10.0, 0.5),
    ],
)
def test_a_network_stands_for_numbers_and_the_files_own_win(
    tmp_path: Path, written: str, send_hz: float, validity_s: float
) -> None:
    fleet = load(tmp_path, TANK + f"\n[link]\n{written}\n")
    assert (fleet.link.send_hz, fleet.estimation.validity_s) == (send_hz, validity_s)
    with pytest.raises(ConfigError, match=r"link\.network': 'acoustic' is no choice; write one of tether, wifi, sat"):
        load(tmp_path, TANK + '\n[link]\nnetwork = "acoustic"\n')


def test_files_of_a_target_lie_beside_the_fleet_file(tmp_path) -> None:
    fleet = load(tmp_path, TANK.replace(BALL, 'detector = "box"\npicture = "a/x.png"\nbox = [1, 2, 30, 40]'))
    target = fleet.target["ball"]
    assert target.picture == str(tmp_path / "a" / "x.png") and target.models is None and target.radius_m is None
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert load(elsewhere, dump(fleet)) == fleet


MISTAKES = {
    "unknown key": (("radius_m = 0.07", "radius_m = 0.07\nshape = 'round'"), "'target.ball'", "shape", "remove"),
    "wrong type": (("radius_m = 0.07", "radius_m = 'big'"), "'target.ball.radius_m'", "float", "correct"),
    "missing key": (("radius_m = 0.07", ""), "'target.ball'", "radius_m", "add"),
    "out of range": (("radius_m = 0.07", "radius_m = -1.0"), "'target.ball.radius_m'", "> 0", "correct"),
    "no choice": (
        ("radius_m = 0.07", "radius_m = 0.07\ncolour = 'blue'"),
        "'blue'",
        "one of green, orange, red, yellow",
    ),
    "not a number": (("x_m = 0.30", "x_m = nan"), "'robot.r1.pose.x_m'", "finite", "correct"),
    "infinite": (("size_m = [1.5,", "size_m = [inf,"), "'tank.size_m[0]'", "finite", "correct"),
    "beyond all tanks": (("size_m = [1.5,", "size_m = [1e300,"), "'tank.size_m[0]'", "beyond 1e+04", "correct"),
    "beyond all seeds": (("[estimation]", "[twin]\nseed = 9223372036854775808\n[estimation]"), "'twin.seed'", "beyond"),
    "outside the tank": (("x_m = 1.25", "x_m = 125.0"), "'robot.r2.pose.x_m'", "outside the tank", "0 to 1.5"),
    "water over the rim": (("surface_m = 0.5", "surface_m = 5.0"), "'tank.surface_m'", "rim", "0.8"),
    "millimetres": (("radius_m = 0.07", "radius_m = 70.0"), "'target.ball.radius_m'", "does not fit"),
    "beyond the gimbal": (("pan_deg = -60.0", "pan_deg = -160.0"), "'robot.r2.look.pan_deg'", "-90 to 90"),
    "limits swapped": (("[estimation]", "[body]\ntilt_limit_deg = [30, -60]\n[estimation]"), "body.tilt", "first"),
    "messages too seldom": (("[estimation]", "[link]\nsend_hz = 1\n[estimation]"), "validity_s", "1.00 s", "longer"),
    "faster than steps": (("[estimation]", "[link]\nsend_hz = 50\n[estimation]"), "'link.send_hz'", "<= 20"),
    "previews like a film": (("[estimation]", "[link]\npreview_hz = 25\n[estimation]"), "'link.preview_hz'", "<= 5"),
    "keys nowhere": (
        ("[estimation]", "[access]\nkeys = ''\n[estimation]"),
        "'access.keys'",
        "write its name, or remove",
    ),
    "another's twin": (('camera = "twin:r2"', 'camera = "twin:r1"'), "'robot.r2.camera'", "write twin:r2"),
    "one board for two": (
        ('serial = "twin:r1"', 'serial = "/dev/ttyACM0"', 'serial = "twin:r2"', 'serial = "/dev/ttyACM0"'),
        "'robot.r2.serial'",
        "also that of 'r1'",
        "own control module",
    ),
    "bad name of a robot": (("[robot.r5]", "[robot.R5]"), "'robot.R5'", "small letters", "correct"),
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
    "same port by name": (("127.0.0.1:17402", "localhost:17401"), "r2.listen", "also that of 'r1'", "own port"),
    "same port by IPv6": (("127.0.0.1:17402", "[0::1]:17401"), "r2.listen", "also that of 'r1'", "own port"),
    "no decimal port": (("127.0.0.1:17402", "127.0.0.1:1740²"), "r2.listen", "tcp/HOST:PORT"),
    "high port": (("127.0.0.1:17402", "127.0.0.1:40000"), "r2.listen", "40000", "32767"),
    "every address": (("127.0.0.1:17402", "0.0.0.0:17402"), "r2.listen", "neighbours dial it", "own"),
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
    "a ball with models": (
        ("radius_m = 0.07", 'radius_m = 0.07\nmodels = "nano"'),
        "ball.models",
        "only a box",
        "remove",
    ),
    "a sample without its box": (
        (BALL, 'detector = "ball"\nradius_m = 0.07\npicture = "x.png"'),
        "target.ball",
        "add the other one",
    ),
    "a sample beside a name": (
        (BALL, 'detector = "ball"\nradius_m = 0.07\npicture = "x.png"\nbox = [1, 2, 30, 40]\ncolour = "red"'),
        "target.ball.colour",
        "remove `colour`",
    ),
    "a box of one colour": (
        (BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 30, 40]\ncolour = "red"'),
        "target.ball.colour",
        "only a ball has one",
    ),
    "a fish that never turns": (
        ("radius_m = 0.07", "radius_m = 0.07\nspeed_m_s = 0.2"),
        "target.ball",
        "`turn_s`",
        "add",
    ),
    "a fish that flies": (("radius_m = 0.07", "radius_m = 0.07\nspeed_m_s = 20.0\nturn_s = 2.0"), "speed_m_s", "<= 1"),
    "no box": ((BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 0, 40]'), "target.ball.box", "[x, y, width"),
    "three numbers": ((BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 3]'), "box", "length 4"),
    "size of a box": (
        (BALL, 'detector = "box"\npicture = "x.png"\nbox = [1, 2, 3, 4]\n[ranging]\ncues = "size"\n'),
        "ranging.cues",
        "'ball' is not known",
        "'focus'",
    ),
    "no target": (('[target.ball]\ndetector = "ball"\nradius_m = 0.07', "[target]"), "key 'target'", "add a table"),
    "bad name": (('fleet = "tank"', 'fleet = "Tank 3"'), "'fleet'", "small letters", "correct"),
    "not TOML": (('fleet = "tank"', "fleet = tank"), "fleet.toml", "not valid TOML", "line 4"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake(tmp_path, mistake: str) -> None:
    changes, *expected = MISTAKES[mistake]
    text = TANK
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(tmp_path / "fleet.toml"))
    for part in expected:
        assert part in message, message


def test_robots_of_two_computers_may_name_the_same_port(tmp_path) -> None:
    text = TANK.replace("tcp/127.0.0.1:17402", "tcp/192.168.7.12:17402")
    for name in ("r1", "r2"):
        text = text.replace(f'"twin:{name}"', '"/dev/ttyACM0"', 1)
    fleet = load(tmp_path, text)
    assert fleet.robot["r1"].serial == fleet.robot["r2"].serial


def test_what_is_no_toml_file(tmp_path) -> None:
    picture = tmp_path / "picture.toml"
    picture.write_bytes(bytes(range(256)))
    for path in (tmp_path / "none.toml", tmp_path, picture):
        with pytest.raises(ConfigError, match=str(path)):
            load_fleet(path)


# --- fleet digest ---
# Fleet files that go together have one digest, and files that do not have another.

SHIPPED = ("tank", "two_balls")


@pytest.fixture
def fleet() -> Fleet:
    return load_fleet(ROOT / "agent" / "fleets" / "tank.toml")


def test_sixteen_digits_the_same_from_every_start_of_python() -> None:
    digests = [common(load_fleet(ROOT / "agent" / "fleets" / f"{name}.toml")) for name in SHIPPED]
    assert digests == ["90c09ac11a9f1aa0", "3e1f9844c7b76196"]


@pytest.mark.parametrize(
    "part",
    [
        {"fleet": "lake"},
        {"tank": Tank(size_m=(1.5, 1.2, 0.9))},
        {"tank": Tank(surface_m=0.6)},
        {"budget": Budget(level_m=0.003)},
        {"target": {"ball": Target(radius_m=0.08)}},
        {"target": {"ball": Target(radius_m=0.07, colour="green")}},
        {"target": {"buoy": Target(radius_m=0.07)}},
        {"target": {"ball": Target(radius_m=0.07), "buoy": Target(radius_m=0.07)}},
        {"target": {"ball": Target(radius_m=0.07, speed_m_s=0.2, turn_s=2.0)}},
        {"extend": {"hum": {"tone_hz": 50}}},
        {"target": {"ball": Target(detector="box", picture="ball.png", box=(1.0, 2.0, 30.0, 40.0))}},
    ],
)
def test_what_is_shared_counts(fleet: Fleet, part: dict) -> None:
    assert common(replace(fleet, **part)) != common(fleet)


@pytest.mark.parametrize(
    ("table", "part"),
    [
        ("estimation", {"protocol": "paper"}),
        ("estimation", {"iteration_s": 0.5}),
        ("estimation", {"validity_s": 0.6}),
        ("estimation", {"liars": 2}),
        ("estimation", {"clip": True}),
        ("water", {"refractive_index": 1.34}),
    ],
)
def test_so_does_each_setting_of_the_protocol_and_of_the_light(fleet: Fleet, table: str, part: dict) -> None:
    assert common(replace(fleet, **{table: replace(getattr(fleet, table), **part)})) != common(fleet)


def test_who_takes_part_counts_and_who_hears_whom(fleet: Fleet) -> None:
    robots = dict(fleet.robot)
    fewer = {name: robot for name, robot in robots.items() if name != "r5"}
    deaf = {**robots, "r1": replace(robots["r1"], neighbours=("r2", "r3", "r4"))}
    assert len({common(fleet), common(replace(fleet, robot=fewer)), common(replace(fleet, robot=deaf))}) == 3


@pytest.mark.parametrize(
    "part",
    [
        {"depth_m": 0.2},
        {"pose": Pose(x_m=0.1, y_m=0.2, yaw_deg=3.0)},
        {"serial": "/dev/ttyACM0", "camera": "/dev/video0"},
        {"listen": "tcp/10.0.0.7:17401"},
        {"calibration": "elsewhere.toml"},
        {"neighbours": ("r5", "r4", "r3", "r2")},
    ],
)
def test_what_is_a_robots_own_does_not(fleet: Fleet, part: dict) -> None:
    robot = {**fleet.robot, "r1": replace(fleet.robot["r1"], **part)}
    assert common(replace(fleet, robot=robot)) == common(fleet)


def test_nor_do_orders_of_tables_ways_to_write_a_number_and_places_of_files(fleet: Fleet, tmp_path: Path) -> None:
    turned = replace(fleet, robot=dict(reversed(fleet.robot.items())), twin=Twin(seed=9, dir=str(tmp_path)))
    assert common(turned) == common(fleet)
    assert common(replace(fleet, tank=Tank(size_m=(1, 2, 3)))) == common(
        replace(fleet, tank=Tank(size_m=(1.0, 2.0, 3.0)))
    )
    red, unsaid = Target(radius_m=0.07, colour="red"), Target(radius_m=0.07)
    assert common(replace(fleet, target={"ball": red})) == common(replace(fleet, target={"ball": unsaid}))
    boxes = [
        Target(detector="box", picture=str(tmp_path / name), box=(k, k, 30.0, 40.0), models=str(tmp_path / name))
        for k, name in ((1.0, "a"), (2.0, "b"))
    ]
    assert len({common(replace(fleet, target={"thing": box})) for box in boxes}) == 1


# --- access rules ---
# `[access]`: who looks and who orders, all links of one kind, and names that are one party's each.

SECURED = TANK.replace("tcp/", "tls/") + '\n[access]\nkeys = "keys"\n'


def access_rules_load(folder: Path, text: str) -> Fleet:
    path = folder / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def test_a_fleet_is_secured_when_every_robot_listens_on_tls(tmp_path: Path) -> None:
    assert not access_rules_load(tmp_path, TANK).secured
    fleet = access_rules_load(tmp_path, SECURED + 'consoles = ["ann", "bob"]\n')
    assert fleet.secured and fleet.access.consoles == ("ann", "bob")
    assert fleet.access.observers == ("recorder", "view", "router")
    assert access_rules_load(tmp_path, dump(fleet)) == fleet


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
        (TANK + '\n[access]\nobservers = ["r1"]\n', "key 'access.observers': 'r1' is a robot already; give each"),
    ],
)
def test_what_is_wrong_is_one_line_that_says_what_to_change(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        access_rules_load(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_an_open_fleet_may_call_a_robot_as_it_likes(tmp_path: Path) -> None:
    assert "view" in access_rules_load(tmp_path, TANK.replace("r5", "view")).robot


DEEP = {
    "lists": "x = " + "[" * 5000,
    "tables": "x = " + "{ a = " * 5000,
    "a dotted key": ".".join("a" * 20_000) + " = 1",
    "quoted parts": " . ".join(["'a'", '"b"'] * 5000) + " = 1",
    "a dotted table": f"[{'.'.join('a' * 20_000)}]",
    "behind a string": 'x = """[ " \\""" ]"""\ny = ' + "[" * 5000,
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP)
def test_what_is_nested_too_deeply_is_refused_before_it_is_parsed(tmp_path, text: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=r"fleet\.toml: nested more than 32 deep"):
            load(tmp_path, text)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "text", [f"# {'[' * 99}", f"x = '{'[' * 99}'", 'x = "\\"[[[ ' + "{" * 99 + '"', "x = [1.5, 2.5]\n" * 99]
)
def test_brackets_in_strings_and_comments_do_not_count(text: str) -> None:
    assert not too_deep(text)


def test_a_text_without_an_end_is_scanned_once() -> None:
    began_s = time.monotonic()
    for text in ('"""\\' * 200_000, "'" * 10**6, "a" * 10**6, "a." * 30 + " " * 10**6, '"' * 10**6):
        too_deep(text)
    assert time.monotonic() - began_s < 30.0


def test_a_number_of_thousands_of_digits_is_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"fleet\.toml: has a number of thousands of digits"):
        load(tmp_path, f"x = {'1' * 5000}")


def test_numbers_of_a_behaviour_on_the_command_line_are_checked(tmp_path) -> None:
    fleet = load(tmp_path, TANK)
    with pytest.raises(ConfigError, match=r"--behaviour: key 'behaviour\.yaw_deg': not a finite number"):
        with_behaviour(fleet, "r1", '{ kind = "turn", yaw_deg = nan }')


def test_only_a_small_regular_file_is_read(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"#" * (2**20 + 1))
    for path, why in (
        (Path("/dev/zero"), "no regular file"),
        (tmp_path / "pipe", "no regular file"),
        (tmp_path, "no regular file"),
        (tmp_path / "large", "larger than 1 MiB"),
        (tmp_path / "none", "no such file"),
        (tmp_path / "a\0b", "no name of a file"),
    ):
        with pytest.raises(ConfigError, match=why):
            read_toml(path)


@pytest.mark.parametrize("name", ["/etc/passwd", "../r1.toml", "a/../../r1.toml"])
def test_a_file_that_leads_out_of_its_folder_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="outside of it"):
        inside(Path("runs"), name)
    assert inside(Path("runs"), "a/r1.toml") == Path("runs/a/r1.toml")
    for none in ("x" * 300, "a\x1b[2J"):
        with pytest.raises(ConfigError, match=r"runs: '.*'\.\.\. is no name of a file; correct it"):
            inside(Path("runs"), none)


class Inner(Struct, frozen=True, kw_only=True):
    kind: Literal["a", "b"]


class Outer(Struct, frozen=True, kw_only=True):
    rows: tuple[Inner, ...] = ()
    pair: tuple[int, Inner | None] | None = None


@pytest.mark.parametrize(
    ("data", "key"),
    [({"rows": [{"kind": "a"}, {"kind": "c"}]}, "rows[1].kind"), ({"pair": [1, {"kind": "c"}]}, "pair[1].kind")],
)
def test_choices_are_named_in_lists_and_tuples_as_well(data: dict, key: str) -> None:
    with pytest.raises(ConfigError) as told:
        convert(data, Outer, "f.toml")
    assert str(told.value) == f"f.toml: key '{key}': 'c' is no choice; write one of a, b"


def test_a_file_that_finds_no_room_stays_as_it_was_and_is_named(tmp_path) -> None:
    path = tmp_path / "r1.toml"
    write_whole(path, "before")
    with room(1000), pytest.raises(OSError, match="File too large") as error:
        write_whole(path, "x" * 2000)
    assert error.value.filename == str(path)
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


def test_an_extra_is_installed_as_the_package_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert to_install("page") == "in your clone: pip install -e '.[page]'"
    monkeypatch.setattr(config, "__file__", str(tmp_path / "agent" / "core" / "config.py"))
    assert to_install("page") == "pip install 'aucamp[page]'"
