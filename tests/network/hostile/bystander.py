"""One process that takes part in a fleet and says what it hears: to be looked at from outside while others misbehave.

python -m tests.network.hostile.bystander FLEET ROBOT|observer|router [ENDPOINT] writes a line "src seq" for each
message heard and a line "refused reason src count" for what was turned away, until its standard input ends. A robot
announces itself and drains twenty times a second, as an agent does; a router listens at the endpoint and says nothing.
"""

import contextlib
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from agent.core.codec import Refusal, decode
from agent.core.config import Fleet, dump
from agent.core.messages import Estimate, State
from agent.core.topics import STATE
from agent.process.transport import Observer, Transport, run_router
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

STEP_S = 0.05


class Bystander:
    """The process, from outside."""

    def __init__(self, process: "subprocess.Popen[bytes]", said: Path) -> None:
        self.process, self._said = process, said

    def lines(self) -> list[list[str]]:
        """All it has said, in words."""
        return [line.split() for line in self._said.read_text().splitlines(keepends=True) if line.endswith("\n")]

    def heard(self, src: str) -> int:
        """How many messages of `src` it has heard."""
        return sum(line[0] == src for line in self.lines())

    def refused(self) -> dict[str, int]:
        """What it turned away, by reason."""
        counts: dict[str, int] = {}
        for line in self.lines():
            if line[0] == "refused":
                counts[line[1]] = counts.get(line[1], 0) + int(line[-1])
        return counts

    def peak_mb(self) -> float:
        """The largest resident memory so far."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) / 1024.0


@contextlib.contextmanager
def bystander(fleet: Fleet, name: str, folder: Path, *endpoint: str) -> Iterator[Bystander]:
    """A robot `name`, or what else that names; it ends with the block."""
    path, said = folder / f"{name}.toml", folder / f"{name}.said"
    path.write_text(dump(fleet))
    said.touch()
    command = [sys.executable, "-m", "tests.network.hostile.bystander", str(path), name, *endpoint]
    with said.open("wb") as out, subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, cwd=ROOT) as process:
        try:
            yield Bystander(process, said)
        finally:
            process.kill()


def as_robot(fleet: Fleet, name: str) -> Iterator[str]:
    with Transport(fleet, name, time.time_ns) as transport:
        while True:
            heard, refused = transport.drain()
            for item in heard:
                with contextlib.suppress(Refusal):
                    yield f"{item.src} {decode(item.payload, Estimate).seq}"
            for row in refused:
                yield f"refused {row.reason.replace(' ', '_')} {row.src or '-'} {row.count}"
            yield ""


def as_observer(fleet: Fleet) -> Iterator[str]:
    with Observer(fleet, time.time_ns, (STATE,)) as watch:
        while True:
            for item in watch.drain():
                yield f"{item.chunks['robot']} {decode(item.payload, State).seq}"
            yield ""


def main(fleet_path: str, name: str, endpoint: str = "") -> None:
    fleet = load_fleet(Path(fleet_path))
    if name == "router":
        stop = threading.Event()
        threading.Thread(target=lambda: (sys.stdin.read(), stop.set())).start()
        run_router(fleet, stop, endpoint)
        return
    with contextlib.closing(as_observer(fleet) if name == "observer" else as_robot(fleet, name)) as lines:
        for line in lines:
            if line:
                sys.stdout.write(line + "\n")
                continue
            sys.stdout.flush()
            if select.select([sys.stdin], [], [], STEP_S)[0]:
                return


if __name__ == "__main__":
    main(*sys.argv[1:])
