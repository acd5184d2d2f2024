"""Colours of discs, and the water before them, fitted to pictures by Adam: one picture a step, each once an epoch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import pixel_grid, ray_slopes
from agent.reconstruction.surfels.cloud import Cloud
from agent.reconstruction.surfels.splat import Splats, blended, gathered, splats
from agent.reconstruction.view import View

Floats = NDArray[np.float64]

GAMMA, DARKEST = 1.0 / 2.2, 1e-5  # a picture's tone is (light + DARKEST)^GAMMA, as in the field
TONE_HUBER = 0.1
COLOUR_RATE, WATER_RATE, LAST_RATE = 0.03, 5e-3, 0.1
MOMENTS = (0.9, 0.99)
START_WATER = (0.10, 0.15, 0.05)  # b_D, b_B [1/m], B_inf


@dataclass(frozen=True, eq=False)
class Surfels:
    """Discs with their colours, and the water in which they were seen."""

    cloud: Cloud
    colour: Floats  # (n, 3) linear light, red green blue, as without water; NaN: no picture showed it
    water: Floats  # (3, 3) rows b_D, b_B, B_inf; columns red green blue


def picture(surfels: Surfels, view: View) -> tuple[Floats, Floats]:
    """Linear light (height, width, 3) and depth (height, width) from a view's pose by its camera; NaN in holes."""
    drawn = splats(surfels.cloud, view)
    return _seen(blended(drawn, np.nan_to_num(surfels.colour)), _range(view, drawn), surfels.water), drawn.depth_m


def fit(cloud: Cloud, views: Sequence[View], epochs: int, done: Callable[[int, int], None], seed: int = 0) -> Surfels:
    """Start at the mean of what pictures show of each disc, then `epochs` times through all of them.

    done(pictures seen, in all) is called after each.
    """
    order, total = np.random.default_rng(seed), (epochs + 1) * len(views)
    sums, shares = np.zeros((len(cloud.place_m), 3)), np.zeros(len(cloud.place_m))
    for n, view in enumerate(views):
        back = gathered(splats(cloud, view), view.picture.astype(float))
        sums, shares = sums + back[0], shares + back[1]
        done(n + 1, total)
    with np.errstate(invalid="ignore", divide="ignore"):
        colour = np.where(shares[:, None] > 0.0, np.maximum(sums / shares[:, None], 0.0), 0.0)
    water = np.repeat(np.array(START_WATER)[:, None], 3, axis=1)
    adam = [_Moments(colour), _Moments(water)]
    for n in range(epochs * len(views)):
        if n % len(views) == 0:
            turn = order.permutation(len(views))
        fade = LAST_RATE ** (n / (epochs * len(views)))
        down_colour, down_water, seen = _gradients(cloud, views[turn[n % len(views)]], colour, water)
        colour = np.maximum(colour - fade * COLOUR_RATE * adam[0].step(down_colour, seen), 0.0)
        water = np.maximum(water - fade * WATER_RATE * adam[1].step(down_water), 0.0)
        done(len(views) + n + 1, total)
    return Surfels(cloud, np.where(shares[:, None] > 0.0, colour, np.nan), water)


class _Moments:
    """Adam's (Kingma and Ba 2015), with a count for each disc: a picture tells nothing of those it does not show."""

    def __init__(self, like: Floats) -> None:
        self._first, self._second = np.zeros_like(like), np.zeros_like(like)
        self._count = np.zeros((len(like), 1))

    def step(self, gradient: Floats, seen: NDArray[np.bool_] | None = None) -> Floats:
        """How far to go against it, in rates; nothing where it is not `seen` (n,)."""
        where = np.ones(len(gradient), bool) if seen is None else seen
        g = gradient[where]
        self._count[where] += 1.0
        first = self._first[where] = MOMENTS[0] * self._first[where] + (1.0 - MOMENTS[0]) * g
        second = self._second[where] = MOMENTS[1] * self._second[where] + (1.0 - MOMENTS[1]) * g * g
        bias = [1.0 - moment ** self._count[where] for moment in MOMENTS]
        away = np.zeros_like(gradient)
        away[where] = first / bias[0] / (np.sqrt(second / bias[1]) + 1e-12)
        return away


def _gradients(cloud: Cloud, view: View, colour: Floats, water: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Of one picture's loss by colours (n, 3) and water (3, 3), and which discs (n,) it shows."""
    drawn = splats(cloud, view)
    t, here = _range(view, drawn), blended(drawn, colour)
    light = _seen(here, t, water)
    good = np.isfinite(light)
    shown = np.maximum(np.where(good, light, 0.5), 0.0)
    off = (shown + DARKEST) ** GAMMA - (np.maximum(view.picture, 0.0) + DARKEST) ** GAMMA
    down = np.clip(off, -TONE_HUBER, TONE_HUBER) * GAMMA * (shown + DARKEST) ** (GAMMA - 1.0) * good
    t = np.nan_to_num(t)[..., None]
    arrives, cleared = np.exp(-water[0] * t), np.exp(-water[1] * t)
    back, shares = gathered(drawn, down * arrives)
    by_direct = -(down * np.nan_to_num(here) * arrives * t).sum(axis=(0, 1))
    by_scatter = (down * water[2] * cleared * t).sum(axis=(0, 1))
    by_veil = (down * (1.0 - cleared)).sum(axis=(0, 1))
    return back, np.stack([by_direct, by_scatter, by_veil]), shares > 0.0


def _range(view: View, drawn: Splats) -> Floats:
    """Way through the water (height, width) to what each pixel shows, m."""
    slopes = ray_slopes(view.camera, pixel_grid(view.camera))
    return np.asarray((drawn.depth_m - view.camera.ahead_m) * np.sqrt(1.0 + (slopes**2).sum(axis=-1)))


def _seen(colour: Floats, range_m: Floats, water: Floats) -> Floats:
    """colour exp(-b_D t) + B_inf (1 - exp(-b_B t))."""
    t = range_m[..., None]
    return np.asarray(colour * np.exp(-water[0] * t) - water[2] * np.expm1(-water[1] * t))
