"""Four real processes in network namespaces: loss, delay, a partition, a hung and a killed agent, clocks hours apart.

One swarm lives through all of it, test by test. Zenoh runs over TCP here, so a lost packet shows as delay, and a
message is lost where the link's queue was full or the connection was given up. tests/experiments loses messages.
All of it counts on the wall: links, stops and clocks stand for the machine's.
"""

import signal
import time
from pathlib import Path

import pytest

from agent.core.codec import decode
from agent.core.estimation.evidence_table import opinion
from agent.core.estimation.fuse import Shared, fuse
from agent.core.estimation.protocols import shared_of
from agent.core.messages import Entry, Estimate
from agent.core.step_io import Outputs
from replay.files.log import read
from tests.network.relay import Links, Relay, refused
from tests.network.swarm_in_namespaces import WATCHER, Swarm, used

CLOCK_AHEAD_S = {"r1": 0.0, "r2": 3600.0, "r3": -3600.0, "r4": 7200.0}
APART_S, HUNG_S = 10.0, 5.0  # leases of links are 2 s
RECENT = 200  # messages to one neighbour: twenty seconds
NO_NAMESPACES = refused()

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(NO_NAMESPACES is not None, reason=f"network namespaces are not permitted: {NO_NAMESPACES}"),
]


@pytest.fixture(scope="module")
def swarm(tmp_path_factory):
    hosts = [*CLOCK_AHEAD_S, WATCHER]
    with Relay(hosts, set(CLOCK_AHEAD_S)) as relay:
        it = Swarm(relay, CLOCK_AHEAD_S, tmp_path_factory.mktemp("bad_links"))
        try:
            it.start(*CLOCK_AHEAD_S)
            it.watch()
            yield it
        finally:
            it.stop()


@pytest.fixture(autouse=True)
def healthy(swarm):
    """Each test finds a swarm that agrees over good links."""
    swarm.relay.links = Links()
    swarm.until("agreement", swarm.agree)
    yield
    swarm.relay.links = Links()


def test_clocks_are_hours_apart(swarm) -> None:
    sent_s = {name: state.sent_ns * 1e-9 - CLOCK_AHEAD_S[name] for name, state in swarm.state.items()}
    assert max(sent_s.values()) - min(sent_s.values()) < 600.0  # or the agents did not take the offset
    assert all(0.0 <= n.age_s < 60.0 for state in swarm.state.values() for n in state.neighbours)


def test_loss(swarm) -> None:
    before = swarm.heard(), swarm.relay.count["lost"]
    swarm.relay.links = Links(loss=0.3)
    swarm.live(*CLOCK_AHEAD_S)
    swarm.until("word from all", lambda: all(n > before[0][pair] for pair, n in swarm.heard().items()))
    assert swarm.relay.count["lost"] > before[1] + 10


def test_delay_jitter_reordering_and_duplicates(swarm) -> None:
    before = dict(swarm.relay.count)
    swarm.relay.links = Links(delay_s=0.2, jitter_s=0.1, duplicate=0.1)
    swarm.live(*CLOCK_AHEAD_S)
    assert swarm.relay.count["overtaken"] > before["overtaken"] + 10
    assert swarm.relay.count["doubled"] > before["doubled"] + 10
    assert not any("order" in state.refused for state in swarm.state.values())  # TCP puts them right


def test_partition_and_healing(swarm) -> None:
    sides = (frozenset({"r1", "r2"}), frozenset({"r3", "r4"}))
    began_s = time.monotonic()
    swarm.relay.links = Links(sides=sides)
    swarm.until("two swarms", lambda: all(used(swarm.state[n]) == s - {n} for s in sides for n in s))
    measured = {name: swarm.state[name].measurements for name in CLOCK_AHEAD_S}
    while time.monotonic() < began_s + APART_S:
        swarm.live(*CLOCK_AHEAD_S, iterations=4)
        assert all(used(swarm.state[n]) <= s for s in sides for n in s)
    assert all(swarm.state[name].measurements > n + 10 for name, n in measured.items())
    swarm.relay.links = Links()
    swarm.until("one swarm", swarm.agree)


def test_a_hung_agent_is_left_out_and_comes_back(swarm) -> None:
    others = CLOCK_AHEAD_S.keys() - {"r4"}
    swarm.processes["r4"].send_signal(signal.SIGSTOP)
    try:
        swarm.until("three", lambda: all(used(swarm.state[n]) == others - {n} for n in others))
        hung_s = time.monotonic()
        while time.monotonic() < hung_s + HUNG_S:
            swarm.live(*others, iterations=4)
    finally:
        swarm.processes["r4"].send_signal(signal.SIGCONT)
    swarm.until("four", swarm.agree)


def test_a_killed_agent_starts_again_over_bad_links(swarm) -> None:
    others, before = CLOCK_AHEAD_S.keys() - {"r2"}, swarm.state["r2"].incarnation
    swarm.processes["r2"].kill()
    swarm.processes["r2"].wait()
    swarm.until("three", lambda: all(used(swarm.state[n]) == others - {n} for n in others))
    swarm.state.pop("r2")
    swarm.relay.links = Links(loss=0.1, delay_s=0.05, jitter_s=0.05)
    swarm.start("r2")
    swarm.until("four", swarm.agree)
    assert swarm.state["r2"].incarnation != before


def test_nothing_was_counted_twice(swarm) -> None:
    """What a robot states after all that is what comes of everybody's own sums, to the last digits.

    The black boxes have each origin's own entry at every count, and the counts that a robot held when it spoke.
    """
    for name in CLOCK_AHEAD_S:
        swarm.processes[name].send_signal(signal.SIGTERM)
    for name in CLOCK_AHEAD_S:
        assert swarm.processes[name].wait(timeout=60.0) == 0
    said = {path: words(path) for _, path in swarm.boxes if path.exists()}
    sums: dict[tuple[str, int, int], Entry] = {}
    for entry in (e for words_ in said.values() for estimate in words_ for e in estimate.gossip.entries):
        first = sums.setdefault((entry.origin, entry.incarnation, entry.count), entry)
        assert entry == first  # whoever passes a sum on, and whichever way it went
    shared = shared_of(swarm.fleet, "ball")
    for name in CLOCK_AHEAD_S:
        newest = [path for robot, path in swarm.boxes if robot == name][-1]
        last = [estimate for estimate in said[newest] if estimate.dst == said[newest][0].dst][-RECENT:]
        checked = [found for estimate in last if (found := restates(estimate, sums, shared)) is not None]
        assert any(checked), f"{name}: {len(checked)} of its last statements could be checked, none was right"


def restates(estimate: Estimate, sums, shared: Shared) -> bool | None:
    """Whether a message's covariance is that of the sums it says it holds; None when they were not all recorded.

    Between two iterations a robot may hold more than it has drawn its conclusion from, so not every message can.
    """
    held = sorted((line.origin, line.incarnation, line.newest) for line in estimate.gossip.digest)
    if {origin for origin, *_ in held} != CLOCK_AHEAD_S.keys() or not all(key in sums for key in held):
        return None
    by_origin = {name: [sums[key] for key in held if key[0] == name] for name in CLOCK_AHEAD_S}
    fused = fuse([opinion(name, entries, shared) for name, entries in by_origin.items()], shared)
    return estimate.cov_m2 == pytest.approx(fused.cov_m2, rel=1e-9, abs=1e-15)


def words(path: Path) -> list[Estimate]:
    """All messages of a recording."""
    outputs = (decode(r.data, Outputs, limit=1 << 20) for r in read(path) if r.channel == "/raw/step_out")
    return [estimate for o in outputs for estimate in o.says if estimate.gossip is not None]
