"""Make a frame look as if there were less water: with the network where it is installed, and how fast; else without.

    plain    the network as it is trained
    folded   the same with fewer steps: equal to rounding
    fast     the network on a small picture, its colours carried to the full one
    classic  grey-world white balance and CLAHE: needs neither torch nor weights
    auto     the first of folded, fast and classic that keeps a budget on this machine, by measurement; fast, or
             classic where there is no network, for whoever has no budget

Pictures are (height, width, 3) uint8, blue green red. It serves colour and the eye. Clarity is taken on the raw frame:
a gain that depends on the whole picture changes from one lens position to the next.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.config import ConfigError
from agent.perception.enhancement import fast_enhance
from agent.perception.enhancement.grey_world import Image, classic
from agent.perception.enhancement.variants import Variant

if TYPE_CHECKING:
    from agent.perception.enhancement.lu2net import LU2Net

BUDGET_MS = 33.0  # of one frame: 30 frames per second
TRIALS = 5  # of each variant, on a frame of TRIAL_SIZE; the first one warms up and does not count
TRIAL_SIZE = (480, 640)
WEIGHTS = Path(str(resources.files("agent.perception.enhancement"))) / "weights"
DEFAULT = "real.safetensors"  # of the shipped weights: nearer to references on scenes held out; see weights/README.md


class Enhancer(NamedTuple):
    """A chosen way: `estimate` is None unless the way is `fast`, whose two halves can be used apart."""

    variant: Variant
    apply: Callable[[Image], Image]
    estimate: Callable[[Image], fast_enhance.Colours] | None = None
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
    """Whoever calls this keeps the network to its own thread; torch keeps the number for each thread."""
    if find_spec("torch") is not None:
        import torch

        torch.set_num_threads(1)


def enhancer(variant: Variant = "auto", weights: Path | None = None, budget_ms: float | None = BUDGET_MS) -> Enhancer:
    """The way called `variant`, with the shipped weights if none are given; reads the weights and may take seconds.

    `budget_ms` is for `auto`, of one frame; None where nothing waits for the picture.
    Raises ConfigError for weights that cannot be used, and where the network was asked for by name and is not there.
    """
    if variant == "classic":
        return Enhancer("classic", classic)
    if weights is not None and not weights.is_file():  # said before torch, whose import takes seconds
        raise ConfigError(
            f"{weights}: no such file; give weights that `aucamp train enhance` wrote, hash beside, or .pth"
        )
    if (lacking := missing(weights)) is not None:
        if variant != "auto" or weights is not None:
            raise ConfigError(f"--variant {variant}: {lacking}; --variant classic needs neither")
        return Enhancer("classic", classic, why=f"{lacking}; grey-world and CLAHE instead")
    from agent.perception.enhancement.lu2net import load

    net = load(weights or shipped_weights())
    if variant != "auto":
        return network_enhancer(net, variant)
    return network_enhancer(net, "fast") if budget_ms is None else choose(net, budget_ms)


def network_enhancer(net: LU2Net, variant: Variant) -> Enhancer:
    """A network that is in memory, in one of its three ways."""
    from agent.perception.enhancement import folded_lu2net, lu2net

    if variant == "plain":
        return Enhancer(variant, lambda image: lu2net.run(net, image))
    quick = folded_lu2net.fold(net)
    if variant == "folded":
        return Enhancer(variant, lambda image: lu2net.to_image(folded_lu2net.forward(quick, lu2net.to_tensor(image))))

    def colours(image: Image) -> NDArray[np.float32]:
        rgb = folded_lu2net.forward(quick, lu2net.to_tensor(image))[0].clamp(0, 1).permute(1, 2, 0).numpy()
        return np.ascontiguousarray(rgb[:, :, ::-1])

    def estimate(image: Image) -> fast_enhance.Colours:
        return fast_enhance.estimate_colours(image, colours)

    return Enhancer("fast", lambda image: fast_enhance.apply_colours(estimate(image), image), estimate)


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
    return Enhancer("classic", classic, why=f"{', '.join(tried)}, over the budget of {budget_ms:.0f} ms")


def missing(weights: Path | None) -> str | None:
    """What the network lacks on this machine, in words."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        return "torch or safetensors is not installed (in your clone: pip install -e '.[enhance]')"
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
