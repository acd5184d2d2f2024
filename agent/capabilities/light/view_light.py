"""Light for a survey's keyframes: whose lamps burn while the focus is swept over a whole view, and which count.

As for a target's sweep there is none without a lease, and none counts whose lamps are not known to have stayed as they
were. By day every view may be swept at once, and counts.
"""

from __future__ import annotations

from typing import Protocol

from agent.capabilities.light.frames import FrameScene
from agent.capabilities.light.proof import Spoiled
from agent.capabilities.light.turn import LOOK_NS, MARGIN_NS, Turn
from agent.capabilities.light.wish import Wishes
from agent.core.attitude import Attitude
from agent.core.control.target_search import Seek
from agent.core.status import Logbook
from agent.core.step_transaction import Revertible


class View(Protocol):
    """What a survey says of the view that it is about to sweep."""

    def frame_scene(self) -> FrameScene: ...

    @property
    def most_ns(self) -> int:
        """How long the sweep can take."""


class ViewLight(Revertible):
    """Of one robot, between steps; of a fleet without [lighting]: by day."""

    def lets(self, view: View, seek: Seek, level: Attitude, now_ns: int) -> bool:
        """Whether a view may be swept now, by light that is at rest; if not, light is asked for. Of a robot at rest,
        whose camera rests at the view."""
        return True

    def began(self, now_ns: int) -> None:
        """The sweep begins with this step."""

    def ended(self, now_ns: int) -> None:
        """Its last frame is in."""

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """What became of the sweep that ended: True, it counts; None: not known yet."""
        return True

    def missed(self, now_ns: int) -> None:
        """The sweep did not end in time."""

    def lamps(self) -> tuple[str, ...]:
        """That burned in the newest sweep."""
        return ()


class LentViewLight(ViewLight):
    """In a fleet that lights for each other."""

    def __init__(self, turn: Turn, wishes: Wishes, log: Logbook) -> None:
        self._turn, self._wishes, self._log = turn, wishes, log
        self._number: int | None = None  # of the lease that is a view's

    def lets(self, view: View, seek: Seek, level: Attitude, now_ns: int) -> bool:
        turn = self._turn
        if turn.phase == "holds":
            return turn.talk.party.number == self._number and not turn.judging and turn.rests(now_ns)
        if not turn.idle(now_ns) or not self._wishes.may_ask(now_ns):
            return False
        scene = view.frame_scene()
        choice = self._wishes.frame_choice(seek, scene, level)
        if choice is not None and set(choice.lamps) != {self._wishes.name}:
            whose = " and ".join(choice.lamps)
            more = f"{choice.blocks:.0f} new blocks expected, {choice.own_blocks:.0f} by its own"
            self._log.note_seldom("info", "light views", f"asks for light of {whose} on a view: {more}", now_ns)
        lamps = None if choice is None else choice.lamps
        holds_ns = LOOK_NS + view.most_ns + MARGIN_NS
        turn.ask(self._wishes.lease(scene.aim_m, lamps, turn.waited_ns(now_ns), holds_ns), now_ns)
        self._number = turn.talk.party.number
        return False

    def began(self, now_ns: int) -> None:
        self._turn.began(now_ns)

    def ended(self, now_ns: int) -> None:
        self._turn.ended(now_ns)

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """The lease ends with it."""
        if (found := self._turn.verdict(now_ns)) is not None:
            self._turn.over(now_ns)
        return found

    def missed(self, now_ns: int) -> None:
        if self._turn.swept:
            self._turn.fail(now_ns)

    def lamps(self) -> tuple[str, ...]:
        return self._turn.burned
