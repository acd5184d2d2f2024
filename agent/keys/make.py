"""`aucamp keys`: a pair of signing keys for each robot, and in words what goes where."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from agent.kernel.config import Access, ConfigError, Fleet
from agent.kernel.fleet_reader import load_robot
from agent.keys.key_files import private_file, public_file, write_pair

FOLDER = "keys"  # beside the fleet file, where nothing else is said


def make_keys(robots: Iterable[str], folder: Path) -> list[Path]:
    """A pair for each of these robots; returns the files. Raises ConfigError before anything is written where one of
    them exists.
    """
    robots = list(robots)
    there = [
        path for name in robots for path in (private_file(folder, name), public_file(folder, name)) if path.exists()
    ]
    if there:
        raise ConfigError(
            f"{there[0]}: exists, and keys are never overwritten; give --out a new folder, take --only for one robot "
            f"that has none yet, or remove both files of a robot whose key is to be replaced"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror}); give --out another folder") from None
    made: list[Path] = []
    try:
        for name in robots:
            made += write_pair(folder, name)
    except BaseException:
        for path in made:  # a part of a fleet's keys would be in the way of the next attempt
            path.unlink()
        raise
    return made


def fleet_keys(fleet: Fleet, path: Path, out: Path, only: str | None = None) -> list[str]:
    """Make the keys of a fleet, or of one robot of it; returns lines that say what to do with them."""
    if only is not None:
        load_robot(fleet, only, path)
    made = make_keys([only] if only is not None else fleet.robot, out)
    beside = out.resolve().parent == path.resolve().parent
    named = fleet.access.keys or (out.resolve().name if beside else FOLDER)
    lines = [
        *(
            f"{file}: {'public, to every robot' if file.suffix == '.pub' else f'private, to {file.stem} alone'}"
            for file in made
        ),
        "",
        f"On each robot's computer these belong into the folder '{named}' beside its fleet file,",
        "or into the folder that the variable AUCAMP_KEYS names there:",
        "  its own NAME.sign, which nobody else may have or read, and the NAME.sign.pub of all.",
        "Whoever has a private key can speak for its robot: keep no copy of it.",
    ]
    if fleet.access == Access():
        lines += ["", f"Every copy of {path.name} has to say so:", "", "[access]", f'keys = "{named}"']
    return lines
