"""Somebody else's eyes: zenoh-ros2-sdk, as a process, looks for topics and reads them. Prints JSON.

Usage: python -m tests.network.bridges.ros2_client PORT DOMAIN. The SDK would fetch the texts of messages from GitHub;
here it gets those that rosbags ships, as files, and computes their digests itself.
"""

import json
import logging
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Subscriber, discovery, message_registry

TEXTS = [
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    *(f"geometry_msgs/msg/{name}" for name in ("Point", "Quaternion", "Pose", "PoseWithCovariance")),
    *(f"geometry_msgs/msg/{name}" for name in ("PoseStamped", "PoseWithCovarianceStamped")),
    "sensor_msgs/msg/CompressedImage",
]
PATIENCE_S = 20.0


def main(port: int, domain: int) -> None:
    store, folder = get_typestore(Stores.ROS2_JAZZY), Path(tempfile.mkdtemp())
    for name in TEXTS:
        path = folder / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(store.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0])
    message_registry.get_registry(str(folder))
    at: dict[str, Any] = {"domain_id": domain, "router_port": port}
    topics = dict(discovery.get_topic_names_and_types(timeout=2.0, **at))
    heard: dict[str, Any] = {}
    found: dict[str, Any] = {}
    kept = []
    for topic, types in topics.items():
        info = discovery.get_topic_info(topic, timeout=2.0, verbose=True, **at)
        (publisher,) = info.publishers

        def keep(message: Any, topic: str = topic) -> None:
            heard.setdefault(topic, summary(message))

        subscriber = ROS2Subscriber(topic, types[0], keep, **at)
        kept.append(subscriber)
        found[topic] = {
            "types": types,
            "node": f"{publisher.node_namespace}/{publisher.node_name}",
            "hash_equal": publisher.type_hash == subscriber.type_hash,
        }
    ends_s = time.monotonic() + PATIENCE_S
    while len(heard) < len(topics) and time.monotonic() < ends_s:
        time.sleep(0.05)
    sys.stdout.write(json.dumps({topic: {**about, "heard": heard.get(topic)} for topic, about in found.items()}))


def summary(message: Any) -> dict[str, Any]:
    kind = type(message).__name__
    told: dict[str, Any] = {"frame": message.header.frame_id, "sec": message.header.stamp.sec}
    if kind.endswith("CompressedImage"):
        return {**told, "format": message.format, "bytes": len(message.data), "first": int(message.data[0])}
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    told["at"] = [pose.position.x, pose.position.y, pose.position.z]
    told["w"] = pose.orientation.w
    if hasattr(message.pose, "covariance"):
        told["variances"] = [float(message.pose.covariance[7 * axis]) for axis in range(3)]
    return told


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR)
    main(int(sys.argv[1]), int(sys.argv[2]))
    sys.stdout.flush()
    os._exit(0)  # the SDK keeps its session, and with it the process
