"""Which lies the localization experiment tells: one list, in the order of the table."""

from __future__ import annotations

from typing import Literal, NamedTuple

from agent.core.config import Protocol
from agent.experiments.localization.graphs import Topology
from agent.experiments.result import Row

Then = Literal["silent", "honest", "no key"]

QUICK = 20  # times fewer draws
MORE = 3  # times more draws with --full


class LiarCase(NamedTuple):
    """Robots 0 to `liars` - 1 lie for 20 iterations. `then`: what becomes of them after it."""

    topology: Topology
    robots: int
    draws: int
    liars: int = 1
    protocol: Protocol = "evidence"
    keys: bool = True  # `evidence` is signed by its origin
    clip: bool = False
    loss: float = 0.1
    then: Then = "silent"
    speed_mm_s: float = 0.0  # of the target
    bumped_mm: float = 0.0  # no lie: robot 0 is wrong by this much for 40 iterations, then repaired

    def named(self) -> Row:
        """What a row of result.json says of its case."""
        return self._asdict()


def liar_cases(quick: bool = False, full: bool = False) -> list[LiarCase]:
    """Fifteen minutes of processor time, most of it for ten robots."""
    found = [*at_rest(), *without_keys(), *afterwards(), *moving(), *two(), *bumped(), *averaging()]
    if quick:
        return [
            case._replace(draws=max(2, case.draws // QUICK))
            for case in found
            if not (case.robots > 5 and case.speed_mm_s)
        ]
    return [case._replace(draws=case.draws * MORE) if full else case for case in found]


def at_rest() -> list[LiarCase]:
    """All hear all; then graphs on which a lie has to be passed on."""
    meshes = [LiarCase("full", robots, 100) for robots in (3, 5, 10)]
    return [*meshes, LiarCase("geometric", 10, 20), LiarCase("line", 5, 40)]


def without_keys() -> list[LiarCase]:
    """Each robot's own mouth counts where it is heard; where it is not, nothing stops a relay."""
    return [LiarCase("full", 3, 40, keys=False), LiarCase("geometric", 10, 10, keys=False)]


def afterwards() -> list[LiarCase]:
    """It starts again and tells the truth, or its key is taken away."""
    honest = [LiarCase("full", robots, draws, then="honest") for robots, draws in ((3, 40), (5, 40), (10, 20))]
    return [*honest, *(LiarCase("full", robots, 20, then="no key") for robots in (3, 5))]


def moving() -> list[LiarCase]:
    """The target swims, and every lie binds the next."""
    return [LiarCase("full", robots, draws, speed_mm_s=20.0) for robots, draws in ((3, 20), (5, 10), (10, 4))]


def two() -> list[LiarCase]:
    """Two of ten agree on their lies, and the fleet file reckons with two."""
    return [LiarCase("full", 10, 10, liars=2)]


def bumped() -> list[LiarCase]:
    """One of three is knocked, for forty iterations nobody notices, then it is repaired and starts again."""
    return [LiarCase("full", 3, 40, bumped_mm=mm) for mm in (30.0, 100.0, 300.0)]


def averaging() -> list[LiarCase]:
    """What the protocols that average beliefs have: a word from the far corner of the tank."""
    swarms = (3, 5, 10)
    found = [LiarCase("full", robots, 40, protocol="paper") for robots in swarms]
    found += [
        LiarCase("full", robots, 40, protocol="metropolis", clip=clip) for clip in (False, True) for robots in swarms
    ]
    return found
