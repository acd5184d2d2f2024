"""What a camera would see of the field: picture and depths."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from agent.reconstruction.field.march import NEAREST_M, depth, look, search, trace
from agent.reconstruction.field.rays import Bundle
from agent.reconstruction.field.train import BAND_M, ROUNDS, SEARCH
from agent.reconstruction.field.volume import Field
from agent.reconstruction.view import View

AT_ONCE = 1 << 15  # rays
SAMPLES = 16

Floats = NDArray[np.float32]


@torch.no_grad()
def picture(field: Field, view: View, searching: bool = False) -> tuple[Floats, Floats]:
    """Linear light (height, width, 3) and depth (height, width) from a view's pose by its camera; the rest is unused.

    searching: the field began with nothing, and has no distances that could be followed.
    """
    device = field.sdf_m.device
    bundle = Bundle([view], device)
    colours, depths = [], []
    for first in range(0, bundle.count, AT_ONCE):
        chosen = torch.arange(first, min(first + AT_ONCE, bundle.count), device=device)
        rays = bundle.rays(chosen)
        middles = torch.full((len(chosen), SEARCH[0] if searching else SAMPLES), 0.5, device=device)
        if searching:
            seen = search(field, rays, middles, SEARCH[1])
        else:
            met = trace(field, rays, torch.full_like(rays.forward, NEAREST_M), 2 * ROUNDS)
            seen = look(field, rays, (met - BAND_M).clamp_min(NEAREST_M), met + BAND_M, middles)
        colours.append(seen.colour)
        depths.append(depth(rays, seen.range_m))
    shape = (view.camera.height, view.camera.width)
    return torch.cat(colours).cpu().numpy().reshape(*shape, 3), torch.cat(depths).cpu().numpy().reshape(shape)
