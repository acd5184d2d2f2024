"""A robot that keeps to no rule: any bytes, on any key, as any robot, at any rate, through a real session.

In the test's own process, for a message or a few:

    with Rogue(fleet, "r3") as rogue:
        rogue.say("r1", payload)                 # on r3's own key to r1, encoded as a link message says it is
        rogue.put("any/key", payload)            # on any other
        rogue.token("aucamp/tank/alive/r1")      # seen as long as the session is open

As a process of its own, for a flood that shall not share an interpreter with those who suffer it:

    with flooding(fleet, "r3", ["r1"], "entries", rate_hz=10_000, folder=tmp_path) as flood:
        ...                                      # it is linked to r1, and the flood has begun
    flood.sent, flood.seconds                    # how many messages it got rid of, in how long

`kind` is one of tests.network.hostile.payloads.kinds. The rogue dials every robot and listens nowhere unless it is
asked to, so it may run beside an honest robot of the same name or in its stead. Its puts wait for room (BLOCK): what is
lost is not its doing.
By hand: python -m tests.network.rogue FLEET NAME TO[,TO] KIND RATE_HZ, until its standard input ends.
"""

import contextlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import zenoh

from agent.core import topics
from agent.core.codec import encoding
from agent.core.config import Fleet, dump
from agent.core.messages import Estimate
from agent.core.topics import LINK
from agent.robot.fleet_reader import load_fleet
from router_config.settings import observer_config, peer_config
from tests.network.hostile.payloads import kinds
from tests.places import ROOT
from tests.waiting import until

LINK_ENCODING = encoding(Estimate)
BURST_S = 0.005  # a sleep is not shorter than a scheduler's turn, so a rate is kept by bursts


class Rogue:
    """A session that speaks as `name`. Context manager."""

    def __init__(self, fleet: Fleet, name: str, listens: bool = False) -> None:
        """`listens`: where the robot of this name would, so that observers and routers dial it."""
        self._fleet, self._name = fleet, name
        self._config = peer_config(fleet, name) if listens else observer_config(fleet, name)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "Rogue":
        self.session = self._open.enter_context(zenoh.open(zenoh.Config.from_json5(self._config)))
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def key(self, to: str, src: str | None = None) -> str:
        """On which `src`, or we, tell `to` about the fleet's first target."""
        chunk = topics.target_chunk(self._fleet.target, next(iter(self._fleet.target)))
        return topics.key(LINK, fleet=self._fleet.fleet, src=src or self._name, dst=to, **chunk)

    def linked(self, to: str) -> None:
        """Wait until `to` listens to what we have for it."""
        self.matched(self.key(to))

    def matched(self, key: str) -> None:
        """Wait until somebody listens to a key."""
        publisher = self.session.declare_publisher(key)
        until(lambda: publisher.matching_status.matching)
        publisher.undeclare()

    def say(self, to: str, payload: bytes) -> None:
        """One message as our name's."""
        self.put(self.key(to), payload)

    def put(self, key: str, payload: bytes, encoding: str = LINK_ENCODING) -> None:
        """One message on any key."""
        self.session.put(key, payload, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)

    def token(self, key: str) -> None:
        """Announce somebody."""
        self._open.enter_context(self.session.liveliness().declare_token(key))

    def flood(self, to: Sequence[str], kind: str, rate_hz: float, stop: threading.Event) -> tuple[int, float]:
        """Send `rate_hz` messages a second of a kind, `to` one after the other, until `stop`: how many, in seconds."""
        makers = [kinds(self._fleet, self._name, name, time.time_ns())[kind] for name in to]
        block = zenoh.CongestionControl.BLOCK
        puts = [
            self.session.declare_publisher(self.key(name), encoding=LINK_ENCODING, congestion_control=block).put
            for name in to
        ]
        began_s, sent = time.monotonic(), 0
        while not stop.is_set():
            due = int((time.monotonic() - began_s + BURST_S) * rate_hz)
            while sent < due and not stop.is_set():
                sent += 1
                puts[sent % len(puts)](makers[sent % len(puts)](sent))
            stop.wait(max(0.0, sent / rate_hz - (time.monotonic() - began_s)))
        return sent, time.monotonic() - began_s


class Flood:
    """What a flood came to, once it is over."""

    sent = 0
    seconds = 0.0


@contextlib.contextmanager
def flooding(fleet: Fleet, name: str, to: Sequence[str], kind: str, rate_hz: float, folder: Path) -> Iterator[Flood]:
    """A process that floods from now until the end of the block; it leaves its fleet file in `folder`."""
    path = folder / f"rogue_{name}.toml"
    path.write_text(dump(fleet))
    command = [sys.executable, "-m", "tests.network.rogue", str(path), name, ",".join(to), kind, str(rate_hz)]
    flood = Flood()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "linked\n"
            yield flood
            said, _ = process.communicate(timeout=60)
            flood.sent, flood.seconds = json.loads(said)
        finally:
            process.kill()


def main(fleet_path: str, name: str, to: str, kind: str, rate_hz: str) -> None:
    """The process of `flooding`."""
    stop, names = threading.Event(), to.split(",")
    with Rogue(load_fleet(Path(fleet_path)), name) as rogue:
        for other in names:
            rogue.linked(other)
        tell("linked")
        threading.Thread(target=lambda: (sys.stdin.read(), stop.set())).start()
        tell(json.dumps(rogue.flood(names, kind, float(rate_hz), stop)))


def tell(line: str) -> None:
    """To whoever started us, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
