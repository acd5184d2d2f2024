"""Keys and tokens by which rmw_zenoh finds topics, and what goes along with each message. Pure.

Source: rmw_zenoh, docs/design.md: a topic's key, graph cache, attachment.
"""

from __future__ import annotations

import hashlib
import itertools
import struct
from typing import NamedTuple

NODE = "aucamp"  # of each robot, in the name space of its own: /r1/aucamp
QOS = "::,10:,:,:,,"  # reliability, durability, history and depth, deadline, lifespan, liveliness: ROS's own defaults
GID = struct.Struct("<qqB16s")  # number, when it was sent, length of the sender's name, that name


class Kind(NamedTuple):
    """A type of message."""

    name: str  # geometry_msgs/msg/PoseStamped
    digest: str  # of its definition: RIHS01_ and 64 hexadecimal digits

    @property
    def dds(self) -> str:
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


class Publisher(NamedTuple):
    """One topic of one robot."""

    topic: str  # r1/pose
    kind: Kind
    key: str
    token: str  # it is there as long as the publisher is

    def attachment(self, number: int, sent_ns: int) -> bytes:
        """`sent_ns`: since the Unix epoch."""
        gid = hashlib.md5(self.token.encode(), usedforsecurity=False).digest()
        return GID.pack(number, sent_ns, len(gid), gid)


class Node(NamedTuple):
    """One robot."""

    token: str
    publishers: dict[str, Publisher]  # by what stands in their topic behind the robot's name


def nodes(session: str, domain: int, robots: dict[str, dict[str, Kind]]) -> dict[str, Node]:
    """`session`: its id; `robots`: of each the topics and their types."""
    found = {}
    numbers = itertools.count()  # one for each node and each publisher of the session
    for robot, topics in robots.items():
        node = next(numbers)
        head = f"@ros2_lv/{domain}/{session}/{node}"
        who = f"%/%{robot}/{NODE}"  # no enclave, name space, node; % stands for /
        publishers = {}
        for name, kind in topics.items():
            topic = f"{robot}/{name}"
            token = f"{head}/{next(numbers)}/MP/{who}/%{topic.replace('/', '%')}/{kind.dds}/{kind.digest}/{QOS}"
            publishers[name] = Publisher(topic, kind, f"{domain}/{topic}/{kind.dds}/{kind.digest}", token)
        found[robot] = Node(f"{head}/{node}/NN/{who}", publishers)
    return found
