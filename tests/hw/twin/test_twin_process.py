"""The twin as users start it: a process that serves, answers signals, and leaves nothing behind."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, Landmarks
from agent.core.step_io import SetPoint
from agent.robot.fleet_reader import load_fleet
from hw.camera import open_camera
from hw.camera.camera import Roi
from hw.twin.board import Board
from hw.twin.calibration_bench import BenchClient
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.scene import SCENES
from hw.twin.twin_folder import clock_path, locked, twin_dir
from tests.places import ROOT
from tests.waiting import until

FLEET = """
fleet = "pair"
[target.ball]
radius_m = 0.07
[robot.r1]
neighbours = ["r2"]
listen = "tcp/127.0.0.1:17401"
serial = "twin:r1"
camera = "twin:r1"
pose = { x_m = 0.30, y_m = 0.25, yaw_deg = 34.0 }
calibration = "r1.toml"
[robot.r2]
neighbours = ["r1"]
listen = "tcp/127.0.0.1:17402"
serial = "twin:r2"
camera = "twin:r2"
pose = { x_m = 1.25, y_m = 0.30, yaw_deg = 152.0 }
calibration = "r2.toml"
[twin]
seed = 3
dir = "PLACE"
"""

SWIMS = """
moored = false
motion_blur = true
current = { gust_m_s = 0.005 }
tether_pull = { force_n = 0.05 }
[[event]]
at_s = 0.1
kind = "tag_lost"
id = 12

"""
NO_TAGS = Landmarks(size_m=0.08, tag=())
START_S = 90.0  # on a fresh machine every kernel is compiled first


@pytest.fixture
def fleet_file(tmp_path):
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.replace("PLACE", str(tmp_path / "twin")))
    return path


@pytest.fixture
def start(fleet_file):
    """Start twins, wait until they are ready, and end them."""
    started = []

    def make(*arguments):
        command = [sys.executable, "-m", "hw.twin", str(fleet_file), *arguments]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT)
        started.append(process)
        ready = fleet_file.parent / "twin" / "ready"
        until(lambda: ready.exists() or process.poll() is not None, START_S)
        return process

    yield make
    for process in started:
        process.kill()
        process.wait()
        process.stderr.close()


def children(pid):
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def exists(pid):
    return Path(f"/proc/{pid}").exists()


def test_a_dive_serves_everybody_and_ends_on_a_signal_with_nothing_left(start, fleet_file):
    serves_and_ends(start(), fleet_file, signal.SIGTERM, set())


def test_a_swim_leaves_what_really_happened(start, fleet_file):
    scene = fleet_file.with_name("sea.toml")
    scene.write_text((SCENES / "tank.toml").read_text().replace("[water]", SWIMS + "[water]", 1))
    tags = 'tag = [{ id = 12, face = "y1", position_m = [0.7, 1.2, 0.2] }]'
    with_tags = f"[landmarks]\nsize_m = 0.08\n{tags}\n[twin]\nscene = '{scene}'\n"
    fleet_file.write_text(fleet_file.read_text().replace("[twin]\n", with_tags))
    serves_and_ends(start(), fleet_file, signal.SIGINT, {"paths.csv", "separation.json"})
    place = twin_dir(load_fleet(fleet_file))
    kept = json.loads((place / "separation.json").read_text())
    assert kept["least_m"] == pytest.approx(0.95, abs=0.05) and kept["between"] == ["r1", "r2"]
    rows = (place / "paths.csv").read_text().splitlines()
    assert rows[1].split(",")[1] == "r1" and len(rows) % 2 == 1
    with locked(place):
        assert not (place / "paths.csv").exists()


def serves_and_ends(process, fleet_file, number, stays):
    place = twin_dir(load_fleet(fleet_file))
    names = {path.name for path in place.iterdir()}
    assert {"r1.serial", "r1.camera", "r2.serial", "r2.camera", "truth.json", "ready"} <= names
    truth = json.loads((place / "truth.json").read_text())
    assert truth["target_m"] == {"ball": [0.76, 0.56, 0.07]}
    fleet = load_fleet(fleet_file)
    tags = {str(tag.id): pytest.approx(tag.position_m, abs=3e-3) for tag in (fleet.landmarks or NO_TAGS).tag}
    assert {number: tag["position_m"] for number, tag in truth.get("tag", {}).items()} == tags
    assert truth["robot"]["r1"]["position_m"] == pytest.approx([0.30, 0.25, 0.10], abs=5e-3)
    boards = children(process.pid)
    assert len(boards) == 2
    eye = open_camera("twin:r1", place, (640, 480))
    first, second = eye.read(), eye.read(Roi(96, 96, 64, 64))
    eye.close()
    assert first.image.shape == (480, 640, 3)
    assert second.image.shape == (64, 64, 3)
    assert second.seq > first.seq
    assert abs(time.time_ns() - second.t_ns) < 10e9
    process.send_signal(number)
    assert process.wait(START_S) == 0
    said = process.stderr.read()
    assert said.startswith("twin: ") and "times real time" in said and said.count("\n") == 1
    assert {path.name for path in place.iterdir()} == {"lock", "clock", *stays}
    assert not any(exists(pid) for pid in boards)


def test_two_twins_do_not_share_a_place(start, fleet_file):
    start("--bench", "r1")
    second = start()
    assert second.wait(START_S) == 2
    error = second.stderr.read()
    assert error.startswith("aucamp: ")
    assert "another twin" in error
    assert error.count("\n") == 1


def test_stale_files_of_a_killed_twin_are_no_obstacle(start, fleet_file):
    first = start("--bench", "r1")
    first.kill()
    first.wait()
    place = twin_dir(load_fleet(fleet_file))
    assert (place / "r1.bench").exists()
    (place / "ready").unlink()
    second = start("--bench", "r2")
    assert second.poll() is None
    assert not (place / "r1.bench").exists()


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ('"twin:r', '"none:r', "no robot lives in the twin"),
        ("seed = 3", 'scene = "sea"', "no such scene"),
        ("seed = 3", "sed = 3", "unknown key `sed`"),
    ],
)
def test_what_a_user_can_put_right_is_one_line(fleet_file, before, after, says):
    fleet_file.write_text(fleet_file.read_text().replace(before, after))
    command = [sys.executable, "-m", "hw.twin", str(fleet_file)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False)
    assert done.returncode == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_path_that_no_socket_can_have_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"set twin\.dir"), locked(tmp_path / ("x" * 100)):
        pass


def test_the_bench_puts_the_board_where_it_is_told_in_no_time(start, fleet_file):
    start("--bench", "r1")
    place = twin_dir(load_fleet(fleet_file))
    eye = open_camera("twin:r1", place, (640, 480))
    with BenchClient(place / "r1.bench") as bench:
        bench.place(None, (1500, 1500))
        nothing = eye.read()
        bench.place((0.8, 0.0, 0.0), (1500, 1500))
        board = eye.read()
        with pytest.raises(ValueError, match="in front"):
            bench.place((-0.8, 0.0, 0.0), (1500, 1500))
        bench.place((0.8, 0.0, 0.0), (1600, 1500))  # 9 degrees to the left
        turned = eye.read()
    eye.close()
    assert nothing.t_ns < board.t_ns < turned.t_ns
    assert board.t_ns - nothing.t_ns > 1e9  # virtual: the servos have settled

    def middle_px(frame):
        changed = np.abs(frame.image.astype(int) - nothing.image).max(axis=2) > 60
        return np.mean(np.nonzero(changed[:, 30:-30])[1])

    # Looking left, the board moves right by f tan(9 deg), about 180 px; what leaves the frame takes some away.
    assert middle_px(turned) > middle_px(board) + 60


def test_the_firmware_lets_a_robot_hover(tmp_path, fleet_file):
    host_protocol = pytest.importorskip("hw.stm32.protocol")
    fleet = load_fleet(fleet_file)
    dive = Dive(fleet, ["r1"], 0)
    board = Board("r1", tmp_path, dive.tare_pa[0])
    dive.boards = [board]
    protocol = host_protocol.HostProtocol(1)
    protocol.connected()
    protocol.arm()
    errors_m = []
    try:
        board.start()
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for k in range(1000):
            now_ns = dive.now_ns
            with contextlib.suppress(BlockingIOError):  # nothing said yet
                protocol.receive(os.read(port, 4096), now_ns)
            out = protocol.due(now_ns) + (protocol.set_point(SetPoint(depth_m=0.35), now_ns) if k % 5 == 0 else b"")
            if out:
                os.write(port, out)
            run_in_lock_step(dive, 1)
            errors_m.append(float(dive.states["position_m"][0, 2]) - 0.15)
        os.close(port)
    finally:
        board.close()
    assert errors_m[0] == pytest.approx(-0.05)  # the crew lets go 5 cm too deep
    assert np.sqrt(np.mean(np.square(errors_m[-200:]))) < 2e-3
    assert abs(dive.states["quaternion"][0, 1:3]).max() < 0.005  # half of 0.6 degrees


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder whose sockets have names that are short enough."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.parametrize("of_whom", ["others can write", "another user", "a link"])
def test_a_temporary_folder_that_others_made_is_refused(short_path, monkeypatch, fleet_file, of_whom) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(short_path))
    fleet = load_fleet(fleet_file)
    fleet = replace(fleet, twin=replace(fleet.twin, dir=None))
    with locked(twin_dir(fleet)) as folder:  # nobody was there before
        assert folder.stat().st_mode & 0o777 == folder.parent.stat().st_mode & 0o777 == 0o700
    if of_whom == "others can write":
        folder.parent.chmod(0o777)
    elif of_whom == "another user":
        me = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: me + 1)
        folder.parent.rename(short_path / f"aucamp-{me + 1}")
    else:
        folder.parent.rename(short_path / "elsewhere")
        folder.parent.symlink_to(short_path / "elsewhere")
    with pytest.raises(ConfigError, match=r"set twin\.dir to a folder of yours"):
        twin_dir(fleet)
    with pytest.raises(ConfigError, match=r"set twin\.dir to a folder of yours"):  # agents follow no strange clock
        clock_path(fleet)
