"""What an image model is, and how it is held against photographs that it has not seen: peak signal to noise, where the
camera really was.

A pose that is a millimetre off costs more than all that a model gets wrong, and says nothing about it: so each
photograph first finds its place in the model's pictures (`pose_evidence.place`), as if it were a robot's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.pose_evidence import place
from agent.reconstruction.views import View, shrunk

Pictures = NDArray[np.float32]
Look = Callable[[View], tuple[Pictures, Pictures]]
ModelKind = Literal["surfels", "field"]


class ImageModel(NamedTuple):
    """What a scene looks like from anywhere, learnt from all pictures together."""

    kind: ModelKind
    look: Look  # linear light (h, w, 3); depth (h, w) [m], NaN where a hole is
    steps: int  # of learning; of surfels: pictures gone through, all epochs together
    beta_mm: float | None = None  # of a field: how thick its surface is
    beta_clamped: bool = False  # at its largest: the field hides geometry in its thickness


GAMMA = 1.0 / 2.2  # PSNR is of tones, as an eye and a file have them
ROUNDS, SMALLER = 4, 2  # of placing, in pictures so many times smaller


class HeldBack(NamedTuple):
    """One photograph and what the model made of it."""

    view: View  # where it was found to be
    light: Pictures  # (h, w, 3) what the model shows from there
    depth_m: Pictures  # (h, w)
    psnr_db: float
    unplaced_db: float  # from where it was said to be


def judged(look: Look, views: Sequence[View]) -> list[HeldBack]:
    """Each of the photographs, placed and compared."""
    return [_judged(look, view) for view in views]


def _judged(look: Look, view: View) -> HeldBack:
    small = smaller(view, SMALLER)
    found = place(small, lambda there: _floats(look(there)), rounds=ROUNDS).view
    there = replace(view, rotation=found.rotation, position_m=found.position_m)
    light, depth_m = look(there)
    return HeldBack(there, light, depth_m, psnr_db(light, view.picture), psnr_db(look(view)[0], view.picture))


def psnr_db(light: Pictures, true: Pictures) -> float:
    """Of tones 0 to 1 of linear light (h, w, 3)."""
    a, b = (np.clip(picture, 0.0, 1.0) ** GAMMA for picture in (light, true))
    return float(-10.0 * np.log10(max(np.mean((a - b) ** 2), 1e-12)))


def smaller(view: View, times: int) -> View:
    """The view with a picture so many times smaller; its depths are those of every so-many-th pixel."""
    camera = shrunk(view.camera, times)
    cut = np.s_[: camera.height * times, : camera.width * times]
    size = (camera.width, camera.height)
    picture = cv2.resize(view.picture[cut], size, interpolation=cv2.INTER_AREA).astype(np.float32)
    every = np.s_[times // 2 : camera.height * times : times, times // 2 : camera.width * times : times]
    return replace(view, camera=camera, picture=picture, depth_m=view.depth_m[every], sigma_m=view.sigma_m[every])


def _floats(seen: tuple[Pictures, Pictures]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return seen[0].astype(float), seen[1].astype(float)


# --- which pictures nothing is made of, so that what is rendered can be held against them ---

ENOUGH = 12  # views from which on some can be spared
EVERY = 10


def held_back(views: Sequence[View]) -> tuple[list[View], list[View]]:
    """Views to build from, and one in EVERY to judge by, each in order; none where there are fewer than ENOUGH."""
    if len(views) < ENOUGH:
        return list(views), []
    spared = range(EVERY // 2, len(views), EVERY)
    return [view for n, view in enumerate(views) if n not in spared], [views[n] for n in spared]
