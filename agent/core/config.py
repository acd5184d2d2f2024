"""The tables of fleet.toml as frozen structs: fleet_reader.py reads them, fleet_rules.py holds them to its rules."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from agent.core.settings import Lighting

Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,15}$")]
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Device = Annotated[str, Meta(min_length=1)]
Protocol = Literal["paper", "metropolis", "evidence"]
Colour = Literal["red", "orange", "yellow", "green"]
Cues = Literal["both", "focus", "size"]
Face = Literal["x0", "x1", "y0", "y1", "floor"]  # walls at x = 0 and the far end of x, likewise y
WaterKind = Literal["air", "tap", "pool", "coastal", "turbid"]


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
    kind: WaterKind = "tap"


class Target(Struct, frozen=True, kw_only=True):
    """What the robots look for: a ball, told from others by its colour, whatever a box in a picture shows, or a
    creature of a colour, whatever its shape."""

    detector: Literal["ball", "box", "creature"] = "ball"
    colour: Colour | None = None  # of a ball or a creature: red if not given
    # of a creature: from nose to tail, about; what is seen of it bears as if all of it were there, give or take
    length_m: Annotated[float, Meta(gt=0, le=2)] | None = None
    # of a ball
    radius_m: Positive | None = None  # None: a thing in a box, whose size nobody knows
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


class Estimation(Struct, frozen=True, kw_only=True):
    protocol: Protocol = "evidence"
    iteration_s: Positive = 1.0  # the paper's t -> t + 1: one attempt to measure, one update
    validity_s: Positive = 0.5  # a neighbour unheard for longer leaves the valid set
    liars: Annotated[int, Meta(ge=1, le=2)] = 1  # `evidence`: robots that may be wrong at once; 2 wants seven that see
    clip: bool = False  # `metropolis`: draw a neighbour's word in to what its covariance and ours can explain


class Link(Struct, frozen=True, kw_only=True):
    send_hz: Annotated[float, Meta(gt=0, le=20)] = 10.0  # at most once a step of the agent
    loss: Share = 0.0  # fault injection: share of outgoing link messages thrown away
    loss_seed: int = 0
    preview_hz: Annotated[float, Meta(ge=0, le=5)] = 2.0  # at most so many pictures for whoever looks; 0: none


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
    standoff_m: Annotated[float, Meta(gt=0.35)]  # nearer than that no robot comes to a target
    search: bool = False  # look for it while nobody knows where it is; else stay


class Search(Struct, frozen=True, kw_only=True, tag_field="kind", tag="search"):
    """Look for a target that nobody knows: around where it was last, then along lanes; once it is known, stay."""

    target: Name
    lane_m: Annotated[float, Meta(ge=0.2)] = 0.8  # from one lane to the next; where the water is murky less
    speed_m_s: Positive = 0.06  # in a quarter of a minute, when the gaze has gone round, a lane's width


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
    access: Access = Access()
    camera: Camera = Camera()
    body: Body = Body()
    robot: dict[Name, Robot]
    landmarks: Landmarks | None = None
    navigation: Navigation | None = None  # none: every robot is moored where `pose` says
    coverage: Coverage | None = None  # none: no keyframes, nobody says what it has seen
    lighting: Lighting | None = None  # none: no lamp burns
    twin: Twin = Twin()

    @property
    def secured(self) -> bool:
        """Whether all links are TLS, between certificates that the fleet's own authority gave."""
        return bool(self.robot) and all(robot.listen.startswith("tls/") for robot in self.robot.values())
