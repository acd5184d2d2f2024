"""Light as part of a robot's step: when it asks for a sweep, and which sweeps count.

Of a fleet without [lighting] it does nothing. Else there is no sweep without a lease: the robot asks as soon as it
knows where to look, looks and sweeps by the light that it got, and gives it back when all neighbours have said that
nothing changed meanwhile. While nobody has a lease each lamp goes with its own camera.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.kernel.codec import Refusal, decode
from agent.kernel.config import Cues, Fleet, Target
from agent.kernel.control.attitude import Attitude, AttitudeLog
from agent.kernel.control.seek import Seek
from agent.kernel.control.sweep import ByLight, Measurement, Rejected
from agent.kernel.estimation.choice import pursued
from agent.kernel.lamps.aim import others
from agent.kernel.lamps.aside import cues_by, whole
from agent.kernel.lamps.follow_light import FollowLight
from agent.kernel.lamps.onlookers import lamp_state
from agent.kernel.lamps.own_lamp import OwnLamp
from agent.kernel.lamps.search import SHOWS, LightSearch, SwimSearch
from agent.kernel.lamps.talk import Talk
from agent.kernel.lamps.turn import LOOK_NS, MARGIN_NS, Turn
from agent.kernel.lamps.view_light import ViewLight
from agent.kernel.lamps.wish import Wishes
from agent.kernel.lighting.allocate import Choice
from agent.kernel.lighting.lease import lit_by
from agent.kernel.lighting.proof import Spoiled
from agent.kernel.lighting.words import Light
from agent.kernel.logbook import Logbook
from agent.kernel.messages import LampState, Vector
from agent.kernel.navigation.swimmer import Swimmer
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.ranging.camera_model import Eye
from agent.kernel.ranging.cues import Outline
from agent.kernel.step_io import Heard, SweepOutcome
from agent.kernel.target_state import TargetState
from agent.kernel.topics import LIGHT

LENS_STEP = 0.25  # of the peak's half width: a blur by less is not worth moving the lens


class Lights:
    """Of one robot, between steps."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int, swimmer: Swimmer | None, log: Logbook
    ) -> None:
        self._fleet, self._name, self._calibration, self._swimmer, self._log = fleet, name, calibration, swimmer, log
        lighting = fleet.lighting
        self._talk = None if lighting is None else Talk(fleet, name, incarnation)
        self.own = None if lighting is None else OwnLamp(fleet, name, lighting, swimmer)
        self._turn = None if self._talk is None or self.own is None else Turn(self._talk, self.own)
        self._wishes: Wishes | None = None
        self._search: LightSearch | None = None
        self._follow: FollowLight | None = None
        if lighting is not None and self.own is not None and self._talk is not None:
            self._wishes = Wishes(fleet, name, calibration, swimmer, lighting, self.own, self._talk)
            self._search = LightSearch(fleet, name) if swimmer is None else SwimSearch(fleet, name)
            if swimmer is not None and lighting.follow:
                self._follow = FollowLight(fleet, name, calibration, swimmer, lighting, self.own.aim)
        self.views = ViewLight(self._turn, self._wishes, log)
        self._pursued = pursued(fleet)  # by frames: a look at rest is of no use
        self._own_shows = True  # the target, as far as it is known where that is
        self._pending: Measurement | None = None  # a sweep whose light is not known to have stayed
        self._lamps_m: tuple[Vector, ...] = ()  # where those are that it was made by
        self._lens: int | None = None  # where it rests between sweeps, as told
        self._wanted_lens: float | None = None

    def hear(self, item: Heard, accepted: frozenset[int]) -> None:
        """A payload on a key of ours. Raises Refusal where it is not believed."""
        if self._talk is None:
            raise Refusal("fleet file", "it lights, and our file has no [lighting]; give all robots the same file")
        said = decode(item.payload, Light, LIGHT.limit, accepted)
        self._talk.hear(item.src, said, item.arrived_ns)

    # --- sweeps -----------------------------------------------------------------------------------------------

    @property
    def claims(self) -> bool:
        """Light is asked for or held, for the target that the camera is at."""
        return self._talk is not None and self._talk.party.mine is not None

    @property
    def obeys(self) -> bool:
        """A neighbour has the light."""
        return self._talk is not None and self._talk.party.phase == "obeys"

    @property
    def judging(self) -> bool:
        """A sweep has ended whose light is not known to have stayed as it was."""
        return self._turn is not None and self._turn.judging

    def judged(self, result: Measurement | Rejected | None, seek: Seek, now_ns: int) -> Measurement | Rejected | None:
        """What became of sweeps: one that ended now waits until all lamps are known not to have changed in it."""
        if self._turn is None:
            return result
        if isinstance(result, Measurement):
            self._pending = result
            self._turn.ended(now_ns)
        elif result is not None:
            self._fail(now_ns)
            return result
        if (pending := self._pending) is None:
            return None
        if (found := self._turn.verdict(now_ns)) is None:
            return None
        self._pending = None
        self._over(now_ns)
        if not isinstance(found, Spoiled):
            return pending
        seek.take_back()
        return Rejected(pending.sweep, f"spoiled: {found.reason}", held_width=pending.held_width)

    def seen(self, peak: Measurement, eye: Eye, ball: Target, cues: Cues) -> tuple[Outline, Cues]:
        """The outline of a ball and the cues to its range, as the light leaves them in which it was swept."""
        if self._turn is None or set(self._turn.burned) <= {self._name}:
            return peak.outline, cues
        outline = whole(self._calibration, eye, peak.outline, peak.lens_position, peak.sigma, ball, self._lamps_m)
        return outline, cues_by(cues)

    def lens(self, told: int | UnsetType | None) -> int | UnsetType | None:
        """Where the lens shall be between sweeps: where the target is believed to be sharp, which out of focus does not
        show in the dark. told: by whoever else moves it; of robots that swim landmarks have it."""
        return told if self._talk is None or self._swimmer is not None or told is not UNSET else self._rest()

    def marked(self, outcome: SweepOutcome | UnsetType) -> SweepOutcome | UnsetType:
        """What came of a sweep, with the lamps that it was made by."""
        if self._turn is None or outcome is UNSET:
            return outcome
        return replace(outcome, lamps=self._turn.assumed, lit=self._turn.burned)

    # --- the step ---------------------------------------------------------------------------------------------

    def tick(self, attitude: AttitudeLog, now_ns: int) -> None:
        """Leases end and are granted."""
        if (turn := self._turn) is None:
            return
        if turn.tick(now_ns):
            self._fail(now_ns)
        elif turn.phase == "holds" and not turn.swept and self._swimmer is not None and self._swimmer.glances:
            self._over(now_ns)  # its camera is at landmarks: the light is others' meanwhile
        turn.own.tick(turn.talk.party, attitude, now_ns)

    def may_sweep(self, seek: Seek, target: TargetState, level: Attitude | None, wanted: bool, now_ns: int) -> bool:
        """Whether a sweep may begin now, by light that is at rest; if not, light is asked for where one is wanted."""
        if (turn := self._turn) is None or not wanted:
            return wanted
        if turn.phase == "holds":
            if self._in_vain(seek, target, now_ns):
                self._over(now_ns)
                return False
            lent = any(name != self._name for name in lit_by(turn.talk.party))
            seek.by_light = ByLight(self._sharp_at(seek, target, target.believed_m, level), lent)
            return not turn.judging and turn.rests(now_ns)
        if turn.idle(now_ns) and level is not None and seek.ready(target.name, now_ns):
            self._ask(seek, target, level, now_ns)
        return False

    def began(self, now_ns: int) -> None:
        """A sweep of the target begins with this step."""
        if (turn := self._turn) is None:
            return
        turn.began(now_ns)
        there = others(self._fleet, self._name, self._swimmer)
        self._lamps_m = tuple(turn.own.aim.place_m(*there[name]) for name in turn.burned if name in there)
        if self._name in turn.burned:  # from beside the camera: nothing of the disc is dark
            self._lamps_m = ()

    def burn(
        self, seek: Seek, target: TargetState, targets: Mapping[str, TargetState], attitude: AttitudeLog, now_ns: int
    ) -> None:
        """The own lamp as it shall burn from now on, and whether the camera sees by it. target: the camera's."""
        if self._talk is None or self.own is None:
            return
        level = None if attitude.newest is None else attitude.at(attitude.newest.t_ns)
        keeps, party, now = seek.measuring or self.judging, self._talk.party, self.own.now
        follows = None if self._follow is None else self._follow.tick(targets, party, now, seek, level, now_ns)
        self.own.burn(party, seek, target.believed_m, follows, keeps, attitude, now_ns)
        if self._swimmer is not None:  # light that is lent, or looked by, does not move
            self._swimmer.keep_still(party.phase in ("holds", "obeys"))
        seek.lit_from_ns = self._lit_from(seek.lit_from_ns, follows is not None, now_ns)
        seek.lit_m = None
        if self._search is not None and target.believed_m is None:
            seek.lit_m = self._search.follows(self._talk.party, seek, target.name, level, now_ns)
        self._wanted_lens = self._sharp_at(seek, target, target.believed_m or seek.lit_m, level)

    def say(self, now_ns: int) -> tuple[Light, ...] | UnsetType:
        """What is told to neighbours in this step."""
        if self._talk is None or self.own is None:
            return UNSET
        return self._talk.say(self.own.now, self.own.dark, now_ns) or UNSET

    @property
    def command(self) -> tuple[float, tuple[int, int]] | None:
        """Power of the own lamp, 0 to 1, and pulses of its gimbal, us; None: no lamps in this fleet."""
        return None if self.own is None else (self.own.lamp.power, self.own.lamp.us)

    def shown(self) -> LampState | UnsetType:
        """For whoever looks."""
        if self._turn is None:
            return UNSET
        return lamp_state(self._turn.talk.party, self._turn.own.now, self._turn.spoiled)

    # --- what it comes from -----------------------------------------------------------------------------------

    def _over(self, now_ns: int) -> None:
        """The own lease is at its end."""
        assert self._turn is not None
        if self._search is not None and self._search.at_m is not None and not self._turn.swept:
            self._search.advance()
        self._turn.over(now_ns)

    def _fail(self, now_ns: int) -> None:
        """The own lease showed nothing."""
        assert self._turn is not None
        if self._search is not None and self._search.at_m is not None and not self._turn.swept:
            self._search.advance()
        self._turn.fail(now_ns)

    def _lit_from(self, before: int | None, follows: bool, now_ns: int) -> int | None:
        """Since when the camera sees by light that is meant for it. follows: by whosever what swims is followed."""
        assert self._turn is not None
        phase, own = self._turn.phase, self._turn.own
        if phase == "holds":
            if not self._turn.rests(now_ns):
                return None
            return before if before is not None and before >= self._turn.granted_ns else now_ns
        shines = phase != "obeys" and (follows or (own.now.power > 0.0 and self._own_shows))
        return own.lamp.steady_ns if shines else None

    def _in_vain(self, seek: Seek, target: TargetState, now_ns: int) -> bool:
        """The place that it has had lit shows nothing."""
        search = self._search
        if search is None or search.at_m is None or self._turn is None or self._turn.swept:
            return False
        if seek.sees(target.name, now_ns):
            return False
        return target.believed_m is not None or search.shown(seek, self._turn.granted_ns, now_ns)

    def _sharp_at(self, seek: Seek, target: TargetState, at_m: Vector | None, level: Attitude | None) -> float | None:
        return None if self._wishes is None else self._wishes.sharp_at(seek, target.ball, at_m, level)

    def _rest(self) -> int | UnsetType:
        """Where the lens shall rest, when that has changed by enough."""
        wanted, fit = self._wanted_lens, self._calibration.focus
        if wanted is None or (self._lens is not None and abs(wanted - self._lens) < LENS_STEP * fit.width):
            return UNSET
        self._lens = round(max(wanted, 0.0))
        return self._lens

    def _ask(self, seek: Seek, target: TargetState, level: Attitude, now_ns: int) -> None:
        """For the light of a sweep, or of a look at the next place of a search."""
        assert self._turn is not None and self._wishes is not None and self._search is not None
        search, at_m = self._search, target.believed_m or seek.glimpsed_m(target.name, level, None, now_ns)
        searches = at_m is None and not seek.sees(target.name, now_ns)
        if not self._wishes.may_ask(now_ns):
            return
        if searches:
            swimmer = self._swimmer
            if swimmer is not None and (target.name in self._pursued or not swimmer.under_way):
                return
            if not search.look(seek, now_ns):
                return
            at_m = search.place(seek, level)
        choice = None if at_m is None else self._wishes.choice(seek, target.ball, at_m, level)
        if searches and not search.worth(choice):
            search.advance()
            return
        search.at_m = at_m if target.believed_m is None else None
        self._own_shows = target.believed_m is None or choice is None or choice.own_contrast >= SHOWS
        if choice is not None:
            self._tell(target.name, choice, searches, now_ns)
        holds_ns = LOOK_NS + seek.most_ns() + MARGIN_NS
        lamps = None if choice is None else choice.lamps
        self._turn.ask(self._wishes.lease(at_m, lamps, self._turn.waited_ns(now_ns), holds_ns), now_ns)

    def _tell(self, target: str, choice: Choice, searches: bool, now_ns: int) -> None:
        """Whose light it asks for, in the log; alone it is no news."""
        if choice.lamps == (self._name,):
            return
        whose = " and ".join(choice.lamps)
        text = f"asks for light of {whose} on '{target}': {choice.sigma_mm:.1f} mm expected"
        if searches:
            text = f"searches for '{target}' by the light of {whose}"
        self._log.note_seldom("info", f"light {target}", text, now_ns)
