"""Which protocol a fleet speaks: `fleet.estimation.protocol` -> an estimator for one robot and one target."""

from __future__ import annotations

from agent.core.authority import Verify
from agent.core.config import Fleet, Follow, Search, Target
from agent.core.estimation.dynamics import ROLLING, Dynamics, swimming
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_checks import Bounds
from agent.core.estimation.interface import Estimator
from agent.core.estimation.metropolis import Metropolis
from agent.core.estimation.paper import Paper
from agent.core.signed import verify

PURSUIT_S = 0.1  # an iteration with a target that is pursued: a frame at 10 Hz, and a window of two and a half seconds


def estimator(fleet: Fleet, me: str, target: str, incarnation: int, verify: Verify = verify) -> Estimator:
    """A fresh estimator of `target` for the robot `me`; `incarnation` tells this start from the ones before.

    verify: how the signatures of others are checked; an experiment may take perfect ones that cost nothing.
    """
    assert target in fleet.target
    validity_ns = round(fleet.estimation.validity_s * 1e9)
    neighbours = fleet.robot[me].neighbours
    match fleet.estimation.protocol:
        case "paper":
            return Paper(validity_ns)
        case "metropolis":
            return Metropolis(me, validity_ns, len(neighbours), fleet.estimation.clip)
        case "evidence":
            bounds = Bounds(frozenset(fleet.robot), fleet.tank.size_m, iteration_ns(fleet, target))
            return Evidence(
                me,
                incarnation,
                neighbours,
                validity_ns,
                bounds,
                liars=fleet.estimation.liars,
                subject=(fleet.fleet, target),
                verify=verify,
                dynamics=dynamics(fleet.target[target]),
            )


def iteration_ns(fleet: Fleet, target: str) -> int:
    """The period of the protocol's iterations with that target, the same on all robots."""
    iteration_s = fleet.estimation.iteration_s
    return round(1e9 * (min(iteration_s, PURSUIT_S) if target in pursued(fleet) else iteration_s))


def pursued(fleet: Fleet) -> tuple[str, ...]:
    """Targets that swim and that a robot of the fleet is to follow or to search for: where its frames give bearings.
    Of the protocols only evidence takes these."""
    if fleet.estimation.protocol != "evidence":
        return ()
    told = {robot.behaviour.target for robot in fleet.robot.values() if isinstance(robot.behaviour, Follow | Search)}
    return tuple(name for name, target in fleet.target.items() if name in told and target.speed_m_s is not None)


def dynamics(target: Target) -> Dynamics:
    """How the fleet file says that a target moves; not at all is: like a ball."""
    if target.speed_m_s is None or target.turn_s is None:
        return ROLLING
    return swimming(target.speed_m_s, target.turn_s)
