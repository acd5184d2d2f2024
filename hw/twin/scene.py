"""A scene file -> frozen structs: the world that the twin simulates and the agents never see described."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta

from agent.core.config import (
    CameraPreset,
    Colour,
    ConfigError,
    Fleet,
    Name,
    Positive,
    Struct,
    WaterKind,
    convert,
    read_toml,
)
from agent.core.messages import Vector

# --- events: what happens in a dive, each at its time and most of it to one robot ---
#
# hw.twin.dive applies them.
#
# [[event]]
# at_s = 40.0           # since the twin began
# kind = "serial_unplug"
# robot = "r1"
# for_s = 5.0

Sensor = Annotated[int, Meta(ge=1, le=4)]
Thruster = Annotated[int, Meta(ge=1, le=8)]


class Event(Struct, frozen=True, kw_only=True, tag_field="kind"):
    at_s: Annotated[float, Meta(ge=0)]


class Fault(Event, frozen=True, kw_only=True):
    robot: Name


class Push(Fault, frozen=True, kw_only=True, tag="push"):
    force_n: Vector  # world frame
    point_m: Vector = (0.0, 0.0, 0.0)  # body frame
    for_s: Positive


class SensorDead(Fault, frozen=True, kw_only=True, tag="sensor_dead"):
    """A pressure sensor answers no more."""

    sensor: Sensor


class SensorStuck(Fault, frozen=True, kw_only=True, tag="sensor_stuck"):
    """A pressure sensor repeats its last reading."""

    sensor: Sensor


class SensorOffset(Fault, frozen=True, kw_only=True, tag="sensor_offset"):
    """A pressure sensor reads so much too deep."""

    sensor: Sensor
    offset_m: float


class SensorWell(Fault, frozen=True, kw_only=True, tag="sensor_well"):
    """The end of a pressure sensor's faults."""

    sensor: Sensor


class GyroDead(Fault, frozen=True, kw_only=True, tag="gyro_dead"):
    """The gyro answers no more; nothing to a robot without one."""


class GyroStuck(Fault, frozen=True, kw_only=True, tag="gyro_stuck"):
    """The gyro repeats its last reading."""


class Leak(Fault, frozen=True, kw_only=True, tag="leak"):
    """Water at the probe in the hull."""


class Battery(Fault, frozen=True, kw_only=True, tag="battery"):
    volts: Positive  # without load


class ThrusterDead(Fault, frozen=True, kw_only=True, tag="thruster_dead"):
    thruster: Thruster


class ThrusterGain(Fault, frozen=True, kw_only=True, tag="thruster_gain"):
    thruster: Thruster
    gain: float  # on what it gave before; negative: mounted the wrong way round


class Crossed(Fault, frozen=True, kw_only=True, tag="crossed"):
    """Two thrusters, or two pressure sensors, hang on each other's wires."""

    what: Literal["thrusters", "sensors"]
    pair: tuple[Sensor, Sensor]  # of the four at the corners


class KillSwitch(Fault, frozen=True, kw_only=True, tag="kill_switch"):
    """The loop of the kill switch is opened or closed; a broken wire is open for good."""

    to: Literal["open", "closed", "broken"]


class SerialUnplug(Fault, frozen=True, kw_only=True, tag="serial_unplug"):
    for_s: Positive


class PowerCut(Fault, frozen=True, kw_only=True, tag="power_cut"):
    """Board and thrusters without power."""

    for_s: Positive


class FirmwareHang(Fault, frozen=True, kw_only=True, tag="firmware_hang"):
    """The firmware's process stops, until the watchdog resets it."""


class SlowBoard(Fault, frozen=True, kw_only=True, tag="slow_board"):
    """Every cycle takes so many times as long as the twin's table of cycle times says."""

    by: Annotated[float, Meta(ge=0, le=100)]


class TetherPull(Fault, frozen=True, kw_only=True, tag="tether_pull"):
    """Something tugs at the tether, horizontally and at random; meanwhile the scene's own pull rests."""

    force_n: Annotated[float, Meta(ge=0)]  # root of the mean square
    correlation_s: Positive = 4.0
    for_s: Positive


class CastOff(Fault, frozen=True, kw_only=True, tag="cast_off"):
    """The mooring lets go: from now on the robot swims."""


class CurrentSet(Event, frozen=True, kw_only=True, tag="current"):
    """The current changes; the water follows within seconds."""

    velocity_m_s: Vector


class Occlude(Event, frozen=True, kw_only=True, tag="occlude"):
    """A stone of the scene is moved, straight and steadily, to where it hides something."""

    solid: Annotated[int, Meta(ge=0)]  # number of its table [[solid]], the first is 0
    to_m: Vector
    over_s: Positive


class TagLost(Event, frozen=True, kw_only=True, tag="tag_lost"):
    """A tag is seen no more: it fell off, or something grew over it."""

    id: Annotated[int, Meta(ge=0)]


class Startle(Event, frozen=True, kw_only=True, tag="startle"):
    """Something frightens a creature, which flees, from the nearest robot if there is one."""

    creature: Name
    speed_m_s: Annotated[float, Meta(gt=0, le=1)]
    for_s: Positive


AnyEvent = (
    Push
    | SensorDead
    | SensorStuck
    | SensorOffset
    | SensorWell
    | GyroDead
    | GyroStuck
    | Leak
    | Battery
    | ThrusterDead
    | ThrusterGain
    | Crossed
    | KillSwitch
    | SerialUnplug
    | PowerCut
    | FirmwareHang
    | SlowBoard
    | TetherPull
    | CastOff
    | CurrentSet
    | Occlude
    | TagLost
    | Startle
)
KINDS = tuple(str(event.__struct_config__.tag) for event in get_args(AnyEvent))


def check(
    events: Sequence[AnyEvent],
    robots: Sequence[str],
    movable: Sequence[int],
    tags: Sequence[int],
    creatures: Sequence[str] = (),
) -> None:
    """Raise ConfigError for an event that nothing in this dive can meet.

    movable: numbers of the solids that are stones and no targets; tags: ids of those in the tank.
    """
    for event in events:
        what, there = None, tuple[object, ...]()
        match event:
            case Fault() if event.robot not in robots:
                what, there = f"no robot '{event.robot}' dives", tuple(robots)
            case Occlude() if event.solid not in movable:
                what, there = f"solid {event.solid} of the scene is no stone that may be moved", tuple(movable)
            case TagLost() if event.id not in tags:
                what, there = f"the fleet file has no tag {event.id}", tuple(tags)
            case Startle() if event.creature not in creatures:
                what, there = f"the scene has no creature '{event.creature}'", tuple(creatures)
        if what is not None:
            remedy = f"name one of {', '.join(map(str, there))}" if there else "take the event out"
            raise ConfigError(f"event at {event.at_s} s: {what}; {remedy}")


# --- scene ---

SCENES = Path(str(resources.files("hw.twin") / "scenes"))  # those that ship with the package

BESIDE_M = 0.12  # camera to lamp, where the fleet file says nothing of lamps

Coefficient = Annotated[float, Meta(gt=0, le=20)]
Coefficients = tuple[Coefficient, Coefficient, Coefficient]


class SceneWater(Struct, frozen=True, kw_only=True):
    preset: WaterKind = "tap"
    grey_per_m: float = 0.15  # scattering by particles, the same in all colours
    # Blue, green, red; both or neither. With them lamps shine, and the preset does not matter.
    absorption_per_m: Coefficients | None = None
    scattering_per_m: Coefficients | None = None


class Solid(Struct, frozen=True, kw_only=True):
    """An ellipsoid or a box that stands where it is put. The agents' targets are among these."""

    kind: Literal["ball", "stone", "box"]
    name: str | None = None  # of a target that robots know from a picture: the evaluation tells by it which one it was
    colour: Colour = "red"  # of a ball; stones and boxes are grey
    position_m: tuple[float, float, float]
    radii_m: tuple[Positive, Positive, Positive]  # of a box half its length, breadth and height
    turn_deg: Vector = (0.0, 0.0, 0.0)  # yaw, pitch, roll: R = Rz Ry Rx


class Creature(Struct, frozen=True, kw_only=True):
    """A fish. Two of one colour look alike, but for their blotches."""

    name: Name
    colour: Literal["orange", "silver", "brown"] = "orange"
    like: Name | None = None  # a creature with the same blotches: only a robot that has followed both tells them apart
    length_m: Annotated[float, Meta(ge=0.05, le=0.4)] = 0.15
    speed_m_s: Annotated[float, Meta(gt=0, le=0.5)] = 0.15  # while it cruises
    path: Literal["wander"] | Annotated[tuple[Vector, ...], Meta(min_length=2)] = "wander"  # or round and round
    position_m: Vector | None = None  # where it starts; None: at the first point of its path, or anywhere


class Waves(Struct, frozen=True, kw_only=True):
    """A standing wave along the tank's x axis."""

    amplitude_m: Annotated[float, Meta(ge=0)] = 0.0  # of the surface at the walls
    mode: Annotated[int, Meta(ge=1)] = 1  # half wavelengths in the tank


class Current(Struct, frozen=True, kw_only=True):
    """How the water flows, everywhere alike."""

    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    gust_m_s: Annotated[float, Meta(ge=0)] = 0.0  # standard deviation of what comes and goes, in x and in y


class Pull(Struct, frozen=True, kw_only=True):
    """What tugs at a robot's tether: horizontal, at random, with a correlation time."""

    force_n: Annotated[float, Meta(ge=0)] = 0.0  # root of the mean square
    correlation_s: Positive = 4.0


class StartSigma(Struct, frozen=True, kw_only=True):
    """How far, in one standard deviation, a robot is put off the pose of the fleet file."""

    place_m: Annotated[float, Meta(ge=0)] = 0.0  # in x and in y
    yaw_deg: Annotated[float, Meta(ge=0)] = 0.0


class Scene(Struct, frozen=True, kw_only=True):
    name: str
    water: SceneWater = SceneWater()
    # Radiance of the ambient light at the surface: 1 is full scale; in water of known absorption and scattering W/m2/sr
    room_light: Annotated[float, Meta(ge=0)] = 0.5
    white_card: Literal["upright", "lying"] = "upright"  # what the exposure is set by; upright, lying paper burns out
    camera: CameraPreset = "imx519_640"
    solid: tuple[Solid, ...] = ()
    creature: tuple[Creature, ...] = ()
    waves: Waves = Waves()
    moored: bool = True  # False: a robot swims freely from when it is armed on
    start_sigma: StartSigma = StartSigma()
    current: Current = Current()
    tether_pull: Pull = Pull()
    motion_blur: bool = False
    event: tuple[AnyEvent, ...] = ()


def load_scene(name: str) -> Scene:
    """A scene that ships with the package, or the path of a TOML file. Raises ConfigError."""
    path = Path(name) if name.endswith(".toml") else SCENES / f"{name}.toml"
    if not path.exists():
        shipped = ", ".join(sorted(scene.stem for scene in SCENES.glob("*.toml")))
        raise ConfigError(f"scene '{name}': no such scene; give one of {shipped}, or the path of a .toml file")
    data = read_toml(path)
    events = data.get("event", [])
    for i, event in enumerate(events if isinstance(events, list) else []):
        kind = event.get("kind") if isinstance(event, dict) else None
        if kind not in KINDS:
            raise ConfigError(f"{path}: key 'event[{i}].kind': {kind!r} is none of {', '.join(KINDS)}; correct it")
    scene = convert(data, Scene, path)
    if (scene.water.absorption_per_m is None) != (scene.water.scattering_per_m is None):
        raise ConfigError(f"{path}: key 'water': give absorption_per_m and scattering_per_m, or neither")
    if not scene.room_light and scene.water.absorption_per_m is None:
        raise ConfigError(
            f"{path}: key 'room_light': in the dark, lamps need water.absorption_per_m and scattering_per_m"
        )
    return scene


def scene_of(fleet: Fleet) -> Scene:
    """The scene that the fleet file names, filled with the water and seen by the cameras that it names."""
    scene = load_scene(fleet.twin.scene)
    water = msgspec.structs.replace(scene.water, preset=fleet.water.kind)
    return msgspec.structs.replace(scene, water=water, camera=fleet.twin.camera or scene.camera)


def in_daylight(scene: Scene) -> Scene:
    """The same with clear water and light from above, if it has lamps: a tank in which cameras are calibrated."""
    if scene.water.absorption_per_m is None:
        return scene
    water = SceneWater(preset=scene.water.preset)
    return msgspec.structs.replace(scene, water=water, room_light=Scene(name=scene.name).room_light)


def lamp_place(fleet: Fleet, scene: Scene) -> Vector | None:
    """Where in a robot's body the pivot of its lamp is: left of the camera's. None: lamps do not show in this water."""
    if scene.water.absorption_per_m is None:
        return None
    x, y, z = fleet.body.camera_m
    return x, y + (BESIDE_M if fleet.lighting is None else fleet.lighting.beam.beside_m), z


def put_off(sigma: StartSigma, said: tuple[float, float, float], seed: int, robot: str) -> tuple[float, float, float]:
    """Where the crew really puts a robot (x_m, y_m, yaw_deg) that is to start as `said`: two sigma off at most."""
    if not (sigma.place_m or sigma.yaw_deg):
        return said
    off = np.clip(generator(seed, robot, "start").standard_normal(3), -2, 2)
    x, y, yaw = np.array(said) + off * (sigma.place_m, sigma.place_m, sigma.yaw_deg)
    return float(x), float(y), float(yaw)


def generator(seed: int, *names: str) -> np.random.Generator:
    """The random stream of one purpose ('r1', 'lens'): adding a purpose never changes another's numbers."""
    return np.random.Generator(np.random.PCG64([seed, *(zlib.crc32(name.encode()) for name in names)]))


# --- targets of a fleet in a scene ---


def target_solids(fleet: Fleet, scene: Scene, fleet_path: Path) -> dict[str, Solid]:
    """A ball is known by its colour, a box target by its name, where the scene has one of the target's name.

    Raises ConfigError when the scene has no ball, or two, of the colour, or two solids of the name.
    """
    found = {}
    for name, target in fleet.target.items():
        if target.detector == "creature":
            continue
        if target.detector == "ball":
            what = f"{target.ball_colour} {target.detector}"
            like = [s for s in scene.solid if (s.kind, s.colour) == (target.detector, target.ball_colour)]
            remedy = "take another colour, or another scene in [twin]"
        else:
            what, like = f"solid called {name}", [s for s in scene.solid if s.name == name]
            remedy = "give each a name of its own"
            if not like:
                continue
        if len(like) != 1:
            raise ConfigError(
                f"{fleet_path}: key 'target.{name}': scene '{scene.name}' has {len(like)} times a {what}; {remedy}"
            )
        found[name] = like[0]
    return found


def target_creatures(fleet: Fleet, scene: Scene, fleet_path: Path) -> dict[str, Creature]:
    """A creature is known by its name. A box target too may be one, where no solid has its name.

    Raises ConfigError for a target that is one and has no speed in the fleet file: no robot could follow it.
    """
    swimming = {creature.name: creature for creature in scene.creature}
    found = {
        name: swimming[name] for name, target in fleet.target.items() if name in swimming and target.detector != "ball"
    }
    for name in found:
        if fleet.target[name].speed_m_s is None:
            raise ConfigError(
                f"{fleet_path}: key 'target.{name}': it swims in scene '{scene.name}'; add `speed_m_s` and `turn_s`"
            )
    return found
