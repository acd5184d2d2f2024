"""keelson as a language of `outward`: robots are entities, and what they say becomes keelson's well-known subjects.

Its attitude is that of ISO 8855, and so is ours. It has no subject for depth, which stands in frame_transform, as z;
none for a target; none for who hears whom.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import keelson
from msgspec import UNSET

from agent.core.config import Fleet
from agent.core.messages import Image, Level, LogLine, Message, State
from agent.core.robot_view import RobotView, robot_view
from agent.core.topics import IMAGE, LOG, STATE, Topic
from agent.ground.bridges.outward import ALT_HOLD, GUIDED, SURFACING, WORLD, Foreign, vehicle

MODES = {ALT_HOLD: "ALT_HOLD", GUIDED: "GUIDED", SURFACING: "SURFACE"}
LEVELS: dict[Level, int] = {"info": 2, "warning": 3, "error": 4}  # of foxglove.Log
PRESSURE, CONTROL, PLACE, CAMERA, AGENT = SOURCES = ("pressure", "control", "place", "camera", "agent")


class Keelson:
    rows: tuple[Topic, ...] = (STATE, IMAGE, LOG)

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet

    def tokens(self, session: str) -> Iterator[str]:
        for robot in self._fleet.robot:
            for source in SOURCES:
                yield keelson.construct_liveliness_key(self._fleet.fleet, robot, source)

    def said(self, message: Message, now_ns: int) -> Iterator[Foreign]:
        match message:
            case State() if message.robot in self._fleet.robot:
                found = self._state(robot_view(message, self._fleet))
            case Image() if message.robot in self._fleet.robot:
                found = iter((self._image(message),))
            case LogLine() if message.robot in self._fleet.robot:
                found = iter((self._line(message),))
            case _:
                return
        for source, subject, told in found:
            key = keelson.construct_pubsub_key(self._fleet.fleet, message.robot, subject, source)
            yield Foreign(key, keelson.enclose(told.SerializeToString(), enclosed_at=now_ns))

    def _state(self, view: RobotView) -> Iterator[tuple[str, str, Any]]:
        """Source, subject and message of all that is known."""
        state, at_ns = view.said, view.said.sent_ns
        if state.roll_deg is not None:
            yield PRESSURE, "roll_deg", made("roll_deg", at_ns, value=state.roll_deg)
        if state.pitch_deg is not None:
            yield PRESSURE, "pitch_deg", made("pitch_deg", at_ns, value=state.pitch_deg)
        if view.body is not None:
            yield PLACE, "yaw_deg", made("yaw_deg", at_ns, value=view.body.yaw_deg)
        if view.place_m is not None and view.turned is not None:
            told = made("frame_transform", at_ns, parent_frame_id=WORLD, child_frame_id=state.robot)
            for axis, value in zip("xyz", view.place_m, strict=True):
                setattr(told.translation, axis, value)
            for axis, value in zip("xyzw", view.turned, strict=True):
                setattr(told.rotation, axis, value)
            yield PLACE, "frame_transform", told
        if state.battery_v is not UNSET:
            yield CONTROL, "battery_voltage_v", made("battery_voltage_v", at_ns, value=state.battery_v)
        if state.armed is not None:
            yield CONTROL, "vehicle_armed", made("vehicle_armed", at_ns, value=state.armed)
        yield CONTROL, "vehicle_mode", made("vehicle_mode", at_ns, value=MODES[vehicle(view).mode])

    def _image(self, image: Image) -> tuple[str, str, Any]:
        about = {"frame_id": f"{image.robot}_camera", "format": "jpeg", "data": image.jpeg}
        return CAMERA, "image_compressed", made("image_compressed", max(0, image.t_ns), **about)

    def _line(self, line: LogLine) -> tuple[str, str, Any]:
        about = {"level": LEVELS[line.level], "message": line.text, "name": line.robot}
        return AGENT, "log_message", made("log_message", line.sent_ns, **about)


def made(subject: str, at_ns: int, **fields: Any) -> Any:
    """The message that keelson has for a subject."""
    message = keelson.get_protobuf_message_class_from_type_name(keelson.get_subject_schema(subject))(**fields)
    message.timestamp.FromNanoseconds(at_ns)
    return message
