"""All robots of some fleets in one process, each with its own session: what real ones say and show, at their rates.

Usage: python -m tests.bench.network.talkers FLEET...
"""

import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from agent.core.codec import decode
from agent.core.messages import Estimate, Image, State
from agent.core.step_io import Outputs
from agent.core.topics import LINK, STATE
from agent.process.certificates import credentials
from agent.process.launch import until_signal
from agent.process.transport import Transport
from agent.robot.fleet_reader import load_fleet
from replay.files.log import read
from tests.places import ROOT

PATTERN = ROOT / "tests" / "golden" / "three" / "r1.mcap"
PREVIEW_HZ, PREVIEW = 1.0, bytes(25_000)  # about as much as the demo's are


class Talker(NamedTuple):
    fleet: str
    name: str
    neighbours: tuple[str, ...]
    network: Transport


def patterns() -> tuple[Estimate, State]:
    """What a robot said last in a recorded dive, and what it showed."""
    outputs = [decode(item.data, Outputs, 1 << 20) for item in read(PATTERN) if item.channel == "/raw/step_out"]
    says = next(out.says[0] for out in reversed(outputs) if out.says)
    return says, next(out.state for out in reversed(outputs) if out.state is not None)


def main(paths: list[Path]) -> None:
    says, shows = patterns()
    with until_signal() as stop, ExitStack() as stack:
        talkers = []
        for path in paths:
            fleet = load_fleet(path)
            for name, robot in fleet.robot.items():
                network = Transport(fleet, name, time.time_ns, credentials(fleet, name, path))
                talkers.append(Talker(fleet.fleet, name, robot.neighbours, stack.enter_context(network)))
        began_s, tick = time.monotonic(), 0
        while not stop.wait(max(0.0, began_s + tick / LINK.hz - time.monotonic())):
            for one in talkers:
                talk(one, tick, says, shows)
            tick += 1


def talk(one: Talker, tick: int, says: Estimate, shows: State) -> None:
    """What is due in this period of the links."""
    now_ns = time.time_ns()
    head = {"fleet": one.fleet, "seq": tick, "sent_ns": now_ns}
    for other in one.neighbours:
        one.network.say(replace(says, src=one.name, dst=other, **head))
    if tick % round(LINK.hz / STATE.hz) == 0:
        one.network.show(replace(shows, robot=one.name, **head))
    if tick % round(LINK.hz / PREVIEW_HZ) == 0:
        about = {"frame": tick, "width_px": 640, "height_px": 480, "enhanced": False, "jpeg": PREVIEW}
        one.network.show(Image(robot=one.name, seq=tick, sent_ns=now_ns, t_ns=now_ns, **about))


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:]])
