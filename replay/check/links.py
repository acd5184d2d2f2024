"""Who heard whom: every message that a robot took in must be one that its sender gave out, byte for byte.

One that is not was forged or damaged on the way, or the sender's recording is not whole. The signatures under what the
sender itself measured are the exception: it puts them there as a message leaves, so its recording is without.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

import msgpack

from agent.core.codec import Refusal
from replay.check.black_box import BlackBox, Step


class Link(NamedTuple):
    """Messages from one robot to another over a run."""

    src: str
    dst: str
    said: int | None  # None: the sender left no recording
    heard: int
    unknown: int  # heard, but not among those said
    after_end: int  # of those: sent after the sender's recordings end, so nobody can tell


class Correspondence:
    """What all robots of a run said and heard, gathered step by step."""

    def __init__(self) -> None:
        self._said: dict[tuple[str, str], Counter[bytes]] = {}
        self._heard: dict[tuple[str, str], Counter[bytes]] = {}
        self._last_ns: dict[str, int] = {}  # of each robot that left a recording

    def add(self, robot: str, step: Step) -> None:
        """One step of a robot. Raises Refusal for one that holds something else than inputs and outputs."""
        for src, payload in _heard(step.inputs):
            self._heard.setdefault((src, robot), Counter())[as_said(payload, src)] += 1
        if step.outputs is not None:
            self._last_ns[robot] = max(step.now_ns, self._last_ns.get(robot, 0))
            for dst, payload in _said(step.outputs):
                self._said.setdefault((robot, dst), Counter())[as_said(payload, robot)] += 1

    def join(self, other: Correspondence) -> None:
        """Take in what another gathered."""
        for ours, theirs in ((self._said, other._said), (self._heard, other._heard)):
            for pair, payloads in theirs.items():
                ours.setdefault(pair, Counter()).update(payloads)
        for robot, last_ns in other._last_ns.items():
            self._last_ns[robot] = max(last_ns, self._last_ns.get(robot, 0))

    def links(self) -> list[Link]:
        """One for each pair that spoke or heard."""
        return [self._link(src, dst) for src, dst in sorted({*self._said, *self._heard})]

    def _link(self, src: str, dst: str) -> Link:
        said, heard = self._said.get((src, dst), Counter()), self._heard.get((src, dst), Counter())
        if src not in self._last_ns:
            return Link(src, dst, None, heard.total(), 0, 0)
        unknown = heard - said
        after_end = sum(count for payload, count in unknown.items() if _sent_ns(payload) > self._last_ns[src])
        return Link(src, dst, said.total(), heard.total(), unknown.total(), after_end)


def links(boxes: Iterable[BlackBox]) -> list[Link]:
    """The links of a run, from the recordings of all starts of its robots."""
    correspondence = Correspondence()
    for box in boxes:
        for step in box.steps():
            correspondence.add(box.robot, step)
    return correspondence.links()


def as_said(payload: bytes, src: str) -> bytes:
    """A message without the signatures of its sender's own word; payloads that are none stay as they are."""
    try:
        estimate = msgpack.unpackb(payload)
        _, entries, samples, _, proposals = estimate["gossip"]  # in the order of messages.Gossip
        for said in (*entries, *samples, *proposals):
            if said[0] == src and isinstance(said[-1], bytes):  # first its origin, last its signature
                said[-1] = b""
        return bytes(msgpack.packb(estimate))
    except (ValueError, TypeError, LookupError, msgpack.UnpackException, RecursionError):
        return payload


def _heard(inputs: bytes) -> list[tuple[str, bytes]]:
    found = _list(inputs, "heard")
    if not all(isinstance(each.get("src"), str) and isinstance(each.get("payload"), bytes) for each in found):
        raise Refusal("content", "a message heard from nobody")
    return [(each["src"], each["payload"]) for each in found]


def _said(outputs: bytes) -> list[tuple[str, bytes]]:
    """What a step said to whom: its very bytes, which need not be of today's version."""
    found = [each for field in ("says", "near", "claims", "keyframes", "light") for each in _list(outputs, field)]
    if not all(isinstance(each.get("dst"), str) for each in found):
        raise Refusal("content", "a message said to nobody")
    return [(each["dst"], bytes(msgpack.packb(each))) for each in found]


def _list(data: bytes, field: str) -> list[dict[str, Any]]:
    """A field that holds maps, of inputs or outputs. Raises Refusal if it does not."""
    fields = _map(data)
    found = fields.get(field, []) if fields is not None else None
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise Refusal("garbage", f"no step: its '{field}' is no list of messages")
    return found


def _sent_ns(payload: bytes) -> int:
    """The sender's time in a message that nobody vouches for; 0 if it has none."""
    sent_ns = (_map(payload) or {}).get("sent_ns", 0)
    return sent_ns if isinstance(sent_ns, int) else 0


def _map(data: bytes) -> dict[str, Any] | None:
    try:
        fields = msgpack.unpackb(data)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError):
        return None
    return fields if isinstance(fields, dict) else None
