"""The image model as a field: distances to the surface, colours and water, learnt by rendering along rays (torch).

A field starts from the surface of all views' depths. It learns from the pixels of all views for as long as it is given,
and then shows the scene from any pose: picture and depths. `learnt` does all of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from agent.process.command import Progress
from agent.reconstruction.bricks import SIDE
from agent.reconstruction.fusion import fuse
from agent.reconstruction.held_back import ImageModel, Pictures
from agent.reconstruction.views import View, pixel_grid, ray_slopes, stacked

# --- all pixels of all views as tensors on one device, so that a step takes any of them ---

LEAST_SIGMA_M = 2e-3  # of a depth that anchors: a smaller sigma is seldom right


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


# --- from distances to a surface to what a ray sees of it: density, weights, water ---
#
# Nothing here is learnt. Density is that of VolSDF (Yariv et al. 2021, arXiv 2106.12052); water is that of SeaThru-NeRF
# (Levy et al. 2023, arXiv 2304.07743), where all there is lies at the surface. Distances in metres, positive outside.

LEAST_TOTAL = 1e-6  # of weights: a ray that meets nothing has its weights divided by this, not by nothing


def density(sdf_m: Tensor, beta_m: Tensor) -> Tensor:
    """Density [1/m] at these distances: the distribution function of Laplace's law of scale beta, over beta."""
    half = 0.5 * torch.exp(-sdf_m.abs() / beta_m)
    return torch.where(sdf_m > 0, half, 1.0 - half) / beta_m


def ray_weights(sigma: Tensor, step_m: Tensor) -> Tensor:
    """Share (n, s) of what is seen that comes from each piece of a ray, of density (n, s) and length (n, s) or (n, 1).

    They add up to 1: no ray of ours ends in open water, or the lens would have told no distance there.
    """
    opacity = 1.0 - torch.exp(-sigma * step_m)
    clear = torch.cumprod(1.0 - opacity + 1e-10, dim=1)
    before = torch.cat([torch.ones_like(clear[:, :1]), clear[:, :-1]], dim=1)
    weights = opacity * before
    return weights / weights.sum(dim=1, keepdim=True).clamp_min(LEAST_TOTAL)


def through_water(colour: Tensor, range_m: Tensor, direct: Tensor, scatter: Tensor, veil: Tensor) -> Tensor:
    """Light (..., 3) that arrives from surfaces of `colour` (..., 3) at `range_m` (...).

    colour exp(-b_D t) + B_inf (1 - exp(-b_B t)); direct b_D and scatter b_B [1/m], veil B_inf, all (3,).
    """
    t = range_m[..., None]
    return colour * torch.exp(-direct * t) - veil * torch.expm1(-scatter * t)


# --- what is learnt: distances on a grid, colours as products of planes and lines, the water, and beta ---
#
# Colours are three sums of rank 16 (TensoRF's vector and matrix factors, Chen et al. 2022, arXiv 2203.09517), read by
# a small network. All of it lives on one device, whichever it is.

RANK = 16
PLANE_M, LINE_M = 3e-3, 6e-3  # cells of the planes, and of their lines
HIDDEN = 32
START_BETA_M, LEAST_BETA_M, MOST_BETA_M = 4e-3, 1.2e-3, 10e-3
PLANE_NOISE, LINE_NOISE = 0.1, 0.2  # of the start; lines begin about 1, so that a plane first reaches all along them
COLOUR_BIAS = -1.0  # softplus of it is 0.31, the middle of a picture in linear light
START_WATER = (0.10, 0.15, 0.05)  # b_D, b_B [1/m], B_inf: clear water
AXES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))  # the two of each plane, and that of its line


class Box(NamedTuple):
    """A grid of points with a value each; the first is at `origin_m`, neighbours are `cell_m` apart."""

    origin_m: tuple[float, float, float]
    cell_m: float
    sdf_m: NDArray[np.float32]  # (nx, ny, nz) positive outside

    @property
    def size_m(self) -> tuple[float, float, float]:
        nx, ny, nz = self.sdf_m.shape
        return (nx - 1) * self.cell_m, (ny - 1) * self.cell_m, (nz - 1) * self.cell_m


class Field(nn.Module):
    """Distances, colours and water of one scene, as functions of places (n, 3) in the world."""

    def __init__(self, start: Box, plane_m: float, line_m: float, seed: int) -> None:
        super().__init__()
        made = torch.Generator().manual_seed(seed)
        self.origin_m: Tensor
        self.size_m: Tensor
        self.register_buffer("origin_m", torch.tensor(start.origin_m, dtype=torch.float32))
        self.register_buffer("size_m", torch.tensor(start.size_m, dtype=torch.float32))
        self.sdf_m = nn.Parameter(torch.from_numpy(np.ascontiguousarray(start.sdf_m, np.float32))[None, None])
        planes, lines = [], []
        for a, b, c in AXES:
            rows, cols = (max(2, math.ceil(start.size_m[k] / plane_m) + 1) for k in (a, b))
            along = max(2, math.ceil(start.size_m[c] / line_m) + 1)
            planes.append(nn.Parameter(PLANE_NOISE * torch.randn((1, RANK, rows, cols), generator=made)))
            lines.append(nn.Parameter(1.0 + LINE_NOISE * torch.randn((1, RANK, along, 1), generator=made)))
        self.planes, self.lines = nn.ParameterList(planes), nn.ParameterList(lines)
        self.inner = nn.Linear(3 * RANK, HIDDEN)
        self.outer = nn.Linear(HIDDEN, 3)
        with torch.no_grad():
            for layer in (self.inner, self.outer):
                bound = math.sqrt(6.0 / layer.in_features)
                layer.weight.copy_((2.0 * torch.rand(layer.weight.shape, generator=made) - 1.0) * bound)
                layer.bias.zero_()
            self.outer.bias.fill_(COLOUR_BIAS)
        # Softplus of these is what counts: coefficients of water are positive.
        raw = [math.log(math.expm1(value)) for value in START_WATER]
        self.water = nn.Parameter(torch.tensor(raw)[:, None].repeat(1, 3))
        self.log_beta = nn.Parameter(torch.tensor(math.log(START_BETA_M)))

    @property
    def beta_m(self) -> Tensor:
        """Width of the density about the surface."""
        return self.log_beta.clamp(math.log(LEAST_BETA_M), math.log(MOST_BETA_M)).exp()

    def unit(self, places_m: Tensor) -> Tensor:
        """Places (..., 3) in the box's own terms, -1 to 1 from side to side."""
        return (places_m - self.origin_m) / self.size_m * 2.0 - 1.0

    def distance(self, places_m: Tensor) -> Tensor:
        """Signed distance (n,) to the surface; beyond the box as at its nearest side."""
        grid = self.unit(places_m).flip(-1)[None, None, None]
        return _sample(self.sdf_m, grid)[0, 0, 0, 0]

    def colour(self, places_m: Tensor) -> Tensor:
        """Linear light (n, 3), red green blue, that leaves the surface there, as it would arrive without water."""
        unit, parts = self.unit(places_m), []
        for (a, b, c), plane, line in zip(AXES, self.planes, self.lines, strict=True):
            on_plane = _sample(plane, unit[:, (b, a)][None, None])[0, :, 0]
            along = torch.stack([torch.zeros_like(unit[:, c]), unit[:, c]], dim=-1)
            parts.append(on_plane * _sample(line, along[None, None])[0, :, 0])
        features = torch.cat(parts).T
        return functional.softplus(self.outer(torch.relu(self.inner(features))))

    def seen(self, colour: Tensor, range_m: Tensor) -> Tensor:
        """What arrives (..., 3) through so much water (...)."""
        direct, scatter, veil = functional.softplus(self.water)
        return through_water(colour, range_m, direct, scatter, veil)


def _sample(values: Tensor, grid: Tensor) -> Tensor:
    return functional.grid_sample(values, grid, mode="bilinear", padding_mode="border", align_corners=True)


# --- where rays meet the surface, and what they see about it ---

NEAREST_M = 0.03  # no surface is nearer: the port and what is before it
STRIDE, LEAST_STRIDE_M = 0.9, 2e-3  # share of the distance that a step may go, and how far it goes at least
HIT_M = 1.5e-3
NEGLIGIBLE = 0.003  # weight of a sample below which its colour is not asked for: a hundredth of a tone at most


class Seen(NamedTuple):
    """What rays (n,) see."""

    colour: Tensor  # (n, 3) linear light
    range_m: Tensor  # (n,) along the ray, mean over its samples' weights


@torch.no_grad()
def trace(field: Field, rays: Rays, start_m: Tensor, rounds: int) -> Tensor:
    """Range (n,) at which each ray meets the surface, going on from `start_m` (n,), or where it leaves the box."""
    leave = leaving(field, rays)
    t = torch.minimum(start_m, leave)
    for _ in range(rounds):
        s = field.distance(rays.origin_m + t[:, None] * rays.toward)
        t = torch.where(s < HIT_M, t, torch.minimum(t + STRIDE * s.clamp_min(LEAST_STRIDE_M), leave))
    return t


def leaving(field: Field, rays: Rays) -> Tensor:
    """Range (n,) at which rays that begin in the box leave it; NEAREST_M at least."""
    low, high = field.origin_m, field.origin_m + field.size_m
    side = torch.where(rays.toward > 0, high, low)
    across = (side - rays.origin_m) / torch.where(rays.toward.abs() < 1e-9, 1e-9, rays.toward)
    return across.amin(dim=1).clamp_min(NEAREST_M)


def look(field: Field, rays: Rays, near_m: Tensor, far_m: Tensor, offsets: Tensor) -> Seen:
    """Sample rays between near and far (n,), one sample in each of as many equal pieces as `offsets` (n, s) has.

    offsets: place of each sample within its piece, 0 to 1.
    """
    step = (far_m - near_m) / offsets.shape[1]
    t = near_m[:, None] + (torch.arange(offsets.shape[1], device=offsets.device) + offsets) * step[:, None]
    return _mean(field, rays, t, step[:, None])


def _distance(field: Field, rays: Rays, t: Tensor) -> Tensor:
    return field.distance(_places(rays, t).reshape(-1, 3)).reshape(t.shape)


def _places(rays: Rays, t: Tensor) -> Tensor:
    return rays.origin_m[:, None] + t[..., None] * rays.toward[:, None]


def _mean(field: Field, rays: Rays, t: Tensor, step_m: Tensor) -> Seen:
    """Over samples at t (n, s), pieces of length step_m (n, s) or (n, 1), by their weights."""
    weights = ray_weights(density(_distance(field, rays, t), field.beta_m), step_m)
    counts = weights.detach() > NEGLIGIBLE
    row, piece = torch.nonzero(counts, as_tuple=True)
    there = field.seen(field.colour(_places(rays, t)[row, piece]), t[row, piece])
    sums = torch.zeros((len(t), 3), dtype=there.dtype, device=there.device)
    sums = sums.index_add(0, row, weights[row, piece, None] * there)
    total = torch.where(counts, weights, 0.0).sum(dim=1).clamp_min(NEGLIGIBLE)
    return Seen(sums / total[:, None], (weights * t).sum(dim=1))


def depth(rays: Rays, range_m: Tensor) -> Tensor:
    """Depth (n,) from the pivot along the axis."""
    return rays.ahead_m + range_m * rays.forward


# --- fit to all pictures ---
#
# A step takes pixels of any of them, and goes against what it sees otherwise. A picture's tone is what counts,
# (C + 1e-5)^(1/2.2), by Huber's loss; depths hold the surface where it was found to be, weakly and robustly. With a
# number of `steps` the same seed gives the same field on one machine's CPU; with a time it depends on how far that
# goes.

GAMMA, DARKEST = 1.0 / 2.2, 1e-5
TONE_HUBER = 0.1
ANCHOR = 0.01  # weight of the depths that focus and stereo found
RATES = {"planes": 2e-2, "net": 2e-3, "water": 5e-3, "sdf": 1.5e-4, "beta": 2e-3}
LAST_RATE = 0.05  # of the rates at the end
WARM_UP = 20  # steps
TRAIN_SAMPLES = 8
BAND_M, WIDE_M = 10e-3, 25e-3  # half of what is sampled about a surface: at the end, and more at the start
ROUNDS, AGAIN_ROUNDS = 40, 10  # of tracing a pixel for the first time, and when it is known where it was
BACK_M = 0.03  # how far before that tracing goes on


class FieldSettings(NamedTuple):
    """Time is what a field is bought with: it has learnt most of it in a minute, and goes on for ten."""

    seconds: float = 300.0  # of the clock on the wall, for learning alone
    steps: int | None = None  # so many instead, however long they take: the same on each run
    rays: int = 4096  # a step
    seed: int = 0


def tone(light: Tensor) -> Tensor:
    """What a picture shows of linear light."""
    return (light.clamp_min(0.0) + DARKEST) ** GAMMA


def loss(seen: Seen, rays: Rays, true: Pixels, anchor: float) -> Tensor:
    """Of one step's rays: tones, and depths in their own standard deviations."""
    tones = functional.huber_loss(tone(seen.colour), tone(true.colour), delta=TONE_HUBER)
    known = ~torch.isnan(true.depth_m)
    if not bool(known.any()):
        return tones
    off = (depth(rays, seen.range_m)[known] - true.depth_m[known]) / true.sigma_m[known]
    share = known.sum() / len(known)
    return tones + anchor * TONE_HUBER**2 * share * functional.huber_loss(off, torch.zeros_like(off), delta=1.0)


def learn(field: Field, views: Sequence[View], settings: FieldSettings, now_s: Callable[[], float]) -> Iterator[float]:
    """Change `field`, which lies on its device, one step an item: the progress, 0 to 1.

    `now_s` is not asked where there are `steps`.
    """
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
        before = met_m[chosen]
        fresh = bool(torch.isnan(before).any())
        start = torch.nan_to_num(before - BACK_M, nan=NEAREST_M).clamp_min(NEAREST_M)
        met = trace(field, rays, start, ROUNDS if fresh else AGAIN_ROUNDS)
        met_m[chosen] = met
        half = BAND_M + WIDE_M * (1.0 - progress)
        offsets = torch.rand((len(chosen), TRAIN_SAMPLES), generator=pick).to(device)
        seen = look(field, rays, (met - half).clamp_min(NEAREST_M), met + half, offsets)
        value = loss(seen, rays, true, ANCHOR)
        for group, rate in zip(optimiser.param_groups, base, strict=True):
            group["lr"] = rate * min(1.0, (step + 1) / WARM_UP) * LAST_RATE**progress
        optimiser.zero_grad()
        value.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        step += 1
        yield progress


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


# --- what a camera would see of the field: picture and depths ---

AT_ONCE = 1 << 15  # rays
SAMPLES = 16


@torch.no_grad()
def picture(field: Field, view: View) -> tuple[Pictures, Pictures]:
    """Linear light (height, width, 3) and depth (height, width) from a view's pose by its camera."""
    device = field.sdf_m.device
    bundle = Bundle([view], device)
    colours, depths = [], []
    for first in range(0, bundle.count, AT_ONCE):
        chosen = torch.arange(first, min(first + AT_ONCE, bundle.count), device=device)
        rays = bundle.rays(chosen)
        middles = torch.full((len(chosen), SAMPLES), 0.5, device=device)
        met = trace(field, rays, torch.full_like(rays.forward, NEAREST_M), 2 * ROUNDS)
        seen = look(field, rays, (met - BAND_M).clamp_min(NEAREST_M), met + BAND_M, middles)
        colours.append(seen.colour)
        depths.append(depth(rays, seen.range_m))
    shape = (view.camera.height, view.camera.width)
    return torch.cat(colours).cpu().numpy().reshape(*shape, 3), torch.cat(depths).cpu().numpy().reshape(shape)


# --- the grid that a field starts from: the surface of all depths ---

CELL_M = 7.5e-3  # of the grid; larger where it would have more than MOST_CELLS
MOST_CELLS = 40_000_000  # 160 MB, and three times as much for Adam
TRUNCATED_M = 30e-3  # distances beyond it say no more than that nothing is near
LEAST_WEIGHT = 0.3  # one depth with a sigma of 18 mm


def box_of_views(views: Sequence[View]) -> Box:
    """Distances to the surface that the views' depths show; what is unknown counts as far from everything.

    Raises Failed where they show none.
    """
    stack = stacked(views, 0)
    surface = fuse(stack, CELL_M)
    cells = surface.table.size * SIDE**3
    if cells > MOST_CELLS:
        surface = fuse(stack, CELL_M * (cells / MOST_CELLS) ** (1.0 / 3.0))
    near = np.clip(surface.distance_m, -TRUNCATED_M, TRUNCATED_M)
    bricks = np.full((len(near) + 1, SIDE, SIDE, SIDE), TRUNCATED_M, np.float32)  # the last is that of no brick, -1
    bricks[:-1] = np.where(surface.weight > LEAST_WEIGHT, near, TRUNCATED_M)
    sdf = bricks[surface.table].transpose(0, 3, 1, 4, 2, 5).reshape(SIDE * np.array(surface.table.shape))
    x, y, z = surface.origin_m.tolist()
    return Box((x, y, z), surface.cell_m, sdf)


# --- the whole of it ---

PARTS = 1000  # of the progress: time is no whole number


def learnt(
    views: Sequence[View], settings: FieldSettings, progress: Progress, now_s: Callable[[], float]
) -> ImageModel:
    """A field that has learnt from all views, on a GPU if there is one. now_s: any clock that counts seconds.

    Raises Failed where no view has a depth.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    field = Field(box_of_views(views), PLANE_M, LINE_M, settings.seed).to(device)
    steps = 0
    for part in learn(field, views, settings, now_s):
        steps += 1
        progress(int(PARTS * part), PARTS)
    progress(PARTS, PARTS)
    beta_m = float(field.beta_m.detach())
    clamped = math.isclose(beta_m, MOST_BETA_M, rel_tol=1e-3)
    return ImageModel("field", lambda view: picture(field, view), steps, 1e3 * beta_m, clamped)
