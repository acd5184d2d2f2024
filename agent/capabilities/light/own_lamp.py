"""A robot's own lamp in its step: how it burns, by whose light, what telemetry says of it, and the robot's turns at the
light.
"""

from __future__ import annotations

from typing import NamedTuple

from agent.capabilities.light.allocate import (
    LENDS_BELOW,
    LampControl,
    OrderedLight,
    aim_of,
    cannot,
    command,
    load,
    looked_at,
    warmed,
)
from agent.capabilities.light.lease import Bound, Party, Phase, Spoiled, Talk, lit_by
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability_messages import LampNow, Lease, Why
from agent.core.config import Fleet, Lighting
from agent.core.control.target_search import Seek
from agent.core.messages import LampState, Vector
from agent.core.step_transaction import Revertible

AWAKE_NS = 1_000_000_000  # after a start nobody knows how the module's lamp burned before
NEAR_US = 22  # of a lamp that goes with its camera: it stays where it is for less, 2 degrees
STILL_M_S = 0.03  # a robot that swims faster does not lend: its lamp would move
BRAKES_NS = 2_000_000_000  # who swims and is asked has come to rest by then, or stays dark


class Obeyed(NamedTuple):
    """How the lamp burns by a neighbour's lease, from its beginning to its end."""

    lease: tuple[str, int, int]  # holder, its incarnation, number
    power: float
    us: tuple[int, int]
    dark: Why  # why it does not, though it is named


class OwnLamp(Revertible):
    """Of one robot, between steps; of one without a lamp it stays dark."""

    def __init__(self, fleet: Fleet, name: str, lighting: Lighting, swimmer: Swimmer | None) -> None:
        self.has, self._name, self._swimmer = fleet.robot[name].lamp, name, swimmer
        self.aim = aim_of(fleet, lighting)
        centre_us = round(fleet.body.servo_centre_us)
        self.lamp = LampControl((centre_us, centre_us))
        self._obeyed: Obeyed | None = None
        self._us: tuple[int, int] | None = None  # by the own lease
        self._woke = False
        self.ordered: OrderedLight | None = None  # by somebody; None: it burns as light is lent
        self._bound_ns = 0  # since when it obeys this lease
        self._comes = False  # it is to burn for it, as soon as its robot rests
        self.now = LampNow()

    @property
    def by_own_lease(self) -> bool:
        """It burns, or is dark, as the lease says that its robot holds."""
        return self._us is not None

    @property
    def dark(self) -> Why:
        """Why it does not burn for the lease that it obeys."""
        return "" if self._obeyed is None else self._obeyed.dark

    def tick(self, party: Party, attitude: AttitudeLog, now_ns: int) -> None:
        """Some time has passed."""
        if not self._woke:
            self._woke, self.lamp = True, self.lamp._replace(steady_ns=now_ns + AWAKE_NS)
        self.lamp = warmed(self.lamp, now_ns)
        self._show(party, attitude, now_ns)

    def burn(
        self,
        party: Party,
        seek: Seek,
        believed_m: Vector | None,
        keeps: bool,
        attitude: AttitudeLog,
        now_ns: int,
    ) -> None:
        """As it shall from now on. keeps: a sweep of its robot's is under way, and light must not change.

        It goes dark at once, whatever is under way, where the control module is silent, disarmed or surfacing, the
        battery is empty or the lamp too warm.
        """
        telemetry = attitude.newest
        level = None if telemetry is None else attitude.at(telemetry.t_ns)
        power, us = self.lamp.power, self.lamp.us
        if level is None or cannot(self.has, self.lamp, telemetry, attitude.silent(now_ns, 0)):
            power = 0.0
        elif self.ordered is not None:
            power, us = self._as_ordered(party, self.ordered)
        elif not keeps:
            power, us = self._wanted(party, seek, believed_m, level, now_ns)
        self.lamp = command(self.lamp, power, us, now_ns)
        self._show(party, attitude, now_ns)

    def _wanted(
        self,
        party: Party,
        seek: Seek,
        believed_m: Vector | None,
        level: Attitude,
        now_ns: int,
    ) -> tuple[float, tuple[int, int]]:
        """Power and pulses."""
        if party.bound is None:
            self._obeyed = None
        else:
            self._us = None
            return self._obedient(self._obey(party.bound, seek, level, now_ns), now_ns)
        if party.mine is not None and party.mine.granted:
            if self._us is None:
                at_m = party.mine.lease.at_m or looked_at(seek, level, believed_m)
                self._us = self.aim.at(at_m, seek.pose, level)[0]
            return (1.0 if self._name in lit_by(party) else 0.0), self._us
        self._us = None
        us, _ = self.aim.at(looked_at(seek, level, believed_m), seek.pose, level)
        near = max(abs(to - at) for to, at in zip(us, self.lamp.us, strict=True)) <= NEAR_US
        return 1.0, self.lamp.us if near and self.lamp.power else us

    def _as_ordered(self, party: Party, lit: OrderedLight) -> tuple[float, tuple[int, int]]:
        """It does not change for anybody's lease; whoever has one is told, and own sweeps are made as it burns."""
        us = self.aim.us(lit.pan_deg), self.aim.us(lit.tilt_deg)
        self._us = us if party.mine is not None and party.mine.granted else None
        self._obeyed = None
        if (bound := party.bound) is not None:
            self._obeyed = Obeyed((bound.holder, bound.incarnation, bound.lease.number), lit.light, us, "busy")
        return lit.light, us

    def _obedient(self, obeyed: Obeyed, now_ns: int) -> tuple[float, tuple[int, int]]:
        """Power and pulses by a neighbour's lease. A lamp that moves lights nobody: it comes to rest first, or stays
        dark; one that burns already goes dark if it is carried away."""
        speed_m_s = self._speed_m_s(now_ns)
        begins = bool(obeyed.power) and not self.lamp.power and speed_m_s > STILL_M_S
        self._comes = begins and now_ns - self._bound_ns < BRAKES_NS
        if begins and not self._comes:
            obeyed = obeyed._replace(power=0.0, dark="moves")
        self._obeyed = obeyed
        return (0.0, self.lamp.us) if begins or speed_m_s > 2.0 * STILL_M_S else (obeyed.power, obeyed.us)

    def _obey(self, bound: Bound, seek: Seek, level: Attitude, now_ns: int) -> Obeyed:
        """By a neighbour's lease: decided once."""
        lease = bound.holder, bound.incarnation, bound.lease.number
        if self._obeyed is not None and self._obeyed.lease == lease:
            return self._obeyed
        self._bound_ns = now_ns
        power, us, dark = dict(bound.lease.lamps).get(self._name, 0.0), self.lamp.us, self.now.cannot
        if power and not dark and bound.lease.at_m is not None:
            us, there = self.aim.at(bound.lease.at_m, seek.pose, level)
            dark = "" if there else "limit"
        return Obeyed(lease, 0.0, self.lamp.us, dark) if dark else Obeyed(lease, power, us, dark)

    def _show(self, party: Party, attitude: AttitudeLog, now_ns: int) -> None:
        """As it is told."""
        lamp, telemetry = self.lamp, attitude.newest
        used = load(lamp, telemetry)
        why = cannot(self.has, lamp, telemetry, attitude.silent(now_ns, 0))
        if not why and used >= LENDS_BELOW:
            why = "heat" if lamp.warm >= LENDS_BELOW else "battery"
        if not why and self._speed_m_s(now_ns) > STILL_M_S and not self._may_stop:
            why = "moves"
        if not why and self.ordered is not None:
            why = "busy"
        pan, tilt = self.aim.deg(lamp.us)
        whose = None if party.bound is None else party.bound.holder
        steady = lamp.steady(now_ns) and not (self._comes and whose is not None)
        self.now = LampNow(lamp.power, pan, tilt, lamp.changes, steady, used, why, whose)

    @property
    def _may_stop(self) -> bool:
        """It swims as it is told to, and holds still for who asks for its light."""
        return self._swimmer is not None and self._swimmer.under_way

    def _speed_m_s(self, now_ns: int) -> float:
        here = None if self._swimmer is None else self._swimmer.localizer.at(now_ns)
        return 0.0 if here is None else max(abs(here.x[3]), abs(here.x[4]))


# --- telemetry ---
# A robot's lamp and whose light it is, for whoever looks.


def lamp_state(party: Party, own: LampNow, spoiled: int) -> LampState:
    """spoiled: own sweeps so far in which a lamp changed."""
    holder: str | None = None
    lease, lamps = 0, tuple[str, ...]()
    if party.bound is not None:
        holder, lease = party.bound.holder, party.bound.lease.number
        lamps = tuple(name for name, power in party.bound.lease.lamps if power > 0.0)
    elif party.mine is not None:
        holder, lease, lamps = party.me, party.mine.lease.number, lit_by(party)
    return LampState(
        power=own.power,
        pan_deg=own.pan_deg,
        tilt_deg=own.tilt_deg,
        phase=party.phase,
        holder=holder,
        lease=lease,
        lamps=lamps,
        load=own.load,
        spoiled=spoiled,
    )


# --- the robot's turn ---
# A robot's turns at the light, whatever it wants it for: when it may ask, how long it may look, what became of it.

LOOK_NS = 3_500_000_000  # from the grant to the sweep: lamps and gimbal come to rest, the target comes into the middle
MARGIN_NS = 2_000_000_000  # of a lease, beyond that and the sweep: until all have said that nothing changed
AGAIN_NS, LONGEST_AGAIN_NS = 400_000_000, 6_400_000_000  # after light that gave nothing, the next time twice as long
RETRY_NS = 200_000_000  # after a lease that was not given, and after one that was


class Turn(Revertible):
    """Of one robot of a fleet with [lighting], between steps."""

    def __init__(self, talk: Talk, own: OwnLamp) -> None:
        self.talk, self.own = talk, own
        self.granted_ns = self._served_ns = self._retry_ns = 0
        self.swept = False  # a sweep began by the lease
        self.judging = False  # one has ended whose light is not known to have stayed
        self.spoiled = 0  # sweeps so far whose light did not
        self._fruitless = 0  # leases in a row without one
        self.assumed, self.burned = tuple[str, ...](), tuple[str, ...]()  # whose lamps a sweep took to, and that did

    @property
    def phase(self) -> Phase:
        return self.talk.party.phase

    def tick(self, now_ns: int) -> bool:
        """Leases end and are granted; returns whether the own one has lasted for too long without a sweep."""
        self._served_ns = self._served_ns or now_ns
        before = self.phase
        self.talk.tick(now_ns)
        phase = self.phase
        if phase == "holds" != before:
            self.granted_ns, self.swept = now_ns, False
        elif phase == "free" and before == "asks":
            self._retry_ns = now_ns + RETRY_NS
        return phase == "holds" and not self.swept and now_ns - self.granted_ns > LOOK_NS

    def idle(self, now_ns: int) -> bool:
        """It may ask."""
        known = now_ns >= self._retry_ns and self.talk.acquainted(now_ns)
        return self.phase == "free" and known and not self.judging

    def rests(self, now_ns: int) -> bool:
        """All lamps that this robot knows of are at rest, its own by the own lease."""
        return self.own.by_own_lease and self.talk.rests(self.own.now, now_ns)

    def ask(self, lease: Lease, now_ns: int) -> None:
        self.talk.ask(lease, now_ns)

    def waited_ns(self, now_ns: int) -> int:
        return now_ns - self._served_ns

    def began(self, now_ns: int) -> None:
        """A sweep begins with this step."""
        self.talk.begin(self.own.now, now_ns)
        self.swept = True
        self.assumed, self.burned = lit_by(self.talk.party), self.talk.burned(self.own.now)

    def ended(self, now_ns: int) -> None:
        """Its last frame is in."""
        self.judging = True
        self.talk.end(now_ns)

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """What became of the sweep that ended: True, it counts; None: not known yet. The lease ends with it."""
        if (found := self.talk.verdict(self.own.now, now_ns)) is None:
            return None
        self.judging = False
        if isinstance(found, Spoiled):
            self.spoiled += 1
        else:
            self._fruitless = 0
        return found

    def over(self, now_ns: int) -> None:
        """The own lease is at its end."""
        if self.talk.party.mine is not None:
            self._served_ns = now_ns
            self._retry_ns = max(self._retry_ns, now_ns + RETRY_NS)  # others were waiting, and shall be heard first
        self.talk.release()
        self.swept = False

    def fail(self, now_ns: int) -> None:
        """The own lease showed nothing: the next one has more time to come, for others are waiting."""
        self._fruitless += 1
        self.over(now_ns)
        self._retry_ns = now_ns + min(AGAIN_NS << min(self._fruitless, 9), LONGEST_AGAIN_NS)
