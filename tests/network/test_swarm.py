"""Three agents in three processes on loopback, real sessions, scripted sightings.

They live by a clock of ours, as fast as they can. A death, a restart, and what is put on the network happen on the
wall; how long robots then live on is counted in iterations, so in their time.
"""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import msgpack
import msgspec
import pytest
import zenoh

from agent.core import topics
from agent.core.codec import decode, encode, encoding
from agent.core.config import dump
from agent.core.messages import Estimate, LogLine, State
from agent.core.step_io import Outputs
from agent.demo.demo import demo_fleet
from agent.process.transport import Observer
from replay.files.log import read
from router_config.settings import observer_config
from tests.killing import killed_after
from tests.network.kept_time import kept_time
from tests.places import ROOT
from tests.sample_messages import estimate
from tests.waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
ENDS_S = 30.0  # on the wall, beside whatever load
TARGET_M = (0.76, 0.56, 0.07)
AGENT = [sys.executable, "-m", "tests.network.scripted_agent"]


class Swarm:
    """Processes by robot, and the newest that each of them said."""

    def __init__(self, fleet, folder: Path, observer: Observer) -> None:
        self.fleet, self.folder, self.observer = fleet, folder, observer
        self.path = folder / "fleet.toml"
        self.path.write_text(dump(fleet))
        self.processes: dict[str, subprocess.Popen] = {}
        self.state: dict[str, State] = {}
        self.lines: dict[str, list[str]] = {name: [] for name in fleet.robot}

    def start(self, *names: str, out: str = "logs") -> None:
        for name in names:
            (self.folder / out).mkdir(exist_ok=True)
            self.processes[name] = subprocess.Popen([*AGENT, str(self.path), name, str(self.folder / out)], cwd=ROOT)

    def listen(self) -> None:
        for seen in self.observer.drain():
            name = seen.chunks["robot"]
            if seen.topic is topics.STATE:
                self.state[name] = decode(seen.payload, State)
            elif seen.topic is topics.LOG:
                self.lines[name].append(decode(seen.payload, LogLine).text)

    def until(self, what: str, true, timeout_s: float = 120.0) -> None:
        def heard_and_true() -> bool:
            self.listen()
            return true()

        until(heard_and_true, timeout_s, lambda: f"{what}: {self.state}")

    def agree(self, *names: str) -> bool:
        states = [self.state.get(name) for name in names]
        return all(
            s is not None
            and s.knows == "sees"
            and s.posterior_m is not None
            and math.dist(s.posterior_m, TARGET_M) < 0.004
            and sum(n.used for n in s.neighbours) == len(names) - 1
            for s in states
        )


@contextmanager
def swarm(folder: Path, *robots: str):
    """Three robots, and the time of those of them that are going to live."""
    fleet = demo_fleet(3, "paper", 0.0, 0, False, folder)
    fleet = msgspec.structs.replace(fleet, estimation=msgspec.structs.replace(fleet.estimation, iteration_s=0.25))
    with kept_time(fleet, robots), Observer(fleet, time.monotonic_ns, (topics.STATE, topics.LOG)) as observer:
        it = Swarm(fleet, folder, observer)
        with killed_after(it.processes):
            yield it


def test_told_then_seen_then_agreed_and_sigterm_leaves_nothing(tmp_path) -> None:
    with swarm(tmp_path, "r1", "r2", "r3") as it:
        it.start("r1", "r2", "r3")
        it.until("agreement", lambda: it.agree("r1", "r2", "r3"))
        assert it.state["r1"].acquired_t < min(it.state["r2"].acquired_t, it.state["r3"].acquired_t)
        for process in it.processes.values():
            process.send_signal(signal.SIGTERM)
        for process in it.processes.values():
            assert process.wait(timeout=ENDS_S) == 0
        it.until("a last word", lambda: all(s.mode == "stopped" for s in it.state.values()))
    logs = sorted(path.name for path in (tmp_path / "logs").iterdir())
    assert logs == ["r1.mcap", "r2.mcap", "r3.mcap"]
    outputs = [r.data for r in read(tmp_path / "logs" / "r2.mcap") if r.channel == "/raw/step_out"]
    lines = [line.text for data in outputs for line in decode(data, Outputs, limit=1 << 20).log]
    assert any(text.startswith("told") for text in lines)  # on the network it may be over before we listen
    steps = [r.sequence for r in read(tmp_path / "logs" / "r1.mcap") if r.channel == "/raw/step_in"]
    assert steps == list(range(len(steps)))
    assert len(steps) > 20


def test_any_one_may_die_and_a_restarted_one_rejoins(tmp_path) -> None:
    with swarm(tmp_path, "r1", "r2", "r3") as it:
        it.start("r1", "r2", "r3")
        it.until("agreement", lambda: it.agree("r1", "r2", "r3"))
        for round_, victim in enumerate(("r1", "r2")):  # the one that saw it first, and one that it told
            others = [name for name in it.fleet.robot if name != victim]
            it.processes[victim].kill()
            it.processes[victim].wait()
            t = {name: it.state[name].t for name in others}
            it.until(
                f"life without {victim}",
                lambda o=others, t=t: it.agree(*o) and all(it.state[n].t > t[n] + 8 for n in o),
            )
            before = it.state[victim].incarnation
            it.state.pop(victim)
            it.start(victim, out=f"again{round_}")
            it.until(f"{victim} back", lambda: it.agree("r1", "r2", "r3"))
            assert it.state[victim].incarnation != before


def test_what_cannot_be_believed_is_refused_counted_logged_and_changes_nothing(tmp_path) -> None:
    with swarm(tmp_path, "r1", "r2") as it:
        it.start("r1", "r2")
        it.until("agreement", lambda: it.agree("r1", "r2"))
        honest = estimate("r3", "r1", seq=1, sent_ns=1, t=5, valid=True, x_m=(0.1,) * 3)
        wrong_schema = msgpack.packb({**msgspec.to_builtins(honest), "schema": 99})
        nan = msgpack.packb({**msgspec.to_builtins(honest), "x_m": [math.nan, 0.0, 0.0]})
        far = encode(msgspec.structs.replace(honest, x_m=(50.0, 0.0, 0.0)))
        forged = encode(msgspec.structs.replace(honest, src="r2"))
        key = topics.key(topics.LINK, fleet="tank", src="r3", dst="r1")
        with zenoh.open(zenoh.Config.from_json5(observer_config(it.fleet))) as session:
            publisher = session.declare_publisher(key)
            until(lambda: publisher.matching_status.matching)  # else the first would go to nobody
            believed = {name: it.state[name].posterior_m for name in ("r1", "r2")}
            said = encoding(Estimate)
            bad = {
                "garbage": (os.urandom(100), said),
                "schema": (wrong_schema, said),
                "content": (nan, said),
                "place": (far, said),
                "address": (forged, said),
                "too large": (b"\0" * 60_000, said),
                "wrong encoding": (encode(honest), "text/plain"),
            }
            for kind, (payload, kind_of_bytes) in bad.items():  # one after the other: a step takes two of a neighbour's
                # Blocking, else our own session throws away what it cannot send at once, on a busy machine.
                session.put(key, payload, encoding=kind_of_bytes, congestion_control=zenoh.CongestionControl.BLOCK)
                it.until(kind, lambda kind=kind: kind in it.state["r1"].refused)
            want = set(bad)
            assert all(count == 1 for kind, count in it.state["r1"].refused.items() if kind in want)
            it.until("log lines", lambda: all(any(k in text for text in it.lines["r1"]) for k in want))
        it.until("agreement still", lambda: it.agree("r1", "r2"))
        assert not any(n.used for n in it.state["r1"].neighbours if n.robot == "r3")
        for name, x in believed.items():
            assert math.dist(it.state[name].posterior_m, x) < 0.002
