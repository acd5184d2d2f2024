"""The fleet of a demo: the first robots of a fleet file, all in the twin, which knows the places of their targets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import msgspec

from agent.core.config import Access, ConfigError, Fleet, Protocol
from agent.ground.new_fleet import FOLDER
from agent.perception.detection.detectors import target_picture
from agent.perception.tracking.follow import load_box_tracker, model_files
from agent.process.command import shipped_fleet
from agent.process.launch import free_ports
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import scene_of
from hw.twin.targets import target_creatures, target_solids

T = TypeVar("T", bound=msgspec.Struct)
CONSOLE = "ann"  # who may order in a secured demo whose file names nobody
OF_THE_TANK = 3  # of its five robots, unless more are asked for: two cores render no more cameras at real time


def demo_fleet(
    robots: int | None,
    protocol: Protocol | None,
    loss: float | None,
    seed: int | None,
    enhance: bool | None,
    folder: Path,
    path: Path | None = None,
) -> Fleet:
    """A fleet file, that of the tank if not given, with its first robots only, on ports that are free now.

    `robots`: None for all of the file, of the tank three; of `protocol`, `loss`, `seed` and `enhance` None is what the
    file has. `folder` is the twin's. It signs nothing: the keys that the file names are of other computers. Raises
    ConfigError for what cannot dive in the twin, or not be judged there.
    """
    path = path or shipped_fleet()
    fleet = load_fleet(path)
    names = _first(fleet, robots, path)
    _lives_in_the_twin(fleet, names, path)
    _has_its_targets(fleet, path)
    kept = {
        name: msgspec.structs.replace(
            fleet.robot[name], neighbours=tuple(n for n in fleet.robot[name].neighbours if n in names)
        )
        for name in names
    }
    replace = msgspec.structs.replace
    fleet = replace(
        fleet,
        robot=kept,
        access=Access(),
        estimation=_with(fleet.estimation, protocol=protocol),
        link=_with(fleet.link, loss=loss, loss_seed=seed),
        camera=_with(fleet.camera, enhance=enhance),
        twin=_with(fleet.twin, seed=seed, dir=str(folder)),
    )
    return listening(fleet, [f"tcp/127.0.0.1:{port}" for port in free_ports(len(names))])


def listening(fleet: Fleet, endpoints: list[str]) -> Fleet:
    """The fleet, its robots listening on these endpoints in the order of the file."""
    robots = {
        name: msgspec.structs.replace(robot, listen=endpoint)
        for (name, robot), endpoint in zip(fleet.robot.items(), endpoints, strict=True)
    }
    return msgspec.structs.replace(fleet, robot=robots)


def with_access(fleet: Fleet, consoles: tuple[str, ...], secure: bool) -> Fleet:
    """The fleet, signing with keys of its run; `secure`: with certificates too, and a console at the least."""
    if secure:
        endpoints = ["tls/" + robot.listen.partition("/")[2] for robot in fleet.robot.values()]
        fleet, consoles = listening(fleet, endpoints), consoles or (CONSOLE,)
    return msgspec.structs.replace(fleet, access=Access(keys=FOLDER, consoles=consoles))


def _with(table: T, **asked: object) -> T:
    """A table of the file, but for what was asked for."""
    return msgspec.structs.replace(table, **{name: value for name, value in asked.items() if value is not None})


def _first(fleet: Fleet, robots: int | None, path: Path) -> list[str]:
    """Names of the robots that dive."""
    all_names = list(fleet.robot)
    if robots is None:
        return all_names[: OF_THE_TANK if path == shipped_fleet() else None]
    if not 1 <= robots <= len(all_names):
        raise ConfigError(f"--robots {robots}: {path.name} has {len(all_names)}; choose 1 to {len(all_names)}")
    return all_names[:robots]


def _lives_in_the_twin(fleet: Fleet, names: list[str], path: Path) -> None:
    for name in names:
        devices: Mapping[str, str] = {"serial": fleet.robot[name].serial, "camera": fleet.robot[name].camera}
        for key, device in devices.items():
            if device != f"twin:{name}":
                raise ConfigError(
                    f"{path}: key 'robot.{name}.{key}': '{device}' is not in the twin, where the demo dives; "
                    f'write "twin:{name}" in a copy of the file, or start the robots with aucamp agent'
                )


def _has_its_targets(fleet: Fleet, path: Path) -> None:
    """The twin's scene has all targets, and what tells those that are no ball can be used."""
    scene = scene_of(fleet)
    known = {*target_solids(fleet, scene, path), *target_creatures(fleet, scene, path)}
    for name, target in fleet.target.items():
        if name not in known:
            raise ConfigError(
                f"{path}: key 'target.{name}': nothing in scene '{scene.name}' has this name, so that nobody could "
                f'judge the estimates; write name = "{name}" under a [[solid]] or [[creature]] of the scene file'
            )
        if target.picture is not None:
            target_picture(name, target, (fleet.camera.width_px, fleet.camera.height_px))
        if target.models is not None:
            load_box_tracker(*model_files(Path(target.models)))
