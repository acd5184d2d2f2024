"""docs/operate.md, followed: its commands are ours, and what its lines put on each computer is what that one needs."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

from agent.__main__ import app
from agent.process.certificates import credentials
from agent.process.keys import NO_KEYS, robot_keys
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

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
def test_each_command_is_one_of_ours(line: str) -> None:
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
    (clean,) = re.findall(r"`(rm -r to [^`]+)`", PAGE)
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
