"""The fleet file that a recorder would have written beside some black boxes, for tests."""

from collections.abc import Callable
from pathlib import Path

from agent.core import topics
from agent.core.codec import decode, encode
from agent.core.config import dump
from agent.core.messages import Message
from agent.core.step_io import Outputs
from replay.check.reexecute import open_boxes
from replay.files.channels import NETWORK, Entry, name
from replay.files.mcap_file import Part


def overheard_run(
    folder: Path, out: Path, change: Callable[[Message], Message | None] = lambda message: message
) -> Path:
    """Write what the robots of `folder` said and showed to `out`; `change` gives another message, or None for none."""
    boxes = open_boxes([folder])
    sent: list[tuple[int, str, Message]] = []
    for box in boxes:
        for step in box.steps():
            outputs = decode(step.outputs or b"", Outputs, limit=10**6)
            fleet = {"fleet": box.fleet.fleet, "robot": box.robot}
            sent += [(step.now_ns, topics.key(topics.LINK, **fleet, src=e.src, dst=e.dst), e) for e in outputs.says]
            sent += [(step.now_ns, topics.key(topics.STATE, **fleet), s) for s in (outputs.state,) if s is not None]
            for said in outputs.outgoing or ():
                topic = next(one for one in topics.TOPICS if one.name == said.topic)
                key = topics.key(topic, **fleet, src=box.robot, dst=said.to)
                sent.append((step.now_ns, key, decode(said.payload, topic.message, topic.limit)))
            sent += [(step.now_ns, topics.key(topics.LOG, **fleet), line) for line in outputs.log]
    part = Part(out)
    header = {**boxes[0].run, "kind": "fleet"}
    part.start(header, {"fleet.toml": dump(boxes[0].fleet)})
    for n, (now_ns, key, said) in enumerate(sorted(sent, key=lambda each: each[0])):
        message = change(said)
        if message is not None:
            part.add(Entry(name(NETWORK, key=key), now_ns, now_ns, n, encode(message), "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    return out
