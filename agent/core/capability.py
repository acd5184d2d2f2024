"""A capability: something that a robot can do beside measuring targets. It exists where its table stands in the fleet
file.

In each step the robot assembles one `Situation`, which never changes once it is made. A capability adds its own fields
to it, proposes who shall have camera, body and lamp, and is told nothing else of the other capabilities. One table of
priorities decides who gets what (agent/robot/arbiter.py). A proposal names a resource and a row of that table. The
command is made by its `act` after the grant; `act` may decline with None, and then the next row is asked.

Two more seams serve the measurement of targets: `Illumination`, which says by which light a sweep is made, and
`PoseSource`, which says where a robot was that is not moored. Their defaults are DAYLIGHT and MOORED.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Generic, Literal, NamedTuple, Protocol, TypeVar

import msgspec
from msgspec import UNSET, UnsetType

from agent.core.attitude import Attitude, AttitudeLog
from agent.core.config import Behaviour, Cues, Fleet, Pose, Struct, Target
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.messages import Message, Vector
from agent.core.ranging.camera_model import Calibration, Eye, camera_pose
from agent.core.ranging.fix import Fix, Outline, OwnPose
from agent.core.ranging.pointing import APPROACH_NS, LAG_NS, SearchPlan
from agent.core.ranging.sweep import ByLight, Measurement
from agent.core.status import Logbook
from agent.core.step_io import Heard, Inputs, Sighting, SweepOutcome, SweepPlan
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetEstimate
from agent.core.topics import Topic
from agent.core.verbs import Args

Planar = tuple[float, float]

# --- what is believed: the situation of one step ---


class SearchView(NamedTuple):
    """A search pattern that the camera is at."""

    target: str
    found: bool  # in the newest frame of the newest look
    spirals: bool  # it has not looked everywhere around the last place yet


class CameraView(msgspec.Struct, frozen=True):
    """Gimbal and lens: of the step before until the camera is granted, then of this one."""

    goal_us: tuple[int, int] | None  # None: it has not been told anything yet
    gimbal_deg: tuple[float, float]  # pan and tilt at rest at the goal
    told_ns: int  # when the goal was set
    last_leg_ns: int  # when the approach to the goal begins its last leg
    steady_from_ns: int  # frames exposed later belong to the goal
    tracks: bool  # the goal follows a target, step by step
    sweep: Literal["none", "target", "view"]  # that is under way
    target: str  # which one gimbal and lens serve
    seen: Sighting | None  # newest frame with that one in it, gimbal at rest where it is now
    in_view: bool  # and that was a moment ago
    ready: bool  # a sweep of it could begin, were it in the middle of the picture
    most_sweep_ns: int  # how long a sweep of it can take
    search: SearchView | None

    @property
    def measuring(self) -> bool:
        """A sweep is under way."""
        return self.sweep != "none"

    @property
    def nearly_from_ns(self) -> int:
        """Frames exposed later show what is at the goal, the servos' play aside."""
        return self.last_leg_ns - APPROACH_NS + LAG_NS

    def steady(self, now_ns: int) -> bool:
        """Whether the gimbal rests at the goal."""
        return self.goal_us is not None and now_ns >= self.steady_from_ns

    def sees(self, target: str) -> bool:
        """Whether it is in view where the gimbal looks, or was as the gimbal came to rest there."""
        found = self.search is not None and self.search.target == target and self.search.found
        return found or (target == self.target and self.in_view)


class LightView(NamedTuple):
    """By which light the camera sees. The defaults: by day."""

    phase: Literal["day", "free", "asks", "holds", "obeys"] = "day"
    from_ns: int | None = 0  # since when it is light where the camera looks; None: dark, nothing shows
    place_m: Vector | None = None  # a place that is lit, for a robot that knows no other place; world frame
    still: bool = False  # a robot that swims does not move: light is lent, or looked by


SwimPhase = Literal["lost", "afloat", "ready", "under_way", "halted"]


class Motion(NamedTuple):
    """Place and velocity in the plane, world frame."""

    pose: Vector  # x, y (m), yaw (rad)
    velocity: Vector  # m/s, m/s, rad/s


class OwnView(NamedTuple):
    """Of a robot that swims."""

    phase: SwimPhase
    own: Motion | None  # by its own sensors; None: it does not know
    at_landmarks: bool  # its camera is turned to landmarks
    calm: bool  # a sweep may begin: it takes seconds, in which a robot on its way would get lost
    does: str  # its behaviour in effect, as the fleet file calls it
    about: str | None  # the target of its behaviour
    pursues: str | None  # that one, where it swims: frames give bearings of it instead of sweeps
    sighted: str | None  # the target of its newest frame that has given no bearing yet

    @property
    def under_way(self) -> bool:
        """It does what it is told: it knows where it is and how it moves, and its camera is where it is to be."""
        return self.phase == "under_way"


class NeighbourView(NamedTuple):
    """A neighbour that swims, as it says."""

    name: str
    pose: Pose
    depth_m: float
    at_landmarks: bool  # its camera is turned to landmarks


class TargetView(NamedTuple):
    """What the robot knows of one target."""

    name: str
    believed: Posterior | None  # None as well of one that a moored robot does not watch (from propose on)
    estimate: TargetEstimate | None = None  # what the fleet agrees on; of the target of the behaviour

    @property
    def believed_m(self) -> Vector | None:
        return None if self.believed is None else self.believed.x_m


class Overrides(NamedTuple):
    """What operators want beside what the fleet file says, in force until another command, or `resume`. None: as the
    fleet file says."""

    depth_m: float | None = None
    look_deg: tuple[float, float] | None = None  # pan, tilt of the camera
    behaviour: Behaviour | None = None
    sweeps: bool = True
    send_hz: float | None = None


class Situation(msgspec.Struct, frozen=True):
    """What one robot believes in one step. It holds nothing that changes."""

    now_ns: int
    level: Attitude | None  # None: the control module is silent
    pose: Pose
    camera: CameraView
    watched: str  # the target whose turn it is
    targets: tuple[TargetView, ...]  # all of the fleet file
    orders: Overrides = Overrides()
    light: LightView = LightView()
    own: OwnView | None = None  # None: moored
    neighbours: tuple[NeighbourView, ...] | None = None  # in the order of names; None: all are moored
    search: SearchPlan | None = None  # that a robot that searches has the camera look by
    view_sweep: bool = False  # a sweep over whole frames is under way, of no target
    camera_holder: str = ""  # the row of the table of priorities that has the camera in this step, once it is granted
    station: tuple[Planar, float] | None = None  # where a survey looks from, and the yaw there, rad; None: where it is

    @property
    def target(self) -> TargetView:
        """The one whose turn it is."""
        return self.about(self.watched)

    def about(self, target: str) -> TargetView:
        """What is known of the target of that name. There must be one."""
        return next(each for each in self.targets if each.name == target)


def eye_of(fleet: Fleet, camera: CameraView, pose: Pose, level: Attitude) -> Eye:
    """Where the camera is while the gimbal rests at its goal; pose, level: of the body then."""
    return camera_pose(pose, fleet.body, *level, *camera.gimbal_deg, fleet.tank.surface_m)


# --- what is proposed ---

Resource = Literal["camera", "body", "lamp"]
T = TypeVar("T")


class CameraAct(NamedTuple):
    """What gimbal and lens do. The default: hold the gimbal where it is."""

    aim_deg: tuple[float, float] | None = None  # pan, tilt
    mode: Literal["rest", "track"] = "rest"  # track: this is the set-point of this step, the next brings the next
    target: str | None = None  # that is tracked; None: the camera looks elsewhere
    plan: SweepPlan | None = None


class BodyAct(NamedTuple):
    """What the thrusters do."""

    force_n: tuple[float, float] = (0.0, 0.0)  # ahead, to the left
    moment_nm: float = 0.0
    depth_m: float | None = None  # None: as operators or the fleet file say


class LampAct(NamedTuple):
    """How the own lamp burns."""

    power: float  # 0 to 1
    us: tuple[int, int]  # pulses of its gimbal


class Proposal(NamedTuple, Generic[T]):
    """`act` makes the command once the resource is granted; None: it declines, and has changed nothing but its own
    phase."""

    resource: Resource
    holder: str  # a row of the table of priorities
    act: Callable[[Situation], T | None]


Sweep = Literal["none", "target", "view"]
ANY: tuple[Sweep, ...] = ("none", "target", "view")


class Row(NamedTuple):
    """Of the table of priorities: who may ask for a resource."""

    resource: Resource
    holder: str
    why: str  # it takes the resource
    sweeps: tuple[Sweep, ...] = ANY  # sweeps in which it is asked
    lent: bool = True  # also while a neighbour has the light
    above: str = ""  # of a row that a capability brings: the holder of that resource which it stands right above


class Outgoing(NamedTuple):
    """One message to one neighbour."""

    topic: Topic
    to: str
    message: Message


# --- protocols ---


class Context(NamedTuple):
    """What a capability is made with."""

    fleet: Fleet
    name: str  # of the robot
    calibration: Calibration
    incarnation: int
    attitude: AttitudeLog  # to read
    log: Logbook  # to write lines
    light: Illumination
    source: PoseSource
    settings: Any = None  # its own table of the fleet file


class Capability(Revertible):
    """Of one robot, between steps. The base does nothing: a capability overrides what it needs.

    A row of agent/robot/arbiter.py has it made with a `Context` where its table stands in the fleet file. What it
    remembers lies in attributes, and is put back where a step breaks (step_transaction.Revertible).
    """

    name: ClassVar[str]
    table: ClassVar[str]  # of the fleet file: a field of config.Fleet, or extend.NAME
    does: ClassVar[str]  # of a robot that has it, in the refusal of its messages where that table is missing
    sweeps: ClassVar[bool] = False  # its views or its light are for sweeps: a camera of fixed focus is of no use to it
    lacks: ClassVar[str] = ""  # in the refusal of its commands where it is missing
    topics: ClassVar[tuple[Topic, ...]] = ()
    commands: ClassVar[tuple[type, ...]] = ()  # of operators; `Resume` and `HoldHere` come to all
    settings: ClassVar[type[Struct] | None] = None  # what the table extend.NAME has to be
    rows: ClassVar[tuple[Row, ...]] = ()  # that it brings to the table of priorities

    @classmethod
    def broken_rules(cls, fleet: Fleet) -> Iterable[tuple[str, str]]:
        """What `settings` cannot say of its table extend.NAME, each mistake as (key, what to change)."""
        return ()

    def __init__(self, context: Context) -> None:
        """One robot's."""

    def receive(self, heard: Heard, accepted: frozenset[int]) -> None:
        """A payload on a key of one of its topics; accepted: schemas. Raises Refusal where it is not believed."""

    def update(self, inputs: Inputs, situation: Situation) -> Situation:
        """Take in what the devices gave, before targets are measured. situation: camera, light and targets of the step
        before. Returns it with its own fields as they are now."""
        return situation

    def decide(self, situation: Situation) -> Situation:
        """Go on, once targets are estimated; which one is watched in this step, and what is believed of that one, is
        known when camera, lamp and body are granted. Returns the situation with its own fields as they are now."""
        return situation

    def bearing(self, target: str, believed: Callable[[], Posterior | None], now_ns: int) -> Bearing | None:
        """What the newest frame says of that target, once, in place of a sweep. believed: where it is, so far."""
        return None

    def propose(self, situation: Situation) -> Iterable[Proposal[Any]]:
        """Who shall have what in this step; asked before anything is granted. It changes nothing, however often it is
        asked. What depends on the camera of this step is for `act` to say."""
        return ()

    def settle(self, situation: Situation) -> Situation:
        """Take note of what came of it, once camera and lamp are granted, before the body is. Returns the situation
        with its own fields as they are now."""
        return situation

    def carry_out(self, command: Args) -> bool:
        """Whether a command of an operator is its own; then it is done. Raises Refusal, and has done nothing. No other
        capability has a command of it but `Resume` and `HoldHere`, which none refuses."""
        return False

    def outgoing(self, situation: Situation) -> Iterable[Outgoing]:
        """What neighbours are told in this step; asked once, after all grants."""
        return ()

    def telemetry(self, now_ns: int) -> Mapping[str, Any]:
        """Its fields of State."""
        return {}

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong, for people."""
        return ()

    def lens(self) -> int | UnsetType | None:
        """Where the lens shall be between sweeps from now on; asked once a step, and of later capabilities only where
        the earlier ones leave it as it is. None: where landmarks are sharp; unset: as before."""
        return UNSET


class Spoiled(NamedTuple):
    """Why a sweep does not count."""

    reason: str


class Illumination(Revertible):
    """By which light sweeps are made, of targets and of a survey's views. The base is the answer of a fleet without
    lamps: by day each sweep may begin, and counts."""

    @property
    def claims(self) -> bool:
        """Light is asked for or held."""
        return False

    @property
    def judging(self) -> bool:
        """A sweep has ended whose light is not known to have stayed as it was."""
        return False

    def consent(self, view: View | None, situation: Situation) -> ByLight | bool:
        """Whether a sweep may begin now, and by which light: of a view, else of the watched target. False: not now;
        light is asked for. Camera and robot rest at a view."""
        return True

    def began(self, situation: Situation) -> None:
        """The sweep begins with this step."""

    def ended(self, now_ns: int) -> None:
        """Its last frame is in."""

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """What became of the light of the sweep that ended: True, the sweep counts; None: not known yet."""
        return True

    def failed(self, now_ns: int) -> None:
        """The sweep showed nothing, or did not end in time."""

    def corrected(self, peak: Measurement, eye: Eye, ball: Target, cues: Cues) -> tuple[Outline, float, Cues]:
        """The outline of a ball, how well its peak is known, in lens positions, and the cues to its range, as the light
        leaves them in which it was swept."""
        return peak.outline, peak.sigma, cues

    def marked(self, outcome: SweepOutcome) -> SweepOutcome:
        """What came of a sweep of a target, with the lamps that it was made by."""
        return outcome

    def released(self, now_ns: int) -> None:
        """The camera was taken by something that needs no light."""


class View(Protocol):
    """What a survey says of the view that it is about to sweep."""

    def frame_scene(self) -> Any: ...

    @property
    def most_ns(self) -> int:
        """How long the sweep can take."""


class Sample(NamedTuple):
    """Where a robot was when a target was measured."""

    pose: Pose
    own: OwnPose  # how well it knew
    belief: Any  # the source's own


class PoseSource(Revertible):
    """Where the robot was. The base is the answer of a moored one: where the fleet file says."""

    @property
    def moves(self) -> bool:
        return False

    @property
    def settling(self) -> bool:
        """A measurement awaits what later frames say of where the robot was."""
        return False

    def at_sample(self, t_ns: int, now_ns: int) -> Sample | None:
        """Where it was when a target was measured; None: not known well enough, or moored."""
        return None

    def keep(self, target: str, seen: Fix, known: Sample, prior: Prior, now_ns: int) -> None:
        """A measurement that is kept until it is better known where the robot was. seen: as if that were exact."""

    def settled(self, now_ns: int) -> tuple[str, Prior] | None:
        """The newest that was kept, and its target, once it is known better, once."""
        return None

    def thrusts(self, body: BodyAct, now_ns: int) -> None:
        """What the thrusters do from now on, whichever row has the body."""


DAYLIGHT, MOORED = Illumination(), PoseSource()
