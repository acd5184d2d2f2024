"""`aucamp bridge ros2` over real links and a router of Zenoh, with zenoh-ros2-sdk at the other end: not ROS itself."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags", reason="pip install 'aucamp[ros]'")

from agent.core.config import ConfigError, Fleet, dump
from agent.ground.bridges.outward import run
from agent.ground.bridges.ros2 import Ros2
from tests.network.bridges.elsewhere import JPEG, PATIENCE_S, shown_elsewhere
from tests.network.conftest import unused_port
from tests.places import ROOT

PAIR = {"r1": ("r2",), "r2": ("r1",)}
DOMAIN = 7


@pytest.fixture
def bridged(make_fleet: Callable[..., Fleet], tmp_path: Path) -> Iterator[int]:
    with shown_elsewhere(make_fleet(PAIR), tmp_path, lambda fleet: Ros2(fleet, DOMAIN)) as port:
        yield port


def looked_at(port: int, domain: int) -> dict[str, Any]:
    """What somebody else's program finds there."""
    command = [sys.executable, "-m", "tests.network.bridges.ros2_client", str(port), str(domain)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_others_find_every_topic_and_read_it(bridged: int) -> None:
    pytest.importorskip("zenoh_ros2_sdk", reason="pip install zenoh-ros2-sdk")
    found = looked_at(bridged, DOMAIN)
    kinds = {
        "pose": "geometry_msgs/msg/PoseStamped",
        "target": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "camera/compressed": "sensor_msgs/msg/CompressedImage",
    }
    assert {topic: about["types"] for topic, about in found.items()} == {
        f"/{robot}/{topic}": [kind] for robot in PAIR for topic, kind in kinds.items()
    }
    assert all(about["hash_equal"] for about in found.values())
    now_s = time.time()
    for robot in PAIR:
        pose, target, picture = (found[f"/{robot}/{topic}"] for topic in kinds)
        assert pose["node"] == f"/{robot}/aucamp"
        assert all(each["heard"] for each in (pose, target, picture)), found
        assert all(abs(each["heard"]["sec"] - now_s) < PATIENCE_S for each in (pose, target, picture))
        assert pose["heard"]["at"] == pytest.approx([0.0, 0.0, 0.4]) and pose["heard"]["frame"] == "world"
        assert pose["heard"]["w"] == pytest.approx(1.0)
        assert target["heard"]["at"] == [0.25, 0.5, 0.125]
        assert target["heard"]["variances"] == [0.01, 0.02, 0.03]
        assert (picture["heard"]["format"], picture["heard"]["bytes"]) == ("jpeg", len(JPEG))
        assert picture["heard"]["first"] == 0xFF


def test_without_a_router_it_says_so(make_fleet: Callable[..., Fleet], tmp_path: Path) -> None:
    fleet, path = make_fleet(PAIR), tmp_path / "fleet.toml"
    path.write_text(dump(fleet))
    with pytest.raises(ConfigError, match=r"no router at tcp/127\.0\.0\.1"):
        run(fleet, path, None, unused_port(), Ros2(fleet, 0), threading.Event(), lambda line: None)
