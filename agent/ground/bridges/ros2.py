"""ROS 2 as a language of `outward`: keys and tokens of rmw_zenoh, the messages, and the topic of each message; and a
recording as a bag.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import shutil
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from agent.core.config import Fleet, writing
from agent.core.messages import Estimate, Image, Message, State
from agent.core.robot_view import robot_view
from agent.core.topics import IMAGE, LINK, STATE, Topic, target_chunk
from agent.ground.bridges.outward import WORLD, Foreign
from agent.process.transport import told_first
from replay.files.info import suspecting
from replay.report.timeline import FleetFile, open_fleet_file
from replay.story import said_in

# --- keys and tokens of rmw_zenoh ---
# Keys and tokens by which rmw_zenoh finds topics, and what goes along with each message. Pure.
#
# Source: rmw_zenoh, docs/design.md: a topic's key, graph cache, attachment.

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


# --- messages ---
# What robots show, as messages of ROS 2. Pure.
#
# Our world frame is ROS's own kind, REP 103 (robot_view); so are roll, pitch and yaw.

ANY_ANGLE = math.pi**2 / 3.0  # variance of an angle of which nothing is known: a ball has none
POSE, TARGET, CAMERA = "pose", "target", "camera/compressed"
TYPES = {
    POSE: "geometry_msgs/msg/PoseStamped",
    TARGET: "geometry_msgs/msg/PoseWithCovarianceStamped",
    CAMERA: "sensor_msgs/msg/CompressedImage",
}


class Telling:
    """Knows the definitions of ROS 2 Jazzy."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet, self.store = fleet, get_typestore(Stores.ROS2_JAZZY)

    def kind(self, topic: str) -> Kind:
        """The type of one of TYPES's topics."""
        return Kind(TYPES[topic], self.store.hash_rihs01(TYPES[topic]))

    def topics(self, robot: str) -> dict[str, Kind]:
        """All of a robot, by what stands behind its name. Targets are heard as neighbours are told of them."""
        of_targets = self._fleet.target if self._fleet.robot[robot].neighbours else ()
        names = {POSE: POSE, CAMERA: CAMERA, **{self.target_topic(target): TARGET for target in of_targets}}
        return {name: self.kind(topic) for name, topic in names.items()}

    def target_topic(self, target: str) -> str:
        """The target stands in the name where a fleet has several."""
        return "/".join((TARGET, *target_chunk(self._fleet.target, target).values()))

    def message(self, message: Message) -> bytes | None:
        """A State as pose, what is told a neighbour as target, a preview; None where nothing is known."""
        match message:
            case State():
                return self.pose(message)
            case Estimate():
                return self.target(message)
            case Image():
                return self.image(message)
        return None

    def pose(self, state: State) -> bytes | None:
        """Where its body is; None where it does not know all of that."""
        view = robot_view(state, self._fleet)
        if view.place_m is None or view.turned is None:
            return None
        pose = self._pose(view.place_m, view.turned)
        return self._bytes(TYPES[POSE], header=self._header(state.sent_ns, WORLD), pose=pose)

    def target(self, estimate: Estimate) -> bytes | None:
        """Where it thinks the target is; None while it does not."""
        if estimate.x_m is None or estimate.cov_m2 is None:
            return None
        xx, xy, xz, yy, yz, zz = estimate.cov_m2
        covariance = np.diag([0.0, 0.0, 0.0, ANY_ANGLE, ANY_ANGLE, ANY_ANGLE])
        covariance[:3, :3] = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
        pose = self._made("geometry_msgs/msg/PoseWithCovariance")(
            pose=self._pose(estimate.x_m, (0.0, 0.0, 0.0, 1.0)), covariance=covariance.ravel()
        )
        return self._bytes(TYPES[TARGET], header=self._header(estimate.sent_ns, WORLD), pose=pose)

    def image(self, image: Image) -> bytes:
        """What its camera sees, stamped with the middle of the exposure."""
        data = np.frombuffer(image.jpeg, np.uint8)
        header = self._header(max(0, image.t_ns), f"{image.robot}_camera")
        return self._bytes(TYPES[CAMERA], header=header, format="jpeg", data=data)

    def _header(self, t_ns: int, frame: str) -> Any:
        seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
        stamp = self._made("builtin_interfaces/msg/Time")(sec=seconds & 0x7FFFFFFF, nanosec=nanoseconds)
        return self._made("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)

    def _pose(self, place_m: tuple[float, float, float], turned: tuple[float, float, float, float]) -> Any:
        point = self._made("geometry_msgs/msg/Point")(*place_m)
        return self._made("geometry_msgs/msg/Pose")(point, self._made("geometry_msgs/msg/Quaternion")(*turned))

    def _made(self, name: str) -> Any:
        return self.store.types[name]

    def _bytes(self, name: str, **fields: Any) -> bytes:
        return bytes(self.store.serialize_cdr(self._made(name)(**fields), name))


# --- topics ---


class Ros2:
    rows: tuple[Topic, ...] = (STATE, LINK, IMAGE)

    def __init__(self, fleet: Fleet, domain: int) -> None:
        self._fleet, self._domain, self.telling = fleet, domain, Telling(fleet)
        self._told_first = told_first(fleet)
        self._nodes: dict[str, Node] = {}
        self._numbers: Counter[str] = Counter()  # of each topic's messages so far

    def tokens(self, session: str) -> Iterator[str]:
        robots = {robot: self.telling.topics(robot) for robot in self._fleet.robot}
        self._nodes = nodes(session, self._domain, robots)
        for node in self._nodes.values():
            yield node.token
            yield from (publisher.token for publisher in node.publishers.values())

    def said(self, message: Message, now_ns: int) -> Iterator[Foreign]:
        robot, topic = self.topic(message)
        if robot not in self._nodes or (to := self._nodes[robot].publishers.get(topic)) is None:
            return  # of no robot or target of the fleet file
        if (payload := self.telling.message(message)) is not None:
            self._numbers[to.key] += 1
            yield Foreign(to.key, payload, to.attachment(self._numbers[to.key], now_ns))

    def topic(self, message: Message) -> tuple[str, str]:
        """Robot, and what stands in the topic behind its name; empty for what is left out, such as copies of what
        its first neighbour is told."""
        match message:
            case State():
                return message.robot, POSE
            case Estimate() if (
                message.target in self._fleet.target and self._told_first.get(message.src) == message.dst
            ):
                return message.src, self.telling.target_topic(message.target)
            case Image():
                return message.robot, CAMERA
        return "", ""


# --- bag ---
# The recording of a fleet as a bag of ROS 2, with the topics and messages of the bridge: for rviz, whose fixed frame is
# `world`, PlotJuggler and `ros2 bag play`. Its times are those at which the recorder had each message.


def write_bag(path: Path, out: Path) -> int:
    """Write a new folder, a bag of MCAP, and return how many messages it has.

    path: a fleet's recording, or the folder of a run with one. Raises ConfigError where there is none.
    """
    file = open_fleet_file(path)
    try:
        with writing(out), Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            return _copied(file, bag)
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)  # half a bag looks like a whole one
        raise


def _copied(file: FleetFile, bag: Writer) -> int:
    ours, count = Ros2(file.fleet, 0), 0
    connections = {
        f"{robot}/{name}": bag.add_connection(f"/{robot}/{name}", kind.name, typestore=ours.telling.store)
        for robot in file.fleet.robot
        for name, kind in ours.telling.topics(robot).items()
    }
    for heard_ns, topic, payload in _payloads(file, ours):
        if (to := connections.get(topic)) is not None:
            bag.write(to, heard_ns, payload)
            count += 1
    return count


def _payloads(file: FleetFile, ours: Ros2) -> Iterator[tuple[int, str, bytes]]:
    """When each message was heard, its topic and its bytes."""
    with suspecting(file.path):
        for said in said_in(file.paths, ours.rows):
            if (payload := ours.telling.message(said.message)) is not None:
                yield said.log_time_ns, "/".join(ours.topic(said.message)), payload
