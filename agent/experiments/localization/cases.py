"""Which cases the localization experiment runs: one list, in the order of the table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agent.core.config import Protocol
from agent.experiments.localization.graphs import Topology
from agent.experiments.localization.world import Noise, Views
from agent.experiments.result import Row

PROTOCOLS: tuple[Protocol, ...] = ("paper", "metropolis", "evidence")
AT = (10, 50, 200)
QUICK = 20  # times fewer draws
MORE = 3  # times more draws with --full
SMALL = 10  # robots above which a swarm is for patient people


class Case(NamedTuple):
    """One protocol in one situation; `at` are the iterations at which it is scored, in ascending order."""

    protocol: Protocol
    topology: Topology
    robots: int
    draws: int
    at: tuple[int, ...] = AT
    noise: Noise = "aniso"
    loss: float = 0.0
    views: Views = "all"
    systematic: bool = False  # errors that do not average out, on every robot
    outlier_mm: float = 0.0  # robot 0 is wrong by this much and does not know it
    speed_mm_s: float = 0.0  # of the target, on a circle
    says: int = 1  # messages to each neighbour in one iteration
    ticks: int = 1  # iterations for each sample, which takes a second: one measures, all exchange

    @property
    def honest(self) -> slice:
        """The robots that count."""
        return slice(1, None) if self.outlier_mm else slice(None)

    def named(self) -> Row:
        """What a row of result.json says of its case."""
        return {name: value for name, value in self._asdict().items() if name != "at"}


def cases(quick: bool = False, full: bool = False) -> list[Case]:
    """The experiment: eleven minutes of processor time; with `full` also what takes longer."""
    losses = (0.0, 0.1, 0.3) if full else (0.0, 0.3)
    found = [*closed_form(), *bad_links(losses), *late_views(losses), *relays(), *one_is_wrong(), *honest_covariance()]
    found += [*moving(losses), *large(full)]
    if quick:
        return [case._replace(draws=max(2, case.draws // QUICK)) for case in found if case.robots <= SMALL]
    return [case._replace(draws=case.draws * MORE) if full and case.robots <= SMALL else case for case in found]


def closed_form() -> Sequence[Case]:
    """Nothing goes wrong: what averaging reaches is known beforehand."""
    graphs: tuple[tuple[Topology, int], ...] = (("full", 3), ("ring", 10), ("line", 10), ("geometric", 10))
    averaging = PROTOCOLS[:2]
    return [Case(p, g, n, 200, (10, 50), noise="iso") for g, n in graphs for p in averaging]


def bad_links(losses: Sequence[float]) -> Sequence[Case]:
    """Ten robots on the hard graph. One message an iteration, as in the paper; and ten, as the agents send by default.

    What is measured in an iteration is heard in the next one, so with one message news travels one hop an iteration.
    """
    found: list[Case] = []
    for loss in losses:
        if loss:
            found.append(Case("evidence", "geometric", 10, 40, (10, 50), loss=loss, says=10))
        draws = {"paper": 120, "metropolis": 60, "evidence": 100 if loss else 30}
        found += [Case(p, "geometric", 10, draws[p], loss=loss) for p in PROTOCOLS]
    return found


def late_views(losses: Sequence[float]) -> Sequence[Case]:
    """The paper's own experiment: views from iterations 0, 16 and 28."""
    return [Case(p, "full", 3, 50, (10, 15, 45, 200), loss=loss, views="paper") for loss in losses for p in PROTOCOLS]


def relays() -> Sequence[Case]:
    """Three of ten see."""
    graphs: tuple[Topology, ...] = ("line", "geometric")
    return [Case(p, g, 10, 40, (10, 50), loss=0.1, views="relay") for g in graphs for p in PROTOCOLS]


def one_is_wrong() -> Sequence[Case]:
    """Robot 0 is 300 mm off, in realistic company."""
    three = [Case(p, "full", 3, 150, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0) for p in PROTOCOLS]
    return [*three, Case("evidence", "geometric", 10, 40, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0)]


def honest_covariance() -> Sequence[Case]:
    """Does a robot know how wrong it is? Robots that share all they know are wrong together: only draws count."""
    swarms = ((3, 600), (5, 400), (10, 150))
    return [Case("evidence", "full", n, draws, (10, 60), systematic=True) for n, draws in swarms]


def moving(losses: Sequence[float]) -> Sequence[Case]:
    """A target that swims in circles. Old news is wrong news: one message a second, ten (the agents' rate), and
    iterations five times as frequent as samples."""
    rates = ((1, 1), (1, 10), (5, 1))
    found = [
        Case("evidence", "geometric", 10, 5, (60,), loss=loss, speed_mm_s=20.0, ticks=ticks, says=says)
        for loss in losses
        for ticks, says in rates
    ]
    wrong = Case("evidence", "full", 3, 10, (60,), loss=0.3, speed_mm_s=20.0, says=10, systematic=True)
    return [*found, wrong, wrong._replace(outlier_mm=300.0)]


def large(full: bool) -> Sequence[Case]:
    """Swarms that no tank holds. A draw of a thousand with `evidence` is a million fusions' worth: one, and short."""
    found = [
        *(Case(p, "geometric", 100, 10, (10, 25, 50), loss=0.3) for p in PROTOCOLS[:2]),
        Case("evidence", "geometric", 100, 2, (10, 25), loss=0.3),
        *(Case(p, "geometric", 1000, 1, (10, 50), loss=0.3) for p in PROTOCOLS[:2]),
    ]
    if full:
        found += [Case(p, "ring", 100, 10, AT, loss=0.3) for p in PROTOCOLS[:2]]
        found += [Case("evidence", g, 100, 4, (25, 60), loss=0.3) for g in ("geometric", "ring")]
        found += [Case("evidence", "geometric", 1000, 1, (5,), loss=0.3)]
    return found
