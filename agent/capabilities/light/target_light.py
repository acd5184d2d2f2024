"""Light for a target: when a robot asks for it, for a sweep or for a look at the next place of a search."""

from __future__ import annotations

from agent.capabilities.light.allocate import Choice
from agent.capabilities.light.lease import lit_by
from agent.capabilities.light.search import SHOWS, LightSearch
from agent.capabilities.light.turn import LOOK_NS, MARGIN_NS, Turn
from agent.capabilities.light.wish import Wishes
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude
from agent.core.config import Fleet
from agent.core.control.sweep import ByLight
from agent.core.control.target_search import Seek
from agent.core.estimation.protocols import pursued
from agent.core.messages import Vector
from agent.core.status import Logbook
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState


class TargetLight(Revertible):
    """Of one robot, between steps."""

    def __init__(
        self, fleet: Fleet, turn: Turn, wishes: Wishes, search: LightSearch, swimmer: Swimmer | None, log: Logbook
    ) -> None:
        self._turn, self._wishes, self._search, self._swimmer, self._log = turn, wishes, search, swimmer, log
        self._swims = pursued(fleet)  # by frames: nobody sweeps these
        self.own_shows = True  # the own lamp, the target, as far as it is known where that is

    def lets(self, seek: Seek, target: TargetState, level: Attitude | None, now_ns: int) -> bool:
        """Whether a sweep that is wanted may begin now, by light that is at rest; if not, light is asked for."""
        turn = self._turn
        if turn.phase == "holds":
            if self._in_vain(seek, target, now_ns):
                self.end(now_ns)
                return False
            lent = any(name != self._wishes.name for name in lit_by(turn.talk.party))
            seek.by_light = ByLight(self.sharp_at(seek, target, target.believed_m, level), lent)
            return not turn.judging and turn.rests(now_ns)
        if turn.idle(now_ns) and level is not None and seek.ready(target.name, now_ns):
            self._ask(seek, target, level, now_ns)
        return False

    def pursues(self, seek: Seek, target: TargetState, level: Attitude | None, now_ns: int) -> None:
        """The camera goes with a target that swims, or round in search of it: for that it has places lit as well. By
        frames it is known to all at once where it is, and the light is of no more use."""
        hunts = self._hunts(seek, target)
        if self._turn.phase == "holds":
            if not hunts or self._search.shown(seek, self._turn.granted_ns, now_ns):
                self.end(now_ns)
        elif hunts and level is not None and self._turn.idle(now_ns):
            self._ask(seek, target, level, now_ns)

    def end(self, now_ns: int, fruitless: bool = False) -> None:
        """The own lease is at its end. fruitless: it showed nothing, and others have more time before the next one."""
        if self._search.at_m is not None and not self._turn.swept:
            self._search.advance()
        if fruitless:
            self._turn.fail(now_ns)
        else:
            self._turn.over(now_ns)

    def lit_m(self, seek: Seek, target: TargetState, level: Attitude | None, now_ns: int) -> Vector | None:
        """The place that is lit for whoever knows no more of the target, world frame."""
        if target.believed_m is not None and not self._hunts(seek, target):
            return None
        return self._search.follows(self._turn.talk.party, seek, target.name, level, now_ns)

    def sharp_at(self, seek: Seek, target: TargetState, at_m: Vector | None, level: Attitude | None) -> float | None:
        """Lens position at which the target would be sharp there; None: nobody knows."""
        return self._wishes.sharp_at(seek, target.ball, at_m, level)

    def _hunts(self, seek: Seek, target: TargetState) -> bool:
        """It looks for that one, which swims: where that was once says nothing."""
        return target.name in self._swims and seek.roam is not None and seek.roam.target == target.name

    def _in_vain(self, seek: Seek, target: TargetState, now_ns: int) -> bool:
        """The place that it has had lit shows nothing."""
        if self._search.at_m is None or self._turn.swept or seek.sees(target.name, now_ns):
            return False
        return target.believed_m is not None or self._search.shown(seek, self._turn.granted_ns, now_ns)

    def _ask(self, seek: Seek, target: TargetState, level: Attitude, now_ns: int) -> None:
        """For the light of a sweep, or of a look at the next place of a search."""
        search, believed_m = self._search, None if self._hunts(seek, target) else target.believed_m
        at_m = believed_m or seek.glimpsed_m(target.name, level, None, now_ns)
        searches = at_m is None and not seek.sees(target.name, now_ns)
        if not self._wishes.may_ask(now_ns):
            return
        if searches:
            if (self._swimmer is not None and not self._swimmer.under_way) or not search.look(seek, now_ns):
                return
            at_m = search.place(seek, level)
        choice = None if at_m is None else self._wishes.choice(seek, target.ball, at_m, level)
        if searches and not search.worth(choice, target.ball):
            search.advance()
            return
        search.at_m = at_m if believed_m is None else None
        self.own_shows = believed_m is None or choice is None or choice.own_contrast >= SHOWS
        if choice is not None:
            self._tell(target.name, choice, searches, now_ns)
        holds_ns = LOOK_NS + seek.most_ns() + MARGIN_NS
        lamps = None if choice is None else choice.lamps
        self._turn.ask(self._wishes.lease(at_m, lamps, self._turn.waited_ns(now_ns), holds_ns), now_ns)

    def _tell(self, target: str, choice: Choice, searches: bool, now_ns: int) -> None:
        """Whose light it asks for, in the log; alone it is no news."""
        if choice.lamps == (self._wishes.name,):
            return
        whose = " and ".join(choice.lamps)
        text = f"asks for light of {whose} on '{target}': {choice.sigma_mm:.1f} mm expected"
        if searches:
            text = f"searches for '{target}' by the light of {whose}"
        self._log.note_seldom("info", f"light {target}", text, now_ns)
