"""All pixels of all views as tensors on one device, so that a step takes any of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from agent.reconstruction.camera import pixel_grid, ray_slopes
from agent.reconstruction.view import View

LEAST_SIGMA_M = 2e-3  # of a depth that anchors: what says that it knows better is seldom right


class Rays(NamedTuple):
    """Pixels (n,) of one or more views; a place on the ray is origin_m + t toward, t in metres."""

    origin_m: Tensor  # (n, 3) where the rays of its view meet
    toward: Tensor  # (n, 3) unit vectors of the world
    forward: Tensor  # (n,) cosine between ray and axis: t times it is the depth, less what lies before the origin
    ahead_m: Tensor  # (n,) what lies before the origin


class Pixels(NamedTuple):
    """What was photographed of (n,) rays."""

    colour: Tensor  # (n, 3) linear light, red green blue
    depth_m: Tensor  # (n,) NaN: unknown
    sigma_m: Tensor  # (n,)


class Bundle:
    """Every pixel of some views. Directions are made when they are asked for: they take less room as slopes."""

    def __init__(self, views: Sequence[View], device: torch.device) -> None:
        cameras = list(dict.fromkeys(view.camera for view in views))
        where = [cameras.index(view.camera) for view in views]
        slopes = [np.asarray(ray_slopes(c, pixel_grid(c)), np.float32).reshape(-1, 2) for c in cameras]
        starts = np.cumsum([0, *(len(one) for one in slopes)])
        counts = [view.picture.shape[0] * view.picture.shape[1] for view in views]

        def tensor(values: object, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.as_tensor(np.asarray(values), dtype=dtype, device=device)

        self.count = int(sum(counts))
        self._view = torch.repeat_interleave(torch.arange(len(views)), torch.tensor(counts)).to(torch.int32).to(device)
        first = np.cumsum([0, *counts[:-1]])
        self._first, self._slopes_at = tensor(first, torch.int64), tensor([starts[k] for k in where], torch.int64)
        self._slopes = tensor(np.concatenate(slopes))
        self._rotation = tensor(np.stack([view.rotation for view in views]))
        self._ahead_m = tensor([view.camera.ahead_m for view in views])
        origins = [view.position_m + view.rotation[:, 2] * view.camera.ahead_m for view in views]
        self._origin_m = tensor(np.stack(origins))
        self._colour = tensor(np.concatenate([view.picture.reshape(-1, 3) for view in views]))
        self._depth_m = tensor(np.concatenate([view.depth_m.ravel() for view in views]))
        sigma = np.concatenate([view.sigma_m.ravel() for view in views])
        self._sigma_m = tensor(np.maximum(sigma, LEAST_SIGMA_M))

    def rays(self, pixels: Tensor) -> Rays:
        """Of pixels (n,) int64, counted through all views."""
        view = self._view[pixels].long()
        slopes = self._slopes[self._slopes_at[view] + pixels - self._first[view]]
        toward = torch.cat([slopes, torch.ones_like(slopes[:, :1])], dim=1)
        length = toward.norm(dim=1)
        toward = (self._rotation[view] @ (toward / length[:, None])[:, :, None])[:, :, 0]
        return Rays(self._origin_m[view], toward, 1.0 / length, self._ahead_m[view])

    def pixels(self, pixels: Tensor) -> Pixels:
        return Pixels(self._colour[pixels], self._depth_m[pixels], self._sigma_m[pixels])
