"""What a robot's step asks of light, as it is answered by a fleet without [lighting]: by day.

No lamp burns, each sweep may begin, and each counts. Fleets that light for each other answer in lamps/conduct.py.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import UNSET, UnsetType

from agent.capabilities.light.own_lamp import OwnLamp
from agent.capabilities.light.view_light import ViewLight
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability_messages import Light
from agent.core.codec import Refusal
from agent.core.config import Cues, Target
from agent.core.control.sweep import Measurement, Rejected
from agent.core.control.target_search import Seek
from agent.core.messages import LampState
from agent.core.ranging.camera_model import Eye
from agent.core.ranging.fix import Outline
from agent.core.step_io import Heard, SweepOutcome
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState


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

    def pursues(self, seek: Seek, target: TargetState, level: Attitude | None, now_ns: int) -> None:
        """The camera goes with a target that swims, or round without rest in search of it."""

    def began(self, now_ns: int) -> None:
        """A sweep of the target begins with this step."""

    def burn(
        self, seek: Seek, target: TargetState, targets: Mapping[str, TargetState], attitude: AttitudeLog, now_ns: int
    ) -> None:
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
