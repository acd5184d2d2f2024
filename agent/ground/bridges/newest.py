"""What each robot said last, and whether that is recent enough to be passed on as what is so now."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.messages import State

STALE_NS = 3_000_000_000  # robots refuse orders by an older State, too
DRIFT = 1e-4  # s in a second: how fast two computers' clocks may go apart


class _Heard(NamedTuple):
    state: State
    arrived_ns: int  # by the fleet's clock as it is here
    wall_ns: int  # by this machine's
    least_ns: int  # least delay so far, which stands for none: clocks of robots and of this computer may differ


class Newest:
    """The newest State of each robot, whichever target it is about."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}

    def take(self, state: State, arrived_ns: int, wall_ns: int) -> None:
        """`arrived_ns`: by the clock of the fleet; `wall_ns`: by that of this machine, which goes on where the fleet's
        stands."""
        least_ns = arrived_ns - state.sent_ns
        before = self._heard.get(state.robot)
        if before is not None and before.state.incarnation == state.incarnation:
            drifted_ns = before.least_ns + round(DRIFT * (arrived_ns - before.arrived_ns))
            least_ns = min(least_ns, drifted_ns)
        self._heard[state.robot] = _Heard(state, arrived_ns, wall_ns, least_ns)

    def fresh(self, robot: str, now_ns: int, wall_ns: int) -> State | None:
        """What it said last; None where that is older than three seconds by either clock, as in the burst that a link
        delivers after an outage."""
        heard = self._heard.get(robot)
        if heard is None:
            return None
        age_ns = now_ns - heard.state.sent_ns - heard.least_ns
        return heard.state if max(age_ns, wall_ns - heard.wall_ns) <= STALE_NS else None
