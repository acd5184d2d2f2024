"""One of three robots lies as well as it can, through real sessions and processes: how far the other two are moved.

The liar has its own key, hears everything, looks for the best lie once a second (tests/studies/liar), tells
it ten times a second, and forges an entry of each of the others in every message. The bar for what it moves, at any
time, is 30 mm; AUCAMP_LIES_S=60 lies for longer, and -s shows the figures. On the wall.
"""

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.config import Access, Fleet, dump
from agent.core.estimation.evidence_table import opinion
from agent.core.estimation.fuse import Opinion, fuse
from agent.core.linear_algebra import apply, upper
from agent.core.messages import Entry, Estimate, Gossip, State
from agent.core.topics import STATE
from agent.demo.demo import demo_fleet
from agent.ground.new_fleet import make_keys
from agent.process.keys import private_file, public_file, read_private, signing
from agent.process.transport import Observer
from tests.killing import killed_after
from tests.network.rogue import Rogue
from tests.places import ROOT
from tests.sample_messages import estimate
from tests.studies.liar.attack import told
from tests.studies.liar.search import Lies, best_lies, conclusions
from tests.waiting import until

LIES_S = float(os.environ.get("AUCAMP_LIES_S", "4"))
SAY_S = 0.1
MOVED_M, AFTER_M = 0.030, 0.0025
HONEST, LIAR = ("r1", "r2"), "r3"
SIGMA_M2 = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(150 + 2 * LIES_S)]


class Swarm:
    """Two honest robots, each a process, what they show and say, and the third, which is us."""

    def __init__(self, fleet: Fleet, folder: Path, observer: Observer, rogue: Rogue) -> None:
        self.state: dict[str, State] = {}
        self.moved_m: list[float] = []
        self.third: Opinion | None = None  # of the third, where it is honest
        self._observer, self._rogue = observer, rogue
        self._sign = signing(LIAR, read_private(private_file(folder / "keys", LIAR)))
        self._said: dict[str, Entry] = {}  # by the honest, of themselves
        self._seq, self._due_s = 0, 0.0
        self.started_ns = time.time_ns()
        (folder / "fleet.toml").write_text(dump(fleet))
        command = [sys.executable, "-m", "tests.network.scripted_agent", str(folder / "fleet.toml")]
        self.processes = {n: subprocess.Popen([*command, n, str(folder), "0"], cwd=ROOT) for n in HONEST}
        rogue.session.declare_subscriber(f"aucamp/{fleet.fleet}/link/*/{LIAR}", self._overhear)

    def _overhear(self, sample: object) -> None:
        said = decode(sample.payload.to_bytes(), Estimate)
        for entry in said.gossip.entries if said.gossip else ():
            if entry.origin == said.src:
                self._said[entry.origin] = entry

    def opinions(self) -> list[Opinion]:
        """What each honest robot measured, by its newest word to us."""
        return [o for name, entry in sorted(self._said.items()) if (o := opinion(name, [entry])) is not None]

    def listen(self) -> dict[str, State]:
        """The newest state of each; notes how far it is from where it would be without lies."""
        for seen in self._observer.drain():
            name = seen.chunks["robot"]
            state = self.state[name] = decode(seen.payload, State)
            alone = fuse([*self.opinions(), *(() if self.third is None else (self.third,))])
            if name in HONEST and state.posterior_m is not None and len(self._said) == len(HONEST) and alone:
                self.moved_m.append(math.dist(state.posterior_m, alone.x_m))
        assert all(p.poll() is None for p in self.processes.values())
        return self.state

    def say(self, *entries: Entry) -> None:
        """Our word to both, ten times a second."""
        if time.monotonic() < self._due_s:
            return
        self._due_s, self._seq = time.monotonic() + SAY_S, self._seq + 1
        common = {"incarnation": self.started_ns, "seq": self._seq, "sent_ns": time.time_ns(), "valid": True}
        for name in HONEST:
            forged = (replace(e, origin=n, count=e.count + 9, signature=bytes(64)) for e in entries for n in HONEST)
            gossip = Gossip(entries=(*entries, *forged))
            said = estimate(LIAR, name, gossip=gossip, **common)
            self._rogue.say(name, encode(self._sign(said)))

    def spend(self, seconds: float, entries: object) -> float:
        """Go on for so long, saying `entries()`; returns how far the honest were moved, at most."""
        self.moved_m.clear()
        until_s = time.monotonic() + seconds
        until(lambda: self.listen() and (self.say(*entries()) or time.monotonic() > until_s), seconds + 60.0)
        return max(self.moved_m)


class Search:
    """Looks for the best lie once a second."""

    def __init__(self, swarm: Swarm) -> None:
        self._swarm, self._rng = swarm, np.random.default_rng(0)
        self._lies: Lies | None = None
        self._told: Entry | None = None
        self._due_s = 0.0

    def __call__(self) -> tuple[Entry, ...]:
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + 1.0
            self._told = self._best()
        return (self._told,)

    def _best(self) -> Entry:
        x_m = np.array([o.x_m for o in self._swarm.opinions()])
        cov_m2 = np.array([full(o.cov_m2) for o in self._swarm.opinions()])
        precision = np.linalg.inv(cov_m2)
        centre_m2 = np.linalg.inv(precision.sum(axis=0))
        centre_m = centre_m2 @ np.einsum("nij,nj->i", precision, x_m)

        def gain(lies_m: np.ndarray, lies_m2: np.ndarray) -> np.ndarray:
            return np.linalg.norm(conclusions(x_m, cov_m2, lies_m, lies_m2) - centre_m, axis=1)

        self._lies = best_lies(gain, centre_m, np.linalg.cholesky(centre_m2), 1, self._rng, self._lies)
        lie = told(LIAR, tuple(self._lies.x_m[0].tolist()), upper(self._lies.cov_m2[0]), self._told)
        return replace(lie, incarnation=self._swarm.started_ns)


def full(a: tuple[float, ...]) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class Truth:
    """What a robot that was repaired says: a new start, a sample a second, each at the place where the target is."""

    def __init__(self, swarm: Swarm) -> None:
        self._swarm, self._began_ns = swarm, time.time_ns()
        self._x_m = fuse(swarm.opinions()).x_m

    def __call__(self) -> tuple[Entry, ...]:
        count = 1 + (time.time_ns() - self._began_ns) // 10**9
        information = tuple(count / 25e-6 if k in (0, 3, 5) else 0.0 for k in range(6))
        said = Entry(LIAR, self._began_ns, count, information, apply(information, self._x_m), SIGMA_M2)
        self._swarm.third = opinion(LIAR, [said])
        return (said,)


@pytest.fixture
def swarm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Swarm]:
    make_keys(("r1", "r2", "r3"), tmp_path / "keys")
    monkeypatch.setenv("AUCAMP_KEYS", str(tmp_path / "keys"))
    fleet = replace(demo_fleet(3, "evidence", 0.0, 0, False, tmp_path), access=Access(keys="keys"))
    with Observer(fleet, time.time_ns, (STATE,)) as observer, Rogue(fleet, LIAR, listens=True) as rogue:
        it = Swarm(fleet, tmp_path, observer, rogue)
        with killed_after(it.processes):
            yield it


def test_what_the_best_lie_moves_and_what_ends_it(swarm: Swarm, tmp_path: Path) -> None:
    until(lambda: all(s.knows == "sees" for s in swarm.listen().values()) and len(swarm.opinions()) == 2, 60.0)
    quiet_m = swarm.spend(1.0, tuple)
    lied_m = swarm.spend(LIES_S, Search(swarm))
    refused = {name: state.refused for name, state in swarm.state.items()}
    repaired = Truth(swarm)
    swarm.spend(10.0, repaired)
    honest_m = swarm.spend(1.0, repaired)
    swarm.third, again = None, Search(swarm)
    swarm.spend(2.0, again)
    public_file(tmp_path / "keys", LIAR).unlink()
    swarm.spend(3.0, again)
    dropped_m = swarm.spend(1.0, again)
    sys.stdout.write(
        f"\nmoved by {1e3 * lied_m:.1f} mm while it lied, {1e3 * honest_m:.2f} mm when it was honest again, "
        f"{1e3 * dropped_m:.2f} mm when its key was gone; {1e3 * quiet_m:.2f} mm before; refused {refused}\n"
    )
    assert 0.001 < lied_m < MOVED_M
    assert honest_m <= AFTER_M
    assert dropped_m <= AFTER_M
    assert all(kinds["bad signature"] > 0 for kinds in refused.values())
    assert all(LIAR not in state.explain.weights for state in swarm.state.values())
