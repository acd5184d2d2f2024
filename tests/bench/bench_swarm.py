"""Whole swarms of real processes: twenty agents on one machine, and five whose links were cut for twenty seconds.

The agents have real sessions, the real loop and the real recording; camera and motors are a script, because twenty
rendered cameras need twenty cores. Run apart: python -m tests.bench.bench_swarm
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec

from agent.core.config import Fleet, Robot, dump
from agent.core.messages import State
from agent.core.topics import STATE
from agent.demo.demo import demo_fleet
from agent.process.launch import free_ports
from agent.process.transport import Observer
from tests.network.relay import Links, Relay, refused
from tests.network.swarm_in_namespaces import WATCHER, Swarm
from tests.places import ROOT

AGENTS = 20
REACH = 3  # robots on either side along a ring that a robot talks to: six neighbours, 120 directed links
NEAR_M = 0.004
SETTLED_S = 10.0  # over which messages are counted
PARTITION_S = 20.0
HEALINGS = 3
HEAL_WANTED_S = 2.0


def run() -> dict[str, dict[str, Any]]:
    return twenty() | healing()


def twenty() -> dict[str, dict[str, Any]]:
    """Memory, traffic and time to agreement of AGENTS processes, from the first one's start."""
    with tempfile.TemporaryDirectory() as folder:
        fleet, path = ring(Path(folder)), Path(folder) / "fleet.toml"
        path.write_text(dump(fleet), encoding="utf-8")
        began_s = time.monotonic()
        agent = [sys.executable, "-m", "tests.network.scripted_agent"]
        processes = [subprocess.Popen([*agent, str(path), name, folder], cwd=ROOT) for name in fleet.robot]
        try:
            with Observer(fleet, time.monotonic_ns, (STATE,)) as observer:
                states: dict[str, State] = {}
                until(observer, states, lambda: agreed(fleet, states), 180.0)
                agreed_s = time.monotonic() - began_s
                before, counted_s = heard(states), time.monotonic()
                until(observer, states, lambda: time.monotonic() > counted_s + SETTLED_S, 2.0 * SETTLED_S)
                per_s = (heard(states) - before) / (time.monotonic() - counted_s)
                memory_mb = statistics.median(resident_mb(process.pid) for process in processes)
        finally:
            for process in processes:
                process.kill()
                process.wait()
    asked = len(fleet.robot) * 2 * REACH * fleet.link.send_hz
    alone = f"{asked:.0f} that {AGENTS} agents with {2 * REACH} neighbours mean to send"
    return {
        "swarm20_memory": {"value": memory_mb, "unit": "MB each", "against": None, "ratio": None},
        "swarm20_messages": {"value": per_s, "unit": "heard/s", "against": alone, "ratio": per_s / asked},
        "swarm20_agreement": {"value": agreed_s, "unit": "s from the start", "against": None, "ratio": None},
    }


def healing() -> dict[str, dict[str, Any]]:
    """Seconds from the end of a partition until all five agree again; empty where namespaces are not permitted."""
    if refused() is not None:
        return {}
    clock_ahead_s = {f"r{k}": 0.0 for k in range(1, 6)}
    sides = (frozenset({"r1", "r2"}), frozenset({"r3", "r4", "r5"}))
    took_s = []
    with Relay([*clock_ahead_s, WATCHER], set(clock_ahead_s)) as relay, tempfile.TemporaryDirectory() as folder:
        swarm = Swarm(relay, clock_ahead_s, Path(folder))
        try:
            swarm.start(*clock_ahead_s)
            swarm.watch()
            for _ in range(HEALINGS):
                swarm.until("agreement", swarm.agree)
                relay.links = Links(sides=sides)
                time.sleep(PARTITION_S)
                relay.links = Links()
                took_s.append(swarm.until("one swarm", swarm.agree))
        finally:
            swarm.stop()
    value = statistics.median(took_s)
    against = f"{HEAL_WANTED_S:.0f} s, after {PARTITION_S:.0f} s of partition"
    return {"swarm5_healing": {"value": value, "unit": "s", "against": against, "ratio": value / HEAL_WANTED_S}}


def ring(folder: Path) -> Fleet:
    """AGENTS robots side by side where the tank's first one stands, each with its neighbours along a ring."""
    pattern = demo_fleet(1, "evidence", 0.0, 0, False, folder)
    (first,) = pattern.robot.values()
    names = [f"r{k:02d}" for k in range(AGENTS)]
    robots: dict[str, Robot] = {}
    for k, (name, port) in enumerate(zip(names, free_ports(AGENTS), strict=True)):
        near = tuple(names[(k + step) % AGENTS] for step in range(-REACH, REACH + 1) if step)
        robots[name] = msgspec.structs.replace(
            first, neighbours=near, listen=f"tcp/127.0.0.1:{port}", serial=f"twin:{name}", camera=f"twin:{name}"
        )
    return msgspec.structs.replace(pattern, robot=robots)


def until(observer: Observer, states: dict[str, State], true: Any, timeout_s: float) -> None:
    """Keep the newest states. Raises TimeoutError."""
    deadline_s = time.monotonic() + timeout_s
    while not true():
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"{len(states)} of {AGENTS} states, not what was waited for after {timeout_s:.0f} s")
        for seen in observer.drain():
            state = msgspec.msgpack.decode(seen.payload, type=State)
            states[state.robot] = state
        time.sleep(0.05)


def agreed(fleet: Fleet, states: dict[str, State]) -> bool:
    """All have a posterior, count on all their neighbours, and no two differ by more than NEAR_M on any axis."""
    if states.keys() != fleet.robot.keys():
        return False
    if any(s.posterior_m is None or sum(n.used for n in s.neighbours) < 2 * REACH for s in states.values()):
        return False
    axes = zip(*(s.posterior_m for s in states.values() if s.posterior_m is not None), strict=True)
    return all(max(axis) - min(axis) < NEAR_M for axis in axes)


def heard(states: dict[str, State]) -> int:
    return sum(n.heard for state in states.values() for n in state.neighbours)


def resident_mb(pid: int) -> float:
    """Memory by Linux' /proc; shared libraries count in full for each process."""
    (line,) = (s for s in Path(f"/proc/{pid}/status").read_text().splitlines() if s.startswith("VmRSS:"))
    return float(line.split()[1]) / 1024.0


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
