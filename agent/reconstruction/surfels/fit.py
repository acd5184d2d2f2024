"""Colours of discs, and the water before them, fitted to pictures by Adam: one picture a step, each once an epoch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import pixel_grid, ray_slopes
from agent.reconstruction.surfels.cloud import Cloud
from agent.reconstruction.surfels.splat import Splats, blended, gathered, pieces_of, splats
from agent.reconstruction.view import View

Floats = NDArray[np.float64]

GAMMA, DARKEST = 1.0 / 2.2, 1e-5  # a picture's tone is (light + DARKEST)^GAMMA, as in the field
TONE_HUBER = 0.1
COLOUR_RATE, WATER_RATE, LAST_RATE = 0.03, 5e-3, 0.1
MOMENTS = (0.9, 0.99)
EVERYTHING = slice(None)
START_WATER = (0.10, 0.15, 0.05)  # b_D, b_B [1/m], B_inf


@dataclass(frozen=True, eq=False)
class Surfels:
    """Discs with their colours, and the water in which they were seen."""

    cloud: Cloud
    colour: Floats  # (n, 3) linear light, red green blue, as without water; NaN: no picture showed it
    water: Floats  # (3, 3) rows b_D, b_B, B_inf; columns red green blue
    pieces: Floats  # of splat.pieces_of


def picture(surfels: Surfels, view: View) -> tuple[Floats, Floats]:
    """Linear light (height, width, 3) and depth (height, width) from a view's pose by its camera; NaN in holes."""
    drawn = splats(surfels.cloud, view, surfels.pieces)
    return _seen(
        blended(drawn, np.nan_to_num(surfels.colour[drawn.numbers])), _range(view, drawn), surfels.water
    ), drawn.depth_m


def fit(cloud: Cloud, views: Sequence[View], epochs: int, done: Callable[[int, int], None], seed: int = 0) -> Surfels:
    """Start at the mean of what pictures show of each disc, then `epochs` times through all of them.

    done(pictures seen, in all) is called after each.
    """
    order, total = np.random.default_rng(seed), (epochs + 1) * len(views)
    sums, shares, pieces = np.zeros((len(cloud.place_m), 3)), np.zeros(len(cloud.place_m)), pieces_of(cloud)
    for n, view in enumerate(views):
        drawn = splats(cloud, view, pieces)
        back = gathered(drawn, view.picture.astype(float))
        sums[drawn.numbers] += back[0]
        shares[drawn.numbers] += back[1]
        done(n + 1, total)
    with np.errstate(invalid="ignore", divide="ignore"):
        colour = np.where(shares[:, None] > 0.0, np.maximum(sums / shares[:, None], 0.0), 0.0)
    water = np.repeat(np.array(START_WATER)[:, None], 3, axis=1)
    of_colour, of_water = _Moments(colour), _Moments(water)
    for n in range(epochs * len(views)):
        if n % len(views) == 0:
            turn = order.permutation(len(views))
        fade = LAST_RATE ** (n / (epochs * len(views)))
        view = views[turn[n % len(views)]]
        here, down_colour, down_water = _gradients(splats(cloud, view, pieces), view, colour, water)
        colour[here] = np.maximum(colour[here] - fade * COLOUR_RATE * of_colour.step(down_colour, here), 0.0)
        water = np.maximum(water - fade * WATER_RATE * of_water.step(down_water, EVERYTHING), 0.0)
        done(len(views) + n + 1, total)
    return Surfels(cloud, np.where(shares[:, None] > 0.0, colour, np.nan), water, pieces)


class _Moments:
    """Adam's (Kingma and Ba 2015), with a count for each disc: a picture tells nothing of those it does not show."""

    def __init__(self, like: Floats) -> None:
        self._first, self._second = np.zeros_like(like), np.zeros_like(like)
        self._count = np.zeros((len(like), 1))

    def step(self, gradient: Floats, where: NDArray[np.int64] | slice) -> Floats:
        """How far to go against it, in rates; gradient: of the rows `where` alone."""
        self._count[where] += 1.0
        first = self._first[where] = MOMENTS[0] * self._first[where] + (1.0 - MOMENTS[0]) * gradient
        second = self._second[where] = MOMENTS[1] * self._second[where] + (1.0 - MOMENTS[1]) * gradient * gradient
        bias = [1.0 - moment ** self._count[where] for moment in MOMENTS]
        return np.asarray(first / bias[0] / (np.sqrt(second / bias[1]) + 1e-12))


def _gradients(drawn: Splats, view: View, colour: Floats, water: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Which discs (m,) one picture shows, and its loss's gradient by their colours (m, 3) and by the water (3, 3)."""
    t, here = _range(view, drawn), blended(drawn, colour[drawn.numbers])
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
    seen = shares > 0.0
    return drawn.numbers[seen], back[seen], np.stack([by_direct, by_scatter, by_veil])


def _range(view: View, drawn: Splats) -> Floats:
    """Way through the water (height, width) to what each pixel shows, m."""
    slopes = ray_slopes(view.camera, pixel_grid(view.camera))
    return np.asarray((drawn.depth_m - view.camera.ahead_m) * np.sqrt(1.0 + (slopes**2).sum(axis=-1)))


def _seen(colour: Floats, range_m: Floats, water: Floats) -> Floats:
    """colour exp(-b_D t) + B_inf (1 - exp(-b_B t))."""
    t = range_m[..., None]
    return np.asarray(colour * np.exp(-water[0] * t) - water[2] * np.expm1(-water[1] * t))
