"""A swarm of scripted agents, each a process in a network namespace of its own, watched from outside."""

import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from agent.core.config import Access, Fleet, dump
from agent.core.messages import State
from agent.demo.demo import demo_fleet
from agent.ground.new_fleet import make_all
from tests.network.relay import Relay
from tests.network.scripted_agent import TARGET_M
from tests.places import ROOT
from tests.waiting import until

PORT = 17401
NEAR_M = 0.004
WATCHER = "eye"


class Swarm:
    """Agents by robot, and the newest state that each of them showed."""

    def __init__(
        self,
        relay: Relay,
        clock_ahead_s: dict[str, float],
        folder: Path,
        name: str = "tank",
        port: int = PORT,
        secured: bool = False,
        of_the_system: Path | None = None,
        prefix: str = "",
        adjust: Callable[[Fleet], Fleet] = lambda fleet: fleet,
        agent: str = "tests.network.scripted_agent",
    ) -> None:
        """Robots r1, r2 ... in the relay's namespaces of these names, with the prefix; their clocks are wrong by so
        much.

        `secured`: with certificates, in the folder `keys`. `of_the_system`: the library of wrong_clock.c, with which
        all of a process has the wrong time, its TLS too; without it the agent's own clock alone is wrong. `adjust`: the
        fleet as a test wants it. `agent`: a module that takes a scripted agent's arguments.
        """
        self.relay, self.clock_ahead_s, self.folder, self.of_the_system = relay, clock_ahead_s, folder, of_the_system
        self.prefix, self.agent = prefix, agent
        self.path = folder / "fleet.toml"
        fleet = demo_fleet(len(clock_ahead_s), "evidence", 0.0, 0, False, folder)
        replace = msgspec.structs.replace
        robots = {
            key: replace(robot, listen=f"{'tls' if secured else 'tcp'}/{relay.address[prefix + key]}:{port}")
            for key, robot in fleet.robot.items()
        }
        access = Access(keys="keys", consoles=("ann",)) if secured else fleet.access
        estimation = replace(fleet.estimation, iteration_s=0.25)
        self.fleet = adjust(replace(fleet, fleet=name, robot=robots, access=access, estimation=estimation))
        self.path.write_text(dump(self.fleet))
        self.keys = folder / "keys"
        if secured:
            make_all(self.fleet, self.keys)
        self.processes: dict[str, subprocess.Popen] = {}
        self.state: dict[str, State] = {}
        self.boxes: list[tuple[str, Path]] = []  # robot and its recording, every start of it
        self._threads: list[threading.Thread] = []

    def start(self, *names: str) -> None:
        for name in names:
            out = self.folder / f"start{len(self.boxes)}"
            out.mkdir()
            self.boxes.append((name, out / f"{name}.mcap"))
            agent = (sys.executable, "-m", self.agent)
            ahead, library = str(self.clock_ahead_s[name]), self.of_the_system
            wrong = {} if library is None else {"LD_PRELOAD": str(library), "CLOCK_AHEAD_S": ahead}
            arguments = (str(self.path), name, str(out), *(() if library else (ahead,)))
            command = self.relay.command(self.prefix + name, *agent, *arguments)
            self.processes[name] = subprocess.Popen(command, cwd=ROOT, env={**os.environ, **wrong})

    def watch(self) -> None:
        command = self.relay.command(
            self.prefix + WATCHER, sys.executable, "-m", "tests.network.watch_states", str(self.path)
        )
        self.processes[WATCHER] = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT)
        self._threads.append(threading.Thread(target=self._listen, args=(self.processes[WATCHER].stdout,)))
        self._threads[-1].start()

    def stop(self) -> None:
        for process in self.processes.values():
            process.kill()
            process.wait()
        for thread in self._threads:
            thread.join()
        if WATCHER in self.processes:
            self.processes[WATCHER].stdout.close()

    def until(self, what: str, true, timeout_s: float = 120.0) -> float:
        """Seconds that it took; fails after `timeout_s`."""
        began_s = time.monotonic()
        until(true, timeout_s, lambda: f"{what}: {self.state}")
        return time.monotonic() - began_s

    def agree(self) -> bool:
        """All see the target, place it well, count on all the others, and place it in the same spot."""
        states = [self.state.get(name) for name in self.clock_ahead_s]
        return all(
            s is not None and near(s) and s.knows == "sees" and used(s) == self.clock_ahead_s.keys() - {s.robot}
            for s in states
        ) and all(math.dist(a.posterior_m, b.posterior_m) < 0.1 * NEAR_M for a in states for b in states)

    def live(self, *names: str, iterations: int = 12) -> None:
        """These robots go on for a while, and never lose the target."""
        goal = {name: self.state[name].t + iterations for name in names}

        def lived() -> bool:
            assert all(near(self.state[name]) for name in names), self.state
            return all(self.state[name].t >= goal[name] for name in names)

        self.until("life", lived)

    def heard(self) -> dict[tuple[str, str], int]:
        """Messages that each robot had from each other."""
        return {(name, n.robot): n.heard for name, state in self.state.items() for n in state.neighbours}

    def _listen(self, lines) -> None:
        for line in lines:
            state = msgspec.json.decode(line, type=State)
            self.state[state.robot] = state


def near(state: State) -> bool:
    return state.posterior_m is not None and math.dist(state.posterior_m, TARGET_M) < NEAR_M


def used(state: State) -> set[str]:
    return {n.robot for n in state.neighbours if n.used}
