"""Numbers over time for viewers: flat protobuf messages of named doubles, the package `aucamp` in a recording.

Their descriptors are built from this table when the module is loaded, so there is no generated code to keep in step.
A value that is not known is NaN, which plots show as a gap. Units are in the names.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

XYZ = "xyz"

PLOTS: dict[str, tuple[str, ...]] = {
    "Attitude": (
        *("depth_m", "roll_deg", "pitch_deg", "battery_v", "armed", "failsafe_level", "loop_us"),
        *(f"sensor{n}_depth_m" for n in range(1, 5)),
    ),
    "Thrusters": (*(f"pwm{n}_us" for n in range(1, 9)), *(f"servo{n}_us" for n in range(1, 5))),
    "Focus": (
        *("position", "clarity", "score", "found", "u_px", "v_px", "radius_px", "radius_sigma_px"),
        *("area_px", "sweep", "index"),
    ),
    "Protocol": (
        *("iteration", "knows", "measurements", "alpha", "prior_sigma_m", "posterior_sigma_m", "valid_robots"),
        *(f"prior_{axis}_m" for axis in XYZ),
        *(f"posterior_{axis}_m" for axis in XYZ),
        *("nis", "pan_deg", "tilt_deg", "refused", "faults"),
    ),
    "Clock": ("rate", "dive_s", "wall_s"),  # wall_s: Unix time
    "Survey": ("share", "own", "held", "looks"),  # own: keyframes; held: those and others'; looks: it claims a view
    "Neighbour": ("age_s", "valid", "used", "heard", "gaps", "weight"),
}


@cache
def message_class(name: str) -> Any:
    """The protobuf class aucamp.NAME of the table above."""
    file = FileDescriptorProto(name=f"aucamp.{name}.proto", package="aucamp", syntax="proto3")
    message = file.message_type.add(name=name)
    for number, field in enumerate(PLOTS[name], start=1):
        message.field.add(
            name=field,
            number=number,
            type=FieldDescriptorProto.TYPE_DOUBLE,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"aucamp.{name}"))


def plot(name: str, **values: float | int | bool | None) -> Any:
    """A message aucamp.NAME; every field of the table must be given, None for what is not known."""
    if values.keys() != set(PLOTS[name]):
        raise ValueError(f"aucamp.{name}: {sorted(values.keys() ^ set(PLOTS[name]))} given or missing")
    return message_class(name)(**{field: math.nan if value is None else value for field, value in values.items()})
