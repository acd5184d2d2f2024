"""Which tags of a frame the lens, by calibration, shows sharply enough.

From a blur as wide as a module on, the edge of a tag's border and those of its code are one. Then they look narrower
than they are, and corners move inwards: by 0.1 % up to 0.9 of a module, by 1.3 % beyond 1.2 (rms, twin, 2900 tags),
which is 25 mm of distance at 2 m. So it is not the picture that is asked how blurred it is, but the lens.
"""

from __future__ import annotations

from collections.abc import Iterable

from agent.capabilities.swim.projection import View
from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import lens_position
from agent.core.step_io import SeenTag

MODULES = 8  # along a tag's side
WIDTH_PX = 2.5  # diameter of the blur's disc a half width of the clarity peak off focus: 2.3 to 2.6 px (five lenses)
MIXED = 1.0  # of a module


def readable(tags: Iterable[SeenTag], size_m: float, of: View, fit: FocusFit, focus: float | None) -> list[SeenTag]:
    """The tags whose blur is narrower than a module. size_m: of a tag; focus: the frame's lens position, None: nobody
    knows, and all count."""
    if focus is None:
        return list(tags)
    return [tag for tag in tags if _blur_px(tag, size_m, of, fit, focus) <= MIXED * tag.size_px / MODULES]


def _blur_px(tag: SeenTag, size_m: float, of: View, fit: FocusFit, focus: float) -> float:
    """Of who stands before the lens's nearest range, infinite."""
    away_m = size_m * of.f_px / max(tag.size_px, 1e-9)
    if away_m <= fit.u_inf_m:
        return float("inf")
    return WIDTH_PX * abs(focus - lens_position(fit, away_m)) / fit.width
