"""Fit the field to all pictures: a step takes pixels of any of them, and goes against what it sees otherwise.

A picture's tone is what counts, (C + 1e-5)^(1/2.2), by Huber's loss; depths hold the surface where it was found to be,
weakly and robustly. With a number of `steps` the same seed gives the same field on one machine's CPU; with a time it
depends on how far that goes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from agent.reconstruction.field.march import NEAREST_M, Seen, depth, look, search, trace
from agent.reconstruction.field.rays import Bundle, Pixels, Rays
from agent.reconstruction.field.settings import FieldSettings
from agent.reconstruction.field.volume import Field
from agent.reconstruction.view import View

GAMMA, DARKEST = 1.0 / 2.2, 1e-5
TONE_HUBER = 0.1
RATES = {"planes": 2e-2, "net": 2e-3, "water": 5e-3, "sdf": 1.5e-4, "beta": 2e-3}
LAST_RATE = 0.05  # of the rates at the end
WARM_UP = 20  # steps
TRAIN_SAMPLES = 8
BAND_M, WIDE_M = 10e-3, 25e-3  # half of what is sampled about a surface: at the end, and more at the start
SEARCH = (64, 24)  # samples of a ray that nobody knows anything of: to find where, and to see
ROUNDS, AGAIN_ROUNDS = 40, 10  # of tracing a pixel for the first time, and when it is known where it was
BACK_M = 0.03  # how far before that tracing goes on


class Step(NamedTuple):
    """One step of learning."""

    loss: float
    progress: float  # 0 to 1


def tone(light: Tensor) -> Tensor:
    """What a picture shows of linear light."""
    return (light.clamp_min(0.0) + DARKEST) ** GAMMA


def loss(seen: Seen, rays: Rays, true: Pixels, anchor: float) -> Tensor:
    """Of one step's rays: tones, and depths in their own standard deviations."""
    tones = functional.huber_loss(tone(seen.colour), tone(true.colour), delta=TONE_HUBER)
    known = ~torch.isnan(true.depth_m)
    if anchor == 0.0 or not bool(known.any()):
        return tones
    off = (depth(rays, seen.range_m)[known] - true.depth_m[known]) / true.sigma_m[known]
    share = known.sum() / len(known)
    return tones + anchor * TONE_HUBER**2 * share * functional.huber_loss(off, torch.zeros_like(off), delta=1.0)


def learn(field: Field, views: Sequence[View], settings: FieldSettings, now_s: Callable[[], float]) -> Iterator[Step]:
    """Change `field`, which lies on its device, one step an item. `now_s` is not asked where there are `steps`."""
    device = field.sdf_m.device
    bundle, pick = Bundle(views, device), torch.Generator().manual_seed(settings.seed)
    optimiser = _optimiser(field)
    base = [group["lr"] for group in optimiser.param_groups]
    met_m = torch.full((bundle.count,), math.nan, device=device)  # where each pixel's ray met the surface last time
    order, at, step = torch.randperm(bundle.count, generator=pick), 0, 0
    began = now_s() if settings.steps is None else 0.0
    while True:
        progress = step / settings.steps if settings.steps else (now_s() - began) / settings.seconds
        if progress >= 1.0:
            return
        if at + settings.rays > len(order):
            order, at = torch.randperm(bundle.count, generator=pick), 0
        chosen = order[at : at + settings.rays].to(device)
        at += settings.rays
        rays, true = bundle.rays(chosen), bundle.pixels(chosen)
        if settings.start == "nothing":
            offsets = torch.rand((len(chosen), SEARCH[0]), generator=pick).to(device)
            seen = search(field, rays, offsets, SEARCH[1])
            value = loss(seen, rays, true, 0.0)
        else:
            before = met_m[chosen]
            fresh = bool(torch.isnan(before).any())
            start = torch.nan_to_num(before - BACK_M, nan=NEAREST_M).clamp_min(NEAREST_M)
            met = trace(field, rays, start, ROUNDS if fresh else AGAIN_ROUNDS)
            met_m[chosen] = met
            half = BAND_M + WIDE_M * (1.0 - progress)
            offsets = torch.rand((len(chosen), TRAIN_SAMPLES), generator=pick).to(device)
            seen = look(field, rays, (met - half).clamp_min(NEAREST_M), met + half, offsets)
            value = loss(seen, rays, true, settings.anchor)
        for group, rate in zip(optimiser.param_groups, base, strict=True):
            group["lr"] = rate * min(1.0, (step + 1) / WARM_UP) * LAST_RATE**progress
        optimiser.zero_grad()
        value.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        step += 1
        yield Step(value.item(), progress)


def _optimiser(field: Field) -> torch.optim.Adam:
    parts = {
        "planes": [*field.planes, *field.lines],
        "net": [*field.inner.parameters(), *field.outer.parameters()],
        "water": [field.water],
        "sdf": [field.sdf_m],
        "beta": [field.log_beta],
    }
    groups = [{"params": parts[name], "lr": rate} for name, rate in RATES.items()]
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-10, fused=field.sdf_m.device.type in ("cpu", "cuda"))
