"""The image model of a scene: what it looks like from anywhere, learnt from all pictures together.

It is a field where torch is installed (the extra `reconstruct`), else surfels: both start from the surface, and say the
same.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.process.command import Progress
from agent.reconstruction.held_back import FieldSettings
from agent.reconstruction.mesh import Mesh
from agent.reconstruction.surfels import Cloud, cloud_of, fit, picture
from agent.reconstruction.views import View

Kind = Literal["auto", "field", "surfels"]
Pictures = NDArray[np.float32]

EPOCHS = 8  # of surfels: more is worth less than 0.1 dB


class ImageSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """auto: a field where there is torch."""

    kind: Kind = "auto"
    field: FieldSettings = FieldSettings()


@dataclass(frozen=True, eq=False)
class ImageModel:
    """What the scene looks like, and what is to be known of how that was found."""

    kind: Literal["field", "surfels"]
    look: Callable[[View], tuple[Pictures, Pictures]]  # linear light (h, w, 3); depth (h, w) [m], NaN where a hole is
    water: Pictures  # (3, 3) b_D, b_B [1/m], B_inf of red green blue: they render this scene, and mean no more
    steps: int  # of learning; of surfels: pictures gone through, all epochs together
    device: str
    beta_mm: float | None = None  # of a field: how thick its surface is
    beta_clamped: bool = False  # at its largest: the field hides geometry in its thickness


def has_torch() -> bool:
    return importlib.util.find_spec("torch") is not None


def image(
    views: Sequence[View],
    mesh: Mesh,
    cell_m: float,
    settings: ImageSettings,
    progress: Progress,
    now_s: Callable[[], float],
) -> ImageModel:
    """Learn from all views, whose poses are taken as they are. now_s: any clock that counts seconds.

    mesh: the surface, from cells of cell_m; a field starts from one of its own, of the views' depths. Raises
    ConfigError for a field without torch, or a device that is not there.
    """
    kind = settings.kind if settings.kind != "auto" else "field" if has_torch() else "surfels"
    if kind == "surfels":
        return _surfels(views, cloud_of(mesh, cell_m), progress)
    if not has_torch():
        raise ConfigError("a field needs torch: pip install 'aucamp[reconstruct]', or choose surfels")
    from agent.reconstruction.field import learnt  # torch takes seconds to import, and may be absent

    found = learnt(views, settings.field, progress, now_s)
    return ImageModel("field", found.look, found.water, found.steps, found.device, found.beta_mm, found.beta_clamped)


def _surfels(views: Sequence[View], cloud: Cloud, progress: Progress) -> ImageModel:
    found = fit(cloud, views, EPOCHS, progress)

    def look(view: View) -> tuple[Pictures, Pictures]:
        light, depth_m = picture(found, view)
        return filled(light.astype(np.float32)), depth_m.astype(np.float32)

    return ImageModel("surfels", look, found.water.astype(np.float32), (EPOCHS + 1) * len(views), "cpu")


def filled(light: Pictures) -> Pictures:
    """The picture (h, w, 3) with holes (NaN) filled from around them, the coarser the farther: for the eye."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(light).all(axis=-1))
    if known.all() or not known.any():
        return np.nan_to_num(light)
    out: Pictures = np.where(known[..., None], light, 0.0).astype(np.float32)
    sums: Pictures = np.array(out, np.float32)
    weight: Pictures = np.array(known, np.float32)
    left: NDArray[np.bool_] = np.array(~known)
    sigma = 2.0
    while left.any():
        mean, share = (np.asarray(cv2.GaussianBlur(one, (0, 0), sigma), np.float32) for one in (sums, weight))
        now = left & (share > 1e-3)
        out[now] = mean[now] / share[now, None]
        left, sigma = np.asarray(left & ~now), 2.0 * sigma
    return out
