"""Somebody else's network of Zenoh, and robots with certificates that a bridge shows there."""

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import zenoh

from agent.core.config import Fleet, dump
from agent.core.messages import Estimate, Image
from agent.ground.bridges.outward import Language, run
from agent.process.transport import Transport
from tests.ground.bridges.states import state
from tests.network.conftest import unused_port
from tests.network.secured.parties import secure

PATIENCE_S = 60.0
JPEG = b"\xff\xd8" + bytes(30_000)


@contextlib.contextmanager
def router(port: int) -> Iterator[None]:
    """A router without rules."""
    config = {
        "mode": "router",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        yield


def speak(fleet: Fleet, keys: Path, robot: str, stop: threading.Event) -> None:
    """A robot that shows all it has, ten times a second."""
    other = next(name for name in fleet.robot if name != robot)
    number = 0
    with Transport(fleet, robot, time.time_ns, keys) as transport:
        while not stop.wait(0.1):
            number += 1
            now_ns = time.time_ns()
            shown = state(robot, now_ns, depth_m=0.1, roll_deg=0.0, pitch_deg=0.0, seq=number)
            transport.show(shown)
            transport.say(
                Estimate(
                    fleet=fleet.fleet,
                    src=robot,
                    dst=other,
                    incarnation=1,
                    seq=number,
                    sent_ns=now_ns,
                    target="ball",
                    t=1,
                    valid=True,
                    x_m=(0.25, 0.5, 0.125),
                    cov_m2=(0.01, 0.0, 0.0, 0.02, 0.0, 0.03),
                )
            )
            about = {"seq": number, "frame": number, "width_px": 640, "height_px": 480, "enhanced": False}
            transport.show(Image(robot=robot, sent_ns=now_ns, t_ns=now_ns, jpeg=JPEG, **about))


@contextlib.contextmanager
def shown_elsewhere(fleet: Fleet, folder: Path, language: Callable[[Fleet], Language]) -> Iterator[int]:
    """The port of a router at which the robots of a fleet, made secure, are shown."""
    fleet, path, port = secure(fleet, folder / "keys"), folder / "fleet.toml", unused_port()
    path.write_text(dump(fleet))
    stop, said = threading.Event(), threading.Event()
    threads = [threading.Thread(target=speak, args=(fleet, folder / "keys", robot, stop)) for robot in fleet.robot]
    arguments = (fleet, path, None, port, language(fleet), stop, lambda line: said.set())
    threads.append(threading.Thread(target=run, args=arguments))
    with router(port):
        for thread in threads:
            thread.start()
        try:
            assert said.wait(PATIENCE_S)
            yield port
        finally:
            stop.set()
            for thread in threads:
                thread.join()
