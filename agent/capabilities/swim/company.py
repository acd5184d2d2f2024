"""A robot among others that swim: it tells them where it is, keeps clear of them, and takes turns with them at looking
for landmarks."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.barrier import DELAY_S, Disc, Planar, Spread, keep_right, safe_velocity
from agent.capabilities.swim.localizer import UNSURE_DEG, UNSURE_M, sigmas, within
from agent.capabilities.swim.neighbours import Neighbours, content_fault
from agent.capabilities.swim.pilot import Reference
from agent.capabilities.swim.pose_filter import Belief
from agent.core.config import Fleet
from agent.core.linear_algebra import plus
from agent.core.messages import Presence
from agent.core.step_transaction import Revertible
from agent.core.topics import NEAR, next_due_ns

NEAR_NS = round(1e9 / NEAR.hz)
CLAIM_NS = 500_000_000  # of looking at landmarks, said anew ten times a second
WAIT_WITHIN = 2.0  # times as unsure as where a look is due: until then one that finds another looking waits
YIELD_NS = 500_000_000  # two that began at once have heard of it by now; the one whose name comes first goes on


class Company(Revertible):
    """Of one robot, between steps."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int) -> None:
        self._fleet, self._name, self._incarnation, self._tank_m = fleet.fleet, name, incarnation, fleet.tank.size_m
        self.neighbours = Neighbours(fleet, name)
        self._at_once = max(1, (1 + len(self.neighbours.letters.senders)) // 3)  # so many look for landmarks
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
        """Whether it leaves it to others to look for landmarks just now: a third of a fleet at a time, so that the
        target is watched. Who is worse off than that a wait could be afforded looks. Asked in each step; looks: it
        does."""
        since_ns = self._looks_since_ns = (self._looks_since_ns or now_ns) if looks else None
        if here is None or direly_unsure(here):
            return False
        others = self.neighbours.glancing(now_ns)
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
        if content_fault(said, self._tank_m) is not None:  # nobody would believe it
            return ()
        return tuple(replace(said, dst=neighbour) for neighbour in self.neighbours.letters.senders)


def direly_unsure(belief: Belief) -> bool:
    """It has to look for landmarks at once, whoever else looks."""
    return not within(belief, WAIT_WITHIN * UNSURE_M, WAIT_WITHIN * UNSURE_DEG)


def pace(belief: Belief) -> float:
    """Share of its speed that a robot may swim and turn at: all of it until it is unsure of its place, nothing once it
    is so unsure that it waits for nobody to look for landmarks. It would be lost while it swims, and then drift on; and
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
