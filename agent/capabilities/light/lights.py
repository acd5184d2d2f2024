"""Light as a capability: by which light targets and views are swept, which sweeps count, and how the own lamp burns.

There is no sweep without a lease: the robot asks as soon as it knows where to look, looks and sweeps by the light that
it got, and gives it back when all neighbours have said that nothing changed meanwhile. While no robot has a lease each
lamp goes with its own camera. A fleet without [lighting] has capability.DAYLIGHT instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.capabilities.light.allocate import Choice, OrderedLight, others
from agent.capabilities.light.lease import Party, Talk, lit_by
from agent.capabilities.light.light_request import SHOWS, LightSearch, Requests, glimpsed_m
from agent.capabilities.light.model import SCATTERS, WANDERS_PX, cues_by, whole
from agent.capabilities.light.own_lamp import LOOK_NS, MARGIN_NS, OwnLamp, Turn, lamp_state
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability import (
    Capability,
    Context,
    Illumination,
    LampAct,
    LightView,
    Outgoing,
    Proposal,
    Situation,
    Spoiled,
    View,
)
from agent.core.capability_messages import Light as LightSaid
from agent.core.codec import Refusal, decode
from agent.core.config import Cues, Target
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Eye
from agent.core.ranging.fix import Outline
from agent.core.ranging.sweep import ByLight, Measurement
from agent.core.step_io import Heard, SweepOutcome
from agent.core.topics import LIGHT, Topic
from agent.core.verbs import Args, Burn, Resume, within

LENS_STEP = 0.25  # of the peak's half width: a blur by less is not worth moving the lens


class Light(Capability, Illumination):
    """Of one robot of a fleet with [lighting], between steps."""

    name: ClassVar[str] = "light"
    table: ClassVar[str] = "lighting"
    sweeps: ClassVar[bool] = True
    does: ClassVar[str] = "lights"
    lacks: ClassVar[str] = "it has no lamp: `lamp = true` is not in its table of the fleet file"
    topics: ClassVar[tuple[Topic, ...]] = (LIGHT,)
    commands: ClassVar[tuple[type, ...]] = (Burn,)

    def __init__(self, context: Context) -> None:
        fleet, name, calibration = context.fleet, context.name, context.calibration
        assert fleet.lighting is not None
        self._fleet, self._name, self._calibration, self._log = fleet, name, calibration, context.log
        self._attitude: AttitudeLog = context.attitude
        self._talk = Talk(fleet, name, context.incarnation)
        self.own = OwnLamp(fleet, name, fleet.lighting, context.attitude)
        self._turn = Turn(self._talk, self.own)
        self._requests = Requests(fleet, name, calibration, fleet.lighting, self.own, self._talk)
        self._search = LightSearch(fleet, name, calibration.camera)
        self._own_shows = True  # the own lamp, the target, as far as it is known where that is
        self._view_lease: int | None = None  # number of the lease that is a view's
        self._lamps_m: tuple[Vector, ...] = ()  # where those are that a sweep was made by
        self._lens: int | None = None  # where it rests between sweeps, as told
        self._wanted_lens: float | None = None

    # --- what comes in ----------------------------------------------------------------------------------------

    def receive(self, heard: Heard, accepted: frozenset[int]) -> None:
        self._talk.hear(heard.src, decode(heard.payload, LightSaid, LIGHT.limit, accepted), heard.arrived_ns)

    def carry_out(self, command: Args) -> bool:
        match command:
            case Burn():
                if not self.own.has:
                    raise Refusal("content", self.lacks)
                body = self._fleet.body
                within("pan_deg", command.pan_deg, *body.pan_limit_deg)
                within("tilt_deg", command.tilt_deg, *body.tilt_limit_deg)
                self.own.order(OrderedLight(command.light, command.pan_deg, command.tilt_deg))
            case Resume():
                self.own.order(None)
            case _:
                return False
        return True

    def decide(self, situation: Situation) -> Situation:
        """Leases end and are granted."""
        turn, own, now_ns = self._turn, situation.own, situation.now_ns
        if turn.tick(now_ns):
            self._end(now_ns, fruitless=True)
        elif turn.phase == "holds" and turn.exposure == "none" and own is not None and own.at_landmarks:
            self._end(now_ns)  # its camera is at landmarks: the light is others' meanwhile
        self.own.tick(self._talk.party, own, now_ns)
        return replace(situation, light=situation.light._replace(phase=turn.phase))

    # --- sweeps -----------------------------------------------------------------------------------------------

    @property
    def claims(self) -> bool:
        return self._talk.party.mine is not None

    @property
    def judging(self) -> bool:
        return self._turn.exposure == "judged"

    def consent(self, view: View | None, situation: Situation) -> ByLight | bool:
        return self._by_target(situation) if view is None else self._by_view(view, situation)

    def _by_target(self, situation: Situation) -> ByLight | bool:
        turn, now_ns = self._turn, situation.now_ns
        if turn.phase == "holds":
            if self._in_vain(situation):
                self._end(now_ns)
                return False
            lent = any(name != self._name for name in lit_by(self._talk.party))
            by_light = ByLight(self._requests.sharp_at(situation.target.believed_m, situation), lent)
            return by_light if turn.exposure != "judged" and turn.rests(now_ns) else False
        ready = situation.camera.ready and situation.camera.target == situation.watched
        if turn.idle(now_ns) and situation.level is not None and ready:
            self._ask(situation.level, situation)
        return False

    def _by_view(self, view: View, situation: Situation) -> bool:
        turn, now_ns, level = self._turn, situation.now_ns, situation.level
        if turn.phase == "holds":
            own = self._talk.party.number == self._view_lease
            return own and turn.exposure != "judged" and turn.rests(now_ns)
        if level is None or not turn.idle(now_ns) or not self._requests.may_ask(situation):
            return False
        scene = view.frame_scene()
        choice = self._requests.frame_choice(scene, level, situation)
        if choice is not None and set(choice.lamps) != {self._name}:
            whose = " and ".join(choice.lamps)
            more = f"{choice.blocks:.0f} new blocks expected, {choice.own_blocks:.0f} by its own"
            self._log.note_seldom("info", "light views", f"asks for light of {whose} on a view: {more}", now_ns)
        lamps = None if choice is None else choice.lamps
        holds_ns = LOOK_NS + view.most_ns + MARGIN_NS
        turn.ask(self._requests.lease(scene.aim_m, lamps, turn.waited_ns(now_ns), holds_ns), now_ns)
        self._view_lease = self._talk.party.number
        return False

    def began(self, situation: Situation) -> None:
        turn = self._turn
        turn.began(situation.now_ns)
        there = others(self._fleet, self._name, situation)
        self._lamps_m = tuple(self.own.aim.place_m(*there[name]) for name in turn.burned if name in there)
        if self._name in turn.burned:  # from beside the camera: nothing of the disc is dark
            self._lamps_m = ()

    def ended(self, now_ns: int) -> None:
        self._turn.ended(now_ns)

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """The lease ends with it."""
        if (found := self._turn.verdict(now_ns)) is not None:
            self._end(now_ns)
        return found

    def failed(self, now_ns: int) -> None:
        self._end(now_ns, fruitless=True)

    def released(self, now_ns: int) -> None:
        if self._turn.phase == "holds":
            self._end(now_ns)

    def corrected(self, peak: Measurement, eye: Eye, ball: Target, cues: Cues) -> tuple[Outline, float, Cues]:
        if peak.lens_position is None or set(self._turn.burned) <= {self._name}:
            return peak.outline, peak.sigma, cues
        outline = whole(self._calibration, eye, peak.outline, peak.lens_position, peak.sigma, ball, self._lamps_m)
        return outline._replace(centre_sigma_px=WANDERS_PX), SCATTERS * peak.sigma, cues_by(cues)

    def marked(self, outcome: SweepOutcome) -> SweepOutcome:
        return replace(outcome, lamps=self._turn.assumed, lit=self._turn.burned)

    def _end(self, now_ns: int, fruitless: bool = False) -> None:
        """The own lease is at its end. fruitless: it showed nothing, and others have more time before the next one."""
        if self._search.at_m is not None and self._turn.exposure == "none":
            self._search.advance()
        if fruitless:
            self._turn.fail(now_ns)
        else:
            self._turn.over(now_ns)

    def _in_vain(self, situation: Situation) -> bool:
        """The place that it has had lit shows nothing."""
        if self._search.at_m is None or self._turn.exposure != "none" or situation.camera.sees(situation.watched):
            return False
        return situation.target.believed_m is not None or self._search.shown(self._turn.granted_ns, situation)

    def _ask(self, level: Attitude, situation: Situation) -> None:
        """For the light of a sweep, or of a look at the next place of a search."""
        search, target, now_ns = self._search, situation.watched, situation.now_ns
        believed_m, ball = situation.target.believed_m, self._fleet.target[target]
        at_m = believed_m or glimpsed_m(self._fleet, self._calibration.camera, None, situation)
        searches, burns = at_m is None and not situation.camera.sees(target), self.own.burns
        if not self._requests.may_ask(situation):
            return
        if searches:
            if (situation.own is not None and not situation.own.under_way) or not search.look(situation, burns):
                return
            at_m = search.place(situation.pose, level)
        choice = None if at_m is None else self._requests.choice(at_m, level, situation)
        if searches and not search.worth(choice, ball, burns):
            search.advance()
            return
        search.have_lit(at_m if believed_m is None else None)
        self._own_shows = believed_m is None or choice is None or choice.own_contrast >= SHOWS
        if choice is not None:
            self._tell(target, choice, searches, now_ns)
        holds_ns = LOOK_NS + situation.camera.most_sweep_ns + MARGIN_NS
        lamps = None if choice is None else choice.lamps
        self._turn.ask(self._requests.lease(at_m, lamps, self._turn.waited_ns(now_ns), holds_ns), now_ns)

    def _tell(self, target: str, choice: Choice, searches: bool, now_ns: int) -> None:
        """Whose light it asks for, in the log; alone it is no news."""
        if choice.lamps == (self._name,):
            return
        whose = " and ".join(choice.lamps)
        text = f"asks for light of {whose} on '{target}': {choice.sigma_mm:.1f} mm expected"
        if searches:
            text = f"searches for '{target}' by the light of {whose}"
        self._log.note_seldom("info", f"light {target}", text, now_ns)

    # --- the own lamp -----------------------------------------------------------------------------------------

    def propose(self, situation: Situation) -> Iterable[Proposal[Any]]:
        """Row by row of the table of priorities."""
        rows: tuple[tuple[str, Callable[[Party, Situation], LampAct | None]], ...] = (
            ("safe", self.own.safe),
            ("operator", self.own.by_operator),
            ("sweep", self._keep),
            ("lent", self.own.lent),
            ("lease", self.own.leased),
            ("camera", self.own.with_camera),
        )
        for holder, act in rows:
            yield Proposal("lamp", holder, partial(self._burn, act))

    def _burn(self, act: Callable[[Party, Situation], LampAct | None], at: Situation) -> LampAct | None:
        return act(self._talk.party, replace(at, level=self._level))

    def _keep(self, party: Party, at: Situation) -> LampAct | None:
        """Light does not change in a sweep of this robot's."""
        return self.own.kept(party, at) if at.camera.measuring or self.judging else None

    def settle(self, situation: Situation) -> Situation:
        """By which light the camera sees from now on."""
        seen = replace(situation, level=self._level)
        from_ns = self._lit_from(situation.light.from_ns, situation.now_ns)
        target_m, place_m = situation.target.believed_m, None
        if target_m is None and situation.search is None:
            place_m = self._search.follows(self._talk.party, seen)
        self._wanted_lens = self._requests.sharp_at(target_m or place_m, seen)
        still = self._turn.phase in ("holds", "obeys")  # light that is lent, or looked by, does not move
        return replace(situation, light=LightView(self._turn.phase, from_ns, place_m, still))

    @property
    def _level(self) -> Attitude | None:
        """By the newest telemetry, however old."""
        newest = self._attitude.newest
        return None if newest is None else self._attitude.at(newest.t_ns)

    def _lit_from(self, before: int | None, now_ns: int) -> int | None:
        """Since when the camera sees by light that is meant for it."""
        phase = self._turn.phase
        if phase == "holds":
            if not self._turn.rests(now_ns):
                return None
            return before if before is not None and before >= self._turn.granted_ns else now_ns
        shines = phase != "obeys" and self.own.now.power > 0.0 and self._own_shows
        return self.own.lamp.steady_ns if shines else None

    # --- what goes out ----------------------------------------------------------------------------------------

    def outgoing(self, situation: Situation) -> Iterable[Outgoing]:
        said = self._talk.say(self.own.now, self.own.dark, situation.now_ns)
        return (Outgoing(LIGHT, each.dst, each) for each in said)

    def telemetry(self, now_ns: int) -> Mapping[str, Any]:
        return {"lamp": lamp_state(self._talk.party, self.own.now, self._turn.spoiled)}

    def lens(self) -> int | UnsetType | None:
        """Where the target is believed to be sharp, which out of focus does not show in the dark, when that has changed
        by enough; of robots that swim landmarks have the lens."""
        wanted, fit = self._wanted_lens, self._calibration.swept
        if self._fleet.navigation is not None or wanted is None:
            return UNSET
        if self._lens is not None and abs(wanted - self._lens) < LENS_STEP * fit.width:
            return UNSET
        self._lens = round(max(wanted, 0.0))
        return self._lens
