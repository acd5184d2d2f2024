"""What is on the network -> what the page is sent, and what each open page has not been sent yet. Pure: live and from a
recording the same row gives the same bytes.

A key names what replaces what: of each only the newest is shown. Names of fields are those of the messages
(docs/messages.md). Nanoseconds do not fit into a number of JavaScript: a stamp `x_ns` becomes `x_ms`, a float, and what
has to come back to the last digit is text.
"""

from __future__ import annotations

import asyncio
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec
from msgspec import UNSET

from agent.capabilities.survey.coverage_map import place_m, places_m
from agent.core.capability_messages import TURN_ONE, UNIT_M, Claim, Keyframe, frame_fault, holds
from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import Answer, Estimate, Image, LogLine, Message, Presence, State
from agent.core.robot_view import in_own_name
from agent.core.topics import Topic

Shown = str | bytes  # a text message, or a picture
Fields = dict[str, Any]

PICTURE = struct.Struct("<BIQ")  # robot, counted as in the fleet file; number of the frame; middle of its exposure, ns
LINES: tuple[type[Message], ...] = (LogLine, Answer)  # of these every one counts, not the newest alone
# So often is enough: of an estimate the page takes an ellipse, and a keyframe never changes.
SELDOM_NS: Mapping[type[Message], int] = {Estimate: 450_000_000, Keyframe: 1 << 62}
UNSHOWN = ("schema", "fleet", "seq")
AGED: tuple[type[Message], ...] = (State, Presence)  # the page says how old they are


class Rows:
    """The rows of one fleet. Robots and targets that its file does not name are shown to nobody."""

    def __init__(self, fleet: Fleet) -> None:
        self._robots = {name: index for index, name in enumerate(fleet.robot)}
        self._targets = frozenset(fleet.target)
        self._tank_m = fleet.tank.size_m
        self._of: Mapping[type[Message], tuple[str, Callable[[Any], Fields | bytes]]] = {
            State: ("state", self._state),
            Estimate: ("link", self._estimate),
            Presence: ("near", _presence),
            Claim: ("claim", _claim),
            Keyframe: ("surface", self._surface),
            Image: ("image", self._image),
            LogLine: ("log", _stamped),
            Answer: ("answer", _answer),
        }

    def key(self, topic: Topic, chunks: Mapping[str, str], payload: bytes) -> str | None:
        """What a row stands for on the page; None: it is not shown. What a robot tells its neighbours is one thing,
        not one for each; what a sweep showed is one thing, by whatever way it came."""
        robot, target = chunks[topic.writer], chunks.get("target")
        if topic.message not in self._of or robot not in self._robots:
            return None
        if target is not None and target not in self._targets:
            return None
        if topic.message is Keyframe:
            return self._surface_key(payload, topic.limit)
        return "/".join((self._of[topic.message][0], robot, *((target,) if target is not None else ())))

    def message(self, topic: Topic, chunks: Mapping[str, str], payload: bytes, arrived_ns: int) -> Shown:
        """What the page is sent. Raises Refusal for a payload that is none of this row, or of somebody else.

        arrived_ns: by the clock that tells the page what time it is. A page that is opened later knows by it how old
        the newest of a robot is, whatever that robot's own clock says.
        """
        key = self.key(topic, chunks, payload)
        if key is None:
            raise Refusal("address", "not shown")
        fields = self._of[topic.message][1](in_own_name(topic, chunks, payload, READABLE))
        if isinstance(fields, bytes):
            return fields
        arrived = {"arrived_ms": arrived_ns * 1e-6} if topic.message in AGED else {}
        return text({"k": key, **fields, **arrived})

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

    def _surface_key(self, payload: bytes, limit: int) -> str | None:
        try:
            frame = decode(payload, Keyframe, limit, READABLE).frame
        except Refusal:
            return None
        return f"surface/{frame.origin}/{frame.incarnation}/{frame.number}" if frame.origin in self._robots else None

    def _surface(self, said: Keyframe) -> Fields:
        """What one sweep showed: where it was measured from, and the place of each block, row by row; mm."""
        frame = said.frame
        if (fault := frame_fault(frame, self._tank_m)) is not None:
            raise Refusal("content", fault)
        blocks: list[tuple[int, ...] | None] = [None] * len(frame.sigmas)
        for k, place, _, _ in places_m(frame):
            blocks[k] = tuple(round(1e3 * x) for x in place)
        return {"from_mm": [1e3 * x for x in place_m(frame.place)], "cols": frame.lens.cols, "blocks": blocks}

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


# --- what the page shows ---
# What a page shows now, and what each open page has not been sent yet.
#
# One message of a key is on its way to a page at any time: the next one goes when the page says that it has drawn the
# last, and is then the newest that there is. A page that was frozen for seconds is thus at most one message behind,
# where a queue, or the sockets' own, would play to it what happened meanwhile.

LINES_KEY = "lines"  # the key of what is a queue: log, orders, answers
CAME = "came"  # the key of what came of a recording, whatever time of it is shown
KEPT = 400  # lines that a page opened later still shows
MOST_KEYS = 1024
MOST_SURFACES = 768  # keyframes are shown while there are fewer keys: the rest is for what robots say of themselves

Make = Callable[[], Shown]


class Item:
    """The newest of a key: made when somebody wants it, and once."""

    __slots__ = ("_made", "_make")

    def __init__(self, make: Make) -> None:
        self._make = make
        self._made: Shown | None = None

    def made(self) -> Shown:
        if self._made is None:
            self._made = self._make()
        return self._made


class Viewer:
    """One open page: which keys it has not seen the newest of, and which it has not acknowledged."""

    def __init__(self) -> None:
        self.news = asyncio.Event()
        self.waiting: dict[str, None] = {}  # a set that keeps its order
        self.owed: set[str] = set()
        self.lines: deque[msgspec.Raw] = deque(maxlen=KEPT)

    def due(self) -> str | None:
        """The key to send next; None: there is nothing, or the page has not drawn what it got."""
        return next((key for key in self.waiting if key not in self.owed), None)

    def got(self, keys: Iterable[str]) -> None:
        """What the page has drawn."""
        self.owed.difference_update(keys)
        self.news.set()

    def wants(self, key: str) -> None:
        self.waiting[key] = None
        if key not in self.owed:
            self.news.set()


class Board:
    """Used from one thread, that of the event loop."""

    def __init__(self) -> None:
        self.refused = 0  # messages that are none: not shown
        self.full = False  # something is not shown, for there are too many keys
        self._newest: dict[str, Item] = {}
        self._lines: deque[msgspec.Raw] = deque(maxlen=KEPT)
        self._viewers: set[Viewer] = set()

    def show(self, key: str, make: Make) -> bool:
        """In place of what was shown of this key. False: there are too many keys already, and it is not shown."""
        most = MOST_SURFACES if key.startswith("surface/") else MOST_KEYS
        if key not in self._newest and len(self._newest) >= most:
            self.full = True
            return False
        self._newest[key] = Item(make)
        for viewer in self._viewers:
            viewer.wants(key)
        return True

    def say(self, line: Shown) -> None:
        """Behind the lines that were said; a line is a message of the page as well."""
        raw = msgspec.Raw(line.encode() if isinstance(line, str) else line)
        self._lines.append(raw)
        for viewer in self._viewers:
            viewer.lines.append(raw)
            viewer.wants(LINES_KEY)

    def start_over(self) -> None:
        """Nothing is shown: another time of a recording follows."""
        kept = {key: item for key, item in self._newest.items() if key in ("hello", "clock", CAME)}
        self._newest = kept
        self._lines.clear()
        self.full = False
        for viewer in self._viewers:
            viewer.waiting = {key: None for key in viewer.waiting if key in kept}
            viewer.lines.clear()
            viewer.owed.clear()  # else what follows could come to a page before it hears that it starts over
        self.show("over", lambda: text({"k": "over"}))

    def join(self) -> Viewer:
        """A page that was opened: all that there is will be sent to it."""
        viewer = Viewer()
        viewer.lines.extend(self._lines)
        for key in self._newest:
            viewer.wants(key)
        if viewer.lines:
            viewer.wants(LINES_KEY)
        self._viewers.add(viewer)
        return viewer

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._viewers)

    def leave(self, viewer: Viewer) -> None:
        self._viewers.discard(viewer)

    def next_for(self, viewer: Viewer) -> list[Shown]:
        """The next messages to this page, which owes an answer for each from now on."""
        found = []
        while (key := viewer.due()) is not None:
            del viewer.waiting[key]
            try:
                found.append(self._lines_for(viewer) if key == LINES_KEY else self._newest[key].made())
            except Refusal:
                self.refused += 1
                self._newest.pop(key)
            except KeyError:  # refused to another page
                continue
            else:
                viewer.owed.add(key)
        return found

    def _lines_for(self, viewer: Viewer) -> Shown:
        lines = list(viewer.lines)
        viewer.lines.clear()
        return text({"k": LINES_KEY, "lines": lines})
