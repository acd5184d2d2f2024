"""The states that a robot shows: one target after the other, so that each has the same rate, however many there are."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.capabilities.light.lights import Lights
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import AttitudeLog
from agent.core.control.target_search import Seek
from agent.core.messages import Mode, State
from agent.core.status import Status
from agent.core.step_transaction import Net, Revertible
from agent.core.target_state import TargetState
from agent.core.topics import next_due_ns
from agent.robot.inbox import Inbox

STATE_NS = 200_000_000  # 5 Hz to whoever looks


class Showing(Revertible):
    """Of one robot, between steps."""

    def __init__(
        self,
        targets: Mapping[str, TargetState],
        status: Status,
        inbox: Inbox,
        attitude: AttitudeLog,
        seek: Seek,
        swimmer: Swimmer | None,
        lights: Lights,
        net: Net,
    ) -> None:
        self._targets, self._status, self._inbox, self._attitude = tuple(targets.values()), status, inbox, attitude
        self._seek, self._swimmer, self._lights, self._net = seek, swimmer, lights, net
        self._period_ns = STATE_NS // len(targets)
        self._due_ns = self._shown = 0

    def state(self, signed: bool, ordered: tuple[str, ...] | UnsetType, now_ns: int) -> State | None:
        """What is known of the target whose turn it is; None: it is not time."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        target = self._targets[self._shown % len(self._targets)]
        self._shown += 1
        state = self._status.state(target, self._inbox.refused, self._attitude, self._seek.gimbal_deg(), now_ns)
        mode: Mode = "running" if self._net.fault(now_ns) is None else "degraded"
        where = UNSET if self._swimmer is None else self._swimmer.localizer.shown(now_ns)
        does = UNSET if self._swimmer is None else self._swimmer.does
        lamp = self._lights.shown()
        target.last_state = replace(
            state, mode=mode, signed=signed, whereabouts=where, behaviour=does, lamp=lamp, ordered=ordered
        )
        return target.last_state

    def last(self, target: TargetState, now_ns: int) -> State | None:
        """What can be shown while no step succeeds: the newest state there was, and that it is no longer true."""
        if now_ns < self._due_ns or target.last_state is None:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        last, why = target.last_state, self._net.fault(now_ns) or ""
        target.last_state = replace(last, seq=last.seq + 1, sent_ns=now_ns, mode="degraded", faults=(why,))
        return target.last_state
