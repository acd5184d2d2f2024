"""What is asked of `aucamp train enhance`, as far as it can be judged without torch, whose import takes seconds."""

from __future__ import annotations

from pathlib import Path

from agent.kernel.config import ConfigError
from agent.pictures.pairs import paired


def check(
    pairs: tuple[Path, Path] | None, start: Path | None, out: Path | None, resume: bool, cross_validate: int | None
) -> None:
    """Raises ConfigError for options that do not go together, and for files and folders that are not there."""
    if resume and out is None:
        raise ConfigError("--resume needs --out, the weights whose checkpoint lies beside it")
    if cross_validate is not None and (pairs is None or start is None):
        raise ConfigError("--cross-validate needs --pairs RAW REFERENCE and --start WEIGHTS")
    if start is not None and not start.is_file():
        raise ConfigError(f"{start}: no such file; give weights that `aucamp train enhance` wrote, hash beside")
    if resume and out is not None and not checkpoint_of(out).is_file():
        raise ConfigError(f"{checkpoint_of(out)}: no such checkpoint; leave --resume out to start anew")
    if pairs is not None:
        paired(*pairs)


def checkpoint_of(weights: Path) -> Path:
    """Where a run that is to write `weights` keeps what it needs to go on."""
    return weights.with_suffix(".checkpoint")
