"""What people around a fleet type: before its dives, while it runs, and through bridges to other programs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn

import typer

from agent.core.config import ConfigError, to_install, write_whole
from agent.core.verbs import VERBS
from agent.process.command import (
    FleetFile,
    Port,
    RobotName,
    complain,
    new_file,
    plain_console,
    refuse_options,
    run_folder,
    terminal,
    with_bar,
)
from agent.process.launch import until_signal
from agent.robot.fleet_reader import load_fleet, load_robot

if TYPE_CHECKING:
    from agent.ground.check import Checked
    from agent.ground.doctor import Diagnosis

app = typer.Typer()


@app.command(epilog="Example: aucamp init --twin --robots 3 --out fleet.toml")
def init(
    robots: Annotated[int, typer.Option(min=1, max=10, help="How many.")] = 3,
    twin: Annotated[bool, typer.Option("--twin", help="In the twin, which needs no hardware.")] = False,
    out: Annotated[Path, typer.Option(help="File to write: NAME.toml.")] = Path("fleet.toml"),
) -> None:
    """A fleet file to begin with, with comments that say what to change. Of real robots, unless --twin is given."""
    from agent.ground.new_fleet import write_fleet

    if out.suffix != ".toml":
        raise ConfigError(f"--out {out}: a fleet file is a TOML file; give it a name that ends in .toml")
    for line in write_fleet(new_file(out), robots, twin):
        typer.echo(line)


@app.command(epilog="Example: aucamp check fleet.toml --robot r1")
def check(
    fleet: FleetFile,
    robot: Annotated[str | None, typer.Option(help="This robot alone, whose computer this is.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """All that can be known before a dive: file, addresses, devices, calibrations, keys, disk. Nothing is started.

    One line for each thing: ok, warning or wrong, and what to do. Exit 1 if something is wrong.
    """
    from agent.ground.check import check as look

    _tell(look(fleet, robot, Path()), as_json)


@app.command(epilog="Example: aucamp keys fleet.toml --out keys")
def keys(
    fleet: FleetFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into; made where there is none.")],
    only: Annotated[
        str | None, typer.Option(metavar="NAME", help="For this one alone: a robot, observer or console that is new.")
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=3650, help="How long certificates are good.")] = 825,
) -> None:
    """A pair of signing keys for each robot, so that nobody can say of a target what another one measured.

    Where robots listen on tls/, also an authority of the fleet's own, and a certificate for each robot, observer and
    console. Nothing is ever overwritten; what goes where is said at the end.
    """
    from agent.ground.new_fleet import fleet_keys

    for line in fleet_keys(load_fleet(fleet), fleet, out, only, days):
        typer.echo(line)


@app.command(epilog="Example: aucamp doctor fleet.toml --as ann")
def doctor(
    fleet: FleetFile,
    name: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="As this console, observer or robot; else as one whose key is here."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Why robots of a running fleet do not hear each other, or us: ports, certificates, links, rules, clocks.

    One line for each thing: ok, warning or wrong, and what to do. Exit 1 unless all are ok.
    """
    from agent.ground.doctor import examine

    _tell(examine(fleet, name, Path()), as_json)


def _tell(found: Checked | Diagnosis, as_json: bool) -> NoReturn:
    """Show what was found, and end: 0 where all is well, else 1."""
    if as_json:
        typer.echo(json.dumps(found.as_json()))
    else:
        for finding in found.findings:
            typer.echo(finding)
        typer.echo(found.verdict)
    raise typer.Exit(0 if found.well else 1)


# --- snapshot and schema ---
# Look at a running fleet from outside: one picture, and what its messages look like.


@app.command(epilog="Example: aucamp snapshot fleet.toml --robot r1 --out r1.jpg")
def snapshot(
    fleet: FleetFile,
    robot: RobotName,
    out: Annotated[Path | None, typer.Option(help="File to write (JPEG); ROBOT.jpg if not given.")] = None,
    target: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Print the table that makes a thing in the picture a target, too."),
    ] = None,
) -> None:
    """The next picture of a running robot's camera, as the robot shows it. It does not notice."""
    from agent.ground.observe import about, check_target, next_picture, target_table
    from agent.process.certificates import credentials
    from agent.process.transport import LOOKER

    robots = load_fleet(fleet)
    load_robot(robots, robot, fleet)
    if target is not None:
        check_target(target, robots)
    path = new_file(out or Path(f"{robot}.jpg"))
    if path.suffix.lower() not in (".jpg", ".jpeg"):
        raise ConfigError(f"--out {path}: a robot shows JPEGs; give it a name that ends in .jpg")
    image = next_picture(robots, robot, credentials(robots, LOOKER, fleet))
    write_whole(path, image.jpeg)
    typer.echo(about(path, image))
    if target is not None:
        typer.echo(target_table(robots, target, path, image))


@app.command(epilog="Example: aucamp watch fleet.toml")
def watch(fleet: FleetFile) -> None:
    """A line for each robot of a running fleet, as they speak, until Ctrl-C. They do not notice."""
    from rich.live import Live
    from rich.text import Text

    from agent.ground import observe
    from agent.process.certificates import credentials
    from agent.process.transport import LOOKER

    robots, console = load_fleet(fleet), terminal()
    with until_signal() as stop:
        if not console.is_terminal:
            observe.watch(robots, credentials(robots, LOOKER, fleet), stop, lambda lines: typer.echo("\n".join(lines)))
            return
        with Live(console=console, auto_refresh=False) as live:

            def show(lines: list[str]) -> None:
                live.update(Text("\n".join(lines)), refresh=True)

            observe.watch(robots, credentials(robots, LOOKER, fleet), stop, show)


Page = StrEnum("Page", ["priorities", "sigma"])  # of what `aucamp explain` explains


@app.command(epilog="Example: aucamp explain priorities")
def explain(
    what: Annotated[
        Page,
        typer.Argument(
            help="priorities: who gets camera, body and lamp in a step; sigma: of what a run's sigmas are made."
        ),
    ],
    run: Annotated[Path | None, typer.Argument(metavar="RUN", help="sigma: folder of a run, or a recording.")] = None,
) -> None:
    """How a robot decides, or of what its sigma is made."""
    from rich.box import SIMPLE
    from rich.table import Table

    from agent.robot.arbiter import table
    from replay.check.explain import PARTS, sigma_parts
    from replay.files.recover import auto_recovered

    if what is Page.sigma:
        if run is None:
            raise ConfigError("sigma: of which run? Give its folder")
        shown = Table("robot", "target", "sigma, mm", *PARTS, box=SIMPLE)
        (there,) = auto_recovered([run], complain)
        rows: list[tuple[str, ...]] = sigma_parts(there)
    else:
        refuse_options("explain priorities", {"RUN": run}, ())
        shown = Table("resource", "who", "in a sweep of", "while another has the light", "takes it when", box=SIMPLE)
        rows = [*table()]
    for row in rows:
        shown.add_row(*row)
    terminal().print(shown)


@app.command(epilog="Example: aucamp schemas --out schemas")
def schemas(out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into: new, or empty.")]) -> None:
    """JSON Schemas of the messages on the network, and the table of keys, for programs of your own."""
    from agent.ground.schemas import write

    for path in write(run_folder(out)):
        typer.echo(path)


# --- order ---
# People in charge: what they tell robots that run.

Verb = StrEnum("Verb", [(verb, verb) for verb in VERBS])  # type: ignore[misc]


@app.command(epilog="Example: aucamp order fleet.toml --as ann hold r1 depth_m=0.3")
def order(
    fleet: FleetFile,
    verb: Annotated[Verb, typer.Argument(help="What to do; docs/orders.md says what each is and takes.")],
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[ROBOT|NAME=VALUE]...", help="Robots, or all; and how. Stops go to all if none is named."
        ),
    ] = None,
    console: Annotated[
        str, typer.Option("--as", metavar="NAME", help="Who orders: a console of the fleet file, by whose keys.")
    ] = "me",
) -> None:
    """Order robots that run, and say what each answered.

    Exit 0: all do it; 1: one refused, or did not answer; 2: bad input.
    """
    from agent.ground.console import give, line, typed, verdict

    robots = load_fleet(fleet)
    told = typed(robots, fleet, verb.value, words or ())
    outcomes = {}
    for robot, outcome in give(robots, fleet, console, told):
        outcomes[robot] = outcome
        typer.echo(line(robot, outcome))
    typer.echo(f"{told.verb}: {verdict(outcomes)}")
    raise typer.Exit(0 if all(outcome.ok for outcome in outcomes.values()) else 1)


# --- page ---
# A page to stand at: a running fleet or a recording in a browser.


@app.command(epilog="Example: aucamp page fleet.toml --as ann")
def page(
    what: Annotated[
        Path,
        typer.Argument(metavar="FLEET|RUN", help="Fleet file (TOML); or a run's folder, or its recording fleet.mcap."),
    ],
    console: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="Give orders, as this console of the fleet file; else only look."),
    ] = None,
    port: Port = 8766,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for what is recorded by the page's button.")
    ] = Path(),
) -> None:
    """A running fleet, or what was recorded of one, in a browser on this machine, until Ctrl-C.

    The address that is printed is good for this run, and for all who have it.
    """
    with until_signal() as stop:
        from agent.ground.page.server import run

        run(what, console, port, out, stop, typer.echo)


# --- bridge ---
# Bridges: a running fleet for programs that people already have.

SIMULATOR = "-35.363262,149.165237"  # where the simulator of ArduPilot stands, as those who know it know

BRIDGE_TAKES = {"mavlink": ("--origin", "--first-system"), "ros2": ("--domain",), "keelson": ()}


def as_place(text: str) -> tuple[float, float]:
    """LATITUDE,LONGITUDE in degrees. Raises ConfigError."""
    try:
        latitude_deg, longitude_deg = map(float, text.split(","))
    except ValueError:
        latitude_deg = longitude_deg = float("nan")
    if not (abs(latitude_deg) < 89 and abs(longitude_deg) <= 180):
        raise ConfigError(f"--origin '{text}': write latitude and longitude in degrees, such as 47.37,8.54")
    return latitude_deg, longitude_deg


@contextmanager
def extra(name: str, package: str) -> Iterator[None]:
    """Say which extra it takes where a package is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        if missing.name is None or missing.name.partition(".")[0] != package:
            raise
        raise ConfigError(f"this needs the extra `{name}`; {to_install(name)}") from None


@app.command(no_args_is_help=True, epilog="Example: aucamp bridge mavlink fleet.toml --as ann")
def bridge(
    kind: Annotated[Literal["mavlink", "ros2", "keelson"], typer.Argument(help="The language.")],
    fleet: FleetFile,
    name: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="mavlink: the console that orders; else the observer that looks."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=1024, max=65535, help="Of the other program on this machine; mavlink 14550, others 7447."),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="mavlink: where the tank's corner is drawn on the map: degrees, made up."),
    ] = None,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ros2: ROS_DOMAIN_ID; 0 if not given.")] = None,
    first_system: Annotated[
        int | None,
        typer.Option(min=1, max=250, help="mavlink: number of the first robot, 1 if not given; one for each fleet."),
    ] = None,
) -> None:
    """A running fleet for programs that speak another language, until Ctrl-C.

    \b
    mavlink  each robot as a submarine for a ground station, by UDP
    ros2     poses, targets and pictures for ROS 2 with rmw_zenoh
    keelson  attitude, place, pictures and log for programs of keelson

    A ground station may arm, disarm, hold and surface a robot, if --as is given; the others only look.
    """
    refuse_options(
        f"bridge {kind}", {"--origin": origin, "--domain": domain, "--first-system": first_system}, BRIDGE_TAKES[kind]
    )
    place, robots = as_place(origin or SIMULATOR), load_fleet(fleet)
    with until_signal() as stop:
        if kind == "mavlink":
            with extra("mavlink", "pymavlink"):
                from agent.ground.bridges.mavlink import Origin
                from agent.ground.bridges.mavlink import run as run_mavlink
            run_mavlink(robots, fleet, name, port or 14550, Origin(*place), stop, typer.echo, first_system or 1)
            return
        from agent.ground.bridges import outward

        language: outward.Language
        if kind == "ros2":
            with extra("ros", "rosbags"):
                from agent.ground.bridges.ros2 import Ros2
            language = Ros2(robots, domain or 0)
        else:
            with extra("keelson", "keelson"):
                from agent.ground.bridges.keelson import Keelson
            language = Keelson(robots)
        outward.run(robots, fleet, name, port or 7447, language, stop, typer.echo)


# --- board ---
# Orders to a robot's control module, whose agent does not run.


BOARD_TAKES = {"params": ("--set",), "tare": ("--depth",), "check": ("--no-hands",), "update": ("--files",)}


@app.command(no_args_is_help=True, epilog="Example: aucamp board check fleet.toml --robot r1")
def board(
    order: Annotated[
        Literal["info", "tare", "check", "params", "reboot", "update", "prompt"],
        typer.Argument(help="What its control module shall do."),
    ],
    fleet: FleetFile,
    robot: RobotName,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="params: set this one and save it; again for more."),
    ] = None,
    depth: Annotated[
        float | None, typer.Option(metavar="M", help="tare: how deep the sensors are; in air if not given.")
    ] = None,
    no_hands: Annotated[
        bool, typer.Option("--no-hands", help="check: thrusters alone, nobody turns the switch or presses corners.")
    ] = False,
    files: Annotated[
        Path | None, typer.Option(metavar="DIR", help="update: what `make firmware` made; this release's if not given.")
    ] = None,
) -> None:
    """A control module whose agent does not run.

    \b
    info      what it says of itself
    tare      before each dive: what its sensors read in air, lying still
    check     after each work on wires, in the water: kill switch, sensors, T1
              to T4, and which wire is wrong; without it no module arms
    params    its parameters; set ones are saved
    reboot    begin anew: what latched it is over, what was set and not saved
              is lost. Look at the robot first: it was latched for a reason
    update    new firmware over the tether, beside the old one; where the new
              one does not answer, the old one runs again
    prompt    MicroPython's prompt on the tether, for 10 minutes

    Refused while its motors are on.
    """
    from agent.ground import board as bench
    from agent.ground import board_update

    given: dict[str, object] = {"--set": set_ or None, "--depth": depth, "--no-hands": no_hands or None}
    refuse_options(f"board {order}", given | {"--files": files}, BOARD_TAKES.get(order, ()))
    if order == "update":
        with_bar(
            plain_console(stderr=True),
            "writing",
            lambda show: board_update.update(fleet, robot, files, complain, show, bench.LIMIT_S),
        )
        return
    if order == "prompt":
        board_update.prompt(fleet, robot, complain, bench.LIMIT_S)
        return
    bench.run(order, fleet, robot, complain, bench.numbers(set_ or ()), depth, not no_hands)
