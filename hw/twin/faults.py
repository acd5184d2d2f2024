"""Faults of a dive, each at its time for one robot: the [[event]] tables of a scene file, as data. hw.twin.dive applies
them.

[[event]]
at_s = 40.0           # since the twin began
kind = "serial_unplug"
robot = "r1"
for_s = 5.0
"""

from __future__ import annotations

from typing import Annotated, get_args

from msgspec import Meta

from agent.kernel.config import Name, Positive, Struct
from agent.kernel.messages import Vector

Sensor = Annotated[int, Meta(ge=1, le=4)]
Thruster = Annotated[int, Meta(ge=1, le=8)]


class Fault(Struct, frozen=True, kw_only=True, tag_field="kind"):
    at_s: Annotated[float, Meta(ge=0)]
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


AnyFault = (
    Push
    | SensorDead
    | SensorStuck
    | SensorOffset
    | SensorWell
    | Leak
    | Battery
    | ThrusterDead
    | ThrusterGain
    | SerialUnplug
    | PowerCut
    | FirmwareHang
    | SlowBoard
)
KINDS = tuple(str(fault.__struct_config__.tag) for fault in get_args(AnyFault))
