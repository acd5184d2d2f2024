"""What people want of a robot beside what its fleet file says, for as long as nobody orders otherwise."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import UNSET, UnsetType

from agent.core.config import Behaviour
from agent.core.step_io import Motors, TargetBox


class Wishes(NamedTuple):
    """In force until another order, or `resume`. None: as the fleet file says."""

    depth_m: float | None = None
    gaze_deg: tuple[float, float] | None = None  # pan, tilt of the camera
    behaviour: Behaviour | None = None
    sweeps: bool = True
    send_hz: float | None = None


class AtOnce(NamedTuple):
    """For the devices, with the outputs of this step."""

    motors: Motors | UnsetType = UNSET
    box: TargetBox | UnsetType = UNSET
    preview_hz: float | UnsetType = UNSET


RANK: tuple[Motors, ...] = ("arm", "surface", "off")  # of two in one step the later here goes


def prevailing(before: Motors | UnsetType, ordered: Motors) -> Motors:
    """Of what was ordered of the motors in one step."""
    return ordered if before is UNSET else max(before, ordered, key=RANK.index)
