"""What is on the network -> what the page is sent. Pure: live and from a recording the same row gives the same bytes.

A key names what replaces what: of each only the newest is shown. Names of fields are those of the messages
(docs/messages.md). Nanoseconds do not fit into a number of JavaScript: a stamp `x_ns` becomes `x_ms`, a float, and what
has to come back to the last digit is text.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
from msgspec import UNSET

from agent.core.capability_messages import TURN_ONE, UNIT_M, Claim, holds
from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import Answer, Estimate, Image, LogLine, Message, Presence, State
from agent.core.topics import Topic

Shown = str | bytes  # a text message, or a picture
Fields = dict[str, Any]

PICTURE = struct.Struct("<BIQ")  # robot, counted as in the fleet file; number of the frame; middle of its exposure, ns
LINES: tuple[type[Message], ...] = (LogLine, Answer)  # of these every one counts, not the newest alone
SELDOM_NS: Mapping[type[Message], int] = {Estimate: 450_000_000}  # so often is enough: of it the page takes an ellipse
UNSHOWN = ("schema", "fleet", "seq")


class Rows:
    """The rows of one fleet. Robots and targets that its file does not name are shown to nobody."""

    def __init__(self, fleet: Fleet) -> None:
        self._robots = {name: index for index, name in enumerate(fleet.robot)}
        self._targets = frozenset(fleet.target)
        self._of: Mapping[type[Message], tuple[str, Callable[[Any], Fields | bytes]]] = {
            State: ("state", self._state),
            Estimate: ("link", self._estimate),
            Presence: ("near", _presence),
            Claim: ("claim", _claim),
            Image: ("image", self._image),
            LogLine: ("log", _stamped),
            Answer: ("answer", _answer),
        }

    def key(self, topic: Topic, chunks: Mapping[str, str]) -> str | None:
        """What a row stands for on the page; None: it is not shown. What a robot tells its neighbours is one thing,
        whomever it tells."""
        robot, target = chunks[topic.writer], chunks.get("target")
        if topic.message not in self._of or robot not in self._robots:
            return None
        if target is not None and target not in self._targets:
            return None
        return "/".join((self._of[topic.message][0], robot, *((target,) if target is not None else ())))

    def message(self, topic: Topic, chunks: Mapping[str, str], payload: bytes) -> Shown:
        """What the page is sent. Raises Refusal for a payload that is none of this row, or of somebody else."""
        key = self.key(topic, chunks)
        if key is None:
            raise Refusal("address", "not shown")
        said = decode(payload, topic.message, topic.limit, READABLE)
        if getattr(said, topic.writer) != chunks[topic.writer]:
            raise Refusal("address", f"on the key of {chunks[topic.writer]}")
        fields = self._of[topic.message][1](said)
        return fields if isinstance(fields, bytes) else text({"k": key, **fields})

    def _state(self, state: State) -> Fields:
        if state.target not in self._targets:
            raise Refusal("target", f"target '{state.target}' is not in the fleet file")
        # An order says which state was looked at, by these two.
        return {**_stamped(state), "seen": [str(state.incarnation), str(state.sent_ns)]}

    def _estimate(self, said: Estimate) -> Fields:
        if said.target not in self._targets:
            raise Refusal("target", f"target '{said.target}' is not in the fleet file")
        return {
            "robot": said.src,
            "target": said.target,
            "valid": said.valid,
            "x_m": said.x_m,
            "cov_m2": said.cov_m2,
            "sent_ms": said.sent_ns * 1e-6,
        }

    def _image(self, image: Image) -> bytes:
        return PICTURE.pack(self._robots[image.robot], image.frame & 0xFFFFFFFF, max(image.t_ns, 0)) + image.jpeg


def text(message: Fields) -> str:
    """A message of the page as JSON."""
    return msgspec.json.encode(message).decode()


def _stamped(message: Message) -> Fields:
    """All fields, but for what only programs need; stamps in milliseconds."""
    fields = msgspec.to_builtins(message)
    for name in UNSHOWN:
        fields.pop(name, None)
    for name in [name for name in fields if name.endswith("_ns")]:
        fields[name.removesuffix("_ns") + "_ms"] = fields.pop(name) * 1e-6
    fields.pop("incarnation", None)
    return dict(fields)


def _presence(said: Presence) -> Fields:
    fields = _stamped(said)
    fields["robot"] = fields.pop("src")
    del fields["dst"]
    return fields


def _claim(said: Claim) -> Fields:
    """Where its camera looks next: the gimbal's pivot and the direction of the optical axis, world frame."""
    view, (own, held) = said.view, holds(said)
    looks = None
    if view is not UNSET:
        w, x, y, z = (part / TURN_ONE for part in view.turn)
        ahead = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        looks = {"x_m": [part * UNIT_M for part in view.place], "ahead": ahead}
    return {
        "robot": said.src,
        "looks": looks,
        "share": said.share,
        "keyframes": own,
        "keyframes_held": held,
        "sent_ms": said.sent_ns * 1e-6,
    }


def _answer(answer: Answer) -> Fields:
    return {**_stamped(answer), "id": str(answer.id)}
