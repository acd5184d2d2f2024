"""Bridges: a running fleet for programs that people already have."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from agent.core.config import ConfigError
from agent.process.command import FleetFile
from agent.process.launch import until_signal
from agent.robot.fleet_reader import load_fleet

SIMULATOR = "-35.363262,149.165237"  # where the simulator of ArduPilot stands, as those who know it know

bridge_app = typer.Typer(no_args_is_help=True, help="A running fleet for programs that speak another language.")


def as_place(text: str) -> tuple[float, float]:
    """LATITUDE,LONGITUDE in degrees. Raises ConfigError."""
    try:
        latitude_deg, longitude_deg = map(float, text.split(","))
    except ValueError:
        latitude_deg = longitude_deg = float("nan")
    if not (abs(latitude_deg) < 89 and abs(longitude_deg) <= 180):
        raise ConfigError(f"--origin '{text}': write latitude and longitude in degrees, such as 47.37,8.54")
    return latitude_deg, longitude_deg


Looker = Annotated[
    str | None,
    typer.Option("--as", metavar="NAME", help="By whose certificate it looks: an observer of the fleet file."),
]


@contextmanager
def extra(name: str, package: str) -> Iterator[None]:
    """Say which extra it takes where a package is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if missing.name is None or missing.name.partition(".")[0] != package:
            raise
        raise ConfigError(f"this bridge needs the extra `{name}`; in your clone: pip install -e '.[{name}]'") from None


@bridge_app.command(epilog="Example: aucamp bridge mavlink fleet.toml --as ann")
def mavlink(
    fleet: FleetFile,
    console: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="Take commands, as this console of the fleet file; else only look."),
    ] = None,
    port: Annotated[
        int, typer.Option(min=1024, max=65535, help="UDP port of the ground station on this machine.")
    ] = 14550,
    origin: Annotated[
        str, typer.Option(metavar="LAT,LON", help="Where on the map the tank's corner is drawn: degrees, made up.")
    ] = SIMULATOR,
) -> None:
    """Each robot as a submarine for a ground station on this machine, until Ctrl-C.

    It may arm, disarm, hold and surface; only the robot that is addressed, and only with --as.
    """
    place, robots = as_place(origin), load_fleet(fleet)
    with until_signal() as stop:
        with extra("mavlink", "pymavlink"):
            from agent.ground.bridges.mavlink import Origin, run
        run(robots, fleet, console, port, Origin(*place), stop, typer.echo)


@bridge_app.command(epilog="Example: aucamp bridge ros2 fleet.toml")
def ros2(
    fleet: FleetFile,
    name: Looker = None,
    port: Annotated[
        int, typer.Option(min=1024, max=65535, help="TCP port of rmw_zenoh's router on this machine.")
    ] = 7447,
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID of whoever shall hear it.")] = 0,
) -> None:
    """Poses, targets and pictures for ROS 2 with rmw_zenoh, until Ctrl-C. It only looks: ROS cannot order robots."""
    robots = load_fleet(fleet)
    with until_signal() as stop:
        with extra("ros", "rosbags"):
            from agent.ground.bridges.outward import run
            from agent.ground.bridges.ros2 import Ros2
        run(robots, fleet, name, port, Ros2(robots, domain), stop, typer.echo)


@bridge_app.command(epilog="Example: aucamp bridge keelson fleet.toml")
def keelson(
    fleet: FleetFile,
    name: Looker = None,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="TCP port of their router on this machine.")] = 7447,
) -> None:
    """Attitude, place, pictures and log for programs that speak keelson, until Ctrl-C. It only looks."""
    robots = load_fleet(fleet)
    with until_signal() as stop:
        with extra("keelson", "keelson"):
            from agent.ground.bridges.keelson import Keelson
            from agent.ground.bridges.outward import run
        run(robots, fleet, name, port, Keelson(robots), stop, typer.echo)
