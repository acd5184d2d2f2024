"""Light as part of a robot's step: the answers of a fleet without [lighting], and a fleet that lights, which sweeps
count there, and how the lamp burns.

There is no sweep without a lease: the robot asks as soon as it knows where to look, looks and sweeps by the light that
it got, and gives it back when all neighbours have said that nothing changed meanwhile. While nobody has a lease each
lamp goes with its own camera.
"""

from __future__ import annotations

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.capabilities.light.allocate import others
from agent.capabilities.light.lease import Spoiled, Talk
from agent.capabilities.light.light_request import LightSearch, Wishes
from agent.capabilities.light.own_lamp import OwnLamp, Turn, lamp_state
from agent.capabilities.light.target_light import (
    SCATTERS,
    WANDERS_PX,
    LentViewLight,
    TargetLight,
    ViewLight,
    cues_by,
    whole,
)
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability_messages import Light
from agent.core.codec import Refusal, decode
from agent.core.config import Cues, Fleet, Lighting, Target
from agent.core.control.sweep import Measurement, Rejected
from agent.core.control.target_search import Seek
from agent.core.messages import LampState, Vector
from agent.core.ranging.camera_model import Calibration, Eye
from agent.core.ranging.fix import Outline
from agent.core.status import Logbook
from agent.core.step_io import Heard, SweepOutcome
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState
from agent.core.topics import LIGHT

# --- a fleet without [lighting] ---
# What a robot's step asks of light, as it is answered by a fleet without [lighting]: by day.
#
# No lamp burns, each sweep may begin, and each counts. Fleets that light for each other answer by `LentLights`.


class Lights(Revertible):
    """Of one robot, between steps."""

    def __init__(self) -> None:
        self.views = ViewLight()
        self.own: OwnLamp | None = None

    def hear(self, item: Heard, accepted: frozenset[int]) -> None:
        """A payload on a key of ours. Raises Refusal where it is not believed."""
        raise Refusal("fleet file", "it lights, and our file has no [lighting]; give all robots the same file")

    # --- sweeps -----------------------------------------------------------------------------------------------

    @property
    def claims(self) -> bool:
        """Light is asked for or held, for the target that the camera is at."""
        return False

    @property
    def obeys(self) -> bool:
        """A neighbour has the light."""
        return False

    @property
    def judging(self) -> bool:
        """A sweep has ended whose light is not known to have stayed as it was."""
        return False

    def judged(self, result: Measurement | Rejected | None, seek: Seek, now_ns: int) -> Measurement | Rejected | None:
        """What became of sweeps: one that ended now waits until all lamps are known not to have changed in it."""
        return result

    def seen(self, peak: Measurement, eye: Eye, ball: Target, cues: Cues) -> tuple[Outline, float, Cues]:
        """The outline of a ball, how well its peak is known, in lens positions, and the cues to its range, as the light
        leaves them in which it was swept."""
        return peak.outline, peak.sigma, cues

    def lens(self, told: int | UnsetType | None) -> int | UnsetType | None:
        """Where the lens shall be between sweeps. told: by whoever else moves it."""
        return told

    def marked(self, outcome: SweepOutcome | UnsetType) -> SweepOutcome | UnsetType:
        """What came of a sweep, with the lamps that it was made by."""
        return outcome

    # --- the step ---------------------------------------------------------------------------------------------

    def tick(self, attitude: AttitudeLog, now_ns: int) -> None:
        """Leases end and are granted."""

    def may_sweep(self, seek: Seek, target: TargetState, level: Attitude | None, wanted: bool, now_ns: int) -> bool:
        """Whether a sweep may begin now, by light that is at rest; if not, light is asked for where one is wanted."""
        return wanted

    def released(self, now_ns: int) -> None:
        """The camera goes with a target that swims, by frames: light that is held for a sweep is given back."""

    def began(self, now_ns: int) -> None:
        """A sweep of the target begins with this step."""

    def burn(self, seek: Seek, target: TargetState, attitude: AttitudeLog, now_ns: int) -> None:
        """The own lamp as it shall burn from now on, and whether the camera sees by it. target: the camera's."""

    def say(self, now_ns: int) -> tuple[Light, ...] | UnsetType:
        """What is told to neighbours in this step."""
        return UNSET

    @property
    def command(self) -> tuple[float, tuple[int, int]] | None:
        """Power of the own lamp, 0 to 1, and pulses of its gimbal, us; None: no lamps in this fleet."""
        return None

    def shown(self) -> LampState | UnsetType:
        """For whoever looks."""
        return UNSET


# --- a fleet that lights ---

LENS_STEP = 0.25  # of the peak's half width: a blur by less is not worth moving the lens


def lights_of(
    fleet: Fleet, name: str, calibration: Calibration, incarnation: int, swimmer: Swimmer | None, log: Logbook
) -> Lights:
    """By day where the fleet file says nothing of light."""
    if fleet.lighting is None:
        return Lights()
    return LentLights(fleet, name, calibration, incarnation, swimmer, log, fleet.lighting)


class LentLights(Lights):
    """Of one robot, between steps."""

    own: OwnLamp

    def __init__(
        self,
        fleet: Fleet,
        name: str,
        calibration: Calibration,
        incarnation: int,
        swimmer: Swimmer | None,
        log: Logbook,
        lighting: Lighting,
    ) -> None:
        super().__init__()
        self._fleet, self._name, self._calibration, self._swimmer = fleet, name, calibration, swimmer
        self._talk, self.own = Talk(fleet, name, incarnation), OwnLamp(fleet, name, lighting, swimmer)
        self._turn = Turn(self._talk, self.own)
        wishes = Wishes(fleet, name, calibration, swimmer, lighting, self.own, self._talk)
        self._sweeps = TargetLight(self._turn, wishes, LightSearch(fleet, name), swimmer, log)
        self.views = LentViewLight(self._turn, wishes, log)
        self._pending: Measurement | None = None  # a sweep whose light is not known to have stayed
        self._lamps_m: tuple[Vector, ...] = ()  # where those are that it was made by
        self._lens: int | None = None  # where it rests between sweeps, as told
        self._wanted_lens: float | None = None

    def hear(self, item: Heard, accepted: frozenset[int]) -> None:
        self._talk.hear(item.src, decode(item.payload, Light, LIGHT.limit, accepted), item.arrived_ns)

    # --- sweeps -----------------------------------------------------------------------------------------------

    @property
    def claims(self) -> bool:
        return self._talk.party.mine is not None

    @property
    def obeys(self) -> bool:
        return self._turn.phase == "obeys"

    @property
    def judging(self) -> bool:
        return self._turn.judging

    def judged(self, result: Measurement | Rejected | None, seek: Seek, now_ns: int) -> Measurement | Rejected | None:
        if isinstance(result, Measurement):
            self._pending = result
            self._turn.ended(now_ns)
        elif result is not None:
            self._sweeps.end(now_ns, fruitless=True)
            return result
        if (pending := self._pending) is None:
            return None
        if (found := self._turn.verdict(now_ns)) is None:
            return None
        self._pending = None
        self._sweeps.end(now_ns)
        if not isinstance(found, Spoiled):
            return pending
        seek.take_back()
        return Rejected(pending.sweep, f"spoiled: {found.reason}", held_width=pending.held_width)

    def seen(self, peak: Measurement, eye: Eye, ball: Target, cues: Cues) -> tuple[Outline, float, Cues]:
        if set(self._turn.burned) <= {self._name}:
            return peak.outline, peak.sigma, cues
        outline = whole(self._calibration, eye, peak.outline, peak.lens_position, peak.sigma, ball, self._lamps_m)
        return outline._replace(centre_sigma_px=WANDERS_PX), SCATTERS * peak.sigma, cues_by(cues)

    def lens(self, told: int | UnsetType | None) -> int | UnsetType | None:
        """Where the target is believed to be sharp, which out of focus does not show in the dark; of robots that swim
        landmarks have the lens."""
        return told if self._swimmer is not None or told is not UNSET else self._rest()

    def marked(self, outcome: SweepOutcome | UnsetType) -> SweepOutcome | UnsetType:
        if outcome is UNSET:
            return outcome
        return replace(outcome, lamps=self._turn.assumed, lit=self._turn.burned)

    # --- the step ---------------------------------------------------------------------------------------------

    def tick(self, attitude: AttitudeLog, now_ns: int) -> None:
        turn = self._turn
        if turn.tick(now_ns):
            self._sweeps.end(now_ns, fruitless=True)
        elif turn.phase == "holds" and not turn.swept and self._swimmer is not None and self._swimmer.glances:
            self._sweeps.end(now_ns)  # its camera is at landmarks: the light is others' meanwhile
        self.own.tick(self._talk.party, attitude, now_ns)

    def may_sweep(self, seek: Seek, target: TargetState, level: Attitude | None, wanted: bool, now_ns: int) -> bool:
        return wanted and self._sweeps.lets(seek, target, level, now_ns)

    def released(self, now_ns: int) -> None:
        if self._turn.phase == "holds":
            self._sweeps.end(now_ns)

    def began(self, now_ns: int) -> None:
        turn = self._turn
        turn.began(now_ns)
        there = others(self._fleet, self._name, self._swimmer)
        self._lamps_m = tuple(self.own.aim.place_m(*there[name]) for name in turn.burned if name in there)
        if self._name in turn.burned:  # from beside the camera: nothing of the disc is dark
            self._lamps_m = ()

    def burn(self, seek: Seek, target: TargetState, attitude: AttitudeLog, now_ns: int) -> None:
        level = None if attitude.newest is None else attitude.at(attitude.newest.t_ns)
        keeps, party = seek.measuring or self.judging, self._talk.party
        self.own.burn(party, seek, target.believed_m, keeps, attitude, now_ns)
        if self._swimmer is not None:  # light that is lent, or looked by, does not move
            self._swimmer.keep_still(party.phase in ("holds", "obeys"))
        seek.lit_from_ns = self._lit_from(seek.lit_from_ns, now_ns)
        seek.lit_m = self._sweeps.lit_m(seek, target, level, now_ns)
        self._wanted_lens = self._sweeps.sharp_at(seek, target, target.believed_m or seek.lit_m, level)

    def say(self, now_ns: int) -> tuple[Light, ...] | UnsetType:
        return self._talk.say(self.own.now, self.own.dark, now_ns) or UNSET

    @property
    def command(self) -> tuple[float, tuple[int, int]]:
        return self.own.lamp.power, self.own.lamp.us

    def shown(self) -> LampState:
        return lamp_state(self._talk.party, self.own.now, self._turn.spoiled)

    # --- what it comes from -----------------------------------------------------------------------------------

    def _lit_from(self, before: int | None, now_ns: int) -> int | None:
        """Since when the camera sees by light that is meant for it."""
        phase = self._turn.phase
        if phase == "holds":
            if not self._turn.rests(now_ns):
                return None
            return before if before is not None and before >= self._turn.granted_ns else now_ns
        shines = phase != "obeys" and self.own.now.power > 0.0 and self._sweeps.own_shows
        return self.own.lamp.steady_ns if shines else None

    def _rest(self) -> int | UnsetType:
        """Where the lens shall rest, when that has changed by enough."""
        wanted, fit = self._wanted_lens, self._calibration.focus
        if wanted is None or (self._lens is not None and abs(wanted - self._lens) < LENS_STEP * fit.width):
            return UNSET
        self._lens = round(max(wanted, 0.0))
        return self._lens
