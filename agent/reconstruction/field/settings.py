"""What can be asked of the field. Nothing here is heavy: whoever reads a fleet file reads this."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Start = Literal["surface", "nothing"]
Device = Literal["auto", "cpu", "cuda", "mps"]


class FieldSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time is what a field is bought with: it has learnt most of it in a minute, and goes on for ten."""

    device: Device = "auto"
    seconds: Annotated[float, Meta(gt=0)] = 300.0  # of the clock on the wall, for learning alone
    steps: Annotated[int, Meta(ge=1)] | None = None  # so many instead, however long they take: the same on each run
    rays: Annotated[int, Meta(ge=1)] = 4096  # a step
    seed: int = 0
    plane_mm: Annotated[float, Meta(gt=0)] = 3.0  # cells of the colours' planes
    line_mm: Annotated[float, Meta(gt=0)] = 6.0  # and of their lines
    start: Start = "surface"  # nothing: a thin fog everywhere, no depths; what a field is worth without focus
    anchor: Annotated[float, Meta(ge=0)] = 0.01  # weight of the depths that focus and stereo found
