"""A field from start to end: the surface, learning for as long as is given, and then whatever is asked of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from agent.core.config import ConfigError
from agent.process.command import Progress
from agent.reconstruction.field.picture import picture
from agent.reconstruction.field.settings import FieldSettings
from agent.reconstruction.field.start import box_of_views, fog
from agent.reconstruction.field.train import learn
from agent.reconstruction.field.volume import MOST_BETA_M, Field
from agent.reconstruction.view import View

Pictures = NDArray[np.float32]

PARTS = 1000  # of the progress: time is no whole number


class Learnt(NamedTuple):
    look: Callable[[View], tuple[Pictures, Pictures]]
    water: Pictures  # (3, 3)
    steps: int
    device: str
    beta_mm: float
    beta_clamped: bool


def learnt(views: Sequence[View], settings: FieldSettings, progress: Progress, now_s: Callable[[], float]) -> Learnt:
    """Raises ConfigError for a device that is not there, Failed where no view has a depth."""
    device = device_of(settings.device)
    box, searching = box_of_views(views), settings.start == "nothing"
    field = Field(fog(box) if searching else box, settings.plane_mm * 1e-3, settings.line_mm * 1e-3, settings.seed).to(
        device
    )
    steps = 0
    for step in learn(field, views, settings, now_s):
        steps += 1
        progress(int(PARTS * step.progress), PARTS)
    progress(PARTS, PARTS)
    beta_m = float(field.beta_m.detach())
    water = functional.softplus(field.water.detach()).cpu().numpy()
    clamped = math.isclose(beta_m, MOST_BETA_M, rel_tol=1e-3)
    return Learnt(lambda view: picture(field, view, searching), water, steps, str(device), 1e3 * beta_m, clamped)


def device_of(name: str) -> torch.device:
    """auto: a GPU if there is one. Raises ConfigError for one that is not there."""
    there = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        return torch.device("cuda" if there["cuda"] else "cpu")
    if not there.get(name, False):
        raise ConfigError(f"device '{name}': torch does not find it on this machine; choose cpu, or auto")
    return torch.device(name)
