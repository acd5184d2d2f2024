"""The training of LU2Net: pairs in, weights out; its losses, what the weights are worth on real pairs, `aucamp train`.
Everything follows from the seed; a training that was cut off goes on as if it had not been.

Adam, cosine rate, and a running average of the weights, which is what is validated and shipped. Batches mix sizes of
whole views, for the attention sees the mean of the whole picture and must not learn the means of small cut-outs.
"""

from __future__ import annotations

import copy
import csv
import hashlib
import math
import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor
from torch.nn import functional as fn

from agent.clock import machine
from agent.core.config import ConfigError, write_whole, writing
from agent.perception.enhancement import lu2net
from agent.perception.enhancement.enhance import clahe, classic, network_enhancer, white_balance
from agent.perception.enhancement.lu2net import LU2Net, run
from agent.process.command import run_folder, with_bar
from agent.tools.evaluate_enhance import Quality, judge, psnr, ssim, summary, table
from agent.tools.training_pairs import Pairs, augmented, checkpoint_of, folds, load, make_pairs, read_pairs, save, split
from agent.tools.training_scenes import Image

# --- losses ---
# What training minimises: RGB + LAB + LCH + (1 - SSIM), as LU2Net's authors train (arXiv 2406.14973), and the colour
# of warm things.
#
# Left out is their fifth term, the distance of VGG-19 features: its ImageNet weights are not ours to ship. Cross
# entropies are means over pixels, not sums, and count CROSS_ENTROPY: they start an order above the distances and
# would drown them.
#
# Pictures are (n, 3, h, w), red green blue, 0 to 1; all losses are scalars.

CROSS_ENTROPY = 0.05
WARM = 1.0  # weight of the colour of warm things: about a third of the loss while they come out wrong
DULL = 20.0  # chroma up to which a colour is not vivid; twice that it is wholly (sand and rock stay below 30)
YELLOW = -0.364  # a over b at the hue of 110 degrees, the end of what is warm (evaluate_enhance.py)
LEAST_WARM = 0.01  # share of the pixels: fewer warm ones count less
AB_LEVELS, AB_RANGE = 7, 80.0  # soft bins of CIELAB's a and b
HUES_RAD = (0.0, math.pi / 2, math.pi, 3 * math.pi / 2)
SHARP, PALE = 4.0, 5.0  # slope of the hue bins; chroma below which hue means little
TAPS, SIGMA = 11, 1.5  # SSIM's window (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2
# sRGB to XYZ over the white of D65 (IEC 61966-2-1).
TO_XYZ = ((0.4339, 0.3762, 0.1899), (0.2126, 0.7152, 0.0722), (0.0178, 0.1095, 0.8727))


def loss(output: Tensor, target: Tensor) -> Tensor:
    """The sum of the five terms."""
    ours, theirs = to_lab(output), to_lab(target)
    distance = (output - target).abs().mean() + WARM * warm_loss(ours, theirs)
    return distance + lab_loss(ours, theirs) + lch_loss(ours, theirs) + 1 - tensor_ssim(output, target)


def to_lab(rgb: Tensor) -> Tensor:
    """sRGB -> CIELAB, L 0 to 100; values outside 0 to 1 are clipped."""
    c = rgb.clamp(1e-4, 1)
    linear = torch.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)
    t = torch.einsum("ij,njhw->nihw", torch.tensor(TO_XYZ, device=rgb.device), linear)
    x, y, z = torch.where(t > 0.008856, t ** (1 / 3), 7.787 * t + 16 / 116).unbind(1)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], 1)


def lab_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in lightness, and cross entropy of softly binned a and b; both arguments CIELAB."""
    lightness = (ours[:, 0] - theirs[:, 0]).abs().mean() / 100
    centres = torch.linspace(-AB_RANGE, AB_RANGE, AB_LEVELS, device=ours.device).view(-1, 1, 1, 1, 1)
    width = 2 * AB_RANGE / (AB_LEVELS - 1)
    bins = [-(((lab[:, 1:] - centres) / width) ** 2) for lab in (ours, theirs)]  # (levels, n, 2, h, w)
    return lightness + CROSS_ENTROPY * _cross_entropy(*bins)


def lch_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in lightness and chroma, and cross entropy of softly binned hue; both arguments CIELAB."""
    lightness = (ours[:, 0] - theirs[:, 0]).abs().mean() / 100
    chroma = [(lab[:, 1:].square().sum(1) + 1e-2).sqrt() for lab in (ours, theirs)]
    bins = [
        torch.stack([SHARP * (lab[:, 1] * math.cos(h) + lab[:, 2] * math.sin(h)) / (c + PALE) for h in HUES_RAD])
        for lab, c in zip((ours, theirs), chroma, strict=True)
    ]
    return lightness + (chroma[0] - chroma[1]).abs().mean() / 100 + CROSS_ENTROPY * _cross_entropy(*bins)


def warm_loss(ours: Tensor, theirs: Tensor) -> Tensor:
    """Distance in colour where the target is red to yellow and vivid, both CIELAB; a buoy is few pixels, so it counts
    by itself."""
    a, b = theirs[:, 1], theirs[:, 2]
    share = (((a * a + b * b).sqrt() - DULL) / DULL).clamp(0, 1) * ((b > 0) & (a > YELLOW * b))
    apart = ((ours[:, 1:] - theirs[:, 1:]).square().sum(1) + 1e-2).sqrt() - 0.1
    return (share * apart).sum() / (share.sum() + LEAST_WARM * share.numel()) / 100


def tensor_ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean structural similarity over colours and pixels, where the window fits."""
    mx, my, xx, yy, xy = _smooth(torch.cat([x, y, x * x, y * y, x * y], 1)).chunk(5, 1)
    sx, sy, sxy = xx - mx * mx, yy - my * my, xy - mx * my
    return ((2 * mx * my + C1) * (2 * sxy + C2) / ((mx * mx + my * my + C1) * (sx + sy + C2))).mean()


def _smooth(x: Tensor) -> Tensor:
    t = torch.arange(TAPS, dtype=x.dtype, device=x.device) - TAPS // 2
    window = fn.softmax(-t * t / (2 * SIGMA**2), 0)
    c = x.shape[1]
    x = fn.conv2d(x, window.view(1, 1, -1, 1).expand(c, 1, -1, 1), groups=c)
    return fn.conv2d(x, window.view(1, 1, 1, -1).expand(c, 1, 1, -1), groups=c)


def _cross_entropy(ours: Tensor, theirs: Tensor) -> Tensor:
    """Mean over everything but axis 0, which holds the bins' logits; zero where both agree."""
    log_ours, log_theirs = fn.log_softmax(ours, 0), fn.log_softmax(theirs, 0)
    return (log_theirs.exp() * (log_theirs - log_ours)).sum(0).mean()


# --- training loop ---

SIZES = ((64, 10), (96, 5), (96, 5), (128, 3), (160, 2))  # px a side and pictures a batch; each step draws one
NARROWEST = 0.6  # share of a picture that a crop keeps at least
WARM_UP = 50  # steps
AVERAGED = 0.998  # decay of the running average per step
CLIP = 1.0  # norm of the gradient
TUNED = 0.25  # of the way from the start to what real pairs made of it; see weights/README.md
FIT_RIDGE = 1e-3  # of the least squares for the first last layer


class Plan(NamedTuple):
    """What a run is made of; a checkpoint goes on only with the plan it was started with."""

    steps: int
    seed: int = 0
    rate: float = 1e-3  # learning rate at its highest
    augment: bool = False  # real pairs stand for many others (training_pairs.py)
    sizes: tuple[tuple[int, int], ...] = SIZES
    validate_every: int = 250


class Point(NamedTuple):
    """One row of the curves: mean loss since the last row, and the averaged weights on pairs of other scenes."""

    step: int
    loss: float
    psnr_db: float
    ssim: float


class Run:
    """A training run between two steps: everything that the next step depends on."""

    def __init__(self, plan: Plan, start: LU2Net | None = None, of: str = "") -> None:
        """of: what its pairs and its start are known by (`digest`)."""
        self.of = of
        self.plan, self.step, self.curve = plan, 0, list[Point]()
        with torch.random.fork_rng():
            torch.manual_seed(plan.seed)
            self.net = copy.deepcopy(start) if start else LU2Net()
        self.fresh = start is None  # the last layer is yet to be fitted
        self.net = self.net.train()
        self.average = copy.deepcopy(self.net)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=plan.rate)
        self.since: list[float] = []  # losses since the last row of the curve

    def save(self, file: Path) -> None:
        """A checkpoint; the old one stays whole until the new one is."""
        kept = {
            "plan": self.plan._asdict(),
            "of": self.of,
            "step": self.step,
            "curve": [tuple(point) for point in self.curve],
            "since": self.since,
            "net": self.net.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        torch.save(kept, data := BytesIO())  # given a path, it raises no OSError
        write_whole(file, data.getvalue())

    @staticmethod
    def resume(file: Path, plan: Plan, of: str = "") -> Run:
        """Raises ConfigError if the file is no checkpoint, or one of another plan, of other pairs or another start."""
        try:
            state: dict[str, Any] = torch.load(file, weights_only=True)
            kept = Plan(**state["plan"])
        except (OSError, RuntimeError, KeyError, TypeError, ValueError, EOFError, UnpicklingError) as error:
            raise ConfigError(f"{file}: no checkpoint to go on from; start anew without --resume") from error
        if kept != plan:
            raise ConfigError(f"{file}: was started {started_with(kept, plan)}; give the same, or start anew elsewhere")
        if state.get("of") != of:
            raise ConfigError(f"{file}: was started with other pairs or another --start; give the same, or start anew")
        run = Run(plan, of=of)
        run.fresh = False
        run.step, run.curve = state["step"], [Point(*point) for point in state["curve"]]
        run.since = state["since"]
        run.net.load_state_dict(state["net"])
        run.average.load_state_dict(state["average"])
        run.optimiser.load_state_dict(state["optimiser"])
        return run


def digest(pairs: Iterable[Pairs], start: Path | None) -> str:
    """Of what a run is trained on and begins with."""
    found = hashlib.blake2b(b"" if start is None else start.read_bytes(), digest_size=8)
    for each in pairs:
        for image in (*each.raw, *each.target):
            found.update(image.tobytes())
    return found.hexdigest()


def started_with(kept: Plan, plan: Plan) -> str:
    """What a run was asked for that is asked for otherwise now, as it is typed."""
    if kept[4:] != plan[4:]:
        return "by another version of aucamp"
    words = [f"--{name} {was}" for name, was, now in zip(Plan._fields[:2], kept, plan, strict=False) if was != now]
    if kept.rate != plan.rate:  # it follows from what a run starts from
        words.append("--start" if kept.rate < plan.rate else "no --start")
    if kept.augment != plan.augment:
        words.append("--pairs" if kept.augment else "no --pairs")
    return f"with {', '.join(words)}"


def advance(run: Run, training: Pairs, validation: Pairs) -> Iterator[float]:
    """Take the steps that are left, one per item: its loss. A row is added to run.curve where one is due."""
    run.net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    while run.step < run.plan.steps:
        raw, target = batch(training, run.plan, run.step)
        if run.fresh:
            fit_last(run.net, raw, target)
            run.average.load_state_dict(run.net.state_dict())
            run.fresh = False
        for group in run.optimiser.param_groups:
            group["lr"] = rate(run.plan, run.step)
        run.optimiser.zero_grad()
        value = loss(run.net(raw), target)
        value.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(run.net.parameters(), CLIP)
        run.optimiser.step()
        run.step += 1
        follow(run.average, run.net, min(AVERAGED, run.step / (run.step + 10)))
        run.since.append(value.item())
        if run.step % run.plan.validate_every == 0 or run.step == run.plan.steps:
            run.curve.append(Point(run.step, float(np.mean(run.since)), *validate(run.average, validation)))
            run.since.clear()
        yield value.item()


def rate(plan: Plan, step: int) -> float:
    """Learning rate of a step: up within WARM_UP, then half a cosine down to zero."""
    return plan.rate * min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / plan.steps))


def batch(pairs: Pairs, plan: Plan, step: int) -> tuple[Tensor, Tensor]:
    """Raw and target of one step, (n, 3, side, side) red green blue, 0 to 1; the same for the same seed and step."""
    rng = np.random.default_rng([plan.seed, step])
    side, count = plan.sizes[int(rng.integers(0, len(plan.sizes)))]
    chosen = rng.choice(len(pairs.raw), count, replace=len(pairs.raw) < count)
    views = [_view(pairs.raw[i], pairs.target[i], side, rng) for i in chosen]
    if plan.augment:
        views = [augmented(*view, rng) for view in views]
    raw, target = (np.stack([view[k] for view in views]) for k in (0, 1))
    return _tensor(raw), _tensor(target)


def _view(
    raw: NDArray[np.uint8], target: NDArray[np.uint8], side: int, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Most of a pair, mirrored or not, side x side."""
    height, width = (max(int(length * rng.uniform(NARROWEST, 1.0)), 1) for length in raw.shape[:2])
    y, x = int(rng.integers(0, raw.shape[0] - height + 1)), int(rng.integers(0, raw.shape[1] - width + 1))
    across = int(rng.choice((-1, 1)))
    cut = [picture[y : y + height, x : x + width][:, ::across] for picture in (raw, target)]
    small = [cv2.resize(np.ascontiguousarray(c), (side, side), interpolation=cv2.INTER_AREA) for c in cut]
    return np.asarray(small[0], np.uint8), np.asarray(small[1], np.uint8)


def _tensor(images: NDArray[np.uint8]) -> Tensor:
    """(n, h, w, 3) blue green red -> (n, 3, h, w) red green blue, channels last in memory."""
    return torch.from_numpy(np.ascontiguousarray(images[:, :, :, ::-1])).permute(0, 3, 1, 2).float() / 255


def fit_last(net: LU2Net, raw: Tensor, target: Tensor) -> None:
    """Set the last layer to the least-squares answer for one batch: training starts from a picture, not from noise."""
    with torch.no_grad():
        features = net.features(raw).permute(0, 2, 3, 1).reshape(-1, 16).double()
        wanted = target.permute(0, 2, 3, 1).reshape(-1, 3).double()
        a = torch.cat([features, torch.ones(len(features), 1, dtype=torch.float64)], 1)
        gram = a.T @ a / len(a)
        answer = torch.linalg.solve(gram + FIT_RIDGE * gram.diagonal().mean() * torch.eye(17), a.T @ wanted / len(a))
        net.last.weight.copy_(answer[:16].T[:, :, None, None].float())
        net.last.bias.copy_(answer[16].float())  # type: ignore[union-attr]


def follow(average: LU2Net, net: LU2Net, decay: float) -> None:
    """Running average of weights and of the norms' statistics."""
    with torch.no_grad():
        for mean, value in zip(average.state_dict().values(), net.state_dict().values(), strict=True):
            if mean.is_floating_point():
                mean.lerp_(value, 1 - decay)
            else:
                mean.copy_(value)


def between(start: LU2Net, tuned: LU2Net, share: float = TUNED) -> LU2Net:
    """Weights on the way from `start` to `tuned` (Wortsman et al. 2022): real pairs are few and alike, and what the
    start knows of other water is lost last."""
    out, begin = copy.deepcopy(tuned), start.state_dict()
    with torch.no_grad():
        for name, value in out.state_dict().items():
            if value.is_floating_point():
                value.copy_(begin[name].lerp(value, share))
    return out.eval()


def validate(net: LU2Net, pairs: Pairs) -> tuple[float, float]:
    """Mean PSNR [dB] and SSIM over whole pictures; not a number where there are none."""
    if not len(pairs.raw):
        return math.nan, math.nan
    net.eval()
    outputs = [run(net, image) for image in pairs.raw]
    figures = [(psnr(o, t), ssim(o, t)) for o, t in zip(outputs, pairs.target, strict=True)]
    mean_psnr_db, mean_ssim = np.mean(figures, axis=0).tolist()
    return mean_psnr_db, mean_ssim


# --- validation ---
# What an enhancement is worth on real pairs: beside the simple methods, and on scenes that it was not trained on.

Method = Callable[[Image], Image]


class Fold(NamedTuple):
    """One round of cross-validation: the figures of each pair that was held out."""

    number: int
    raw: list[Quality]  # as they are
    before: list[Quality]  # by the weights that were given, the fast way
    plain: list[Quality]  # by those that were tuned on the other folds, in full
    fast: list[Quality]  # and the fast way, which is what users get


SIMPLE: dict[str, Method] = {
    "identity": lambda image: image,
    "grey-world": white_balance,
    "CLAHE": clahe,
    "classic": classic,
}


def score(pairs: Pairs, method: Method) -> list[Quality]:
    """What a method makes of each pair."""
    return [judge(method(raw), target) for raw, target in zip(pairs.raw, pairs.target, strict=True)]


def cross_validate(start: LU2Net, pairs: Pairs, plan: Plan, count: int) -> Iterator[float | Fold]:
    """Fine-tune `start` on all scenes but a fold's, for each fold; yields each step's loss, and each fold when done.

    The number of steps is fixed beforehand: nothing is chosen by looking at what is held out.
    Raises ConfigError if there are fewer scenes than folds.
    """
    fold_of = folds(pairs.scene, count, plan.seed)
    nothing = pairs.only(np.zeros(len(pairs.raw), bool))
    for number in range(count):
        held_out = pairs.only(fold_of == number)
        state = Run(plan, start)
        yield from advance(state, pairs.only(fold_of != number), nothing)
        tuned = between(start, state.average)
        methods = SIMPLE["identity"], fast(start), partial(run, tuned), fast(tuned)
        yield Fold(number + 1, *(score(held_out, method) for method in methods))


def fast(net: LU2Net) -> Method:
    return network_enhancer(net, "fast").apply


# --- `aucamp train`: pairs of our own making or of yours -> weights, their hash, curves and a checkpoint ---

MADE, MADE_SIDE = 3120, 160  # pairs of our own, and their side in pixels: larger than what a step sees
SIDE = 256  # px, to which real pairs are scaled
VALIDATED = 24  # pairs: enough for a curve, and a small part of the time
SHARES = 5  # of real pairs, one in so many scenes is for validation
FINE_TUNING_RATE = 3e-4  # a third of the rate from scratch: the start is worth keeping
SAVE_EVERY, SAVE_S = 50, 60.0  # steps; on a slow computer, of which so many take long


def train(
    folders: tuple[Path, Path] | None,
    out: Path | None,
    plan: Plan,
    start: Path | None,
    resume: bool,
    everything: bool,
    console: Console,
) -> None:
    """Train from scratch, or from the weights `start`; `everything`: no pair is kept back for validation.

    What request.check asks for holds. Raises ConfigError for pairs, weights or a checkpoint that cannot be used.
    """
    real = _real(folders, everything, console) if folders else None  # complain before a folder is made
    net = lu2net.load(start) if start else None
    out = run_folder(None) / "lu2net.safetensors" if out is None else out
    out.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(out.parent, os.W_OK):
        raise ConfigError(f"{out.parent}: cannot be written; give --out another folder")
    checkpoint = checkpoint_of(out)
    training, validation = real or _made(out, plan.seed, console)
    of = digest((training, validation), start)
    state = Run.resume(checkpoint, plan, of) if resume else Run(plan, net, of)
    console.print(
        f"{len(training.raw)} pairs of {len(set(training.scene))} scenes to train on, "
        f"{len(validation.raw)} of {len(set(validation.scene))} others to validate"
    )
    saved_s = machine.since_boot_s()
    with steps_bar(console) as bar:
        task = bar.add_task("training", total=plan.steps, completed=state.step)
        for value in advance(state, training, validation):
            seen = state.curve and math.isfinite(state.curve[-1].psnr_db)
            last = f", validation {state.curve[-1].psnr_db:.2f} dB" if seen else ""
            bar.update(task, completed=state.step, description=f"loss {value:.3f}{last}")
            now_s = machine.since_boot_s()
            if state.step % SAVE_EVERY == 0 or state.step == plan.steps or now_s - saved_s > SAVE_S:
                saved_s = now_s
                state.save(checkpoint)
                curves(state.curve, out)
    lu2net.save(between(net, state.average) if net and folders else state.average.eval(), out)
    console.print(f"written to {out}; curves beside it")


def cross_validation(folders: tuple[Path, Path], start: Path, plan: Plan, count: int, console: Console) -> None:
    """Print what fine-tuning on real pairs is worth on scenes it has not seen, beside what it starts from."""
    net = lu2net.load(start)
    pairs = _read(folders, console)
    done: list[Fold] = []
    with steps_bar(console) as bar:
        task = bar.add_task("cross-validation", total=plan.steps * count)
        for item in cross_validate(net, pairs, plan, count):
            if isinstance(item, Fold):
                done.append(item)
                before, plain, fast = (summary(f, item.raw).psnr_db for f in (item.before, item.plain, item.fast))
                console.print(
                    f"fold {item.number}: {len(item.raw)} pairs held out, {before:.2f} dB before, "
                    f"{plain:.2f} dB tuned (plain), {fast:.2f} dB (fast)"
                )
            else:
                bar.update(task, advance=1, description=f"fold {len(done) + 1}, loss {item:.3f}")
    simple = {name: score(pairs, method) for name, method in SIMPLE.items()}
    rows = {name: summary(figures, simple["identity"]) for name, figures in simple.items()}
    raw = [q for fold in done for q in fold.raw]
    rows["as given, fast"] = summary([q for fold in done for q in fold.before], raw)
    rows["tuned, held out, plain"] = summary([q for fold in done for q in fold.plain], raw)
    rows["tuned, held out, fast"] = summary([q for fold in done for q in fold.fast], raw)
    console.print(table(rows, f"{len(raw)} pairs of {len(set(pairs.scene))} scenes at {SIDE}x{SIDE}"))


def curves(points: Iterable[Point], out: Path) -> None:
    """Loss and validation against steps, as CSV and PNG beside the weights."""
    from matplotlib.figure import Figure

    points = list(points)
    table = out.with_suffix(".csv")
    with writing(table), table.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(Point._fields)
        rows.writerows(points)
    figure = Figure(figsize=(7, 4))
    left = figure.subplots()
    left.plot([p.step for p in points], [p.loss for p in points], "C0.-")
    left.set(xlabel="step", ylabel="training loss")
    if any(math.isfinite(p.psnr_db) for p in points):
        right = left.twinx()
        right.plot([p.step for p in points], [p.psnr_db for p in points], "C1.-")
        right.set_ylabel("validation PSNR, dB", color="C1")
    figure.savefig(out.with_suffix(".png"), dpi=100, bbox_inches="tight")


def steps_bar(console: Console) -> Progress:
    """A bar with the steps done and the time left."""
    words, left = TextColumn("{task.description}", markup=False), TimeRemainingColumn()
    return Progress(words, BarColumn(), MofNCompleteColumn(), left, console=console)


def _made(out: Path, seed: int, console: Console) -> tuple[Pairs, Pairs]:
    """Our own pairs, from the file beside the weights, or made and put there."""
    file = out.with_suffix(".pairs.npz")
    if file.exists():
        pairs = load(file)
    else:
        pairs = with_bar(console, "making pairs", lambda show: make_pairs(MADE, MADE_SIDE, seed, show))
        save(pairs, file)
    training, validation = split(pairs)
    return training, validation.only(np.arange(min(VALIDATED, len(validation.raw))))


def _real(folders: tuple[Path, Path], everything: bool, console: Console) -> tuple[Pairs, Pairs]:
    pairs = _read(folders, console)
    if not everything and (scenes := len(set(pairs.scene))) < SHARES:
        raise ConfigError(
            f"{folders[0]}: {scenes} different scenes, of which one in {SHARES} is kept back for validation; give "
            f"pairs of at least {SHARES} scenes, or keep none back with --all"
        )
    held_out = np.zeros(len(pairs.raw), bool) if everything else folds(pairs.scene, SHARES, 0) == 0
    return pairs.only(~held_out), pairs.only(held_out)


def _read(folders: tuple[Path, Path], console: Console) -> Pairs:
    return with_bar(console, "reading pairs", lambda show: read_pairs(*folders, SIDE, show))


def plan_of(steps: int | None, seed: int, fine: bool, real: bool) -> Plan:
    """Steps and rate as they suit: from scratch, or from weights that are good already. Raises ConfigError."""
    if steps is not None and steps < 1:
        raise ConfigError(f"--steps {steps}: give at least 1")
    return Plan(steps or 400, seed, FINE_TUNING_RATE, real) if fine else Plan(steps or 4000, seed, augment=real)
