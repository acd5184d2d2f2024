"""The paper's protocol against its closed form and its stated branches."""

import math
from random import Random

import pytest

from agent.core.codec import Refusal
from agent.core.estimation.interface import EstimateCache, Prior
from agent.core.estimation.protocols import Paper
from agent.core.messages import Estimate
from tests.sample_messages import estimate

COV = (4e-4, 0.0, 0.0, 4e-4, 0.0, 4e-4)
TICK_NS = 1_000_000_000


def prior(x: float) -> Prior:
    return Prior((x, 0.0, 0.0), COV, 0)


def say(src: str, dst: str, robot: Paper, seq: int, now_ns: int) -> Estimate:
    x = robot.posterior
    knows = {"x_m": x.x_m, "cov_m2": x.cov_m2} if x else {}
    return estimate(src, dst, seq=seq, sent_ns=now_ns, t=robot.t, valid=robot.valid, **knows)


class Swarm:
    """Robots and a list make a network: all speak, then all tick."""

    def __init__(self, links: dict[str, tuple[str, ...]]) -> None:
        self.links = links
        self.robots = {name: Paper(validity_ns=2 * TICK_NS) for name in links}
        self.boxes = {name: EstimateCache("tank", name, "ball", neighbours) for name, neighbours in links.items()}
        self.now_ns = TICK_NS
        self.seq = 0

    def tick(self, priors: dict[str, Prior | None]):
        for src in self.links:
            for dst in self.links[src]:
                self.boxes[dst].put(src, say(src, dst, self.robots[src], self.seq, self.now_ns), self.now_ns)
        self.seq += 1
        updates = {
            name: robot.tick(priors.get(name), self.boxes[name], self.now_ns) for name, robot in self.robots.items()
        }
        self.now_ns += TICK_NS
        return updates


FULL3 = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}
LINE3 = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}


@pytest.mark.parametrize("links", [FULL3, LINE3])
def test_noise_gain_is_the_closed_form(links) -> None:
    """e_i^T = (1/T) sum_k W^k n^{T-1-k}: feed one unit impulse and read the gain of every robot."""
    names = list(links)
    weights = [[1 / len(links[i]) if j in links[i] else 0.0 for j in names] for i in names]
    total = 7
    for source in names:
        for when in range(1, total):  # the first tick has no neighbours yet: every robot takes its own sample
            swarm = Swarm(links)
            for t in range(total):
                swarm.tick({n: prior(1.0 if (n == source and t == when) else 0.0) for n in names})
            row = [float(n == source) for n in names]
            for _ in range(total - 1 - when):
                row = [math.fsum(weights[i][j] * row[j] for j in range(3)) for i in range(3)]
            for name, gain in zip(names, row, strict=True):
                assert swarm.robots[name].posterior.x_m[0] == pytest.approx(gain / total, abs=1e-12)


def test_a_lone_observer_starts_again_from_each_sample() -> None:
    swarm = Swarm(FULL3)
    for x in (1.0, 2.0, 5.0):
        updates = swarm.tick({"r1": prior(x)})
    assert updates["r1"].rule == "alone"
    assert swarm.robots["r1"].posterior.x_m[0] == 5.0


def test_the_blind_are_told_and_do_not_relay() -> None:
    swarm = Swarm(LINE3)
    for _ in range(6):
        updates = swarm.tick({"r1": prior(3.0)})
    assert updates["r2"].rule == "told"
    assert swarm.robots["r2"].posterior.x_m[0] == 3.0
    assert updates["r3"].rule == "hold"
    assert swarm.robots["r3"].posterior is None


def test_stale_neighbours_do_not_count() -> None:
    swarm = Swarm(FULL3)
    swarm.tick({n: prior(1.0) for n in FULL3})
    swarm.tick({n: prior(1.0) for n in FULL3})
    late_ns = swarm.now_ns + 10 * TICK_NS
    update = swarm.robots["r1"].tick(None, swarm.boxes["r1"], late_ns)
    assert update.rule == "hold"
    assert update.used == ()


def test_late_robot_adopts_the_iteration() -> None:
    robot = Paper(TICK_NS)
    robot.adopt(1)
    assert robot.t == 0
    robot.adopt(16)
    robot.tick(None, EstimateCache("tank", "r1", "ball", ()), 0)
    assert robot.t == 16


def test_robots_whose_periods_jitter_do_not_drive_each_other() -> None:
    """Three robots, periods of 1.0 to 1.5 s: the swarm's index never runs ahead of the fastest robot's clock."""
    random, robots, box = Random(1), [Paper(TICK_NS) for _ in range(3)], EstimateCache("tank", "r1", "ball", ())
    due_s = [0.0, 0.3, 0.6]
    for _ in range(600):
        i = min(range(3), key=lambda k: due_s[k])
        now_s = due_s[i]
        robots[i].adopt(max(other.t for other in robots))
        robots[i].tick(None, box, 0)
        due_s[i] += random.uniform(1.0, 1.5)
        assert max(one.t for one in robots) <= now_s / 1.0 + 1
    assert max(one.t for one in robots) - min(one.t for one in robots) <= 2


def test_covariance_of_independent_samples_falls_as_one_over_t() -> None:
    swarm = Swarm(FULL3)
    for _ in range(50):
        swarm.tick({n: prior(0.0) for n in FULL3})
    assert swarm.robots["r1"].posterior.cov_m2[0] == pytest.approx(COV[0] / 50, rel=0.05)


def test_cache_refuses_what_does_not_belong_there() -> None:
    box = EstimateCache("tank", "r1", "ball", ("r2",))
    for src, bad in (
        ("r9", estimate(src="r9")),
        ("r2", estimate(src="r3")),
        ("r2", estimate(dst="r3")),
        ("r2", estimate(fleet="other")),
        ("r2", estimate(target="fish")),
    ):
        with pytest.raises(Refusal):
            box.put(src, bad, 0)
    assert box.senders["r2"].heard == 0


def test_cache_counts_gaps_refuses_repeats_and_believes_a_restart() -> None:
    box = EstimateCache("tank", "r1", "ball", ("r2",))
    box.put("r2", estimate(seq=3), 0)
    box.put("r2", estimate(seq=6), 0)
    assert box.senders["r2"].gaps == 2
    with pytest.raises(Refusal):
        box.put("r2", estimate(seq=6), 0)
    box.put("r2", estimate(seq=0, incarnation=2), 0)
    assert box.senders["r2"].newest.message.incarnation == 2


def test_a_burst_of_queued_messages_is_old_although_it_just_arrived() -> None:
    """Clocks an hour apart; one message spent five seconds in a queue."""
    box, hour, ms = EstimateCache("tank", "r1", "ball", ("r2",)), 3600 * TICK_NS, 1_000_000
    for k in range(5):
        now = hour + k * 100 * ms
        box.put("r2", estimate(seq=k, sent_ns=k * 100 * ms), now + 2 * ms)
    assert box.age_ns("r2", now + 2 * ms) == 0
    box.put("r2", estimate(seq=5, sent_ns=500 * ms), hour + 5500 * ms)
    assert box.age_ns("r2", hour + 5500 * ms) == 5000 * ms - 2 * ms
    assert box.usable(hour + 5500 * ms, validity_ns=500 * ms) == ()
