"""The newest words of each neighbour, between two steps.

What one neighbour says about one target may fill KEPT places and no more: the newest stay. That loses nothing, as
evidence is a sum, and the newest estimate stands for those before it; a gap in the numbers tells of the rest. No
neighbour can take another's places, or come before another by speaking more often.
"""

from __future__ import annotations

import math
import threading
from collections import Counter, deque
from collections.abc import Mapping
from typing import Literal

from msgspec import UNSET

from agent.core import topics
from agent.core.config import Fleet
from agent.core.step_io import DroppedPayloads, Heard
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, LINK, NEAR, Topic
from router_config.door import Sample, unusable

KEPT = LINK.qos.buffer
FASTEST_HZ = 40.0  # twice what a fleet file may ask for: who speaks more often for long floods
BURST = 64.0  # messages that may come at once after a cable was out: links are given up after two seconds of silence

NAMES: Mapping[Topic, Literal["near", "claim", "keyframe", "light"]] = {
    NEAR: "near",
    CLAIM: "claim",
    KEYFRAME: "keyframe",
    LIGHT: "light",
}

STRANGER = "unknown sender"
FLOOD = "flood"


def rows_of(fleet: Fleet) -> tuple[Topic, ...]:
    """What neighbours of this fleet tell each other beside estimates."""
    swims = () if fleet.navigation is None else (NEAR,)
    lights = () if fleet.lighting is None else (LIGHT,)
    return (*swims, *lights) if fleet.coverage is None else (*swims, *lights, CLAIM, KEYFRAME)


class _Inbox:
    """Places for what one neighbour says about one target, or about where it is itself."""

    __slots__ = ("arrived", "credit", "kept", "src", "topic")

    def __init__(self, src: str, topic: Topic = LINK) -> None:
        self.src, self.topic = src, topic
        self.kept: deque[tuple[int, bytes]] = deque(maxlen=KEPT)
        self.arrived = 0  # since the last drain
        self.credit = BURST  # messages that may come without being called a flood


class Inboxes:
    """All neighbours' places, filled by Zenoh's threads and emptied by the loop."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        neighbours, targets = fleet.robot[robot].neighbours, fleet.target
        self._by_key = {
            topics.key(LINK, fleet=fleet.fleet, src=src, dst=robot, **topics.target_chunk(targets, target)): _Inbox(src)
            for target in targets
            for src in neighbours
        }
        self._by_key |= {
            topics.key(row, fleet=fleet.fleet, src=src, dst=robot): _Inbox(src, row)
            for row in rows_of(fleet)
            for src in neighbours
        }
        # Who speaks of a target that our file lacks has another fleet file. One place for all such: the step says so.
        self._elsewhere: Mapping[str, _Inbox] = {src: _Inbox(src) for src in neighbours}
        self._inboxes = (*self._by_key.values(), *self._elsewhere.values())  # by target, then by neighbour
        self._refused: Counter[tuple[str, str]] = Counter()  # reason and neighbour: few, whatever arrives
        self._lock = threading.Lock()  # Zenoh has a thread per link
        self._drained_ns: int | None = None

    def put(self, sample: Sample, at_ns: int) -> None:
        """Judge a sample by its outside, and keep a copy if it can be a neighbour's word."""
        inbox = self._by_key.get(key := sample.key)
        if inbox is None:
            inbox = self._unusual(key)
        reason = STRANGER if inbox is None else unusable(sample, inbox.topic)
        payload = b"" if reason else sample.payload()
        with self._lock:
            if inbox is None or reason is not None:
                self._refused[reason or STRANGER, inbox.src if inbox else ""] += 1
            else:
                inbox.arrived += 1
                inbox.kept.append((at_ns, payload))

    def drain(self, now_ns: int) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]:
        """What was kept since the last call, and how much was turned away, by reason and neighbour.

        First the older one of each neighbour, then the newer. What a step that came late could not take is turned away
        in silence; more than a neighbour can have to say is counted as a flood.
        """
        # Before the first step neighbours may have spoken for as long as they like.
        elapsed_s = math.inf if self._drained_ns is None else max(0, now_ns - self._drained_ns) * 1e-9
        self._drained_ns = now_ns
        with self._lock:
            kept = [(inbox, list(inbox.kept)) for inbox in self._inboxes]
            for inbox in self._inboxes:
                self._settle(inbox, elapsed_s)
            refused = sorted(self._refused.items())
            self._refused.clear()
        heard = tuple(
            Heard(
                arrived_ns=payloads[k][0],
                src=inbox.src,
                payload=payloads[k][1],
                topic=NAMES.get(inbox.topic, UNSET),
            )
            for k in range(KEPT)
            for inbox, payloads in kept
            if k < len(payloads)
        )
        return heard, tuple(
            DroppedPayloads(reason=reason, count=count, src=src or UNSET) for (reason, src), count in refused
        )

    def _settle(self, inbox: _Inbox, elapsed_s: float) -> None:
        """Empty it, and count what was beyond all measure."""
        credit = inbox.credit + FASTEST_HZ * elapsed_s
        inbox.credit = max(0.0, min(BURST, credit - inbox.arrived))
        if inbox.arrived:
            beyond = min(inbox.arrived - credit, inbox.arrived - len(inbox.kept))
            if beyond > 0:
                self._refused[FLOOD, inbox.src] += round(beyond)
            inbox.arrived = 0
            inbox.kept.clear()

    def _unusual(self, key: str) -> _Inbox | None:
        """The place of a neighbour's word on a key that is not among the expected ones."""
        row = topics.match(key)
        return self._elsewhere.get(row[1]["src"]) if row and row[0] is LINK else None
