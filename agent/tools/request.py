"""What is asked of `aucamp train enhance`, as far as it can be judged without torch, whose import takes seconds."""

from __future__ import annotations

from pathlib import Path

from agent.core.config import ConfigError
from agent.process.command import new_file
from agent.tools.pairs import paired

ENDS_IN = ".safetensors"


def check(
    pairs: tuple[Path, Path] | None, start: Path | None, out: Path | None, resume: bool, cross_validate: int | None
) -> None:
    """Raises ConfigError for options that do not go together, for files and folders that are not there, and for those
    that are there and would be overwritten."""
    if resume and out is None:
        raise ConfigError("--resume needs --out, the weights whose checkpoint lies beside it")
    if cross_validate is not None and (pairs is None or start is None):
        raise ConfigError("--cross-validate needs --pairs RAW REFERENCE and --start WEIGHTS")
    if start is not None and not start.is_file():
        raise ConfigError(f"{start}: no such file; give weights that `aucamp train enhance` wrote, hash beside")
    if out is not None and cross_validate is None:
        if out.suffix != ENDS_IN:
            raise ConfigError(f"{out}: give --out a name that ends in {ENDS_IN}")
        _check_resumed(out) if resume else _check_new(out)
    if pairs is not None:
        paired(*pairs)


def _check_new(out: Path) -> None:
    if checkpoint_of(out).exists() and not out.exists():
        raise ConfigError(
            f"{checkpoint_of(out)}: is there already, of a training that was cut off; go on with --resume, "
            "or give --out another name"
        )
    for file in (out, *(out.with_suffix(end) for end in (".checkpoint", ".csv", ".png"))):
        new_file(file)


def _check_resumed(out: Path) -> None:
    if not checkpoint_of(out).is_file():
        raise ConfigError(f"{checkpoint_of(out)}: no such checkpoint; start anew without --resume")
    if out.with_name(out.name + ".sha256").exists():  # the last file that a training writes
        raise ConfigError(f"{out}: this training has ended; train on with --start {out} and another --out")


def checkpoint_of(weights: Path) -> Path:
    """Where a run that is to write `weights` keeps what it needs to go on."""
    return weights.with_suffix(".checkpoint")
