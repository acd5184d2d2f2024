"""What a robot says, as all read it who show it: in its own name alone, and what its State comes to, decided once.

The page, viewers, reports, tables, bridges and consoles draw and word what stands here. World frame, body x ahead, y to
the left, z up, as ROS's REP 103 and ISO 8855 have it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from msgspec import UNSET

from agent.core.codec import Refusal, decode
from agent.core.config import Fleet, Pose
from agent.core.messages import SCHEMA, Message, State, Vector
from agent.core.status import fault_kind
from agent.core.topics import Topic

LATELY_S = 1.0  # ten messages at the default rate: younger than that is "hears"
ROUNDS = 3.0  # of a fleet that speaks seldom: as many of its own rounds
BLIND = ("no camera", "no frames")  # kinds of faults without a picture
MOTORS = {True: "motors on", False: "motors off", None: ""}
AXES = "xyz"

Quaternion = tuple[float, float, float, float]  # x y z w, of unit length


def in_own_name(
    topic: Topic, chunks: Mapping[str, str], payload: bytes, accepted: Collection[int] = frozenset({SCHEMA})
) -> Any:
    """The message of a row of the network. Raises Refusal for what cannot be read, and for what says that it is of
    another robot than its key does."""
    message: Message = decode(payload, topic.message, topic.limit, accepted)
    if getattr(message, topic.writer) != chunks[topic.writer]:
        raise Refusal("address", f"on the key of {chunks[topic.writer]}")
    return message


class RobotView(NamedTuple):
    """What a State comes to; what is shown as it was said stands in `said`."""

    said: State
    body: Pose | None  # of the body's centre; None: it swims and does not know, or the fleet file is not at hand
    place_m: Vector | None  # the same, world frame; None where its depth is not known either
    turned: Quaternion | None  # of the body in the world; None where any of its three angles is not known
    hears: tuple[str, ...]  # the neighbours whose word is fresh
    seeing: int  # how many robots see the target, as far as this one knows: itself and its neighbours
    motors: str  # motors on, motors off; empty: nobody knows
    remarks: tuple[str, ...]  # kinds of its faults and what people ordered; of one without any that its motors are off
    blind: tuple[str, ...]  # faults for which there is no picture

    @property
    def row(self) -> dict[str, Any]:
        """Columns of plots and tables, by their names; None: not known."""
        said = self.said
        return {
            "target": said.target,
            "iteration": said.t,
            "knows": said.knows,
            "measurements": said.measurements,
            "valid_robots": self.seeing,
            "rule": said.rule,
            "alpha": said.alpha,
            **along_axes("prior_{}_m", said.prior_m),
            "prior_sigma_m": said.prior_sigma_m,
            **along_axes("posterior_{}_m", said.posterior_m),
            "posterior_sigma_m": said.posterior_sigma_m,
            **{name: getattr(said, name) for name in ("depth_m", "roll_deg", "pitch_deg", "pan_deg", "tilt_deg")},
            "lens_position": said.focus,
            "faults": "; ".join(said.faults),
        }


def robot_view(state: State, fleet: Fleet | None = None) -> RobotView:
    """`fleet` says where a moored robot hangs and how high the water stands: without it there is no `body`."""
    body, z_m, lately_s = None, None, LATELY_S
    if fleet is not None and state.robot in fleet.robot:
        body = _body(state, fleet.robot[state.robot].pose)
        z_m = None if state.depth_m is None else fleet.tank.surface_m - state.depth_m
        lately_s = max(LATELY_S, ROUNDS / fleet.link.send_hz)
    remarks = *map(fault_kind, state.faults), *(state.ordered or ())
    return RobotView(
        said=state,
        body=body,
        place_m=None if body is None or z_m is None else (body.x_m, body.y_m, z_m),
        turned=None
        if body is None or state.roll_deg is None or state.pitch_deg is None
        else turn(body.yaw_deg, state.pitch_deg, state.roll_deg),
        hears=tuple(near.robot for near in state.neighbours if near.age_s is not None and near.age_s < lately_s),
        seeing=(state.knows == "sees") + sum(near.valid for near in state.neighbours),
        motors=MOTORS[state.armed],
        remarks=remarks or ((MOTORS[False],) if state.armed is False else ()),
        blind=tuple(fault for fault in state.faults if fault.startswith(BLIND)),
    )


def _body(state: State, moored: Pose) -> Pose | None:
    at = state.whereabouts
    if at is UNSET:
        return moored
    return None if at is None else Pose(x_m=at.x_m, y_m=at.y_m, yaw_deg=at.yaw_deg)


def turn(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Quaternion:
    """Rz(yaw) Ry(pitch) Rx(roll): by yaw about z, then by pitch about the new y, then by roll about the new x."""
    (sx, cx), (sy, cy), (sz, cz) = (
        (math.sin(half), math.cos(half)) for half in (math.radians(deg) / 2.0 for deg in (roll_deg, pitch_deg, yaw_deg))
    )
    return (
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
        cx * cy * cz + sx * sy * sz,
    )


def camera_tilt_rad(state: State) -> float:
    """How far the camera looks up, as its gimbal is told and its body is turned; level where that is not known."""
    pan, tilt, roll, pitch = (
        math.radians(deg or 0.0) for deg in (state.pan_deg, state.tilt_deg, state.roll_deg, state.pitch_deg)
    )
    ahead, left, up = math.cos(tilt) * math.cos(pan), math.cos(tilt) * math.sin(pan), math.sin(tilt)
    rise = -math.sin(pitch) * ahead + math.cos(pitch) * (math.sin(roll) * left + math.cos(roll) * up)
    return math.asin(min(max(rise, -1.0), 1.0))


def along_axes(name: str, x_m: Vector | None) -> dict[str, float | None]:
    """A place in columns; `name` has {} where x, y and z stand."""
    return {name.format(axis): value for axis, value in zip(AXES, x_m or (None, None, None), strict=True)}
