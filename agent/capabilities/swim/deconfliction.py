"""A robot among others that swim: it tells them where it is, keeps clear of them, and takes turns with them at looking
for landmarks."""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.barrier import (
    DELAY_S,
    RINGS_M,
    Disc,
    Planar,
    Reference,
    Spread,
    keep_right,
    robot,
    safe_velocity,
)
from agent.capabilities.swim.localizer import UNSURE_DEG, UNSURE_M, sigmas, within
from agent.capabilities.swim.pose_filter import Belief
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.estimation.evidence_table import MARGIN_M, SLACK, finite, inside, widest_m2
from agent.core.linear_algebra import plus, semidefinite, trace
from agent.core.messages import Presence, Vector
from agent.core.step_transaction import Revertible
from agent.core.topics import NEAR, next_due_ns
from agent.core.trust import CachedMessage, MessageCache

# --- neighbours ---

FASTEST_M_S = 2.0  # a robot that drops from a hand; none swims at a quarter of it
OLDEST_NS = 1_000_000_000  # a place was that old, at most, when it was said
LONGEST_NS = 2_000_000_000  # a claim on looking ends by itself: the robot that claimed may have lost its link
SILENT_NS = 3_000_000_000  # by then a robot may be a metre and more from where it was going


class Neighbours(Revertible):
    """Where the neighbours of a robot that swims are, as they say, and whose camera is at landmarks; between steps.

    The robot steers by it, and nothing of it comes back in what the robot says itself.
    """

    def __init__(self, fleet: Fleet, me: str) -> None:
        assert fleet.navigation is not None
        self.cache = MessageCache[Presence](fleet.fleet, me, fleet.robot[me].neighbours)
        self._tank_m, self._clear_m = fleet.tank.size_m, fleet.navigation.limits.separation_m

    def hear(self, src: str, presence: Presence, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := content_fault(presence, self._tank_m)) is not None:
            raise Refusal("content", fault)
        self.cache.put(src, presence, arrived_ns)

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
        """The nearest place where its ring touches no wall: a robot that is lost may believe itself in one."""
        ring_m, (length_m, breadth_m, _) = 0.5 * RINGS_M, self._tank_m
        x, y = (min(max(at, ring_m), side - ring_m) for at, side in zip(at_m, (length_m, breadth_m), strict=True))
        return x, y

    def places(self) -> tuple[tuple[float, float, float], ...]:
        """x, y and depth of all that ever said where they are."""
        heard = (letter.message for letter in self._heard())
        return tuple((said.x_m, said.y_m, said.depth_m) for said in heard)

    def doing(self, behaviour: str, target: str, now_ns: int) -> tuple[Planar, ...]:
        """Where robots are that do the same about the same target, in order of their names; silent ones left out."""
        cache = [e for e in self._heard() if now_ns - said_ns(e) <= SILENT_NS]
        return tuple(
            (said.x_m, said.y_m)
            for said in (letter.message for letter in cache)
            if said.behaviour == behaviour and said.target == target
        )

    def at_landmarks(self, now_ns: int) -> tuple[str, ...]:
        """Names of the robots whose camera is at landmarks."""
        claims_ns = {e.message.src: e.message.glance_until_ns - e.message.sent_ns for e in self._heard()}
        return tuple(
            e.message.src
            for e in self._heard()
            if now_ns < e.arrived_ns - e.late_ns + min(claims_ns[e.message.src], LONGEST_NS)
        )

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """Which neighbours are silent, for people to look after."""
        silent = (e.message.src for e in self._heard() if now_ns - said_ns(e) > SILENT_NS)
        return tuple(
            f"silent neighbour: {name} no longer says where it is, and is not approached; see to it" for name in silent
        )

    def newest(self) -> tuple[Presence, ...]:
        """The newest word of all that ever said where they are, in the order of their names."""
        return tuple(letter.message for letter in self._heard())

    def _heard(self) -> tuple[CachedMessage[Presence], ...]:
        return tuple(sender.newest for sender in self.cache.senders.values() if sender.newest is not None)


def said_ns(letter: CachedMessage[Presence]) -> int:
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


# --- keeping clear, taking turns, telling ---

NEAR_NS = round(1e9 / NEAR.hz)
CLAIM_NS = 500_000_000  # of looking at landmarks, said anew ten times a second
WAIT_WITHIN = 2.0  # times as unsure as where a look is due: until then one that finds another looking waits
YIELD_NS = 500_000_000  # two that began at once have heard of it by now; the one whose name comes first goes on


class Deconfliction(Revertible):
    """What a robot that swims has to do with its neighbours, between steps."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int) -> None:
        self._fleet, self._name, self._incarnation, self._tank_m = fleet.fleet, name, incarnation, fleet.tank.size_m
        self.neighbours = Neighbours(fleet, name)
        self._at_once = max(1, (1 + len(self.neighbours.cache.senders)) // 3)  # so many look for landmarks
        self._looks_since_ns: int | None = None  # at landmarks
        self._goal: Reference | None = None  # where it was told to be last
        self._due_ns = self._told = 0  # when it says so next, and how often it was due

    def velocity(
        self, wanted: Planar, here: Belief, to: Reference, things: Iterable[Disc], now_ns: int
    ) -> tuple[float, float]:
        """The velocity nearest to the wanted one, in the world, that keeps clear of walls, things and neighbours."""
        self._goal = to
        at_m, spread_m2, robots = here.pose[:2], spread_ahead(here), self.neighbours.discs(now_ns)
        wanted = keep_right(wanted, at_m, spread_m2, robots)
        return safe_velocity(wanted, at_m, spread_m2, self._tank_m, things, robots)

    def waits(self, here: Belief | None, looks: bool, now_ns: int) -> bool:
        """Whether it leaves it to others to look for landmarks just now: a third of a fleet looks at a time, so that
        the target is watched. A robot that is too unsure to wait looks. Asked in each step; looks: whether it does."""
        since_ns = self._looks_since_ns = (self._looks_since_ns or now_ns) if looks else None
        if here is None or direly_unsure(here):
            return False
        others = self.neighbours.at_landmarks(now_ns)
        if since_ns is None:
            return len(others) >= self._at_once
        first = sum(name < self._name for name in others)
        return now_ns - since_ns < YIELD_NS and first >= self._at_once

    def due(self, now_ns: int) -> bool:
        """Whether it is time to say where it is; asked once a step."""
        if now_ns < self._due_ns:
            return False
        self._due_ns, self._told = next_due_ns(self._due_ns, NEAR_NS, now_ns), self._told + 1
        return True

    def say(
        self, here: Belief, behaviour: str, about: str | None, looks: bool, depth_m: float, now_ns: int
    ) -> tuple[Presence, ...]:
        """Where it is and where it goes, to each neighbour; about: the target of its behaviour; looks: its camera is at
        landmarks."""
        to = self._goal or Reference(here.pose[:2], here.pose[2])
        said = Presence(
            fleet=self._fleet,
            src=self._name,
            dst=self._name,
            incarnation=self._incarnation,
            seq=self._told,
            sent_ns=now_ns,
            t_ns=now_ns,
            x_m=here.pose[0],
            y_m=here.pose[1],
            yaw_rad=here.pose[2],
            depth_m=depth_m,
            cov=plus(here.covariance, here.stays),
            v_x_m_s=here.x[3],
            v_y_m_s=here.x[4],
            rate_rad_s=here.x[5],
            goal_x_m=to.place_m[0],
            goal_y_m=to.place_m[1],
            goal_yaw_rad=to.yaw,
            behaviour=behaviour,
            target=UNSET if about is None else about,
            glance_until_ns=now_ns + CLAIM_NS if looks else 0,
        )
        if content_fault(said, self._tank_m) is not None:  # no neighbour would believe it
            return ()
        return tuple(replace(said, dst=neighbour) for neighbour in self.neighbours.cache.senders)


def direly_unsure(belief: Belief) -> bool:
    """It has to look for landmarks at once, whichever others look."""
    return not within(belief, WAIT_WITHIN * UNSURE_M, WAIT_WITHIN * UNSURE_DEG)


def pace(belief: Belief) -> float:
    """Share of its speed that a robot may swim and turn at: all of it until it is unsure of its place, nothing once it
    is so unsure that it no longer waits to look for landmarks. It would be lost while it swims, and then drift on; and
    a camera that is turned to where landmarks should be misses them while the body turns on."""
    place, yaw = sigmas(belief)
    worst = max(place / UNSURE_M, yaw / UNSURE_DEG)
    return min(max((WAIT_WITHIN - worst) / (WAIT_WITHIN - 1.0), 0.0), 1.0)


def spread_ahead(here: Belief) -> Spread:
    """How well a robot knows where it will be once it has braked: it does not know its speed for certain either."""
    P, T = here.P, DELAY_S
    xx, xy, yy = (
        P[i][j] + T * (P[i][j + 3] + P[i + 3][j]) + T * T * P[i + 3][j + 3] for i, j in ((0, 0), (0, 1), (1, 1))
    )
    return xx + here.stays[0], xy + here.stays[1], yy + here.stays[3]
