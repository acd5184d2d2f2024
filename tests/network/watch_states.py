"""Prints every state that a fleet shows, one line of JSON each. Usage: python -m tests.network.watch_states FLEET"""

import sys
import time
from pathlib import Path

import msgspec

from agent.core.codec import decode
from agent.core.messages import State
from agent.core.topics import STATE
from agent.process.certificates import credentials
from agent.process.transport import LOOKER, Observer
from agent.robot.fleet_reader import load_fleet


def main(fleet_path: Path) -> None:
    fleet = load_fleet(fleet_path)
    with Observer(fleet, time.monotonic_ns, (STATE,), keys=credentials(fleet, LOOKER, fleet_path)) as observer:
        while True:
            for seen in observer.drain():
                sys.stdout.write(msgspec.json.encode(decode(seen.payload, State)).decode() + "\n")
            sys.stdout.flush()
            time.sleep(0.05)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
