"""What a ground computer is given beside the package: its service, judged by systemd, and its firewall, by nftables."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import typer.main

from agent.__main__ import app
from agent.ground.check_files import OPEN_FILES
from agent.ground.new_fleet import write_fleet
from agent.robot.fleet_reader import load_fleet
from replay.files.log import CLOSE_S
from tests.places import ROOT

FOLDER = ROOT / "hw" / "ground_computer"
UNIT = (FOLDER / "aucamp-agent@.service").read_text(encoding="utf-8")
FIREWALL = FOLDER / "aucamp.nft"
MOST_EXPOSED = 25  # tenths of systemd's own figure, of which 100 is the worst; ours is 19

analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")


def settings(name: str) -> list[str]:
    """Every value that the unit gives a setting."""
    return re.findall(rf"^{name}=(.*)$", UNIT, re.MULTILINE)


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The unit of one robot, on a computer where the package is not in /opt."""
    path = tmp_path / "aucamp-agent@r1.service"
    path.write_text(UNIT.replace("/opt/aucamp/bin/aucamp ", "/bin/true "))
    return path


@analyze
def test_systemd_understands_all_of_the_unit(installed: Path) -> None:
    done = subprocess.run(["systemd-analyze", "verify", installed], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@analyze
def test_systemd_would_say_so_if_it_did_not(installed: Path) -> None:
    installed.write_text(installed.read_text().replace("ProtectHome=", "ProtectHouse="))
    done = subprocess.run(["systemd-analyze", "verify", installed], capture_output=True, text=True, timeout=60)
    assert "ProtectHouse" in done.stderr


@analyze
def test_the_service_is_shut_in(installed: Path) -> None:
    command = ["systemd-analyze", "security", "--offline=yes", f"--threshold={MOST_EXPOSED}", "--no-pager", installed]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout


def test_its_command_is_ours_and_starts_no_motors() -> None:
    (line,) = settings("ExecStart")
    words = shlex.split(line.replace("%i", "r2").replace("%S", "/var/lib"))
    assert words[0] == "/opt/aucamp/bin/aucamp"
    group = typer.main.get_command(app)
    context = group.make_context("aucamp", words[1:])
    verb, command, arguments = group.resolve_command(context, [*context._protected_args, *context.args])
    parsed = command.make_context(verb, arguments, parent=context)
    assert verb == "agent" and parsed.params["robot"] == "r2"
    assert not parsed.params["arm"] and "--arm" not in line, "motors start where a person looks on"


def test_it_writes_where_it_may_and_finds_its_devices(tmp_path: Path) -> None:
    (line,) = settings("ExecStart")
    out = line.split("--out ")[1].split()[0]
    assert out.startswith("%S/") and out.removeprefix("%S/") in settings("StateDirectory")
    caches = re.findall(r"=(%C/\w+)", " ".join(settings("Environment")))
    assert caches and {cache.removeprefix("%C/") for cache in caches} == set(settings("CacheDirectory"))
    write_fleet(tmp_path / "fleet.toml", 3, twin=False)
    allowed = [value.removeprefix("char-").split()[0] for value in settings("DeviceAllow")]
    for robot in load_fleet(tmp_path / "fleet.toml").robot.values():
        assert re.sub(r"\d+$", "", robot.serial.removeprefix("/dev/")) in allowed
        assert robot.camera.startswith("v4l2:") and "video4linux" in allowed


def test_a_crash_starts_it_again_at_once_and_without_end() -> None:
    assert settings("Restart") == ["on-failure"] and settings("StartLimitIntervalSec") == ["0"]
    assert float(settings("RestartSec")[0]) < 3.0, "the control module surfaces after so long without its agent"
    assert float(settings("TimeoutStopSec")[0]) > CLOSE_S, "as long as a recording may take to end"
    assert int(settings("LimitNOFILE")[0]) >= OPEN_FILES


def test_the_firewall_opens_the_ports_of_a_new_fleet(tmp_path: Path) -> None:
    write_fleet(tmp_path / "fleet.toml", 10, twin=False)
    text = FIREWALL.read_text(encoding="utf-8")
    first, last = map(int, re.findall(r"FLEET_PORTS = \{ (\d+)-(\d+) \}", text)[0])
    (network,) = re.findall(r"FLEET_NETWORK = ([\d.]+)\.0/24", text)
    for robot in load_fleet(tmp_path / "fleet.toml").robot.values():
        host, port = re.fullmatch(r"\w+/([\d.]+):(\d+)", robot.listen).groups()
        assert host.startswith(f"{network}.") and first <= int(port) <= last


@pytest.mark.skipif(shutil.which("nft") is None, reason="no nft here")
def test_nftables_understands_the_firewall() -> None:
    done = subprocess.run(["nft", "--check", "--file", FIREWALL], capture_output=True, text=True, timeout=60)
    if "Operation not permitted" in done.stderr:
        pytest.skip("nft may not look here")
    assert (done.returncode, done.stderr) == (0, "")
