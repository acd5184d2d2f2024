"""The tables of fleet.toml as frozen structs, and files into structs and back.

agent/robot/fleet_reader.py reads a fleet file and checks it against its rules.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISREG
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import tomli_w
from msgspec import Meta

from agent.core.codec import MOST_DEEP, as_text, printable, too_deep
from agent.core.messages import Id

# --- fleet file ---

Name = Id  # of a fleet, a robot, a target, a console
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Device = Annotated[str, Meta(min_length=1)]
Protocol = Literal["paper", "metropolis", "evidence"]
Colour = Literal["red", "orange", "yellow", "green"]
Cues = Literal["both", "focus", "size"]
MainsHz = Literal[50, 60]
Face = Literal["x0", "x1", "y0", "y1", "floor"]  # walls at x = 0 and the far end of x, likewise y
WaterKind = Literal["air", "tap", "pool", "coastal", "turbid"]
CameraPreset = Literal["imx519_640", "binned_640", "crop_1280", "fixed_640"]  # hw.twin.optics.lens has their figures
Coefficient = Annotated[float, Meta(gt=0, le=20)]
Bands = tuple[Coefficient, Coefficient, Coefficient]  # blue, green, red


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all configuration: immutable, and an unknown key is an error."""


class ConfigError(ValueError):
    """A file that a user wrote cannot be used; the message is one line that says what to change."""


class Tank(Struct, frozen=True, kw_only=True):
    """Where an estimate can be. World frame: origin at the lower left corner of the floor, z up."""

    size_m: tuple[Positive, Positive, Positive] = (1.5, 1.2, 0.8)
    surface_m: Positive = 0.5  # height of the water surface above the floor


class Water(Struct, frozen=True, kw_only=True):
    """All that refracts rays uses the index; only the twin uses `kind`, how murky the water is."""

    refractive_index: Annotated[float, Meta(ge=1.0, le=1.5)] = 1.333
    kind: WaterKind = "tap"


class Target(Struct, frozen=True, kw_only=True):
    """What the robots look for: a ball, told from others by its colour, whatever a box in a picture shows, or a
    creature of a colour, whatever its shape."""

    detector: Literal["ball", "box", "creature"] = "ball"
    colour: Colour | None = None  # of a ball or a creature: red if not given
    # of a creature: from nose to tail, about; a part of it that is seen gives a bearing as the whole would, about. Of a
    # thing in a box: its longest side, by which a camera of fixed focus knows its range to a quarter
    length_m: Annotated[float, Meta(gt=0, le=2)] | None = None
    # of a ball
    radius_m: Positive | None = None  # None: a thing in a box, of unknown size
    radius_sigma_m: Annotated[float, Meta(ge=0)] = 0.0001  # how well it is known: callipers, 0.2 mm on the diameter
    # of what swims by itself; both or neither
    speed_m_s: Annotated[float, Meta(gt=0, le=1)] | None = None
    turn_s: Annotated[float, Meta(ge=0.2, le=60)] | None = None  # how long it keeps a course, about
    # of a box, or of a ball or creature whose colour is sampled, not named; files are looked for beside the fleet file
    picture: str | None = None  # taken by a camera of the fleet
    # around the thing in it, or on a part of the ball or creature: x, y, width, height in pixels
    box: tuple[float, float, float, float] | None = None
    models: str | None = None  # folder with NanoTrack's two files; without them a correlation filter follows it

    @property
    def ball_colour(self) -> Colour:
        return self.colour or "red"


class Ranging(Struct, frozen=True, kw_only=True):
    cues: Cues = "both"  # range from the focus, from the apparent size of a known target, or from both


class Budget(Struct, frozen=True, kw_only=True):
    """What a careful laboratory has wrong and cannot see in the data: standard deviations. What cameras have wrong
    stands in their calibrations."""

    # the same on all robots: it does not fall with their number, and no two of them can notice it
    level_m: Annotated[float, Meta(ge=0)] = 0.0015  # height of the water in the frame of the tank
    survey_m: Annotated[float, Meta(ge=0)] = 0.001  # that frame itself, in x and in y: a tape's, or the map's of tags
    scale: Annotated[float, Meta(ge=0, le=0.1)] = 0.0015  # share of all ranges: refractive index, print of the chart
    # of each robot by itself; of one that swims, its filter says how well it knows its place and heading
    place_m: Annotated[float, Meta(ge=0)] = 0.0014  # in x and in y: surveyed to 1 mm, and moored to 1 mm
    height_m: Annotated[float, Meta(ge=0)] = 0.0004  # what the tare leaves
    heading_deg: Annotated[float, Meta(ge=0)] = 0.14  # surveyed to 0.1 degrees, and moored to 0.1
    attitude_deg: Annotated[float, Meta(ge=0)] = 0.035  # of roll and pitch, what the tare leaves
    # by how much the zero of a pressure sensor is another once it is warm: it makes height and attitude worse with time
    drift_m: Annotated[float, Meta(ge=0)] = 0.005


CAREFUL = Budget()


class Estimation(Struct, frozen=True, kw_only=True):
    protocol: Protocol = "evidence"
    iteration_s: Positive = 1.0  # the paper's t -> t + 1: one attempt to measure, one update
    validity_s: Positive = 0.5  # a neighbour unheard for longer leaves the valid set
    liars: Annotated[int, Meta(ge=1, le=2)] = 1  # `evidence`: robots that may be wrong at once; 2 wants seven that see
    clip: bool = False  # `metropolis`: draw a neighbour's word in to what its covariance and ours can explain


class Link(Struct, frozen=True, kw_only=True):
    send_hz: Annotated[float, Meta(gt=0, le=20)] = 10.0  # at most once a step; from 10 on news goes between two
    loss: Share = 0.0  # fault injection: share of outgoing link messages thrown away
    loss_seed: int = 0
    preview_hz: Annotated[float, Meta(ge=0, le=5)] = 2.0  # previews for observers, at most; 0: none


class Access(Struct, frozen=True, kw_only=True):
    """Who may say what. Robots, observers and consoles share one name space: their certificates' common names."""

    keys: str | None = None  # folder of keys, looked for beside the fleet file; none: nothing is signed
    # of a fleet whose robots listen on tls/
    observers: tuple[Name, ...] = ("recorder", "view", "router")  # hear everything and say nothing
    consoles: tuple[Name, ...] = ()  # hear everything and give orders


class Camera(Struct, frozen=True, kw_only=True):
    width_px: Annotated[int, Meta(ge=64)] = 640
    height_px: Annotated[int, Meta(ge=64)] = 480
    settle_s: Positive = 0.05  # lens at rest after a focus command
    sweep_steps: Annotated[int, Meta(ge=8)] = 30
    row_time_us: Annotated[float, Meta(ge=0)] = 0.0  # from row to row of a rolling shutter; 0: all rows at once
    mains_hz: MainsHz = 50  # what lamps flicker by, where the fleet dives
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


class Hold(Struct, frozen=True, kw_only=True, tag_field="kind", tag="hold"):
    """Stay where it is told to, looking as it does then."""


class Goto(Struct, frozen=True, kw_only=True, tag_field="kind", tag="goto"):
    """Swim to a place and stay there."""

    x_m: float
    y_m: float
    depth_m: Positive | None = None  # none: as deep as before
    yaw_deg: float | None = None  # none: towards the target that is watched, else along the way


class Turn(Struct, frozen=True, kw_only=True, tag_field="kind", tag="turn"):
    """Turn the body on the spot."""

    yaw_deg: float


class Orbit(Struct, frozen=True, kw_only=True, tag_field="kind", tag="orbit"):
    """Swim around something and face it; back the other way before the tether is wound up."""

    x_m: float
    y_m: float
    radius_m: Positive
    speed_m_s: float = 0.1  # positive: anticlockwise, seen from above


class Trial(Struct, frozen=True, kw_only=True, tag_field="kind", tag="trial"):
    """Swim what `aucamp calibrate body` reads mass and drag from, to and fro along yaw_deg, and turning."""

    x_m: float  # the middle
    y_m: float
    yaw_deg: float = 0.0
    half_m: Positive = 0.5  # from the middle to where legs begin, and nearly to where their coasts end
    speed_m_s: Positive = 0.25  # of the faster legs


class Follow(Struct, frozen=True, kw_only=True, tag_field="kind", tag="follow"):
    """Keep a distance from a target that may move, on a side of its own, and face it."""

    target: Name
    standoff_m: Annotated[float, Meta(gt=0.35)]  # no robot comes nearer to a target
    search: bool = False  # look for it while no robot knows where it is; else stay


class Search(Struct, frozen=True, kw_only=True, tag_field="kind", tag="search"):
    """Look for a target that no robot knows: around where it was last, then along lanes; once it is known, stay."""

    target: Name
    lane_m: Annotated[float, Meta(ge=0.2)] = 0.8  # from one lane to the next; where the water is murky less
    speed_m_s: Positive = 0.06  # the gimbal goes round in a quarter of a minute, while the robot swims a lane's width


class Survey(Struct, frozen=True, kw_only=True, tag_field="kind", tag="survey"):
    """Look where the fleet's map gains most by it: go there, or, moored, turn the camera; until all is known that
    [coverage] asks for."""


Behaviour = Hold | Goto | Turn | Orbit | Trial | Follow | Search | Survey


class Robot(Struct, frozen=True, kw_only=True):
    neighbours: tuple[Name, ...] = ()
    listen: str
    serial: Device
    camera: Device
    pose: Pose
    depth_m: Positive = 0.40  # hover set-point
    look: Look = Look()
    calibration: str
    lamp: bool = False  # it has one, on the second gimbal; for fleets with [lighting]
    behaviour: Behaviour | None = None  # of a robot that swims; none: it goes to its pose and stays there


class Tag(Struct, frozen=True, kw_only=True):
    """One square of the family 36h11, flat on a face of the tank, printed side towards the water."""

    id: Annotated[int, Meta(ge=0, le=586)]
    face: Face
    position_m: tuple[float, float, float]  # of its middle, world frame, on that face
    # Anticlockwise as the camera sees it, from: its top towards the surface on a wall, towards +y on the floor.
    turn_deg: float = 0.0


class Landmarks(Struct, frozen=True, kw_only=True):
    """AprilTags in the tank, where a survey found them."""

    family: Literal["36h11"] = "36h11"
    size_m: Positive  # black edge to black edge
    sigma_m: Annotated[float, Meta(ge=0)] = 0.0005  # of the survey: each coordinate of a tag's middle
    sigma_deg: Annotated[float, Meta(ge=0)] = 0.1  # and each angle by which it lies otherwise than said
    tag: tuple[Tag, ...]


class Limits(Struct, frozen=True, kw_only=True):
    """What a swimming robot keeps to, whatever it is asked for."""

    speed_m_s: Annotated[float, Meta(gt=0, le=0.5)] = 0.25
    turn_deg_s: Annotated[float, Meta(gt=0, le=90)] = 57.0
    separation_m: Annotated[float, Meta(ge=0.34, le=1.0)] = 0.34  # between centres; thruster rings touch at 0.34


class Navigation(Struct, frozen=True, kw_only=True):
    """Robots that swim: `pose` of a robot is then where it shall be, and landmarks tell it where it is."""

    limits: Limits = Limits()
    follow_hz: Annotated[float, Meta(ge=2, le=20)] = 10.0  # at most so many frames a second are searched for landmarks
    gyro: bool = False  # every control module has one that says how fast the robot turns


class Coverage(Struct, frozen=True, kw_only=True):
    """What robots are to see of the tank, and how well. Those whose behaviour is `survey` look; all share the map."""

    goal_mm: Annotated[float, Meta(ge=2, le=50)] = 4.0  # standard deviation at which a cell is known well enough
    cell_mm: Annotated[float, Meta(ge=20, le=200)] = 40.0
    share: Annotated[float, Meta(gt=0, le=1)] = 0.9  # of the wanted cells; then the survey is done
    faces: Annotated[tuple[Face, ...], Meta(min_length=1)] = ("floor", "x0", "x1", "y0", "y1")


class WaterOptics(Struct, frozen=True, kw_only=True):
    """Absorption and scattering; beam attenuation is the sum of both. An instrument measures them: pictures do not tell
    one from the other."""

    absorption_per_m: Bands
    scattering_per_m: Bands


class Beam(Struct, frozen=True, kw_only=True):
    """The beam of a lamp; all lamps of the fleet are alike. Flat to 0.8 of the half angle, nothing beyond 1.2 of it."""

    intensity_w_sr: Annotated[float, Meta(gt=0)] = 1.2  # on its axis, in each colour, at full power
    half_deg: Annotated[float, Meta(ge=5, le=60)] = 25.0  # in water
    beside_m: Annotated[float, Meta(ge=0.01, le=1)] = 0.12  # to the left of the optical centre, level with it


class Lighting(Struct, frozen=True, kw_only=True):
    """Robots that light for each other: water and lamps as measured, and how lamps are lent.

    Without this table no lamp burns, and no decision takes light into account.
    """

    water: WaterOptics
    beam: Beam = Beam()
    guard_s: Annotated[float, Meta(gt=0, le=5)] = 0.3  # how long a sweep waits for robots that it asked for light
    gain: Annotated[float, Meta(ge=0)] = 0.10  # of the information that borrowed light must bring, else the own lamp


class Twin(Struct, frozen=True, kw_only=True):
    """Only the twin reads this: which scene, which world of that scene, where its sockets are."""

    scene: str = "tank"
    camera: CameraPreset | None = None  # none: the scene's
    # faults of all cameras, on the bench and in the dive
    stamp_late_ms: Annotated[float, Meta(ge=0, le=200)] = 0.0  # by which frames are stamped after they were exposed
    lens_slow_ms: Annotated[float, Meta(ge=0, le=500)] = 0.0  # in which the lens goes 95 % of its way
    sensor_tilt_deg: Annotated[float, Meta(ge=0, le=2)] = 0.0  # by which sensors are not square to the optical axis
    field_um: Annotated[float, Meta(ge=-50, le=50)] = 0.0  # by which the field is curved at the picture's corner
    seed: Annotated[int, Meta(ge=0)] = 0
    dir: str | None = None


class Fleet(Struct, frozen=True, kw_only=True):
    fleet: Name
    tank: Tank = Tank()
    water: Water = Water()
    target: dict[Name, Target]
    ranging: Ranging = Ranging()
    budget: Budget = CAREFUL
    estimation: Estimation = Estimation()
    link: Link = Link()
    access: Access = Access()
    camera: Camera = Camera()
    body: Body = Body()
    robot: dict[Name, Robot]
    landmarks: Landmarks | None = None
    navigation: Navigation | None = None  # none: every robot is moored where `pose` says
    coverage: Coverage | None = None  # none: no keyframes, robots do not say what they have seen
    lighting: Lighting | None = None  # none: no lamp burns
    extend: dict[Name, dict[str, Any]] | None = None  # tables of capabilities that are not built in, as they check them
    twin: Twin = Twin()

    @property
    def secured(self) -> bool:
        """Whether all links are TLS, between certificates that the fleet's own authority gave."""
        return bool(self.robot) and all(robot.listen.startswith("tls/") for robot in self.robot.values())


# --- files that a person or another file names ---

MOST_BYTES = 2**20  # of a text file: a survey of all tags of the family has 60 kB


def read_file(path: Path, most_bytes: int = MOST_BYTES, give: str = "give another file") -> bytes:
    """All of a file. Raises ConfigError where there is none, and for what is no regular file or larger: a device never
    ends, and a pipe may never begin."""
    data = None
    try:
        if S_ISREG(path.stat().st_mode):
            with path.open("rb") as file:
                data = file.read(most_bytes + 1)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; {give}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); {give}") from None
    except ValueError:  # zero bytes
        raise ConfigError(f"{str(path)!r}: no name of a file; {give}") from None
    if data is None:
        raise ConfigError(f"{path}: no regular file; {give}")
    if len(data) > most_bytes:
        raise ConfigError(f"{path}: larger than {most_bytes / 2**20:g} MiB, which no such file is; {give}")
    return data


def read_text(path: Path, give: str) -> str:
    """All of a small file, as `as_text`. Raises ConfigError."""
    try:
        return as_text(read_file(path, give=give))
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file; {give}") from None


def inside(folder: Path, name: str) -> Path:
    """The path of a file that a file in `folder` names, where somebody else may have written it. Raises ConfigError for
    one that leads out of the folder."""
    path = Path(name)
    if len(name.encode(errors="replace")) > 240 or not name.isprintable():  # 255 bytes with an ending
        raise ConfigError(f"{folder}: {name[:60]!r}... is no name of a file; correct it")
    if path.is_absolute() or ".." in path.parts:
        raise ConfigError(f"{folder}: names the file '{name}', which is outside of it; put that file into the folder")
    return folder / path


def to_install(extra: str) -> str:
    """What to type for an extra: in a clone, or of an installed package."""
    is_clone = (Path(__file__).parents[2] / "pyproject.toml").exists()
    return f"in your clone: pip install -e '.[{extra}]'" if is_clone else f"pip install 'aucamp[{extra}]'"


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """An OSError of the block names this file: a full disk does not say for what it had no room."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_whole(path: Path, data: str | bytes) -> None:
    """All of it or nothing: a file that was there is as it was until the new one is written."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data.encode() if isinstance(data, str) else data)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None


def check_depth(text: str, what: object) -> None:
    """Raises ConfigError for TOML or JSON that is nested too deeply to be read."""
    if too_deep(text):
        raise ConfigError(f"{what}: nested more than {MOST_DEEP} deep, as no file for aucamp is; correct the file")


def parse_toml(text: str, what: object) -> dict[str, Any]:
    """Every failure is a ConfigError; `what` names the text."""
    check_depth(text, what)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{what}: not valid TOML: {error}") from None
    except ValueError:  # Python reads no integer of more than 4300 digits
        raise ConfigError(f"{what}: has a number of thousands of digits; correct it") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; every failure is a ConfigError."""
    return parse_toml(read_text(path, "give the path of an existing TOML file"), path)


def dump(struct: msgspec.Struct) -> str:
    """The TOML text from which the same struct is read again."""

    def drop_none(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: drop_none(v) for k, v in value.items() if v is not None}
        return value

    return tomli_w.dumps(drop_none(msgspec.to_builtins(struct)))


T = TypeVar("T")


def convert(data: dict[str, Any], kind: type[T], what: object) -> T:
    """Check parsed TOML against a struct, and its numbers; the message names `what`, the key and the remedy."""
    found = typed(data, kind, what)
    check_numbers(found, what)
    return found


def typed(data: dict[str, Any], kind: type[T], what: object) -> T:
    """The same for what its rules will say of its numbers."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{what}: {printable(explain(error, data, kind))}") from None


# Larger than any of that unit which a robot, a tank or a camera has; a unit is the end of a name.
LARGEST = {"m": 1e4, "mm": 1e7, "px": 1e6, "deg": 1e4, "s": 1e7, "us": 1e7, "hz": 1e6}
LARGEST_OF_ALL = 1e9
LARGEST_SEED = 2**63 - 1  # and of every other whole number without a unit


def check_numbers(found: Any, what: object) -> None:
    """Raises ConfigError, naming the key, for a number in a struct that is not finite or beyond LARGEST."""
    for key, remedy in odd_numbers(msgspec.to_builtins(found)):
        raise ConfigError(f"{what}: key '{key}': {remedy}")


def odd_numbers(found: Any) -> Iterator[tuple[str, str]]:
    """Such numbers of what msgspec made of a struct, as (key, what to change)."""
    for key, value in numbers_in(found):
        most = LARGEST.get(unit_of(key), LARGEST_SEED if isinstance(value, int) else LARGEST_OF_ALL)
        if not math.isfinite(value):
            yield key, "not a finite number; correct the value"
        elif abs(value) > most:
            yield key, f"{value:.3g} is beyond {most:.3g}, the largest that can be; correct the value"


def numbers_in(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Every number below a key, with a key of its own, such as body.camera_m[0]."""
    if isinstance(value, dict):
        for name, child in value.items():
            yield from numbers_in(child, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for i, child in enumerate(value):
            yield from numbers_in(child, f"{key}[{i}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, value


def unit_of(key: str) -> str:
    """The end of its name: m of body.camera_m[0]."""
    return key.partition("[")[0].rpartition("_")[2]


# --- what is wrong in a TOML file ---
# In words: the key as the file spells it, and what may stand there instead.

ANY = "*"  # for msgspec's [...], which stands for the name of a table of which there may be several, such as robot.r1
NAME_RULE = "a name is a small letter and up to 15 small letters, digits or _"


def explain(error: msgspec.ValidationError, data: dict[str, Any], kind: Any) -> str:
    """One sentence about the first mistake in `data`, which could not be converted to the struct `kind`."""
    key, remedy = mistake(error, data, kind)
    return f"key '{key or 'top level'}': {remedy}"


def mistake(error: msgspec.ValidationError, data: dict[str, Any], kind: Any) -> tuple[str, str]:
    """That mistake as (key, what to change); "": a key of `data` itself is missing or unknown."""
    what, _, where = str(error).partition(" - at `")
    path = where.rstrip("`").replace("[...]", f".{ANY}").split(".")[1:]
    if where.startswith("key`"):  # the name of a table is itself the mistake
        path.append(ANY)
    return ".".join(_named(path, data, kind, str(error))), _remedy(what, path, kind)


def _named(path: list[str], data: dict[str, Any], kind: Any, error: str) -> list[str]:
    """The path with the name of the table in question: the one that makes the same mistake without the others."""
    if ANY not in path:
        return path
    at = path.index(ANY)
    above: Any = data
    for chunk in path[:at]:
        above = above[chunk]
    for name, value in above.items():
        alone: Any = {name: value}
        for chunk in reversed(path[:at]):
            alone = {chunk: alone}
        try:
            msgspec.convert({**data, **alone}, kind)
        except msgspec.ValidationError as same:
            if str(same) == error:
                return [*path[:at], name, *path[at + 1 :]]
    return path


def _remedy(what: str, path: list[str], kind: Any) -> str:
    if what.startswith("Object contains unknown field"):
        return f"unknown key {what.rsplit(' ', 1)[-1]}; remove it or correct its spelling"
    if what.startswith("Object missing required field"):
        return f"required key {what.rsplit(' ', 1)[-1]} is missing; add it"
    if what.startswith("Invalid enum value"):
        return f"{what.rsplit(' ', 1)[-1]} is no choice; write one of {', '.join(_choices(path, kind))}"
    if "matching regex" in what:
        return f"{NAME_RULE}; correct the name"
    return what[0].lower() + what[1:] + "; correct the value"


def _choices(path: list[str], kind: Any) -> list[str]:
    """The values of the Literal at `path` below the struct `kind`."""
    there = [msgspec.inspect.type_info(kind)]
    for chunk in ".".join(path).replace("[", ".[").split("."):
        there = [below for one in there for each in getattr(one, "types", (one,)) for below in _below(each, chunk)]
    return [
        str(value) for one in there for each in getattr(one, "types", (one,)) for value in getattr(each, "values", ())
    ]


def _below(there: Any, chunk: str) -> list[Any]:
    """The types of what a key, or an index such as [0], stands for."""
    fields = [field.type for field in getattr(there, "fields", ()) if field.encode_name == chunk]
    inner = [getattr(there, name) for name in ("value_type", "item_type") if hasattr(there, name)]
    return [*fields, *inner, *getattr(there, "item_types", ())]
