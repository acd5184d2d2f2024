"""Three scripted robots over four named networks. Judge: the kernel's TCP, and Zenoh, which others wrote.

Each robot is a process in a network namespace of its own (tests/network). The rate, the delay and the losses are our
relay's: it stands for a modem at each robot, so robots do not share one medium. Robots start, dial and find the
target over the network that is judged; who watches them has a good link.

Run as a program it is such a robot, with the arguments of tests/network/scripted_agent.py.
"""

from __future__ import annotations

import json
import math
import platform
import random
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from msgspec.structs import replace

from agent.core.config import Fleet, Link
from agent.core.messages import State
from agent.core.step_io import Sighting
from router_config import session, settings
from tests.network import scripted_agent
from tests.network.relay import Links, Relay, refused
from tests.network.scripted_agent import TARGET_M, Script
from tests.network.swarm_in_namespaces import WATCHER, Swarm, used

ROOM = "tests.studies.outside.network"
ROBOTS = ("r1", "r2", "r3")
LEASE_S = 2.0  # of router_config/peer.json5; as long a link may take to be made (router_config/session.py, DIAL_LOOKS)
WITHIN_M, APART_M = 0.010, 0.0004  # of the script's truth; from each other, to agree
LOOK_S = 0.1
CASE = "case.json"  # beside the fleet file: seed and lease
JUDGE = f"Linux {platform.release().partition('-')[0]}, Zenoh {version('eclipse-zenoh')}"
ACOUSTIC = {"delay_s": 2.0, "queue_bytes": 1 << 14}
NETWORKS = {
    "tether": Links(delay_s=0.001, rate_bit_s=100e6),
    "wifi": Links(delay_s=0.005, jitter_s=0.010, loss=0.02, burst=5, rate_bit_s=10e6, queue_bytes=1 << 16),
    "satellite": Links(delay_s=0.3, loss=0.005, rate_bit_s=256e3, queue_bytes=1 << 15),
    **{f"acoustic, {kbit} kbit/s": Links(rate_bit_s=kbit * 1e3, **ACOUSTIC) for kbit in (1, 4, 16, 64)},
}


class Case(NamedTuple):
    """A run: the settings of the fleet file, and for how long."""

    network: str
    send_hz: float
    validity_s: float = 0.5
    lease_s: float = LEASE_S
    for_s: float = 12.0


CASES = (
    Case("tether", 10),
    Case("wifi", 10),
    Case("wifi", 2, 1.5),
    Case("satellite", 10),
    Case("satellite", 10, 2),
    Case("satellite", 5, 2),
    Case("satellite", 1, 4),
)
SLOW = (
    Case("acoustic, 1 kbit/s", 0.1, 30, for_s=80),
    Case("acoustic, 64 kbit/s", 1, 5, for_s=80),
    Case("acoustic, 64 kbit/s", 1, 5, 20, 80),
    Case("acoustic, 16 kbit/s", 0.2, 30, 20, 80),
    Case("acoustic, 4 kbit/s", 0.1, 60, 60, 80),
    Case("acoustic, 1 kbit/s", 0.05, 120, 60, 80),
)


@dataclass(frozen=True)
class Crossing:
    """What became of a swarm on a network."""

    COLUMNS: ClassVar = (
        f"network ({JUDGE})", "`send_hz`", "`validity_s`", "lease, s", "all agree after, s",
        "agree from then, share of time", "error, mm", "sigma, mm", "3 (error / sigma)²", "kbit/s a robot",
        "of it got through", "messages heard of those due", "links made anew",
    )  # fmt: skip
    case: Case
    agreed_s: float | None  # from the first word of all robots to the first moment in which they agree
    agrees: float
    error_m: float  # of the worst robot in the end
    sigma_m: float  # its own
    kbit_s: float
    through: float
    heard: float
    anew: int

    @property
    def row(self) -> tuple[str, ...]:
        case, agreed = self.case, "**never**" if self.agreed_s is None else f"{self.agreed_s:.0f}"
        knows = ("**nothing known**", "", "")  # by the worst robot
        if math.isfinite(self.error_m):
            nees = 3 * (self.error_m / self.sigma_m) ** 2
            knows = f"{1e3 * self.error_m:.2f}", f"{1e3 * self.sigma_m:.2f}", f"{nees:.2f}"
        return (
            case.network, f"{case.send_hz:g}", f"{case.validity_s:g}", f"{case.lease_s:g}", agreed,
            share(self.agrees), *knows, f"{self.kbit_s:.3g}", share(self.through), share(self.heard),
            str(self.anew),
        )  # fmt: skip


def share(of: float) -> str:
    return f"{100 * of:.3g} %"


def judge(quick: bool) -> Sequence[Crossing]:
    """All networks. Raises ImportError, with the reason, where this machine has no network namespaces."""
    if (why := refused()) is not None:
        raise ImportError(f"no network namespaces: {why}")
    if quick:
        return [cross(case._replace(for_s=8.0), seed) for seed, case in enumerate(CASES) if case.send_hz == 10]
    found = [cross(case, seed) for seed, case in enumerate(CASES)]
    with ThreadPoolExecutor(len(SLOW)) as pool:  # they wait most of the time
        seeds = range(len(CASES), len(CASES) + len(SLOW))
        return found + list(pool.map(cross, SLOW, seeds, [f"s{seed}" for seed in seeds]))


def cross(case: Case, seed: int, prefix: str = "") -> Crossing:
    """Start a swarm on hosts of these names, and look at it."""
    hosts = [prefix + name for name in (*ROBOTS, WATCHER)]
    with Relay(hosts, set(hosts[:-1]), seed) as relay, tempfile.TemporaryDirectory() as folder:
        relay.links = NETWORKS[case.network]
        (Path(folder) / CASE).write_text(json.dumps({"seed": seed, "lease_s": case.lease_s}))

        def adjust(fleet: Fleet) -> Fleet:
            estimation = replace(fleet.estimation, iteration_s=1.0, validity_s=case.validity_s)
            return replace(fleet, link=Link(send_hz=case.send_hz), estimation=estimation)

        clocks = dict.fromkeys(ROBOTS, 0.0)
        swarm = Swarm(relay, clocks, Path(folder), prefix=prefix, adjust=adjust, agent=ROOM)
        try:
            swarm.start(*ROBOTS)
            swarm.watch()
            swarm.until("states", lambda: swarm.state.keys() == set(ROBOTS))
            return watched(swarm, case)
        finally:
            swarm.stop()


def watched(swarm: Swarm, case: Case) -> Crossing:
    relay, began_s = swarm.relay, time.monotonic()
    bytes_before, agreed_s, looks, heard = dict(relay.bytes), None, [], []
    while (after_s := time.monotonic() - began_s) < case.for_s:
        agree = agreement(swarm.state)
        if agree and agreed_s is None:
            agreed_s = after_s
        if agreed_s is not None:
            looks.append(agree)
        heard.append((after_s, sum(swarm.heard().values())))
        time.sleep(LOOK_S)
    sent, arrived = (relay.bytes[key] - bytes_before[key] for key in ("sent", "arrived"))
    (from_s, first), (to_s, last) = heard[len(heard) // 2], heard[-1]
    due = len(ROBOTS) * (len(ROBOTS) - 1) * case.send_hz * (to_s - from_s)
    worst = max(swarm.state.values(), key=off_m)
    return Crossing(
        case=case,
        agreed_s=agreed_s,
        agrees=sum(looks) / len(looks) if looks else 0.0,
        error_m=off_m(worst),
        sigma_m=worst.posterior_sigma_m or math.inf,
        kbit_s=8e-3 * sent / case.for_s / len(ROBOTS),
        through=arrived / sent if sent else 1.0,
        heard=(last - first) / due,
        anew=len(relay.accepted) - len(ROBOTS) * (len(ROBOTS) - 1) // 2,
    )


def agreement(state: Mapping[str, State]) -> bool:
    """All are within `WITHIN_M` of the truth, count on all others, and place the target in the same spot."""
    return (
        all(used(s) == state.keys() - {name} for name, s in state.items())
        and all(off_m(s) < WITHIN_M for s in state.values())
        and apart(state) < APART_M
    )


def off_m(state: State) -> float:
    """From the truth; infinite where the robot believes nothing."""
    return math.inf if state.posterior_m is None else math.dist(state.posterior_m, TARGET_M)


def apart(state: Mapping[str, State]) -> float:
    """The greatest distance between what two believe, m; infinite where one believes nothing."""
    places = [s.posterior_m for s in state.values()]
    return math.inf if None in places else max(math.dist(a, b) for a, b in combinations(places, 2))


# --- the process of a robot ---


class Moored(Script):
    """A script whose robot is not quite where its survey says: each error is drawn as the fleet file has it.

    Shared ones too, the level and the survey's frame. Attitude and the scale of ranges are as said.
    """

    def __init__(self, fleet: Fleet, robot: str, clock: Callable[[], int]) -> None:
        super().__init__(fleet, robot, clock)
        budget, seed = fleet.budget, json.loads((Path(sys.argv[1]).parent / CASE).read_text())["seed"]
        shared, own = random.Random(f"{seed}"), random.Random(f"{seed} {robot}")
        x_m, y_m = (shared.gauss(0, budget.survey_m) + own.gauss(0, budget.place_m) for _ in "xy")
        up_m = shared.gauss(0, budget.level_m) + own.gauss(0, budget.height_m)
        pose = self.robot.pose
        pose = replace(
            pose, x_m=pose.x_m + x_m, y_m=pose.y_m + y_m, yaw_deg=pose.yaw_deg + own.gauss(0, budget.heading_deg)
        )
        self.true = replace(self.robot, pose=pose, depth_m=self.robot.depth_m - up_m)

    def look(self, *about: Any) -> Sighting:
        surveyed, self.robot = self.robot, self.true
        try:
            return super().look(*about)
        finally:
            self.robot = surveyed


def patient(lease_s: float) -> None:
    """In this process a link may be silent, or not yet made, for so long."""
    base = settings._over

    def over(name: str, differences: dict) -> str:
        config = json.loads(base(name, differences))
        config["transport"]["link"]["tx"]["lease"] = round(1e3 * lease_s)
        return json.dumps(config)

    settings._over = over
    session.DIAL_LOOKS = round(lease_s / session.LOOK_S)


def main(fleet_path: Path, robot: str, out: Path, ahead_s: float) -> None:
    patient(json.loads((fleet_path.parent / CASE).read_text())["lease_s"])
    scripted_agent.Script = Moored
    scripted_agent.main(fleet_path, robot, out, ahead_s)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), float(sys.argv[4]))
