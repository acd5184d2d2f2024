"""Make a frame look as if there were less water: with the network where it is installed, and how fast; else without.

    plain    the network as it is trained
    folded   the same with fewer steps: equal to rounding
    fast     the network on a small picture, its colours carried to the full one
    classic  grey-world white balance and CLAHE: needs neither torch nor weights
    auto     the first of folded, fast and classic that keeps a budget on this machine, by measurement; without a
             budget fast, or classic where there is no network

Pictures are (height, width, 3) uint8, blue green red. It serves colour and the eye. Clarity is taken on the raw frame:
a gain that depends on the whole picture changes from one lens position to the next. `OnDemandEnhancer` serves the
vision worker, whose frames must not be late for it.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.config import ConfigError, to_install
from hw.camera.camera import Frame
from hw.compiled import compiled

if TYPE_CHECKING:
    from agent.perception.enhancement.lu2net import LU2Net

Variant = Literal["plain", "folded", "fast", "classic", "auto"]
Image = NDArray[np.uint8]

# --- what needs nothing ---
#
# Water takes red first. A picture in which red reaches as far as it would in air, and in which some bright things are
# warm, lacks nothing that an enhancement could bring back: its blue is the water's own, and stays. None of 108 real
# pictures that were made better by people passes both, and 99 of what people made of them do. What is burnt out has
# lost its colour and has no say: the white sky above green water is as red as it is blue.

BURNT = 250  # of 255: where the brightest colour reaches it, nothing is known of the others
RED_RANGE = (0.55, 0.65)  # from the darkest hundredth to the brightest, full scale 1: below no, above yes
WARM_SHARE = (0.01, 0.04)  # of the pixels
WARM, BRIGHT = 0.95, 0.25  # red against the stronger of the others; full scale 1


def needs_nothing(image: Image) -> float:
    """From 0, enhance it, to 1, leave it as it is; between them, so much of it stays."""
    return share_kept(np.asarray(shrunk(image, SMALL_PX), np.float32) / np.float32(255))


def share_kept(seen: Floats) -> float:
    """The same of a small picture (h, w, 3), full scale 1."""
    brightest = seen.max(axis=2)
    blue, green, red = cv2.split(seen)
    known = brightest < np.float32(BURNT / 255)
    if not known.any():
        return 1.0
    dark, bright = np.percentile(red[known], (1, 99))
    warm = known & (red >= WARM * cv2.max(blue, green)) & (brightest > BRIGHT)
    return min(_ramp(bright - dark, *RED_RANGE), _ramp(float(warm.mean()), *WARM_SHARE))


def _ramp(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)


def sparing(way: Callable[[Image], Image]) -> Callable[[Image], Image]:
    """The same for a picture that needs it; of one that does not, so much stays as it is."""

    def apply(image: Image) -> Image:
        kept = needs_nothing(image)
        if kept == 1.0:
            return image.copy()
        after = way(image)
        return after if kept == 0.0 else np.asarray(cv2.addWeighted(image, kept, after, 1.0 - kept, 0.0), np.uint8)

    return apply


# --- classic: white balance and local contrast, which the network has to beat ---

MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour
CLIP_LIMIT, TILES = 2.0, (8, 8)  # CLAHE: steep enough to lift the veil, shallow enough not to lift the noise


def white_balance(image: Image) -> Image:
    """Scale the planes to one mean (grey world). Burnt-out pixels do not vote."""
    votes = (image.max(axis=2) < BURNT).astype(np.uint8)
    mean = np.array(cv2.mean(image, votes)[:3])
    gain = np.clip(mean.mean() / np.maximum(mean, 1.0), 1.0 / MAX_GAIN, MAX_GAIN)
    table = np.clip(np.arange(256.0)[:, None] * gain[None, :] + 0.5, 0, 255).astype(np.uint8)
    return cv2.LUT(image, table[:, None, :])  # type: ignore[return-value]


def clahe(image: Image) -> Image:
    """Contrast-limited adaptive histogram equalisation (Zuiderveld 1994) of the lightness; colours stay."""
    lab = cv2.cvtColor(image, cv2.COLOR_BGR2LAB)
    lab[:, :, 0] = cv2.createCLAHE(CLIP_LIMIT, TILES).apply(np.ascontiguousarray(lab[:, :, 0]))
    return cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)  # type: ignore[return-value]


def classic(image: Image) -> Image:
    """Both, one after the other."""
    return clahe(white_balance(image))


# --- fast: colours that are estimated small and carried to the full picture ---
#
# The network sees the picture shrunk to SMALL_PX pixels. What it does to each colour there is written as an affine
# function of the three colours, one for each pixel, by a guided filter (He, Sun and Tang 2013, with colour as the
# guide) at the small size (He and Sun 2015). Edges stay where they are in the frame itself: only coefficients, which
# are smooth, are enlarged.
#
# What a window says nothing of, such as a red that only one pixel of it has, the network's white balance of the whole
# picture says: the filter is fitted to what the network does beyond a gain per colour. So a small vivid thing is not
# painted in the colours of its surroundings.
#
# What is brightest is the light itself, or nearest to it: glitter, white sand. Where it was bluish or greenish and
# would come out red, the picture is mostly open water, whose colour the balance takes for a tint: red is given less
# for all.
#
# The coefficients outlive their frame: while camera and scene stand still, as in a focus sweep, the same ones serve
# every frame and every part of one, for a few milliseconds each.

Floats = NDArray[np.float32]

SMALL_PX = 160 * 120  # that the network sees: near what it was trained on (PSNR falls above), and cheap
# Of the windows, small pixels; smaller ones smear the outline of a vivid thing over its surroundings. At 16 it is
# 0.3 dB farther from real references; pairs of our own making, whose veil grows with range, tell no difference.
RADIUS = 32
EPSILON = 1e-3  # variance of a colour (full scale 1) below which a window says little of it, and the balance stands
MAX_BALANCE = 4.0  # gain: a colour that is weaker in the whole picture is noise
BRIGHTEST = 0.02  # share of the pixels that tell the light; from 0.01 to 0.1 it makes no difference to real pairs
MANY = 0.5  # share of the brightest that have red as their weakest colour; 0.25 to 0.75 makes no difference to them


class Colours(NamedTuple):
    """What to do with every colour, for a frame of `size`."""

    affine: Floats  # (h, w, 3, 4): output blue green red from input blue green red and one, full scale 1
    size: tuple[int, int]  # width, height of the full frame, pixels


def estimate_colours(image: Image, network: Callable[[Image], Floats]) -> Colours:
    """`network` maps a picture (h, w, 3) uint8 to one of float32, full scale 1, both blue green red."""
    height, width = image.shape[:2]
    small = shrunk(image, SMALL_PX)
    guide = np.asarray(small, np.float32) / np.float32(255)
    wanted = network(np.ascontiguousarray(small, np.uint8))
    gain = balance(guide, wanted)
    affine = guided_filter(guide, np.asarray(wanted - gain * guide, np.float32))
    for c in range(3):
        affine[:, :, c, c] += gain[c]
    affine[:, :, 2] *= red_share(guide, affine)
    kept = np.float32(share_kept(guide))
    affine *= 1 - kept
    for c in range(3):
        affine[:, :, c, c] += kept
    return Colours(affine, (width, height))


def shrunk(image: Image, most_px: int) -> Image:
    """The whole picture in about so many pixels at most."""
    height, width = image.shape[:2]
    shrink = max(1.0, math.sqrt(height * width / most_px))
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    return (
        image
        if size == (width, height)
        else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    )


def balance(guide: Floats, wanted: Floats) -> Floats:
    """(3,) gain per colour that takes the mean of one picture to that of the other."""
    means = wanted.mean((0, 1)) / np.maximum(guide.mean((0, 1)), 1e-3)
    return np.asarray(np.clip(means, 0, MAX_BALANCE), np.float32)


def red_share(guide: Floats, affine: Floats) -> np.float32:
    """Share of the red at which the brightest pixels, if red is their weakest colour before, are not red after."""
    blue, green, red = cv2.split(guide)
    bright = cv2.max(cv2.max(blue, green), red).ravel()
    top = np.argpartition(bright, -(count := math.ceil(BRIGHTEST * bright.size)))[-count:]
    cold = top[(red < cv2.min(blue, green)).ravel()[top]]
    if len(cold) < MANY * len(top):
        return np.float32(1)
    light = np.insert(guide.reshape(-1, 3)[cold], 3, 1, axis=1)
    after = np.einsum("nij,nj->ni", affine.reshape(-1, 3, 4)[cold], light).mean(axis=0)
    return np.float32(min(1.0, after[:2].max() / max(after[2], 1e-3)))


def apply_colours(colours: Colours, image: Image, origin: tuple[int, int] = (0, 0)) -> Image:
    """A frame, or the part of one whose upper left pixel is `origin` (x, y), with its colours restored."""
    out = np.empty_like(image)
    _apply(colours.affine, colours.size[0], colours.size[1], np.ascontiguousarray(image), origin[0], origin[1], out)
    return out


def guided_filter(guide: Floats, wanted: Floats) -> Floats:
    """(h, w, 3) and (h, w, 3) -> (h, w, 3, 4): in each window the affine map with the least squared error, averaged
    over the windows that hold a pixel."""
    window = (2 * RADIUS + 1, 2 * RADIUS + 1)

    def mean(x: Floats) -> Floats:
        return np.asarray(cv2.blur(x, window, borderType=cv2.BORDER_REFLECT_101), np.float32).reshape(x.shape)

    i, j = np.triu_indices(3)
    around, target = mean(guide), mean(wanted)
    upper = mean(guide[..., i[:3]] * guide[..., j[:3]]), mean(guide[..., i[3:]] * guide[..., j[3:]])
    covariance = np.concatenate(upper, axis=2) - around[..., i] * around[..., j]
    cross = np.stack([mean(guide * wanted[..., c : c + 1]) - around * target[..., c : c + 1] for c in range(3)], axis=2)
    affine = np.empty((*guide.shape, 4), np.float32)
    _solve(covariance, cross, around, target, EPSILON, affine)
    return np.stack([mean(np.ascontiguousarray(affine[:, :, c])) for c in range(3)], axis=2)


@compiled()
def _solve(covariance: Floats, cross: Floats, around: Floats, target: Floats, epsilon: float, affine: Floats) -> None:
    """slope = (covariance + epsilon)^-1 cross by cofactors, offset = target - slope around; in float64."""
    for y in range(affine.shape[0]):
        for x in range(affine.shape[1]):
            v = covariance[y, x]
            a, b, c = v[0] + epsilon, np.float64(v[1]), np.float64(v[2])
            d, e, f = v[3] + epsilon, np.float64(v[4]), v[5] + epsilon
            aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
            dd, de, ff = a * f - c * c, b * c - a * e, a * d - b * b
            scale = 1.0 / (a * aa + b * ab + c * ac)
            for o in range(3):
                p, q, r = cross[y, x, o]
                first = scale * (aa * p + ab * q + ac * r)
                second = scale * (ab * p + dd * q + de * r)
                third = scale * (ac * p + de * q + ff * r)
                affine[y, x, o, 0], affine[y, x, o, 1], affine[y, x, o, 2] = first, second, third
                mean = around[y, x]
                affine[y, x, o, 3] = target[y, x, o] - (first * mean[0] + second * mean[1] + third * mean[2])


@compiled(fastmath=True)
def _apply(affine: Floats, width: int, height: int, image: Image, x0: int, y0: int, out: Image) -> None:
    """Coefficients between the centres of small pixels are linear in x and y; beyond the outermost they stay."""
    rows, cols = affine.shape[:2]
    left = np.empty(image.shape[1], np.int64)
    share = np.empty(image.shape[1], np.float32)
    for u in range(image.shape[1]):
        x = min(max((x0 + u + 0.5) * cols / width - 0.5, 0.0), cols - 1.0)
        left[u] = min(int(x), max(cols - 2, 0))
        share[u] = x - left[u]
    row = np.empty((cols + 1, 12), np.float32)
    for v in range(image.shape[0]):
        y = min(max((y0 + v + 0.5) * rows / height - 0.5, 0.0), rows - 1.0)
        top = min(int(y), max(rows - 2, 0))
        below, s = min(top + 1, rows - 1), np.float32(y - top)
        for k in range(cols):
            for c in range(3):
                for d in range(4):
                    a = affine[top, k, c, d]
                    row[k, 4 * c + d] = a + s * (affine[below, k, c, d] - a)
        row[cols] = row[cols - 1]
        for u in range(image.shape[1]):
            near, far, t = row[left[u]], row[left[u] + 1], share[u]
            b, g, r = np.float32(image[v, u, 0]), np.float32(image[v, u, 1]), np.float32(image[v, u, 2])
            for c in range(3):
                k = 4 * c
                first = near[k] * b + near[k + 1] * g + near[k + 2] * r + near[k + 3] * np.float32(255)
                second = far[k] * b + far[k + 1] * g + far[k + 2] * r + far[k + 3] * np.float32(255)
                value = first + t * (second - first)
                out[v, u, c] = np.uint8(min(max(value, np.float32(0)), np.float32(255)) + np.float32(0.5))


# --- the ways, and the choice between them ---

BUDGET_MS = 33.0  # of one frame: 30 frames per second
TRIALS = 5  # of each variant, on a frame of TRIAL_SIZE; the first one warms up and does not count
TRIAL_SIZE = (480, 640)
WEIGHTS = Path(str(resources.files("agent.perception.enhancement"))) / "weights"
DEFAULT = "real.safetensors"  # of the shipped weights: nearer to references on scenes held out; see weights/README.md


class Enhancer(NamedTuple):
    """A chosen way: `estimate` is None unless the way is `fast`, whose two halves can be used apart."""

    variant: Variant
    apply: Callable[[Image], Image]
    estimate: Callable[[Image], Colours] | None = None
    why: str = ""  # it is this one; a line for the user where it is not what was wished for


def enhance(image: Image) -> Image:
    """The default way: fast where the network is installed, else classic."""
    return default().apply(image)


@cache
def default() -> Enhancer:
    """Fast where torch and weights are there, else classic, and `why`; the same on a slow machine as on a quick one.

    The weights are read at the first call, which takes seconds.
    """
    return enhancer("auto", budget_ms=None)


def one_thread() -> None:
    """Keep the network to the calling thread; torch keeps the number for each thread."""
    if find_spec("torch") is not None:
        import torch

        torch.set_num_threads(1)


def enhancer(variant: Variant = "auto", weights: Path | None = None, budget_ms: float | None = BUDGET_MS) -> Enhancer:
    """The way called `variant`, with the shipped weights if none are given; reads the weights and may take seconds.

    `budget_ms` is for `auto`, of one frame; None where nothing waits for the picture.
    Raises ConfigError for weights that cannot be used, and where the network was asked for by name and is not there.
    """
    if variant == "classic":
        return Enhancer("classic", sparing(classic))
    if weights is not None and not weights.is_file():  # said before torch, whose import takes seconds
        raise ConfigError(f"{weights}: no such file; give weights that `aucamp train` wrote, hash beside, or .pth")
    if (lacking := missing(weights)) is not None:
        if variant != "auto" or weights is not None:
            raise ConfigError(f"--variant {variant}: {lacking}; --variant classic needs neither")
        return Enhancer("classic", sparing(classic), why=f"{lacking}; grey-world and CLAHE instead")
    from agent.perception.enhancement.lu2net import load

    net = load(weights or shipped_weights())
    if variant != "auto":
        return network_enhancer(net, variant)
    return network_enhancer(net, "fast") if budget_ms is None else choose(net, budget_ms)


def network_enhancer(net: LU2Net, variant: Variant) -> Enhancer:
    """A network that is in memory, in one of its three ways."""
    from agent.perception.enhancement import lu2net

    if variant != "fast":
        machine.keep_memory()
    if variant == "plain":
        return Enhancer(variant, sparing(lambda image: lu2net.run(net, image)))
    quick = lu2net.fold(net)
    if variant == "folded":
        return Enhancer(variant, sparing(lambda image: lu2net.to_image(lu2net.forward(quick, lu2net.to_tensor(image)))))

    def colours(image: Image) -> NDArray[np.float32]:
        rgb = lu2net.forward(quick, lu2net.to_tensor(image))[0].clamp(0, 1).permute(1, 2, 0).numpy()
        return np.ascontiguousarray(rgb[:, :, ::-1])

    def estimate(image: Image) -> Colours:
        return estimate_colours(image, colours)

    return Enhancer("fast", lambda image: apply_colours(estimate(image), image), estimate)


def choose(
    net: LU2Net, budget_ms: float, shape: tuple[int, int] = TRIAL_SIZE, clock: Callable[[], float] = machine.stopwatch_s
) -> Enhancer:
    """The most faithful way whose median on a frame of `shape` keeps the budget; `clock` in seconds."""
    frame = np.random.Generator(np.random.PCG64(0)).integers(0, 256, (*shape, 3), dtype=np.uint8)
    tried = []
    for way in (network_enhancer(net, "folded"), network_enhancer(net, "fast")):
        took_ms = 1e3 * _median_s(lambda way=way: way.apply(frame), clock)  # type: ignore[misc]
        tried.append(f"{way.variant} {took_ms:.0f} ms")
        if took_ms <= budget_ms:
            return way._replace(why=f"{', '.join(tried)} of {budget_ms:.0f} ms")
    return Enhancer("classic", sparing(classic), why=f"{', '.join(tried)}, over the budget of {budget_ms:.0f} ms")


def missing(weights: Path | None) -> str | None:
    """What the network lacks on this machine, in words."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        return f"torch or safetensors is not installed ({to_install('enhance')})"
    if weights is None and not shipped_weights().is_file():
        return "no weights are shipped with this version (give some with --weights)"
    return None


def shipped_weights() -> Path:
    return WEIGHTS / DEFAULT


def shipped_files() -> dict[str, Path]:
    """All weights that come with the package, by name."""
    return {file.stem: file for file in sorted(WEIGHTS.glob("*.safetensors"))}


def _median_s(work: Callable[[], object], clock: Callable[[], float]) -> float:
    times = []
    for _ in range(TRIALS):
        start = clock()
        work()
        times.append(clock() - start)
    return statistics.median(times[1:])


# --- on demand: what the vision worker looks at with `[camera] enhance = true` ---
#
# A target is looked for in the frame as it came, and where that shows none in the enhanced frame as well
# (docs/experiments.md, Detection, has the figures).
#
# An estimate of the colours costs tens of milliseconds, its use on a frame one or two. So a whole frame gives a new
# estimate when one is due, and all others use the newest: the frames and parts of frames of a focus sweep are treated
# alike, whatever their blur. When no estimate is young enough, because the processor is busy elsewhere, a frame is
# shown raw and counted. The classic way has no such halves and treats each frame by itself.
#
# Previews come from here as well: their estimates serve vision, and vision's serve them.

DUE_NS = 200_000_000  # between estimates: each idle frame (0.25 s apart) has its own, a sweep of a second a few
OLD_NS = 3_000_000_000  # older colours belong to another view: the longest sweep, and no more
SHARE = 0.25  # of one core that estimates may take; three agents share two cores with twin and firmware

T = TypeVar("T")


def raw_else_enhanced(find: Callable[[Image], T | None], image: Image, enhanced: Callable[[], Image]) -> T | None:
    """What `find` sees in the frame as it came, else in the enhanced one."""
    found = find(image)
    return found if found is not None else find(enhanced())


class OnDemandEnhancer:
    """One camera's frames, enhanced; one thread uses it at a time. `way`: the machine's best if none is given."""

    def __init__(self, way: Enhancer | None = None, clock: Callable[[], float] = machine.stopwatch_s) -> None:
        self._way = way
        self._clock = clock  # seconds
        self._colours: Colours | None = None
        self._estimated_ns = 0  # time of the frame that gave them
        self._last: tuple[Frame, Image] | None = None
        self._raw_sufficed = True  # for the last frame that was looked at
        self._rest_s = 0.0  # no estimate before this time of `clock`
        self.frames = 0
        self.raw = 0  # of them, shown as they came

    def wants_whole(self, t_ns: int) -> bool:
        """Whether a frame taken about now should be read whole: it will be enhanced, and the colours are aging."""
        estimates = self._way is not None and self._way.estimate is not None
        return estimates and not self._raw_sufficed and self._age_ns(t_ns) > OLD_NS // 2

    def look(self, find: Callable[[Image], T | None], frame: Frame, whole: tuple[int, int]) -> T | None:
        """What `find` sees in the frame, or in the part of one; `whole`: (width, height) of the camera."""
        self._raw_sufficed = True

        def enhanced() -> Image:
            self._raw_sufficed = False
            return self.view(frame, whole)

        return raw_else_enhanced(find, frame.image, enhanced)

    def view(self, frame: Frame, whole: tuple[int, int]) -> Image:
        """The frame, or the part of one, enhanced if that can be had in time; `whole`: (width, height) of the camera.

        The same frame again, for another target, costs nothing.
        """
        if self._last is None or frame is not self._last[0]:
            self.frames += 1
            self._last = frame, self._enhanced(frame, whole)
        return self._last[1]

    def _enhanced(self, frame: Frame, whole: tuple[int, int]) -> Image:
        way = self._way = self._way or default()
        if way.estimate is None:
            return way.apply(frame.image)
        if (frame.roi.width, frame.roi.height) == whole and self._due(frame.t_ns):
            start_s = self._clock()
            self._colours, self._estimated_ns = way.estimate(frame.image), frame.t_ns
            took_s = self._clock() - start_s
            self._rest_s = start_s + took_s / SHARE
        if self._colours is None or self._colours.size != whole or self._age_ns(frame.t_ns) > OLD_NS:
            self.raw += 1
            return frame.image
        return apply_colours(self._colours, frame.image, (frame.roi.x, frame.roi.y))

    def _due(self, t_ns: int) -> bool:
        return self._age_ns(t_ns) >= DUE_NS and self._clock() >= self._rest_s

    def _age_ns(self, t_ns: int) -> int:
        """Age of the colours; a camera that starts again counts from anew."""
        return OLD_NS + 1 if self._colours is None or t_ns < self._estimated_ns else t_ns - self._estimated_ns
