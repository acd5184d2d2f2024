"""Fleets on free ports of this machine, and what several of the tests say and wait for."""

import random
import socket
import time
from collections.abc import Callable

import pytest

from agent.config import Fleet, Link, Pose, Robot, Target
from agent.messages import Estimate, State


def free_port() -> int:
    """A port that nobody listens on, below the ephemeral range so that no outgoing connection takes it meanwhile."""
    while True:
        port = random.SystemRandom().randrange(18000, 32000)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
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
                    listen=f"tcp/127.0.0.1:{free_port()}",
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
def until() -> Callable[..., None]:
    """until(lambda: ...): ask again and again; fails when the answer is still no after `timeout_s`."""

    def wait(condition: Callable[[], object], timeout_s: float = 10.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            time.sleep(0.02)

    return wait


@pytest.fixture
def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"
