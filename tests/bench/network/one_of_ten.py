"""A process of bench_access: one of ten robots, all neighbours.

It opens its links, speaks to all others 20 times a second, prints "all" once it has heard them all, or after a minute
whom it has not heard, and ends with its standard input. python -m tests.bench.network.one_of_ten FLEET NAME
"""

import sys
import threading
import time
from pathlib import Path

from agent.core import topics
from agent.process.certificates import credentials
from agent.robot.fleet_reader import load_fleet
from router_config.session import Session
from router_config.settings import peer_config

SIZE = 600  # bytes: an estimate
MUTE_S = 60.0


def main(path: Path, name: str) -> None:
    fleet, heard, over = load_fleet(path), set(), threading.Event()
    others = fleet.robot[name].neighbours
    with Session(peer_config(fleet, name, credentials(fleet, name, path)), name) as door:
        mine = topics.key(topics.LINK, fleet=fleet.fleet, src="*", dst=name)
        door.subscribe(mine, lambda sample: heard.add(sample.key.split("/")[-2]))
        keys = [topics.key(topics.LINK, fleet=fleet.fleet, src=name, dst=other) for other in others]
        says = [door.publisher(topics.LINK, key) for key in keys]
        threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
        told, mute_s = False, time.monotonic() + MUTE_S
        while not over.wait(0.05):
            for say in says:
                say(b"q" * SIZE)
            if not told and (heard >= set(others) or time.monotonic() > mute_s):
                told = True
                print(" ".join(sorted(set(others) - heard)) or "all", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
