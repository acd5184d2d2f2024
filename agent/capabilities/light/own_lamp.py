"""A robot's own lamp in its step: how it burns, by whose light, what telemetry says of it, and the robot's turns at the
light.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

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
from agent.capabilities.light.lease import Bound, Party, Phase, Talk, lit_by
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability import LampAct, OwnView, Situation, Spoiled, eye_of
from agent.core.capability_messages import LampNow, Lease, Why
from agent.core.config import Fleet, Lighting
from agent.core.messages import LampState
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

    def __init__(self, fleet: Fleet, name: str, lighting: Lighting, attitude: AttitudeLog) -> None:
        self.has, self._fleet, self._name, self._attitude = fleet.robot[name].lamp, fleet, name, attitude
        self.aim = aim_of(fleet, lighting)
        centre_us = round(fleet.body.servo_centre_us)
        self.lamp = LampControl((centre_us, centre_us))
        self._obeyed: Obeyed | None = None
        self._us: tuple[int, int] | None = None  # by the own lease
        self._woke = False
        self._ordered: OrderedLight | None = None  # by an operator; None: it burns as light is lent
        self._bound_ns = 0  # since when it obeys this lease
        self._comes = False  # it is to burn for it, as soon as its robot rests
        self._cannot: Why = ""  # burn at all
        self.now = LampNow()

    @property
    def burns(self) -> bool:
        """It can light what its own robot looks at; else that needs others' light, as one does that has no lamp."""
        dark = self._ordered is not None and not self._ordered.light
        return self.has and not dark and self._cannot not in ("battery", "heat")

    @property
    def by_own_lease(self) -> bool:
        """It burns, or is dark, as the lease says that its robot holds."""
        return self._us is not None

    @property
    def dark(self) -> Why:
        """Why it does not burn for the lease that it obeys."""
        return "" if self._obeyed is None else self._obeyed.dark

    def order(self, lit: OrderedLight | None) -> None:
        """Burn so from now on, whatever is lent; None: as light is lent."""
        self._ordered = lit

    def tick(self, party: Party, own: OwnView | None, now_ns: int) -> None:
        """Some time has passed. own: of a robot that swims."""
        if not self._woke:
            self._woke, self.lamp = True, self.lamp._replace(steady_ns=now_ns + AWAKE_NS)
        self.lamp = warmed(self.lamp, now_ns)
        self._show(party, own, now_ns)

    # --- how it burns from now on, row by row of the table of priorities --------------------------------------------
    # It goes dark at once, whatever is under way, where the module is silent, disarmed or surfacing, the battery
    # is empty or the lamp too warm. at.level: by the newest telemetry, however old.

    def _burn(self, power: float, us: tuple[int, int], party: Party, at: Situation) -> LampAct:
        self.lamp = command(self.lamp, power, us, at.now_ns)
        self._show(party, at.own, at.now_ns)
        return LampAct(self.lamp.power, self.lamp.us)

    def safe(self, party: Party, at: Situation) -> LampAct | None:
        silent = self._attitude.silent(at.now_ns, 0)
        unsafe = at.level is None or cannot(self.has, self.lamp, self._attitude.newest, silent)
        return self._burn(0.0, self.lamp.us, party, at) if unsafe else None

    def by_operator(self, party: Party, at: Situation) -> LampAct | None:
        return None if self._ordered is None else self._burn(*self._as_ordered(party, self._ordered), party, at)

    def kept(self, party: Party, at: Situation) -> LampAct:
        return self._burn(self.lamp.power, self.lamp.us, party, at)

    def lent(self, party: Party, at: Situation) -> LampAct | None:
        """By a neighbour's lease."""
        if party.bound is None or at.level is None:
            return None
        self._us = None
        return self._burn(*self._obedient(self._obey(party.bound, at, at.level), at), party, at)

    def leased(self, party: Party, at: Situation) -> LampAct | None:
        """By the own lease."""
        self._obeyed = None
        if party.mine is None or not party.mine.granted or at.level is None:
            return None
        if self._us is None:
            eye = eye_of(self._fleet, at.camera, at.pose, at.level)
            at_m = party.mine.lease.at_m or looked_at(eye, at.target.believed_m)
            self._us = self.aim.at(at_m, at.pose, at.level)[0]
        return self._burn(1.0 if self._name in lit_by(party) else 0.0, self._us, party, at)

    def with_camera(self, party: Party, at: Situation) -> LampAct:
        """Beside its camera."""
        self._us = None
        level = at.level or Attitude(0.0, 0.0, 0.0)
        eye = eye_of(self._fleet, at.camera, at.pose, level)
        us, _ = self.aim.at(looked_at(eye, at.target.believed_m), at.pose, level)
        near = max(abs(to - now) for to, now in zip(us, self.lamp.us, strict=True)) <= NEAR_US
        return self._burn(1.0, self.lamp.us if near and self.lamp.power else us, party, at)

    def _as_ordered(self, party: Party, lit: OrderedLight) -> tuple[float, tuple[int, int]]:
        """It does not change for anybody's lease; its holder is told, and own sweeps are made as it burns."""
        us = self.aim.us(lit.pan_deg), self.aim.us(lit.tilt_deg)
        self._us = us if party.mine is not None and party.mine.granted else None
        self._obeyed = None
        if (bound := party.bound) is not None:
            self._obeyed = Obeyed((bound.holder, bound.incarnation, bound.lease.number), lit.light, us, "busy")
        return lit.light, us

    def _obedient(self, obeyed: Obeyed, at: Situation) -> tuple[float, tuple[int, int]]:
        """Power and pulses by a neighbour's lease. A lamp that moves lights nobody: it comes to rest first, or stays
        dark; one that burns already goes dark if it is carried away."""
        speed_m_s = speed(at.own)
        begins = bool(obeyed.power) and not self.lamp.power and speed_m_s > STILL_M_S
        self._comes = begins and at.now_ns - self._bound_ns < BRAKES_NS
        if begins and not self._comes:
            obeyed = obeyed._replace(power=0.0, dark="moves")
        self._obeyed = obeyed
        return (0.0, self.lamp.us) if begins or speed_m_s > 2.0 * STILL_M_S else (obeyed.power, obeyed.us)

    def _obey(self, bound: Bound, at: Situation, level: Attitude) -> Obeyed:
        """By a neighbour's lease: decided once."""
        lease = bound.holder, bound.incarnation, bound.lease.number
        if self._obeyed is not None and self._obeyed.lease == lease:
            return self._obeyed
        self._bound_ns = at.now_ns
        power, us, dark = dict(bound.lease.lamps).get(self._name, 0.0), self.lamp.us, self.now.cannot
        if power and not dark and bound.lease.at_m is not None:
            us, there = self.aim.at(bound.lease.at_m, at.pose, level)
            dark = "" if there else "limit"
        return Obeyed(lease, 0.0, self.lamp.us, dark) if dark else Obeyed(lease, power, us, dark)

    def _show(self, party: Party, own: OwnView | None, now_ns: int) -> None:
        """As it is told."""
        lamp, telemetry = self.lamp, self._attitude.newest
        used = load(lamp, telemetry)
        why = self._cannot = cannot(self.has, lamp, telemetry, self._attitude.silent(now_ns, 0))
        if not why and used >= LENDS_BELOW:
            why = "heat" if lamp.warm >= LENDS_BELOW else "battery"
        may_stop = own is not None and own.under_way  # it holds still for a robot that asks for its light
        if not why and speed(own) > STILL_M_S and not may_stop:
            why = "moves"
        if not why and self._ordered is not None:
            why = "busy"
        pan, tilt = self.aim.deg(lamp.us)
        whose = None if party.bound is None else party.bound.holder
        steady = lamp.steady(now_ns) and not (self._comes and whose is not None)
        self.now = LampNow(lamp.power, pan, tilt, lamp.changes, steady, used, why, whose)


def speed(own: OwnView | None) -> float:
    """Of a robot that swims, along the faster axis, m/s."""
    if own is None or own.own is None:
        return 0.0
    return max(abs(own.own.velocity[0]), abs(own.own.velocity[1]))


# --- telemetry ---
# A robot's lamp and whose light it is, for people who look.


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
SHARE_NS = 1_000_000_000  # where it had more than its share of the last minute
RETRY_NS = 200_000_000  # after a lease that was not given, and after one that was


# What becomes of the light of one sweep, beside the lease (lease.py), which may end under it.
Exposure = Literal["none", "sweeping", "judged"]
ExposureEvent = Literal["granted", "began", "ended", "over"]


def exposed(phase: Exposure, event: ExposureEvent) -> Exposure:
    """A lease was granted, a sweep began, its last frame is in, and what came of it is known."""
    match event:
        case "began":
            return "judged" if phase == "judged" else "sweeping"
        case "ended":
            return "judged"
    return "none"


class Turn(Revertible):
    """Of one robot of a fleet with [lighting], between steps."""

    def __init__(self, talk: Talk, own: OwnLamp) -> None:
        self.talk, self.own = talk, own
        self.granted_ns = self._served_ns = self._retry_ns = 0
        self.exposure: Exposure = "none"
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
            self.granted_ns, self.exposure = now_ns, exposed(self.exposure, "granted")
        elif phase == "free" and before == "asks":
            self._retry_ns = now_ns + RETRY_NS
        return phase == "holds" and self.exposure == "none" and now_ns - self.granted_ns > LOOK_NS

    def idle(self, now_ns: int) -> bool:
        """It may ask."""
        known = now_ns >= self._retry_ns and self.talk.acquainted(now_ns)
        return self.phase == "free" and known and self.exposure != "judged"

    def rests(self, now_ns: int) -> bool:
        """All lamps that this robot knows of are at rest, its own by the own lease."""
        return self.own.by_own_lease and self.talk.rests(self.own.now, now_ns)

    def ask(self, lease: Lease, now_ns: int) -> None:
        if self.talk.may_have(lease, now_ns):
            self.talk.ask(lease, now_ns)
        else:
            self._retry_ns = now_ns + SHARE_NS

    def waited_ns(self, now_ns: int) -> int:
        return now_ns - self._served_ns

    def began(self, now_ns: int) -> None:
        """A sweep begins with this step."""
        self.talk.begin(self.own.now, now_ns)
        self.exposure = exposed(self.exposure, "began")
        self.assumed, self.burned = lit_by(self.talk.party), self.talk.burned(self.own.now)

    def ended(self, now_ns: int) -> None:
        """Its last frame is in."""
        self.exposure = exposed(self.exposure, "ended")
        self.talk.end(now_ns)

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """What became of the sweep that ended: True, it counts; None: not known yet. The lease ends with it."""
        if (found := self.talk.verdict(self.own.now, now_ns)) is None:
            return None
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
        self.talk.release(now_ns)
        self.exposure = exposed(self.exposure, "over")

    def fail(self, now_ns: int) -> None:
        """The own lease showed nothing: the next one has more time to come, for others are waiting."""
        self._fruitless += 1
        self.over(now_ns)
        self._retry_ns = now_ns + min(AGAIN_NS << min(self._fruitless, 9), LONGEST_AGAIN_NS)
