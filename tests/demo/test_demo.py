"""What is said while cameras are calibrated, and when a run does not come to its end."""

import io
import socket
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

import agent.demo.demo
from agent.core.config import ConfigError, dump
from agent.demo.demo import calibrate, demo, demo_fleet, keeping, reserved, with_access
from agent.demo.display import how_to_look, program
from agent.process.command import Failed, fleet_file, shipped_fleet, shipped_names
from agent.process.launch import free_ports, is_free
from agent.robot.fleet_reader import load_fleet


class FakeCrew:
    """Its processes are done when they are waited for."""

    def __init__(self) -> None:
        self.started: list[str] = []
        self.most_at_once = self.running = 0

    def start(self, name: str, *arguments: str) -> None:
        self.started.append(name)
        self.running += 1
        self.most_at_once = max(self.most_at_once, self.running)

    def finish_one(self, timeout_s: float) -> None:
        self.running -= 1


def test_calibration_says_how_many_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Spinner:
        def __enter__(self):
            return said.append

        def __exit__(self, *_):
            pass

    said: list[str] = []
    monkeypatch.setattr(agent.demo.demo, "with_spinner", lambda console, what: Spinner())
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    crew = FakeCrew()
    calibrate(demo_fleet(5, "evidence", 0.0, 0, False, tmp_path), tmp_path / "fleet.toml", crew, Console())
    assert crew.started == [f"calibrate_r{k}" for k in (1, 2, 3, 4, 5)]
    assert (crew.most_at_once, crew.running) == (2, 0)
    assert [words.partition("(")[2] for words in said] == [f"{done} of 5 done)" for done in range(5)]


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), SystemExit(143), Failed("r1 ended by itself")])
def test_who_ends_a_run_is_told_where_its_files_are(ending: BaseException) -> None:
    out = io.StringIO()
    with pytest.raises(type(ending)) as caught, keeping(Path("runs/one"), Console(file=out)):
        raise ending
    words = str(caught.value) if isinstance(ending, Failed) else out.getvalue()
    assert words.strip().endswith("; what there is of this run is in runs/one")


def test_bad_input_is_said_as_it_is() -> None:
    with pytest.raises(ConfigError, match=r"^bad$"), keeping(Path("runs/one"), Console(file=io.StringIO())):
        raise ConfigError("bad")


def test_how_to_look_is_ready_to_paste(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = demo_fleet(2, "evidence", 0.0, 0, False, tmp_path)
    _, console, view, router = how_to_look(fleet, Path("runs/my run/fleet.toml"))
    assert f"--mode client --connect {fleet.robot['r1'].listen} subscribe -k 'aucamp/**' " in console
    assert console.endswith("--decoder aucamp --line '{key} {value}'")
    assert view.endswith("aucamp view 'runs/my run/fleet.toml'")
    assert router.endswith("aucamp router 'runs/my run/fleet.toml'")
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    words, *_ = how_to_look(fleet, Path("fleet.toml"))
    assert words.endswith("(first: pip install zenoh-cli foxglove-sdk)")


def test_how_to_look_at_a_secured_demo_names_its_keys(tmp_path: Path) -> None:
    keys = tmp_path / "its keys"
    fleet = with_access(demo_fleet(2, "evidence", 0.0, 0, False, tmp_path), (), secure=True)
    assert fleet.secured and fleet.access.consoles == ("ann",)
    _, console, view, router = how_to_look(fleet, Path("fleet.toml"), keys)
    assert f"--config '{keys}/zenoh-cli.json5' --connect tls/127.0.0.1:" in console
    assert view.strip().startswith(f"AUCAMP_KEYS='{keys}' ") and router.strip().startswith(f"AUCAMP_KEYS='{keys}' ")
    plain = with_access(demo_fleet(2, "evidence", 0.0, 0, False, tmp_path), ("bob",), secure=False)
    assert not plain.secured and plain.access.consoles == ("bob",)
    assert not any("keys" in line for line in how_to_look(plain, Path("fleet.toml"), keys))


def test_a_program_is_named_as_a_shell_here_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_ = tmp_path / ".venv" / "bin"
    bin_.mkdir(parents=True)
    (bin_ / "aucamp").write_text("#!/bin/sh\n")
    (bin_ / "aucamp").chmod(0o755)
    monkeypatch.setattr("sys.executable", str(bin_ / "python"))
    monkeypatch.setenv("PATH", "/usr/bin")
    monkeypatch.chdir(tmp_path)
    assert program("aucamp") == ".venv/bin/aucamp"
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert program("aucamp") == str(bin_ / "aucamp")
    assert program("zenoh") == str(bin_ / "zenoh"), "where pip would put it"
    (tmp_path / "elsewhere" / "zenoh").symlink_to(bin_ / "aucamp")
    monkeypatch.setenv("PATH", str(tmp_path / "elsewhere"))
    assert program("zenoh") == "zenoh", "not ours, but there"
    monkeypatch.setenv("PATH", str(bin_))
    assert program("aucamp") == "aucamp"


# --- endpoints ---
# Where a demo's robots listen: the endpoints of the fleet file, unless somebody is there or is about to be.


@pytest.fixture
def wished() -> list[str]:
    return [f"tcp/127.0.0.1:{port}" for port in free_ports(2)]


def test_the_files_own_where_nobody_is(wished: list[str]) -> None:
    with reserved(wished) as endpoints:
        assert endpoints == wished


def test_another_demo_that_has_not_bound_them_yet_has_them_all_the_same(wished: list[str]) -> None:
    with reserved(wished), reserved(wished[1:]) as others, reserved(wished[1:]) as third:
        assert not {*others, *third} & set(wished) and others != third
        assert all(map(is_free, [*others, *third]))
    with reserved(wished[1:]) as endpoints:
        assert endpoints == wished[1:], "it has ended"


def test_one_of_them_is_taken(wished: list[str]) -> None:
    with socket.create_server(("127.0.0.1", int(wished[1].rpartition(":")[2]))), reserved(wished) as endpoints:
        assert wished[1] not in endpoints and len(set(endpoints)) == 2 and all(map(is_free, endpoints))


def test_a_port_where_old_connections_linger_is_free(wished: list[str]) -> None:
    address = ("127.0.0.1", int(wished[0].rpartition(":")[2]))
    with socket.create_server(address) as server, socket.create_connection(address) as client:
        server.accept()[0].close()  # who closes first keeps the connection in TIME_WAIT
        assert client.recv(1) == b""
    with socket.socket() as strict, pytest.raises(OSError):
        strict.bind(address)
    assert is_free(wished[0])


def test_an_address_of_another_computer_is_not_free() -> None:
    assert not is_free("tcp/192.0.2.1:17401")


def test_without_names_nobody_can_be_sure_of_the_files_own(wished: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agent.demo.demo, "NAMES", False)
    with reserved(wished) as endpoints:
        assert len(set(endpoints)) == 2 and all(map(is_free, endpoints))


# --- fleet ---
# Which robots dive in a demo, and what is refused before anything is made.

TANK = shipped_fleet().read_text()
NO_TWIN = TANK.replace('camera = "twin:r2"', 'camera = "v4l2:/dev/video0"').replace('"twin:r2"', '"/dev/ttyACM0"')
FISH = fleet_file("fish").read_text()
EEL = FISH.replace("target.fish", "target.eel").replace('"fish", s', '"eel", s')
BOX = 'detector = "box"\npicture = "rock.png"\nbox = [0, 0, 9, 9]'
ROCK = TANK.replace("[target.ball]", "[target.rock]").replace('detector = "ball"\nradius_m = 0.07', BOX)
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
        (NO_TWIN, None, r"'robot.r2.serial': '/dev/ttyACM0' is not in the twin, .*; write \"twin:r2\" in"),
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
        (TANK + '\n[twin]\ncamera = "two"\n', None, r"'twin.camera': 'two' is no choice; write one of binned_640, "),
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
        demo(robots, "evidence", 0.0, 0, 1.0, None, Console(file=io.StringIO()), str(file))
    assert "\n" not in str(caught.value)
    assert not list(Path().iterdir())


@pytest.mark.parametrize("name", ["none", "there/tank", ""])
def test_a_fleet_that_does_not_ship_is_told_which_do(name: str) -> None:
    with pytest.raises(ConfigError, match=f"--fleet {name}: no such fleet; give one of .*tank, two_balls"):
        fleet_file(name)
