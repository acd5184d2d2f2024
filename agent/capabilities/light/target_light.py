"""When a robot asks for light: for a sweep of a target, for a look at the next place of a search, and for a view of a
survey. And a ball that is lit from aside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from agent.capabilities.light.allocate import Choice, FrameScene
from agent.capabilities.light.lease import Spoiled, lit_by
from agent.capabilities.light.light_request import SHOWS, LightSearch, Wishes
from agent.capabilities.light.own_lamp import LOOK_NS, MARGIN_NS, Turn
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude
from agent.core.config import Cues, Target
from agent.core.control.sweep import ByLight
from agent.core.control.target_search import Seek
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, at_lens_position, ray, to_camera
from agent.core.ranging.fix import Outline, focus_range
from agent.core.status import Logbook
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState


class TargetLight(Revertible):
    """Of one robot, between steps."""

    def __init__(self, turn: Turn, wishes: Wishes, search: LightSearch, swimmer: Swimmer | None, log: Logbook) -> None:
        self._turn, self._wishes, self._search, self._swimmer, self._log = turn, wishes, search, swimmer, log
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
        if target.believed_m is not None or seek.roam is not None:
            return None
        return self._search.follows(self._turn.talk.party, seek, target.name, level, now_ns)

    def sharp_at(self, seek: Seek, target: TargetState, at_m: Vector | None, level: Attitude | None) -> float | None:
        """Lens position at which the target would be sharp there; None: nobody knows."""
        return self._wishes.sharp_at(seek, target.ball, at_m, level)

    def _in_vain(self, seek: Seek, target: TargetState, now_ns: int) -> bool:
        """The place that it has had lit shows nothing."""
        if self._search.at_m is None or self._turn.swept or seek.sees(target.name, now_ns):
            return False
        return target.believed_m is not None or self._search.shown(seek, self._turn.granted_ns, now_ns)

    def _ask(self, seek: Seek, target: TargetState, level: Attitude, now_ns: int) -> None:
        """For the light of a sweep, or of a look at the next place of a search."""
        search, believed_m = self._search, target.believed_m
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


# --- light for a view ---
# Light for a survey's keyframes: whose lamps burn while the focus is swept over a whole view, and which count.
#
# As for a target's sweep there is none without a lease, and none counts whose lamps are not known to have stayed as
# they were. By day every view may be swept at once, and counts.


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


# --- a ball lit from aside ---
# A ball that is lit from aside: which of its cues hold, and where its middle is when only its lit part was outlined.
#
# The edge towards the lamp is the ball's own, the one opposite is where its shadow begins. With the radius r of the
# outline, the radius R that the ball must have in the picture at the range of its focus, and u the way to the lamp:
#
# middle = outline's middle - (R - r) u
#
# Its size says nothing of its range then, so that the focus alone counts.

LEAST_PX = 3.0  # of R - r: twice what the range by focus leaves open of R at 1.5 m
MOST = 0.4  # of R: an outline that lacks more is of something else
ONE_SIDE = 0.5  # cosine between ways to lamps, above which they light the same side

# By pictures of nights with seeds 3, 11 and 15, 1.3 m from the ball: peaks scatter by so much more than their curves
# and the size of the outline say, for part of it is dark, and the rest dim; and its middle wanders by so many pixels.
SCATTERS = 1.75
WANDERS_PX = 2.0


def cues_by(cues: Cues) -> Cues:
    """What of the wanted cues a lamp from aside leaves."""
    return "focus" if cues == "both" else cues


def whole(
    calibration: Calibration,
    eye: Eye,
    outline: Outline,
    rho: float,
    sigma: float,
    ball: Target,
    lamps_m: Sequence[Vector],
) -> Outline:
    """The outline of the ball, where that was one of its lit part. lamps_m: places of the lamps that burned."""
    ways = []
    camera = at_lens_position(calibration.camera, outline.lens_position)
    if ball.radius_m is None or outline.radius_px is None or not lamps_m:
        return outline
    far = focus_range(calibration.focus, camera, outline.centre_px, rho, sigma, ball)
    if far is None or far.distance_m <= ball.radius_m:
        return outline
    whole_px = camera.f_px * math.asin(ball.radius_m / far.distance_m)
    lacks_px = whole_px - outline.radius_px
    if not LEAST_PX <= lacks_px <= MOST * whole_px:
        return outline
    at = tuple(far.distance_m * part for part in ray(camera, outline.centre_px))
    for place_m in lamps_m:
        x, y, _ = (lamp - ball_at for lamp, ball_at in zip(to_camera(eye, place_m), at, strict=True))
        length = math.hypot(x, y)
        if length > 0.0:
            ways.append((x / length, y / length))
    x, y = sum(way[0] for way in ways), sum(way[1] for way in ways)
    length = math.hypot(x, y)
    if not ways or length < 1e-6 or any(way[0] * x + way[1] * y < ONE_SIDE * length for way in ways):
        return outline  # from both sides: there is no telling which edge is whose
    u, v = outline.centre_px
    centre_px = u - lacks_px * x / length, v - lacks_px * y / length
    return outline._replace(centre_px=centre_px, radius_px=whole_px)
