"""A robot's lamp and whose light it is, for whoever looks."""

from __future__ import annotations

from agent.capabilities.light.lease import Party, lit_by
from agent.core.capability_messages import LampNow
from agent.core.messages import LampState


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
