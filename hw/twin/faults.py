"""What happens in a dive, each at its time and most of it to one robot: the [[event]] tables of a scene file, as data,
and the rules for them. hw.twin.dive applies them.

[[event]]
at_s = 40.0           # since the twin began
kind = "serial_unplug"
robot = "r1"
for_s = 5.0
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, get_args

from msgspec import Meta

from agent.core.config import ConfigError, Name, Positive, Struct
from agent.core.messages import Vector

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
    """Something tugs at the tether, horizontally and at random; what the scene says of that is silent meanwhile."""

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
