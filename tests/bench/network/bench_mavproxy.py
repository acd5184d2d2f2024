"""MAVProxy as the ground station of three robots: when it sees them, and whom its commands reach.

MAVProxy is 1.2 GB with all that it brings, so that it lives in an environment of its own:

    python3 -m venv ELSEWHERE && ELSEWHERE/bin/pip install MAVProxy setuptools future
    aucamp experiment mavproxy --set program=ELSEWHERE/bin/mavproxy.py
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import msgspec

from agent.core.codec import decode
from agent.core.config import ConfigError
from agent.core.messages import Answer
from agent.core.topics import ANSWER
from agent.experiments.claim import Figure, Row
from agent.ground.console import OrderConsole
from agent.process.certificates import credentials
from agent.process.launch import free_ports
from agent.process.transport import Observer
from tests.bench.network.processes import Made, agents, in_one_line, made, python
from tests.bench.timing import claim_of_medians
from tests.network.conftest import unused_port
from tests.waiting import until

QUIET_S = 2.0
SEEN = r"Detected vehicle \d+:1"
MODULES = "link,mode,arm,cmdlong,param,misc,output"
ORDERS = ((1, "arm throttle", "COMPONENT_ARM_DISARM"), (3, "mode SURFACE", "DO_SET_MODE"))
WANTED = [("r1", "arm", True), ("r3", "surface", True)]


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    program: str = "mavproxy.py"


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises ConfigError without MAVProxy, or what our bridge needs."""
    if importlib.util.find_spec("pymavlink") is None:
        raise ConfigError("pymavlink is not installed: pip install 'aucamp[mavlink]'")
    program = shutil.which(settings.program)
    if program is None:
        raise ConfigError(f"{settings.program} is not installed: see the head of tests/bench/network/bench_mavproxy.py")
    with tempfile.TemporaryDirectory() as folder:
        one, port = made(Path(folder), "tls", free_ports(3)), unused_port()
        with agents(one) as processes:
            with OrderConsole(one.fleet, "ann", credentials(one.fleet, "ann", one.path)) as console:
                until(lambda: len(console.states()) == len(one.fleet.robot))
            first = Station(program, port, Path(folder) / "first.log")
            processes["first"] = first.process
            first.until("Waiting for heartbeat")
            began_s = time.monotonic()
            bridge = ("-m", "agent", "bridge", "mavlink", str(one.path), "--as", "ann", "--port", str(port))
            processes["bridge"] = python(*bridge)
            first.until(SEEN, len(one.fleet.robot))
            bridge_s = time.monotonic() - began_s
            first.process.kill()  # it does not end otherwise
            first.process.wait()
            began_s = time.monotonic()
            second = Station(program, port, Path(folder) / "second.log")
            processes["second"] = second.process
            second.until(SEEN, len(one.fleet.robot))
            return [{"bridge_s": bridge_s, "station_s": time.monotonic() - began_s, **ordered(one, second)}]


def ordered(one: Made, station: Station) -> Row:
    """Arm the first and have the third surface, as a person would type it."""
    with Observer(one.fleet, time.time_ns, (ANSWER,), "view", credentials(one.fleet, "view", one.path)) as observer:
        time.sleep(QUIET_S)
        took_ms = []
        for system, command, said in ORDERS:
            station.types(f"vehicle {system}")
            time.sleep(QUIET_S)
            began_s = time.monotonic()
            station.types(command)
            station.until(f"{said}: ACCEPTED")
            took_ms.append(1e3 * (time.monotonic() - began_s))
        time.sleep(QUIET_S)
        answers = [decode(one.payload, Answer) for one in observer.drain()]
    reached = [(answer.robot, answer.order, answer.ok) for answer in answers]
    return {"typed_ms": max(took_ms), "astray": reached != WANTED}


class Station:
    """MAVProxy as a process, and what it has printed."""

    def __init__(self, program: str, port: int, log: Path) -> None:
        self._log, own = log, f"--state-basedir={log.parent}"
        words = [program, f"--master=udpin:127.0.0.1:{port}", "--default-modules", MODULES, own]
        with log.open("wb") as out:
            files = {"stdin": subprocess.PIPE, "stdout": out, "stderr": out}
            self.process = subprocess.Popen(words, text=True, cwd=log.parent, **files)

    def types(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def until(self, pattern: str, different: int = 1) -> None:
        """It has printed so many different texts of this pattern."""

        def found() -> set[str]:
            return set(re.findall(pattern, self._log.read_text(encoding="utf-8", errors="replace")))

        until(lambda: len(found()) >= different, what=lambda: f"MAVProxy says only {found()} of {pattern}")


# --- the claim ---


CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    measured_on="outside judge",
    figures=(
        Figure("all.bridge_s", "three vehicles, from the start of the bridge", "s", most=5.0),
        Figure("all.station_s", "three vehicles, from the start of MAVProxy", "s", most=5.0),
        Figure("all.astray<=0", "runs whose two commands reach the two addressed and nobody else", "%", least=95.0),
        Figure("all.typed_ms", "from typing to its acknowledgement, the slower of two", "ms"),
    ),
    seeds=59,  # as many as the 95 % take
    explanation="""MAVProxy, which others wrote, is the ground station of three robots behind our bridge; one of the two
        starts last, by turns. Two commands are typed as a person types them, and all answers of all robots are looked
        at. The robots are real agents with certificates and access rules; cameras and motors are a script.""",
)
