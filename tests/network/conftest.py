"""Fleets on free ports of this machine, and what several of the tests say."""

import random
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from agent.core.config import Fleet, Link, Pose, Robot, Target
from agent.core.messages import Estimate, State
from tests.network.recorder_thread import RecorderThread, StartRecorder

_given: set[int] = set()  # to a test before, or to another robot of the same fleet


def unused_port() -> int:
    """A port that nobody listens on, from a range in which nobody else looks for one.

    The demo's lie below it (agent.process.launch.free_ports), those of outgoing connections above.
    """
    while True:
        port = random.SystemRandom().randrange(29500, 32700)
        if port in _given:
            continue
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        _given.add(port)
        return port


@pytest.fixture
def make_fleet() -> Callable[..., Fleet]:
    """make_fleet({"r1": ("r2",), "r2": ("r1",)}, loss=0.3): robots and their neighbours."""

    def make(graph: dict[str, tuple[str, ...]], loss: float = 0.0, loss_seed: int = 0) -> Fleet:
        return Fleet(
            fleet="test",
            target={"ball": Target(radius_m=0.07)},
            link=Link(loss=loss, loss_seed=loss_seed),
            robot={
                name: Robot(
                    neighbours=neighbours,
                    listen=f"tcp/127.0.0.1:{unused_port()}",
                    serial=f"twin:{name}",
                    camera=f"twin:{name}",
                    pose=Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0),
                    calibration=f"{name}.toml",
                )
                for name, neighbours in graph.items()
            },
        )

    return make


@pytest.fixture
def estimate() -> Callable[..., Estimate]:
    """estimate("r1", "r2", seq=3): what r1 says to r2."""

    def make(src: str, dst: str, seq: int = 0) -> Estimate:
        return Estimate(
            fleet="test",
            src=src,
            dst=dst,
            incarnation=1,
            seq=seq,
            sent_ns=time.time_ns(),
            target="ball",
            t=0,
            valid=False,
        )

    return make


@pytest.fixture
def state() -> Callable[..., State]:
    def make(robot: str, seq: int = 0) -> State:
        now_ns = time.time_ns()
        return State(
            fleet="test", robot=robot, incarnation=1, seq=seq, sent_ns=now_ns, target="ball", knows="blind", t=seq
        )

    return make


@pytest.fixture
def start_recorder() -> Iterator[StartRecorder]:
    """start_recorder(fleet, out): a recorder in a thread of this process; it is stopped after the test."""
    threads: list[RecorderThread] = []

    def start(*arguments: Any, **options: Any) -> RecorderThread:
        threads.append(RecorderThread(*arguments, **options))
        return threads[-1]

    yield start
    for thread in threads:
        thread.stop()


@pytest.fixture
def free_port() -> int:
    return unused_port()
