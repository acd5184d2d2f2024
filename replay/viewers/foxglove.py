"""Our structs as foxglove.* protobuf messages, which Foxglove and Rerun draw without a converter; and numbers over time
for plots.

Frames: `world` (corner of the tank's floor, z up), `<robot>/body` (x forward, y left, z up), `<robot>/gimbal` (turned
with the camera, x along the optical axis) and `<robot>/camera` (z forward, x right, y down). Lengths in metres, time
stamps in nanoseconds since the Unix epoch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from agent.core.config import Body
from agent.core.messages import Level, LogLine, Vector
from agent.core.ranging.camera_model import CameraFit
from agent.core.robot_view import AXES, RobotView, turn
from replay.files.frames import stamp

WORLD = "world"
Turn = tuple[float, float, float, float]  # unit quaternion x y z w
LEVELS: dict[Level, Any] = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}

# From the gimbal's axes (x forward, y left, z up) to the camera's (x right, y down, z forward).
GIMBAL_CAMERA: Turn = (-0.5, 0.5, -0.5, 0.5)


def position(x_m: Vector, t_ns: int) -> Any:
    """foxglove.PoseInFrame: a point of the world. The quaternion is set, for one of zeros is no rotation at all."""
    return world_pose(x_m, (0.0, 0.0, 0.0, 1.0), t_ns)


def world_pose(x_m: Vector, turned: Turn, t_ns: int) -> Any:
    """foxglove.PoseInFrame: a body, or what else is turned, in the world."""
    x, y, z, w = turned
    pose = Pose(position=_vector(x_m), orientation=Quaternion(x=x, y=y, z=z, w=w))
    return PoseInFrame(timestamp=stamp(t_ns), frame_id=WORLD, pose=pose)


def transforms(view: RobotView, body: Body) -> Any | None:
    """foxglove.FrameTransforms: world to body, gimbal and camera. None while place, depth or tilt is not known."""
    if view.place_m is None or view.turned is None:
        return None
    state, robot, at = view.said, view.said.robot, stamp(view.said.sent_ns)
    aim = turn(state.pan_deg, -state.tilt_deg, 0.0)  # tilt is positive upwards, a turn about y downwards
    return FrameTransforms(
        transforms=[
            _transform(at, WORLD, f"{robot}/body", view.place_m, view.turned),
            _transform(at, f"{robot}/body", f"{robot}/gimbal", body.camera_m, aim),
            _transform(at, f"{robot}/gimbal", f"{robot}/camera", (0.0, 0.0, 0.0), GIMBAL_CAMERA),
        ]
    )


def calibration(robot: str, fit: CameraFit, roi: tuple[int, int, int, int], t_ns: int) -> Any:
    """foxglove.CameraCalibration of a part of the frame, `roi` = (x, y, width, height), with the port's bend."""
    cx, cy = fit.cx_px - roi[0], fit.cy_px - roi[1]
    k = [fit.f_px, 0.0, cx, 0.0, fit.f_px, cy, 0.0, 0.0, 1.0]
    p = [fit.f_px, 0.0, cx, 0.0, 0.0, fit.f_px, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return CameraCalibration(
        timestamp=stamp(t_ns),
        frame_id=f"{robot}/camera",
        width=roi[2],
        height=roi[3],
        distortion_model="plumb_bob",
        D=[fit.bend, 0.0, 0.0, 0.0, 0.0],
        K=k,
        R=r,
        P=p,
    )


NUMBERS = {"<f4": PackedElementField.FLOAT32, "|u1": PackedElementField.UINT8}


def cloud(robot: str, places_m: NDArray[np.float32], colours: NDArray[np.uint8], t_ns: int) -> Any:
    """foxglove.PointCloud: places (n, 3) in the camera frame, colours (n, 3) red green blue."""
    return _cloud(f"{robot}/camera", places_m, colours, {}, t_ns)


def world_cloud(
    places_m: NDArray[np.float32], colours: NDArray[np.uint8], beside: Mapping[str, NDArray[Any]], t_ns: int
) -> Any:
    """The same of places in the world; beside: more of each place (n,), float32 or bytes, to colour it by."""
    return _cloud(WORLD, places_m, colours, beside, t_ns)


def _cloud(
    frame: str, places_m: NDArray[np.float32], colours: NDArray[np.uint8], beside: Mapping[str, NDArray[Any]], t_ns: int
) -> Any:
    kinds: dict[str, Any] = {**dict.fromkeys(("x", "y", "z"), "<f4"), **dict.fromkeys(("red", "green", "blue"), "u1")}
    kinds["alpha"] = "u1"
    packed = np.zeros(len(places_m), np.dtype([*kinds.items(), *((name, one.dtype) for name, one in beside.items())]))
    for name, column in zip(kinds, [*places_m.T, *colours.T, 255], strict=True):
        packed[name] = column
    for name, column in beside.items():
        packed[name] = column
    fields: Mapping[str, Any] = packed.dtype.fields or {}
    return PointCloud(
        timestamp=stamp(t_ns),
        frame_id=frame,
        pose=Pose(position=_vector((0.0, 0.0, 0.0)), orientation=Quaternion(w=1.0)),  # Rerun refuses a missing one
        point_stride=packed.dtype.itemsize,
        fields=[
            PackedElementField(name=name, offset=offset, type=NUMBERS[kind.str])
            for name, (kind, offset) in ((name, fields[name][:2]) for name in packed.dtype.names or ())
        ],
        data=packed.tobytes(),
    )


def world_poses(places_m: Sequence[Vector], turns: Sequence[Turn], t_ns: int) -> Any:
    """foxglove.PosesInFrame: cameras or bodies in the world."""
    poses = [
        Pose(position=_vector(place), orientation=Quaternion(x=x, y=y, z=z, w=w))
        for place, (x, y, z, w) in zip(places_m, turns, strict=True)
    ]
    return PosesInFrame(timestamp=stamp(t_ns), frame_id=WORLD, poses=poses)


def log_line(line: LogLine) -> Any:
    """foxglove.Log."""
    return Log(timestamp=stamp(line.sent_ns), level=LEVELS[line.level], name=line.robot, message=line.text)


def gimbal_of(camera: Turn) -> Turn:
    """The turn of the gimbal's axes to the world, of that of the camera's: x along the optical axis."""
    x, y, z, w = camera
    a, b, c, d = -GIMBAL_CAMERA[0], -GIMBAL_CAMERA[1], -GIMBAL_CAMERA[2], GIMBAL_CAMERA[3]
    return (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )


def _transform(at: Timestamp, parent: str, child: str, at_m: Vector, turned: Turn) -> Any:
    x, y, z, w = turned
    return FrameTransform(
        timestamp=at,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(at_m),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )


def _vector(v: Vector) -> Vector3:
    return Vector3(x=v[0], y=v[1], z=v[2])


# --- plots ---
# Numbers over time for viewers: flat protobuf messages of named doubles, the package `aucamp` in a recording.
#
# Their descriptors are built from this table when the module is loaded, so there is no generated code to keep in
# step. A value that is not known is NaN, which plots show as a gap. Units are in the names.

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
        *(f"prior_{axis}_m" for axis in AXES),
        *(f"posterior_{axis}_m" for axis in AXES),
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
            name=field, number=number, type=FieldDescriptorProto.TYPE_DOUBLE, label=FieldDescriptorProto.LABEL_OPTIONAL
        )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"aucamp.{name}"))


def plot(name: str, **values: float | int | bool | None) -> Any:
    """A message aucamp.NAME; every field of the table must be given, None for what is not known."""
    if values.keys() != set(PLOTS[name]):
        raise ValueError(f"aucamp.{name}: {sorted(values.keys() ^ set(PLOTS[name]))} given or missing")
    return message_class(name)(**{field: math.nan if value is None else value for field, value in values.items()})


def plot_of(name: str, row: Mapping[str, Any]) -> Any:
    """The same of a row that has more columns."""
    return plot(name, **{field: row[field] for field in PLOTS[name]})
