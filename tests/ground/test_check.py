"""`aucamp check`: each thing that would keep a robot from starting is one line, and nothing is started."""

import json
import os
import pty
import re
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import CAREFUL, dump
from agent.core.ranging.camera_model import Calibration
from agent.ground import check as devices
from agent.ground import check_files
from agent.ground.check import Checked, check
from agent.ground.new_fleet import make_keys, write_fleet
from agent.process import launch
from agent.process.command import shipped_fleet, with_pictures
from agent.process.launch import free_ports
from agent.robot.fleet_reader import load_fleet
from hw.camera.camera import CameraError
from hw.twin.scene import SCENES
from tests.hw.camera.fake_picamera2 import FakePi
from tests.known_lens import TWIN, TWIN_CAMERA


def lines(checked: Checked, level: str) -> list[str]:
    return [f"{finding.about}: {finding.text}" for finding in checked.findings if finding.level == level]


@pytest.fixture
def real(tmp_path: Path) -> Path:
    """A robot with devices of this computer: a pty that stands for its serial port, photographs for its camera."""
    path = tmp_path / "real.toml"
    write_fleet(path, 2, twin=False)
    known = Calibration(robot="r1", made="2026-01-01", source="a test", focus=TWIN, camera=TWIN_CAMERA)
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "r1.toml").write_text(dump(known))
    text = path.read_text().replace("MEASURE", "").replace("SURVEY", "").replace("192.168.7.11", "127.0.0.1")
    path.write_text(text)
    return path


@pytest.fixture
def port() -> Iterator[str]:
    """A serial port that is there and may be opened."""
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def changed(path: Path, **changes: str) -> Path:
    """The file with the value of a key in the first table that has it put in the place of another."""
    text = path.read_text()
    for key, value in changes.items():
        before = next(line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(before, f"{key} = {value}", 1)
    path.write_text(text)
    return path


def test_a_new_fleet_of_the_twin_is_ready_for_a_demo(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, 3, twin=True)
    done = CliRunner().invoke(app, ["check", str(path)])
    assert done.exit_code == 0, done.output
    told = done.output.splitlines()
    assert told[0].startswith("ok       file: ") and told[-1].startswith("ready to start; ")
    assert sum("aucamp calibrate run" in line and "(a demo makes its own)" in line for line in told) == 3
    as_json = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).output)
    assert as_json["well"] and as_json["robots"] == 3
    assert {finding["level"] for finding in as_json["findings"]} == {"ok", "warning"}
    assert not (tmp_path / "calibration").exists()


def test_a_robot_whose_devices_are_there_is_ready(real: Path, port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(devices, "camera", lambda fleet, name: seen.append(name) or "a camera")
    checked = check(changed(real, serial=f'"{port}"'), "r1", real.parent)
    assert not lines(checked, "wrong"), checked
    assert seen == ["r1"] and any(f"{port} is there" in line for line in lines(checked, "ok"))
    everywhere = check(real, None, real.parent)
    assert everywhere.robots == 1 and seen == ["r1", "r1"]
    assert any(f"aucamp check {real} --robot r2" in line for line in lines(everywhere, "ok"))


def test_a_focus_curve_that_misses_its_own_measurements_is_said(real: Path, port: str) -> None:
    bad = replace(TWIN, r2=-0.3, rmse_m=0.309)
    known = Calibration(robot="r1", made="2026-01-01", source="a test", focus=bad, camera=TWIN_CAMERA)
    checked = changed(real, serial=f'"{port}"')
    assert not any("calibrate again" in line for line in lines(check(checked, "r1", real.parent), "warning"))
    (real.parent / "calibration" / "r1.toml").write_text(dump(known))
    assert any("by 309 mm rms; calibrate again" in line for line in lines(check(checked, "r1", real.parent), "warning"))


@pytest.mark.parametrize(
    ("focus", "camera", "says"),
    [
        (
            {"b_m": -TWIN.b_m},
            {},
            "by its focus curve (u_inf_m, b_m, rho0) lens positions 208 and 717 are not both sharp",
        ),
        ({"rho0": 400.0}, {}, "by its focus curve"),
        ({"b_m": 40.0 * TWIN.b_m}, {}, "by its focus curve"),
        ({}, {"f_px": 11.84}, "[camera] f_px is 11.84; 192 to 3840 are usual"),
        ({}, {"pan_gain": 0.01745}, "[camera] pan_gain is 0.01745; 0.5 to 2 are usual"),
        ({}, {"tilt_zero_deg": 32.0}, "[camera] tilt_zero_deg is 32; -15 to 15 are usual"),
        ({}, {"cx_px": 5.0}, "[camera] cx_px is 5; 213.333 to 426.667 are usual"),
        ({}, {"gamma": 22.0}, "[camera] gamma is 22; 1 to 3 are usual"),
    ],
)
def test_a_calibration_that_cannot_be_is_said(real: Path, focus: dict, camera: dict, says: str) -> None:
    known = Calibration(
        robot="r1",
        made="2026-01-01",
        source="a test",
        focus=replace(TWIN, **focus),
        camera=replace(TWIN_CAMERA, **camera),
    )
    (real.parent / "calibration" / "r1.toml").write_text(dump(known))
    (line,) = (line for line in lines(check(real, "r1", real.parent), "warning") if "calibrate again" in line)
    assert line.startswith(f"r1: calibration/r1.toml: {says}")


def test_a_lens_that_was_copied_to_another_robot_is_said(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, 2, twin=True)
    (tmp_path / "calibration").mkdir()
    for name, curve in (("r1", TWIN), ("r2", replace(TWIN, b_m=TWIN.b_m + 1.0))):
        known = Calibration(robot=name, made="2026-01-01", source="a test", focus=curve, camera=TWIN_CAMERA)
        (tmp_path / "calibration" / f"{name}.toml").write_text(dump(known))
    assert not lines(check(path, None, tmp_path), "warning")
    same = replace(known, focus=TWIN)
    (tmp_path / "calibration" / "r2.toml").write_text(dump(same))
    (line,) = lines(check(path, None, tmp_path), "warning")
    assert line == "r2: calibration/r2.toml: its [focus] is that of r1; each lens needs its own: calibrate r2"


def test_tags_in_millimetres_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    text = shipped_fleet("swim").read_text()
    path.write_text(text.replace("size_m = 0.08", "size_m = 80.0"))
    found = check(path, None, tmp_path).findings
    assert [str(one) for one in found] == [
        f"wrong    file: {path}: key 'landmarks.size_m': 80; 0.01 to 1 are usual: write metres"
    ]


def test_all_that_is_wrong_is_said_at_once(real: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["check", str(changed(real, serial='"/dev/ttyNONE"')), "--robot", "r1"])
    assert done.exit_code == 1
    assert "wrong    r1: /dev/ttyNONE: no such serial port" in done.output
    assert "wrong    r1: /dev/video0: cannot be opened" in done.output or Path("/dev/video0").exists()
    assert done.output.splitlines()[-1].startswith("not ready: ")
    (tmp_path / "calibration" / "r1.toml").unlink()
    assert any("aucamp calibrate run" in line for line in lines(check(real, "r1", tmp_path), "wrong"))
    elsewhere = lines(check(real, "r2", tmp_path), "wrong")
    assert "tcp/192.168.7.12:17401 is no address of this computer" in elsewhere[0]


def test_every_rule_that_a_file_breaks_is_said_and_a_file_that_is_not_there_is_bad_input(real: Path) -> None:
    path = changed(changed(real, radius_m="3.0"), neighbours='["r9"]')
    checked = check(path, None, real.parent)
    assert len(lines(checked, "wrong")) == 3 == len(checked.findings)
    path.write_text("fleet = ")
    assert "not valid TOML" in lines(check(path, None, real.parent), "wrong")[0]
    for bad in (["check", str(real.parent / "none.toml")], ["check", str(shipped_fleet()), "--robot", "r9"]):
        done = CliRunner().invoke(app, bad)
        assert type(done.exception).__name__ == "ConfigError", done.output


def test_marks_of_init_are_told_of_and_a_fleet_of_elsewhere_is_not_called_ready(tmp_path: Path) -> None:
    path = tmp_path / "pool.toml"
    write_fleet(path, 2, twin=False)
    checked = check(path, None, tmp_path)
    assert checked.verdict == "nothing is wrong with the file; 2 warnings" and checked.well
    assert any("MEASURE and SURVEY" in line for line in lines(checked, "warning"))


def test_a_csi_camera_is_asked_who_it_is(real: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = load_fleet(changed(real, camera='"libcamera:0"'))
    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=FakePi()))
    assert devices.camera(fleet, "r1") == "libcamera:0 is 'imx708'"
    monkeypatch.setitem(sys.modules, "picamera2", None)
    with pytest.raises(CameraError, match="needs picamera2"):
        devices.camera(fleet, "r1")


def test_a_port_in_use_and_an_unknown_host(real: Path, tmp_path: Path) -> None:
    (number,) = free_ports(1)
    real.write_text(real.read_text().replace("127.0.0.1:17401", f"127.0.0.1:{number}"))
    with socket.create_server(("127.0.0.1", number)):
        assert any("in use" in line for line in lines(check(real, "r1", tmp_path), "warning"))
    assert f"r1: tcp/127.0.0.1:{number} is this computer's, and free" in lines(check(real, "r1", tmp_path), "ok")
    real.write_text(real.read_text().replace("127.0.0.1", "no..host"))  # no name server needs to be asked
    assert any("no such host" in line for line in lines(check(real, "r1", tmp_path), "wrong"))


def test_a_port_that_may_not_be_opened_names_the_group(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(devices, "group", lambda _: "dialout")
    found = devices.tried("r1", lambda: devices.serial_port(Path(port)))
    assert found.level == "wrong" and "sudo usermod -aG dialout $USER" in found.text


def test_keys_that_are_missing_or_readable_for_others(real: Path, tmp_path: Path) -> None:
    real.write_text(real.read_text() + '[access]\nkeys = "keys"\n')
    assert any("r1.sign: no such file" in line for line in lines(check(real, "r1", tmp_path), "wrong"))
    make_keys(["r1"], tmp_path / "keys")
    checked = check(real, "r1", tmp_path)
    assert any("no public key of r2" in line for line in lines(checked, "warning"))
    assert any("keys in " in line for line in lines(checked, "ok"))
    make_keys(["r2"], tmp_path / "keys")
    assert any("holds private keys of r2" in line for line in lines(check(real, "r1", tmp_path), "warning"))
    (tmp_path / "keys" / "r1.sign").chmod(0o644)
    assert any("chmod 600" in line for line in lines(check(real, "r1", tmp_path), "wrong"))


def test_two_groups_without_a_link_between_them_are_told_of(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    text = shipped_fleet("line_of_five").read_text()
    path.write_text(text.replace('["r1", "r3"]', '["r1"]').replace('["r2", "r4"]', '["r4"]'))
    assert "fleet: no word comes from r1 to r3, r4, r5; give somebody a neighbour there" in lines(
        check(path, None, tmp_path), "warning"
    )


def test_pictures_scenes_extras_and_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(shipped_fleet("box_target").read_text() + "\n[camera]\nenhance = true\n")
    monkeypatch.setattr(check_files, "find_spec", lambda name: None)
    checked = check(path, "r1", tmp_path)
    assert any("no picture for target 'stone'" in line for line in lines(checked, "wrong"))
    assert any("pip install -e '.[enhance]'" in line for line in lines(checked, "warning"))
    fleet = with_pictures(load_fleet(shipped_fleet("box_target")), tmp_path)
    path.write_text(dump(fleet))
    assert load_fleet(path).target["stone"].picture == str(tmp_path / "stone.jpg")
    assert not lines(check(path, "r1", tmp_path), "wrong")
    path.write_text(dump(fleet).replace('"flat_stone"', '"tank"'))
    assert any(
        "nothing in scene 'tank' is called stone" in line for line in lines(check(path, "r1", tmp_path), "wrong")
    )
    path.write_text(dump(fleet).replace('"flat_stone"', '"nowhere"').replace('serial = "twin:r1"', 'serial = "/dev/x"'))
    wrong = lines(check(path, "r1", tmp_path), "wrong")
    assert any("no such scene" in line for line in wrong) and any("real device" in line for line in wrong)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("[[event]] at_s = 1.0; kind = 'push'; robot = 'r9'; force_n = [1, 0, 0]; for_s = 1.0", "no robot 'r9' dives"),
        ("[[creature]] name = 'fish'; path = [[0, 0, 0], [1, 1, 0.2]]", "is too close to a wall"),
        (
            "[[solid]] kind = 'ball'; colour = 'yellow'; position_m = [760, 560, 70]; radii_m = [0.07, 0.07, 0.07]",
            "[760.0, 560.0, 70.0] is outside of the water, 1.5 x 1.2 x 0.5 m; write metres",
        ),
    ],
)
def test_a_scene_that_no_dive_can_have_is_wrong(tmp_path: Path, table: str, says: str) -> None:
    path, scene = tmp_path / "fleet.toml", tmp_path / "mine.toml"
    write_fleet(path, 2, twin=True)
    shipped = (SCENES / "tank.toml").read_text()
    for text, wrong in (
        (shipped, False),
        (f"{shipped}\n{table.replace('; ', chr(10)).replace(']] ', ']]' + chr(10))}", True),
    ):
        scene.write_text(text)
        path.write_text(re.sub(r"scene = .*", f'scene = "{scene}"', path.read_text()))
        assert any(says in line for line in lines(check(path, None, tmp_path), "wrong")) == wrong


def test_a_disk_that_is_full_or_may_not_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = {"now": 10**11}
    monkeypatch.setattr(check_files.shutil, "disk_usage", lambda _: (10**12, 0, free["now"]))
    assert check_files.disk_finding(tmp_path).level == "ok"
    free["now"] = 2 * 10**9
    assert check_files.disk_finding(tmp_path).level == "warning"
    free["now"] = 10**8
    assert check_files.disk_finding(tmp_path).level == "wrong"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "you may not write here" in check_files.disk_finding(tmp_path).text


def test_a_folder_that_is_not_there_yet_is_judged_by_where_it_will_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = tmp_path / "new" / "newer"
    assert check_files.disk_finding(new).level == "ok"
    monkeypatch.setattr(os, "access", lambda where, how: where != tmp_path)
    assert "you may not write here" in check_files.disk_finding(new).text


def test_an_agent_says_in_one_line_what_will_go_wrong_and_starts(real: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "_asked", [signal.SIGTERM])  # it came while the command was starting
    monkeypatch.setattr(devices, "camera", lambda fleet, name: "a camera")
    monkeypatch.setattr(check_files, "OPEN_FILES", 1 << 40)
    changed(real, serial='"/dev/ttyNONE"')
    bad = replace(TWIN, r2=-0.3, rmse_m=0.309)
    known = Calibration(robot="r1", made="2026-01-01", source="a test", focus=bad, camera=TWIN_CAMERA)
    (real.parent / "calibration" / "r1.toml").write_text(dump(known))
    done = CliRunner().invoke(app, ["agent", str(real), "--robot", "r1", "--out", str(real.parent)])
    assert done.exit_code == 0, done.output
    (told,) = (line for line in done.stderr.splitlines() if line.startswith("r1: before the dive: "))
    assert "/dev/ttyNONE: no such serial port" in told and "run: ulimit -n" in told
    assert "calibration/r1.toml: its focus curve misses what it was fitted to by 309 mm rms" in told


def test_an_address_that_every_computer_has_is_told_of(real: Path, tmp_path: Path) -> None:
    (told,) = (line for line in lines(check(real, None, tmp_path), "warning") if "is every computer's own" in line)
    assert told.startswith("r1: tcp/127.0.0.1:17401 ")
    real.write_text(real.read_text().replace("192.168.7.12", "127.0.0.2"))
    at_home = check(real, None, tmp_path)
    assert at_home.robots == 2 and not any("every computer's own" in line for line in lines(at_home, "warning"))


def test_angles_that_look_like_radians_and_balls_of_another_unit_are_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, 2, twin=True)
    text = re.sub(r"yaw_deg = [-0-9.]+", "yaw_deg = 0.6", path.read_text())
    path.write_text(re.sub(r"radius_m = [0-9.]+", "radius_m = 0.002", text))
    warned = lines(check(path, None, tmp_path), "warning")
    assert any("yaw_deg: 0.6 degrees; is it in radians? That would be 34.4 degrees" in line for line in warned)
    assert any("radius_m: 0.002; 0.005 to 0.5 are usual: write metres" in line for line in warned)


@pytest.mark.parametrize(
    ("pattern", "becomes", "says"),
    [
        (
            r"size_m = \[.*\]",
            "size_m = [1500.0, 1200.0, 800.0]",
            "tank.size_m: 1500; 0.1 to 60 are usual: write metres",
        ),
        (
            r"(radius_m = 0.07).*",
            r"\1\nradius_sigma_m = 0.1",
            "radius_sigma_m: 0.1; 0 to 0.035 are usual: write metres",
        ),
        (r"\Z", "\n[budget]\nlevel_m = 1.5\n", "budget.level_m: 1.5; 0 to 0.1 are usual: write metres"),
        (r"\Z", "\n[budget]\nattitude_deg = 90.0\n", "attitude_deg: 90; 0 to 30 are usual: write degrees"),
        (r"\Z", "\n[body]\npan_limit_deg = [-900.0, 900.0]\n", "body.pan_limit_deg: -900; -180 to 180 are usual"),
        (r"\Z", "\n[body]\ntilt_limit_deg = [-1.05, 0.52]\n", "-1.05 to 0.52 leave 1.57 degrees in all: write degrees"),
        (
            r"\Z",
            '\n[target.fish]\ndetector = "creature"\ncolour = "green"\nlength_m = 0.15\nspeed_m_s = 0.1\nturn_s = 3.0',
            "target.fish: swims, and robots take no bearings of it",
        ),
        (r"\Z", "\n[body]\ncamera_m = [0.1, 0.0, 30.0]\n", "body.camera_m: 30; -1 to 1 are usual: write metres"),
        (r"\Z", "\n[body]\nservo_centre_us = 1.5\n", "servo_centre_us: 1.5; 500 to 2500 are usual: write microseconds"),
        (r"\Z", "\n[camera]\nsettle_s = 50.0\n", "camera.settle_s: 50; 0 to 3 are usual: write seconds"),
        (r"\Z", "\n[camera]\nsweep_steps = 3000\n", "sweep_steps: 3000; 8 to 300 are usual: correct it"),
        (r"\Z", "\n[camera]\nrow_time_us = 30000\n", "row_time_us: 30000; 0 to 208.333 are usual: write microseconds"),
        (r"\Z", "\n[camera]\nwidth_px = 64000\n", "camera.width_px: 64000; 64 to 16000 are usual: write pixels"),
        (r"(protocol = .*)", r"\1\niteration_s = 0.01", "iteration_s: 0.01; 0.05 to 60 are usual: write seconds"),
        (r"(protocol = .*)", r"\1\nvalidity_s = 500", "validity_s: 500; 0 to 10 are usual: write seconds"),
        (
            r"(protocol = .*)",
            r"\1\nliars = 2",
            "liars: two are found among 7 to 32 robots that see, and there are 2; write 1",
        ),
        (r"n/r2.toml", "n/r1.toml", "r1 and r2 have one calibration, calibration/r1.toml; each camera needs its own"),
        (r"(calibration = )", r"depth_m = 0.49\n\1", "r2.depth_m: 0.49 m deep, r2 lies on the floor; 0.42 m or less"),
        (
            r"(calibration = )",
            r"depth_m = 0.02\n\1",
            "r1.depth_m: 0.02 m deep, r1 is lifted out of the water; write 0.08",
        ),
        (r"yaw_deg = 34.0", "yaw_deg = 0.593", "r1.pose.yaw_deg: 0.593 degrees; is it in radians? That would be 34.0"),
        (r"yaw_deg = 34.0", "yaw_deg = 3400.0", "r1.pose.yaw_deg: 3400 degrees are more than a turn; correct it"),
        (
            r"\Z",
            "\n[budget]\n" + "".join(f"{key} = 0\n" for key in CAREFUL.__struct_fields__),
            "budget: all are 0, as if nothing were ever off",
        ),
        (
            r'kind = "tap".*',
            'kind = "tap"\nrefractive_index = 1.0',
            "water.refractive_index: 1 is no water's; remove it",
        ),
        (r"pose = \{.*\}", "pose = { x_m = 0.4, y_m = 0.4, yaw_deg = 45.0 }", "r1 and r2 have the same place"),
    ],
)
def test_what_is_hardly_meant_is_a_warning(tmp_path: Path, pattern: str, becomes: str, says: str) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, 2, twin=True)
    text = path.read_text()
    assert "[budget]" not in text and "[body]" not in text and text.count("pose = {") == 2
    assert not [line for line in lines(check(path, None, tmp_path), "warning") if "no such file" not in line]
    path.write_text(re.sub(pattern, becomes, text))
    warned = [line for line in lines(check(path, None, tmp_path), "warning") if "no such file" not in line]
    assert any(says in line for line in warned), warned


def test_tags_that_read_as_others_in_the_mirror_of_the_surface_are_a_warning() -> None:
    fleet = load_fleet(shipped_fleet("swim"))
    assert fleet.landmarks is not None and not list(check_files.place_findings(fleet))
    tags = (*fleet.landmarks.tag, replace(fleet.landmarks.tag[0], id=314))
    (found,) = check_files.place_findings(replace(fleet, landmarks=replace(fleet.landmarks, tag=tags)))
    assert "ids 314 can read as others" in found.text


def test_robots_that_have_no_room_are_a_warning() -> None:
    fleet = load_fleet(shipped_fleet("swim"))
    small = replace(fleet, tank=replace(fleet.tank, size_m=(0.5, 0.45, 0.8)))
    assert any("0.5 x 0.45 m have no room for" in found.text for found in check_files.place_findings(small))


def test_robots_that_swim_and_are_not_linked_are_a_warning() -> None:
    fleet = load_fleet(shipped_fleet("swim"))
    assert not [found for found in check_files.links(fleet) if found.level != "ok"]
    a, b, *_ = fleet.robot
    robots = {
        name: replace(robot, neighbours=tuple(other for other in robot.neighbours if {name, other} != {a, b}))
        for name, robot in fleet.robot.items()
    }
    warned = [found.text for found in check_files.links(replace(fleet, robot=robots)) if found.level == "warning"]
    assert any(f"{a} and {b} swim without a link" in text for text in warned), warned


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_of_its_encoding_is_no_mistake_in_a_fleet_file(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "fleet.toml"
    write_fleet(path, 2, twin=True)
    wanted = load_fleet(path)
    path.write_text(path.read_text(), encoding=encoding)
    assert load_fleet(path) == wanted
    assert check(path, None, tmp_path).well


def test_one_device_by_two_names_is_found(real: Path, port: str, tmp_path: Path) -> None:
    """As udev makes links to one port, by its place and by its number."""
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30, (640, 480))
    writer.write(np.zeros((480, 640, 3), np.uint8))
    writer.release()
    for link in ("by-id", "by-path"):
        (tmp_path / link).symlink_to(port)
    text = re.sub(r'"tcp/192.168.7.12:\d+"', '"tcp/127.0.0.1:17462"', real.read_text())
    names = iter(("by-id", "by-path"))
    text = re.sub(r"serial = .*", lambda _: f'serial = "{tmp_path / next(names)}"', text)
    films = iter((str(film), f"{tmp_path}/./film.avi"))
    text = re.sub(r"camera = .*", lambda _: f'camera = "video:{next(films)}"', text)
    real.write_text(text)
    checked = check(real, None, tmp_path)
    assert f"r2: serial '{tmp_path / 'by-path'}' is also that of 'r1', which calls it" in str(lines(checked, "wrong"))
    assert f"r2: camera 'video:{tmp_path}/./film.avi' is also that of 'r1'" in str(lines(checked, "warning"))
