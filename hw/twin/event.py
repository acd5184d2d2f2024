"""What goes wrong at its time, from the [[event]] tables of a scene file. The doing is the dive's: see hw.twin.dive.

[[event]]
at_s = 40.0           # since the twin began
kind = "serial_unplug"
robot = "r1"
for_s = 5.0
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, get_args

from msgspec import Meta

from agent.config import Name, Positive, Struct
from agent.messages import Vector

if TYPE_CHECKING:
    from hw.twin.dive import Dive

Sensor = Annotated[int, Meta(ge=1, le=4)]
Thruster = Annotated[int, Meta(ge=1, le=8)]


class Trouble(Struct, frozen=True, kw_only=True, tag_field="kind"):
    at_s: Annotated[float, Meta(ge=0)]
    robot: Name

    def strike(self, dive: Dive) -> None:
        raise NotImplementedError


class Push(Trouble, frozen=True, kw_only=True, tag="push"):
    force_n: Vector  # world frame
    point_m: Vector = (0.0, 0.0, 0.0)  # body frame
    for_s: Positive

    def strike(self, dive: Dive) -> None:
        dive.push(self.robot, self.force_n, self.point_m, self.for_s)


class SensorDead(Trouble, frozen=True, kw_only=True, tag="sensor_dead"):
    sensor: Sensor

    def strike(self, dive: Dive) -> None:
        dive.kill_sensor(self.robot, self.sensor)


class SensorStuck(Trouble, frozen=True, kw_only=True, tag="sensor_stuck"):
    sensor: Sensor

    def strike(self, dive: Dive) -> None:
        dive.stick_sensor(self.robot, self.sensor)


class SensorOffset(Trouble, frozen=True, kw_only=True, tag="sensor_offset"):
    sensor: Sensor
    offset_m: float

    def strike(self, dive: Dive) -> None:
        dive.shift_sensor(self.robot, self.sensor, self.offset_m)


class SensorWell(Trouble, frozen=True, kw_only=True, tag="sensor_well"):
    sensor: Sensor

    def strike(self, dive: Dive) -> None:
        dive.mend_sensor(self.robot, self.sensor)


class Leak(Trouble, frozen=True, kw_only=True, tag="leak"):
    def strike(self, dive: Dive) -> None:
        dive.leak(self.robot)


class Battery(Trouble, frozen=True, kw_only=True, tag="battery"):
    volts: Positive  # without load

    def strike(self, dive: Dive) -> None:
        dive.set_battery(self.robot, self.volts)


class ThrusterDead(Trouble, frozen=True, kw_only=True, tag="thruster_dead"):
    thruster: Thruster

    def strike(self, dive: Dive) -> None:
        dive.scale_thruster(self.robot, self.thruster, 0.0)


class ThrusterGain(Trouble, frozen=True, kw_only=True, tag="thruster_gain"):
    thruster: Thruster
    gain: float  # on what it gave before; negative: mounted the wrong way round

    def strike(self, dive: Dive) -> None:
        dive.scale_thruster(self.robot, self.thruster, self.gain)


class SerialUnplug(Trouble, frozen=True, kw_only=True, tag="serial_unplug"):
    for_s: Positive

    def strike(self, dive: Dive) -> None:
        dive.unplug(self.robot, self.for_s)


class PowerCut(Trouble, frozen=True, kw_only=True, tag="power_cut"):
    for_s: Positive

    def strike(self, dive: Dive) -> None:
        dive.cut_power(self.robot, self.for_s)


class FirmwareHang(Trouble, frozen=True, kw_only=True, tag="firmware_hang"):
    def strike(self, dive: Dive) -> None:
        dive.hang_firmware(self.robot)


Event = (
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
)
KINDS = tuple(str(kind.__struct_config__.tag) for kind in get_args(Event))
