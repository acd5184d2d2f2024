"""`aucamp train`: pairs of our own making or of yours -> weights, their hash, curves and a checkpoint."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from agent.core.config import ConfigError, writing
from agent.perception.enhancement import lu2net
from agent.process.command import run_folder, with_bar
from agent.tools.evaluate_enhance import summary, table
from agent.tools.training import SIMPLE, Fold, Plan, Point, Run, advance, between, cross_validate, score
from agent.tools.training_pairs import Pairs, checkpoint_of, folds, load, make_pairs, read_pairs, save, split

MADE, MADE_SIDE = 3120, 160  # pairs of our own, and their side in pixels: larger than what a step sees
SIDE = 256  # px, to which real pairs are scaled
VALIDATED = 24  # pairs: enough for a curve, and a small part of the time
SHARES = 5  # of real pairs, one in so many scenes is for validation
FINE_TUNING_RATE = 3e-4  # a third of the rate from scratch: the start is worth keeping
SAVE_EVERY = 50  # steps


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
    checkpoint = checkpoint_of(out)
    state = Run.resume(checkpoint, plan) if resume else Run(plan, net)
    training, validation = real or _made(out, plan.seed, console)
    console.print(
        f"{len(training.raw)} pairs of {len(set(training.scene))} scenes to train on, "
        f"{len(validation.raw)} of {len(set(validation.scene))} others to validate"
    )
    with steps_bar(console) as bar:
        task = bar.add_task("training", total=plan.steps, completed=state.step)
        for value in advance(state, training, validation):
            seen = state.curve and math.isfinite(state.curve[-1].psnr_db)
            last = f", validation {state.curve[-1].psnr_db:.2f} dB" if seen else ""
            bar.update(task, completed=state.step, description=f"loss {value:.3f}{last}")
            if state.step % SAVE_EVERY == 0 or state.step == plan.steps:
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
