"""Where the neighbours of a robot that swims are, as they say, and whose camera is at landmarks.

Nothing of it comes back in what the robot says itself: it steers by it, and that is all.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from agent.capabilities.swim.barrier import RINGS_M, Disc, Planar, robot
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.estimation.evidence_table import MARGIN_M, SLACK, finite, inside, widest_m2
from agent.core.linear_algebra import semidefinite, trace
from agent.core.messages import Presence, Vector
from agent.core.step_transaction import Revertible
from agent.core.trust import Letter, Letters

FASTEST_M_S = 2.0  # a robot that drops from a hand; none swims at a quarter of it
OLDEST_NS = 1_000_000_000  # a place was that old, at most, when it was said
LONGEST_NS = 2_000_000_000  # a claim on glancing ends by itself: who claimed may have lost its link
SILENT_NS = 3_000_000_000  # by then a robot may be a metre and more from where it was going


class Neighbours(Revertible):
    """Of one robot, between steps."""

    def __init__(self, fleet: Fleet, me: str) -> None:
        assert fleet.navigation is not None
        self.letters = Letters[Presence](fleet.fleet, me, fleet.robot[me].neighbours)
        self._tank_m, self._clear_m = fleet.tank.size_m, fleet.navigation.limits.separation_m

    def hear(self, src: str, presence: Presence, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := content_fault(presence, self._tank_m)) is not None:
            raise Refusal("content", fault)
        self.letters.put(src, presence, arrived_ns)

    def discs(self, now_ns: int) -> tuple[Disc, ...]:
        """All that ever said where they are, in the order of their names, where they should be by now."""
        return tuple(
            robot(
                self._in_tank((said.x_m, said.y_m)),
                (said.v_x_m_s, said.v_y_m_s),
                (said.cov[0], said.cov[1], said.cov[3]),
                (now_ns - said_ns(letter)) * 1e-9,
                self._clear_m,
            )
            for letter in self._heard()
            for said in (letter.message,)
        )

    def _in_tank(self, at_m: Planar) -> Planar:
        """The nearest place where its ring touches no wall: who does not know where he is may believe to be in one."""
        ring_m, (length_m, breadth_m, _) = 0.5 * RINGS_M, self._tank_m
        x, y = (min(max(at, ring_m), side - ring_m) for at, side in zip(at_m, (length_m, breadth_m), strict=True))
        return x, y

    def places(self, but: Collection[str] = ()) -> tuple[tuple[float, float, float], ...]:
        """x, y and depth of all that ever said where they are, but those of these names."""
        heard = (letter.message for letter in self._heard())
        return tuple((said.x_m, said.y_m, said.depth_m) for said in heard if said.src not in but)

    def doing(self, behaviour: str, target: str, now_ns: int) -> tuple[Planar, ...]:
        """Where those are that do the same about the same target, in the order of their names; silent ones left out."""
        letters = [e for e in self._heard() if now_ns - said_ns(e) <= SILENT_NS]
        return tuple(
            (said.x_m, said.y_m)
            for said in (letter.message for letter in letters)
            if said.behaviour == behaviour and said.target == target
        )

    def glancing(self, now_ns: int) -> tuple[str, ...]:
        """Whose camera is at landmarks, by name."""
        claims_ns = {e.message.src: e.message.glance_until_ns - e.message.sent_ns for e in self._heard()}
        return tuple(
            e.message.src
            for e in self._heard()
            if now_ns < e.arrived_ns - e.late_ns + min(claims_ns[e.message.src], LONGEST_NS)
        )

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """Who is silent, and for people to look after."""
        silent = (e.message.src for e in self._heard() if now_ns - said_ns(e) > SILENT_NS)
        return tuple(
            f"silent neighbour: {name} no longer says where it is, and is not approached; see to it" for name in silent
        )

    def _heard(self) -> tuple[Letter[Presence], ...]:
        return tuple(sender.newest for sender in self.letters.senders.values() if sender.newest is not None)


def said_ns(letter: Letter[Presence]) -> int:
    """When a neighbour was where it said, on our clock."""
    said = letter.message
    return letter.arrived_ns - letter.late_ns - (said.sent_ns - said.t_ns)


def content_fault(said: Presence, tank_m: Vector) -> str | None:
    """Why a robot cannot be there, or not know it so; None where it can."""
    places = (said.x_m, said.y_m, tank_m[2] - MARGIN_M), (said.goal_x_m, said.goal_y_m, 0.0)
    if not all(inside(place, tank_m) for place in places) or abs(said.depth_m) > tank_m[2] + MARGIN_M:
        return "a place outside the tank"
    size = trace(said.cov)
    if not finite(said.cov) or not semidefinite(said.cov, SLACK * size) or size > widest_m2(tank_m):
        return "cov is no covariance of a pose in the tank"
    if math.hypot(said.v_x_m_s, said.v_y_m_s) > FASTEST_M_S:
        return f"faster than {FASTEST_M_S} m/s"
    if not 0 <= said.sent_ns - said.t_ns <= OLDEST_NS:
        return "its place is not of the time at which it was said"
    return None
