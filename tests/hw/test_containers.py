"""compose.yaml, Dockerfile and .dockerignore, as far as they can be judged without a container engine."""

import re
import shlex
import tomllib

import pytest
import typer.main
import yaml

from agent.__main__ import app
from agent.ground.new_fleet import write_fleet
from agent.robot.fleet_reader import load_fleet
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
def test_none_is_root_loops_or_writes_where_it_should_not(name):
    service = SERVICES[name]
    assert re.fullmatch(r"no|on-failure:[1-9]", service["restart"])
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


def test_a_second_start_of_the_recorder_has_another_file():
    for name in ("recorder", "twin"):
        assert "$(date -u +%Y%m%dT%H%M%SZ)" in filled_in(SERVICES[name]["command"][0])


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
