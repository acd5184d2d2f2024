"""A scene file -> frozen structs: the world that the twin simulates and the agents never see described."""

from __future__ import annotations

import zlib
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from agent.core.config import Colour, ConfigError, Fleet, Name, Positive, Struct, WaterKind, convert, read_toml
from agent.core.messages import Vector
from hw.twin.faults import KINDS, AnyEvent

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
    name: str | None = None  # of a target that robots know from a picture: what tells who judges which one it was
    colour: Colour = "red"  # of a ball; stones and boxes are grey
    position_m: tuple[float, float, float]
    radii_m: tuple[Positive, Positive, Positive]  # of a box half its length, breadth and height
    turn_deg: Vector = (0.0, 0.0, 0.0)  # yaw, pitch, roll: R = Rz Ry Rx


class Creature(Struct, frozen=True, kw_only=True):
    """A fish. Two of one colour look alike, but for their blotches."""

    name: Name
    colour: Literal["orange", "silver", "brown"] = "orange"
    like: Name | None = None  # a creature whose very blotches it has too: to tell them apart, one must have followed
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
    """What tugs at a robot's tether: horizontal, at random, with the time after which it has forgotten itself."""

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
    camera: str = "imx519_640"  # preset of hw.twin.optics.lens
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
    """The scene that the fleet file names, filled with the water that it names."""
    scene = load_scene(fleet.twin.scene)
    return msgspec.structs.replace(scene, water=msgspec.structs.replace(scene.water, preset=fleet.water.kind))


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
    """Where the crew really puts a robot (x_m, y_m, yaw_deg) that shall start as `said`: two sigma off at most."""
    if not (sigma.place_m or sigma.yaw_deg):
        return said
    off = np.clip(generator(seed, robot, "start").standard_normal(3), -2, 2)
    x, y, yaw = np.array(said) + off * (sigma.place_m, sigma.place_m, sigma.yaw_deg)
    return float(x), float(y), float(yaw)


def generator(seed: int, *names: str) -> np.random.Generator:
    """The random stream of one purpose ('r1', 'lens'): adding a purpose never changes another's numbers."""
    return np.random.Generator(np.random.PCG64([seed, *(zlib.crc32(name.encode()) for name in names)]))
