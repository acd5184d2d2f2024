"""compose.yaml, Dockerfile and .dockerignore, as far as they can be judged without a container engine."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer.main
import yaml

from agent.__main__ import app
from agent.ground.check_files import OPEN_FILES
from agent.ground.new_fleet import write_fleet
from agent.process.certificates import credentials
from agent.process.keys import NO_KEYS, robot_keys
from agent.robot.fleet_reader import load_fleet
from replay.files.log import CLOSE_S
from tests.places import ROOT

COMPOSE = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))
SERVICES = COMPOSE["services"]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def filled_in(text, **given):
    """A text as compose reads it: ${NAME:-default}, and $$ for a dollar."""
    text = re.sub(r"(?<!\$)\$\{(\w+):-([^}]*)\}", lambda found: given.get(found[1], found[2]), text)
    return text.replace("$$", "$")


def command_line(service, **given):
    """The words behind `aucamp`; of a shell's line those after exec, with one word for what the shell puts in."""
    words = service["command"]
    if "entrypoint" not in service:
        return shlex.split(filled_in(words, **given))
    assert service["entrypoint"] == ["/bin/sh", "-c"] and len(words) == 1
    (line,) = re.findall(r"exec aucamp (.*)", re.sub(r"\$\([^)]*\)", "NOW", filled_in(words[0], **given)))
    return shlex.split(line)


@pytest.mark.parametrize("name", SERVICES)
def test_each_command_is_one_of_ours(name):
    group = typer.main.get_command(app)
    context = group.make_context("aucamp", command_line(SERVICES[name]))
    verb, command, arguments = group.resolve_command(context, [*context._protected_args, *context.args])
    parsed = command.make_context(verb, arguments, parent=context)
    assert not parsed.args and not parsed.params.get("arm"), "motors start where a person looks on"


@pytest.mark.parametrize("name", SERVICES)
def test_none_is_root_or_writes_where_it_should_not_and_those_of_a_robot_are_up_after_a_reboot(name):
    service = SERVICES[name]
    assert re.fullmatch(r"no|on-failure:[1-9]" if "twin" in name else "unless-stopped", service["restart"])
    assert filled_in(service["user"]) == "1000:1000"
    assert service["read_only"] is True and service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["network_mode"] == "host" and service["init"] is True
    for volume in service["volumes"]:
        writable = not volume.get("read_only")
        assert not writable or volume["target"] in ("/recordings", "/twin", "/var/cache/aucamp")
        if volume["type"] == "bind":
            assert volume["bind"] == {"create_host_path": False}, "what the engine makes is root's"
        else:
            assert volume["source"] in COMPOSE["volumes"]
            assert f" {volume['target']}" in re.findall(r"RUN mkdir --mode=1777(.*)", DOCKERFILE)[0]


@pytest.mark.parametrize("name", SERVICES)
def test_what_a_command_names_is_there(name):
    service = SERVICES[name]
    targets = {volume["target"] for volume in service["volumes"]}
    command = service["command"] if isinstance(service["command"], str) else service["command"][0]
    assert set(re.findall(r"(?<!\w)/(?:fleet|recordings|twin)\b", command)) <= targets
    if "twin" in name:
        assert service["profiles"] == ["twin"] and "devices" not in service
    if name in ("twin", "twin-router"):
        assert service["depends_on"] == {"twin-fleet": {"condition": "service_completed_successfully"}}


def started(name, recordings, tmp_path):
    """What `aucamp` is given by the shell of a service, whose /recordings are there."""
    line = filled_in(SERVICES[name]["command"][0]).replace("/recordings", str(recordings))
    (tmp_path / "aucamp").write_text('#!/bin/sh\nfor word; do last=$word; done; echo "$last"\n')
    (tmp_path / "aucamp").chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    return subprocess.run(["sh", "-c", line], env={"PATH": path}, check=True, capture_output=True, text=True).stdout


def test_a_second_start_of_the_recorder_has_another_file_and_one_that_broke_off_goes_on(tmp_path):
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    new = re.escape(str(recordings)) + r"/fleet-\d{8}T\d{6}Z\.mcap\n"
    (recordings / "fleet-20260101T000000Z.mcap").touch()
    assert re.fullmatch(new, started("recorder", recordings, tmp_path))
    assert re.search(r"/twin-\d{8}T\d{6}Z$", started("twin", recordings, tmp_path))
    for file in ("fleet-20260102T000000Z.mcap.active", "fleet-20260103T000000Z.2.part002.mcap.active"):
        (recordings / file).touch()
    assert started("recorder", recordings, tmp_path) == f"{recordings / 'fleet-20260103T000000Z.mcap'}\n"
    for file in recordings.iterdir():
        os.utime(file, (0, 0))  # of a dive long ago
    assert re.fullmatch(new, started("recorder", recordings, tmp_path))


def test_the_robot_has_its_devices_and_its_own_keys_alone(tmp_path):
    write_fleet(tmp_path / "fleet.toml", 3, twin=False)
    fleet, agent = load_fleet(tmp_path / "fleet.toml"), SERVICES["agent"]
    for name, robot in fleet.robot.items():
        words = command_line(agent, ROBOT=name)
        assert words[words.index("--robot") + 1] == name
        assert [filled_in(each) for each in agent["devices"]] == [robot.serial, robot.camera.removeprefix("v4l2:")]
        assert robot.calibration.startswith("calibration/")  # beside the fleet file, in ./fleet
    assert [filled_in(each) for each in agent["group_add"]] == ["dialout", "video"]


def test_each_service_sees_its_own_keys_alone():
    seen = {}
    for name, service in SERVICES.items():
        for volume in service["volumes"]:
            if volume["target"] == "/keys":
                assert volume["type"] == "bind" and volume["read_only"] is True
                seen[name] = filled_in(volume["source"], ROBOT="r2")
            else:
                assert "keys" not in volume["source"]
    assert seen == {"agent": "./keys/r2", "recorder": "./keys/recorder", "router": "./keys/router"}
    assert all(SERVICES[name]["environment"] == {"AUCAMP_KEYS": "/keys"} for name in seen)
    told = (ROOT / "docs" / "containers.md").read_text(encoding="utf-8")
    assert set(re.findall(r"`keys/(\w+)/`", told)) == {"r1", "recorder", "router"}


def test_the_image_is_made_of_what_is_packaged_and_nothing_else():
    copied = [word for line in re.findall(r"^COPY (?!--from)(.*)", DOCKERFILE, re.M) for word in line.split()[:-1]]
    packages = [name.removesuffix("*") for name in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]]
    assert set(copied) == {*packages, "LICENSE", "README.md", "constraints.txt", "pyproject.toml"}
    assert all((ROOT / name).exists() for name in copied)
    lines = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if not line.startswith("#")]
    ignored = [line.removesuffix("/") for line in (ROOT / ".gitignore").read_text().splitlines() if line[0] != "/"]
    assert lines == ["*", *(f"!{name}" for name in sorted(copied)), *(f"**/{name}" for name in ignored)]


def test_the_image_is_built_in_two_stages_and_runs_as_nobody_special():
    build, last = re.split(r"^FROM ", DOCKERFILE, flags=re.M)[1:]
    assert "python:${PYTHON}-slim AS build" in build and "--constraint constraints.txt" in build
    assert "pip install" not in last and "COPY --from=build /opt/aucamp /opt/aucamp" in last
    assert re.findall(r"^USER (.*)", last, re.M) == ["1000:1000"]
    assert re.findall(r"^ENTRYPOINT (.*)", last, re.M) == ['["aucamp"]']
    version = re.findall(r"^ARG PYTHON=(.*)", DOCKERFILE, re.M)[0]
    assert PROJECT["project"]["requires-python"] == f">={version}"
    extras = re.findall(r"EXTRAS=([\w,]+)", DOCKERFILE)[0].split(",")
    assert set(extras) <= PROJECT["project"]["optional-dependencies"].keys()


# --- ground computer ---
# What a ground computer is given beside the package: its service, judged by systemd, and its firewall, by nftables.

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


def test_drivers_are_there_before_the_unit_says_what_may_be_opened() -> None:
    """Of a class that the kernel does not know yet, systemd allows nothing."""
    drivers = {"char-ttyACM rw": "cdc_acm", "char-ttyUSB rw": "usbserial", "char-video4linux rw": "uvcvideo"}
    assert set(settings("DeviceAllow")) == drivers.keys()
    for when in ("Wants", "After"):
        assert {f"modprobe@{name}.service" for name in drivers.values()} <= set(" ".join(settings(when)).split())


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


def test_the_firewall_leaves_alone_what_is_no_port_of_the_fleet() -> None:
    """Neighbour discovery and names, for example: without them nobody gets there by IPv6."""
    before, _, _ = FIREWALL.read_text(encoding="utf-8").partition(" drop\n")
    assert "meta l4proto != tcp accept" in before and "tcp dport != $FLEET_PORTS accept" in before


@pytest.mark.skipif(shutil.which("nft") is None, reason="no nft here")
def test_nftables_understands_the_firewall() -> None:
    done = subprocess.run(["nft", "--check", "--file", FIREWALL], capture_output=True, text=True, timeout=60)
    if "Operation not permitted" in done.stderr:
        pytest.skip("nft may not look here")
    assert (done.returncode, done.stderr) == (0, "")


# --- operate ---
# docs/operate.md, followed: its commands are ours, and what its lines put on each computer is what that one needs.

PAGE = (ROOT / "docs" / "operate.md").read_text(encoding="utf-8")
FENCED = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
BLOCKS = [block.replace("\\\n", " ") for kind, block in FENCED if not kind]
LINES = [re.sub(r"\s+#.*", "", line) for block in BLOCKS for line in block.splitlines()]
TYPED = [found[1] for line in LINES if (found := re.search(r"(?:^|/bin/)(aucamp .*)", line))]
OURS = sorted({*TYPED, *re.findall(r"`(aucamp [^`]+)`", PAGE)})
PRIVATE = (".key", ".sign")


def block_with(text: str) -> str:
    (found,) = [block for block in BLOCKS if text in block]
    return found


@pytest.mark.parametrize("line", OURS)
def test_each_line_of_the_operating_page_is_a_command_of_ours(line: str) -> None:
    command, arguments = typer.main.get_command(app), shlex.split(line)
    context = command.make_context(arguments.pop(0), arguments)
    while hasattr(command, "commands"):
        verb, command, arguments = command.resolve_command(context, [*context._protected_args, *context.args])
        context = command.make_context(verb, arguments, parent=context)
    assert not context.args and not context.params.get("arm"), "motors start by an order"


def test_there_are_commands_on_the_page() -> None:
    assert {line.split()[1] for line in OURS} >= {
        "init",
        "check",
        "keys",
        "doctor",
        "order",
        "record",
        "view",
        "snapshot",
    }


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ann's folder, once she has followed the page up to the copying; nothing is sent anywhere."""
    folder = tmp_path_factory.mktemp("ann") / "tank"
    folder.mkdir()

    def aucamp(*words: str) -> None:
        command = [sys.executable, "-m", "agent", *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, timeout=60)

    aucamp("init", "--robots", "3", "--out", "fleet.toml")
    (secured,) = [block.partition("[robot")[0] for kind, block in FENCED if kind == "toml"]
    text = (folder / "fleet.toml").read_text().replace('listen = "tcp/', 'listen = "tls/')
    (folder / "fleet.toml").write_text(text + secured)
    aucamp("keys", "fleet.toml", "--out", "keys")
    subprocess.run(["bash", "-eu", "-c", block_with("mkdir -p to/$name")], cwd=folder, check=True, timeout=60)
    return folder


def test_addresses_on_the_page_are_those_of_a_new_fleet(tank: Path) -> None:
    for name, robot in load_fleet(tank / "fleet.toml").robot.items():
        host = robot.listen.partition("/")[2].rpartition(":")[0]
        assert f".{host.rpartition('.')[2]}" in PAGE and host.startswith("192.168.7."), name
    assert 'listen = "tls/192.168.7.11:17401"' in PAGE


@pytest.mark.parametrize("robot", ["r1", "r2", "r3"])
def test_a_robot_has_what_it_needs_and_nobody_elses(tank: Path, robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, there = load_fleet(tank / "fleet.toml"), tank / "to" / robot
    monkeypatch.setenv("AUCAMP_KEYS", str(there))
    assert credentials(fleet, robot, tank / "fleet.toml") == there
    assert robot_keys(fleet, robot, tank / "fleet.toml") is not NO_KEYS
    assert {path.name for path in there.glob("*.sign.pub")} == {f"{name}.sign.pub" for name in fleet.robot}
    assert {path.name for path in there.iterdir() if path.suffix in PRIVATE} == {f"{robot}.key", f"{robot}.sign"}
    assert all(path.stat().st_mode & 0o077 == 0 for path in there.iterdir() if path.suffix in PRIVATE)


def test_bob_can_order_and_look_and_issue_nothing(tank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, there = load_fleet(tank / "fleet.toml"), tank / "to" / "bob"
    monkeypatch.setenv("AUCAMP_KEYS", str(there))
    assert all(credentials(fleet, name, tank / "fleet.toml") == there for name in ("bob", "view"))
    assert {path.name for path in there.iterdir() if path.suffix in PRIVATE} == {"bob.key", "view.key"}


def test_a_renewed_certificate_is_made_after_private_keys_were_given_away(tank: Path) -> None:
    clean = block_with("rm -r to\n")
    for end in PRIVATE:
        (tank / "keys" / f"r10{end}").touch()
    lines = block_with("--only r1").splitlines()
    before = (tank / "keys" / "r1.pem").read_bytes()
    ours = f'aucamp() {{ {shlex.quote(sys.executable)} -m agent "$@"; }}'
    script = "\n".join([ours, clean, *lines[:2]])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(["bash", "-eu", "-c", script], cwd=tank, env=environment, check=True, timeout=60)
    assert (tank / "keys" / "r1.pem").read_bytes() != before
    left = {path.name for path in (tank / "keys").iterdir() if path.suffix in PRIVATE}
    assert left == {"ca.key", "r1.key", "ann.key", "recorder.key", "view.key", "router.key"}


def test_the_files_that_it_installs_are_there() -> None:
    named = set(re.findall(r"\bhw/ground_computer/[\w@.-]+", PAGE))
    assert named == {f"hw/ground_computer/{path.name}" for path in (ROOT / "hw" / "ground_computer").iterdir()}
