"""fleet.toml -> frozen structs. Every mistake is one line: the file, the key, and what to change."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import tomli_w
from msgspec import Meta

from agent.remedies import explain

Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,15}$")]
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Device = Annotated[str, Meta(min_length=1)]
Protocol = Literal["paper", "metropolis", "evidence"]
Colour = Literal["red", "yellow", "green"]
Cues = Literal["both", "focus", "size"]

T = TypeVar("T")

MAX_PORT = 32767  # ports above are handed out by the kernel as ephemeral source ports


class ConfigError(ValueError):
    """A file that a user wrote cannot be used; the message is one line that says what to change."""


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all configuration: immutable, and a key that nobody knows is an error."""


class Tank(Struct, frozen=True, kw_only=True):
    """Where an estimate can be. World frame: origin at the lower left corner of the floor, z up."""

    size_m: tuple[Positive, Positive, Positive] = (1.5, 1.2, 0.8)
    surface_m: Positive = 0.5  # height of the water surface above the floor


class Water(Struct, frozen=True, kw_only=True):
    """The index is for everybody who bends rays; `kind`, how murky it is, for the twin alone."""

    refractive_index: Annotated[float, Meta(ge=1.0, le=1.5)] = 1.333
    kind: Literal["air", "tap", "pool", "coastal", "turbid"] = "tap"


class Target(Struct, frozen=True, kw_only=True):
    """What the robots look for: a ball, told from others by its colour, or whatever a box in a picture shows."""

    detector: Literal["ball", "box"] = "ball"
    # of a ball
    colour: Colour = "red"
    radius_m: Positive | None = None  # None: a thing in a box, whose size nobody knows
    radius_sigma_m: Annotated[float, Meta(ge=0)] = 0.0001  # how well it is known: callipers, 0.2 mm on the diameter
    # of a box; files are looked for beside the fleet file
    picture: str | None = None  # taken by a camera of the fleet
    box: tuple[float, float, float, float] | None = None  # around the thing in it: x, y, width, height in pixels
    models: str | None = None  # folder with NanoTrack's two files; without them OpenCV's MIL follows the box


class Ranging(Struct, frozen=True, kw_only=True):
    cues: Cues = "both"  # range from the focus, from the apparent size of a known target, or from both


class Estimation(Struct, frozen=True, kw_only=True):
    protocol: Protocol = "evidence"
    iteration_s: Positive = 1.0  # the paper's t -> t + 1: one attempt to measure, one update
    validity_s: Positive = 0.5  # a neighbour unheard for longer leaves the valid set


class Link(Struct, frozen=True, kw_only=True):
    send_hz: Annotated[float, Meta(gt=0, le=20)] = 10.0  # at most once a step of the agent
    loss: Share = 0.0  # fault injection: share of outgoing link messages thrown away
    loss_seed: int = 0


class Camera(Struct, frozen=True, kw_only=True):
    width_px: Annotated[int, Meta(ge=64)] = 640
    height_px: Annotated[int, Meta(ge=64)] = 480
    settle_s: Positive = 0.05  # lens at rest after a focus command
    sweep_steps: Annotated[int, Meta(ge=8)] = 30
    enhance: bool = False  # look again, enhanced, where a frame shows no target; clarity is always the raw frame's


class Body(Struct, frozen=True, kw_only=True):
    """Where the camera sits and how its gimbal turns, the same on every robot of the fleet."""

    camera_m: tuple[float, float, float] = (0.10, 0.0, 0.0)  # gimbal pivot, body frame
    servo_centre_us: float = 1500.0
    servo_us_per_deg: Positive = 2000.0 / 180.0
    pan_limit_deg: tuple[float, float] = (-90.0, 90.0)
    tilt_limit_deg: tuple[float, float] = (-60.0, 30.0)


class Pose(Struct, frozen=True, kw_only=True):
    """Surveyed pose of the body's centre; height, roll and pitch come from the pressure sensors."""

    x_m: float
    y_m: float
    yaw_deg: float


class Look(Struct, frozen=True, kw_only=True):
    """Gimbal direction while nothing is known: pan positive to the left, tilt positive upwards."""

    pan_deg: float = 0.0
    tilt_deg: float = 0.0


class Robot(Struct, frozen=True, kw_only=True):
    neighbours: tuple[Name, ...] = ()
    listen: str
    serial: Device
    camera: Device
    pose: Pose
    depth_m: Positive = 0.40  # hover set-point
    look: Look = Look()
    calibration: str


class Twin(Struct, frozen=True, kw_only=True):
    """Only the twin reads this: which scene, which world of that scene, where its sockets are."""

    scene: str = "tank"
    seed: Annotated[int, Meta(ge=0)] = 0
    dir: str | None = None


class Fleet(Struct, frozen=True, kw_only=True):
    fleet: Name
    tank: Tank = Tank()
    water: Water = Water()
    target: dict[Name, Target]
    ranging: Ranging = Ranging()
    estimation: Estimation = Estimation()
    link: Link = Link()
    camera: Camera = Camera()
    body: Body = Body()
    robot: dict[Name, Robot]
    twin: Twin = Twin()


def load_fleet(path: Path) -> Fleet:
    """Read and check a fleet file. Raises ConfigError with one line."""
    fleet = convert(read_toml(path), Fleet, path)
    _check(fleet, path)
    return msgspec.structs.replace(fleet, target={name: _found(t, path.parent) for name, t in fleet.target.items()})


def _found(target: Target, folder: Path) -> Target:
    """Its files, which count from the fleet file's folder, by their full paths: copies of the file lie elsewhere."""
    full = {key: str((folder / name).resolve()) for key in ("picture", "models") if (name := getattr(target, key))}
    return msgspec.structs.replace(target, **full)


def load_robot(fleet: Fleet, name: str, path: Path) -> Robot:
    """The robot called `name`, or ConfigError naming those that exist."""
    if name not in fleet.robot:
        raise ConfigError(f"{path}: no robot '{name}'; the file has {', '.join(fleet.robot)}")
    return fleet.robot[name]


def dump(struct: msgspec.Struct) -> str:
    """The TOML text from which the same struct is read again."""

    def drop_none(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: drop_none(v) for k, v in value.items() if v is not None}
        return value

    return tomli_w.dumps(drop_none(msgspec.to_builtins(struct)))


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; every failure is a ConfigError."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; give the path of an existing TOML file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give the path of a TOML file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file; give the path of a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None


def convert(data: dict[str, Any], kind: type[T], path: Path) -> T:
    """Check parsed TOML against a struct; the message names file, key and remedy."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {explain(error, data, kind)}") from None


def _check(fleet: Fleet, path: Path) -> None:
    """What a type cannot say. Raises ConfigError for the first rule that is broken."""
    for key, remedy in _broken_rules(fleet):
        raise ConfigError(f"{path}: key '{key}': {remedy}")


def _broken_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    for key in _not_finite(msgspec.to_builtins(fleet)):
        yield key, "not a finite number; correct the value"
    if not fleet.robot:
        yield "robot", "the fleet has no robot; add a table [robot.r1]"
    if not fleet.target:
        yield "target", "nothing to look for; add a table [target.ball]"
    yield from _tank_rules(fleet)
    yield from _rate_rules(fleet)
    for limits in ("pan_limit_deg", "tilt_limit_deg"):
        lowest, highest = getattr(fleet.body, limits)
        if lowest >= highest:
            yield f"body.{limits}", f"{lowest} is not below {highest}; write the lower limit first"
    for name in fleet.robot:
        for key, remedy in (*_neighbour_rules(fleet, name), *_place_rules(fleet, name)):
            yield f"robot.{name}.{key}", remedy
    yield from _device_rules(fleet)


def _not_finite(value: Any, key: str = "") -> Iterator[str]:
    """Keys of the numbers that are infinite or not a number."""
    if isinstance(value, float) and not math.isfinite(value):
        yield key
    if isinstance(value, dict):
        for name, child in value.items():
            yield from _not_finite(child, f"{key}.{name}" if key else name)
    if isinstance(value, list | tuple):
        for i, child in enumerate(value):
            yield from _not_finite(child, f"{key}[{i}]")


def _tank_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    tank = fleet.tank
    if tank.surface_m > tank.size_m[2]:
        yield "tank.surface_m", f"{tank.surface_m} is above the rim; the tank is {tank.size_m[2]} m high"
    wearer: dict[str, str] = {}
    for name, target in fleet.target.items():
        yield from _target_rules(fleet, name)
        if target.detector != "ball":
            continue
        if target.colour in wearer:
            other = wearer[target.colour]
            why = f"'{other}' is {target.colour} too and nobody could tell them apart; give each target its own colour"
            yield f"target.{name}.colour", why
        wearer[target.colour] = name


def _target_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """A target has what its detector needs, and nothing that belongs to the other one."""
    target, key = fleet.target[name], f"target.{name}"
    belongs = {"radius_m": "ball", "picture": "box", "box": "box", "models": "box"}
    for one, detector in belongs.items():
        given = getattr(target, one) is not None
        if given and detector != target.detector:
            yield f"{key}.{one}", f"only a {detector} has one; remove it, or correct the detector"
        if not given and detector == target.detector and one != "models":
            yield key, f"required key `{one}` is missing; add it"
    if target.radius_m is not None and 2.0 * target.radius_m > min(fleet.tank.size_m):
        yield f"{key}.radius_m", f"{target.radius_m} m does not fit into the tank; correct the value"
    if target.box is not None:
        x, y, width, height = target.box
        if not (min(x, y) >= 0 and min(width, height) > 0):
            yield f"{key}.box", f"{list(target.box)} is no box; write [x, y, width, height], pixels"
        if fleet.ranging.cues == "size":
            yield "ranging.cues", f"the size of '{name}' is not known; take 'both' or 'focus'"


def _rate_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    validity_s, send_hz = fleet.estimation.validity_s, fleet.link.send_hz
    if validity_s * send_hz < 1.0:
        why = f"{validity_s} s is shorter than the time between two messages, {1.0 / send_hz:.2f} s; make it longer"
        yield "estimation.validity_s", why


def _neighbour_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """The graph is symmetric."""
    neighbours = fleet.robot[name].neighbours
    for other in neighbours:
        if other == name:
            yield "neighbours", f"'{name}' names itself; remove it"
        elif other not in fleet.robot:
            yield "neighbours", f"no robot '{other}'; remove it or add a table [robot.{other}]"
        elif name not in fleet.robot[other].neighbours:
            yield "neighbours", f"names '{other}', but '{other}' does not name '{name}'; add '{name}' there"
    if len(set(neighbours)) != len(neighbours):
        yield "neighbours", "a name stands twice; remove one"


def _place_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """Where a robot is and looks can be."""
    robot, tank, body = fleet.robot[name], fleet.tank, fleet.body
    for axis, at_m, size_m in zip("xy", (robot.pose.x_m, robot.pose.y_m), tank.size_m, strict=False):
        if not 0.0 <= at_m <= size_m:
            yield (
                f"pose.{axis}_m",
                f"{at_m} is outside the tank; write metres from its corner, 0 to {size_m}",
            )
    if robot.depth_m > tank.surface_m:
        yield "depth_m", f"{robot.depth_m} is below the floor; the water is {tank.surface_m} m deep"
    looks = ("pan", robot.look.pan_deg, body.pan_limit_deg), ("tilt", robot.look.tilt_deg, body.tilt_limit_deg)
    for axis, at_deg, (lowest, highest) in looks:
        if not lowest <= at_deg <= highest:
            yield f"look.{axis}_deg", f"{at_deg} is beyond the gimbal's limit; choose {lowest:g} to {highest:g}"


def _device_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Addresses can be used; addresses and devices are each robot's own. Another computer has other devices."""
    owner: dict[tuple[str, str], str] = {}
    for name, robot in fleet.robot.items():
        if wrong := _wrong_endpoint(robot.listen):
            yield f"robot.{name}.listen", wrong
        for key, device in (("serial", robot.serial), ("camera", robot.camera)):
            if device.startswith("twin:") and "/" not in device and device != f"twin:{name}":
                yield f"robot.{name}.{key}", f"'{device}' is not this robot's; write twin:{name}"
        address = robot.listen.partition("/")[2]
        host = address.rpartition(":")[0]
        held = [("listen", address, "port"), ("serial", f"{host} {robot.serial}", "control module")]
        if robot.camera.startswith(("twin:", "v4l2:")):  # recorded pictures may be looked at by many
            held.append(("camera", f"{host} {robot.camera}", "camera"))
        for key, what, kind in held:
            if (key, what) in owner:
                text, other = getattr(robot, key), owner[key, what]
                yield f"robot.{name}.{key}", f"'{text}' is also that of '{other}'; give each robot its own {kind}"
            owner[key, what] = name


def _wrong_endpoint(text: str) -> str | None:
    """What is wrong with a Zenoh endpoint, tcp/HOST:PORT; None if nothing is."""
    protocol, _, address = text.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or not host or not port.isdigit():
        return f"'{text}' is no endpoint; write tcp/HOST:PORT"
    if host in ("0.0.0.0", "[::]"):
        return f"neighbours dial it, and {host} is no address to dial; write the computer's own"
    if not 1024 <= int(port) <= MAX_PORT:
        return f"port {port}; choose one from 1024 to {MAX_PORT}"
    return None
