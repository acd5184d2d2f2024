"""What robots show, as messages of ROS 2. Pure.

Our world frame is ROS's own kind (REP 103): z up, body x ahead and y to the left; so are roll, pitch and yaw.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from agent.core.config import Fleet
from agent.core.messages import Estimate, Image, Message, State
from agent.core.topics import target_chunk
from agent.ground.bridges.placed import WORLD, placed
from agent.ground.bridges.ros2.names import Kind

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
        self._fleet, self._store = fleet, get_typestore(Stores.ROS2_JAZZY)

    def kind(self, topic: str) -> Kind:
        """The type of one of TYPES's topics."""
        return Kind(TYPES[topic], self._store.hash_rihs01(TYPES[topic]))

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
        if (at := placed(self._fleet, state)) is None:
            return None
        return self._bytes(TYPES[POSE], header=self._header(state.sent_ns, WORLD), pose=self._pose(*at))

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
        return self._store.types[name]

    def _bytes(self, name: str, **fields: Any) -> bytes:
        return bytes(self._store.serialize_cdr(self._made(name)(**fields), name))
