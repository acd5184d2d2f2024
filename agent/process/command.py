"""What commands share: progress and the terminal, folders to write to, the fleet files that ship, and options.

Nothing here is heavy: `aucamp --help` loads it.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import shutil
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Annotated, Protocol, TypeVar

import msgspec
import typer
from rich import progress as bars
from rich.console import Console
from rich.text import Text

from agent.core.config import ConfigError, Fleet, read_file, write_whole

# --- progress: a bar where the end is known, else a spinner ---

T = TypeVar("T")

Progress = Callable[[int, int], None]  # parts of the work that are done, parts in all


class Show(Protocol):
    """A Progress that may be told what is done now; nothing: as before."""

    def __call__(self, done: int, total: int, what: str = "") -> None: ...


def with_bar(console: Console, what: str, work: Callable[[Show], T]) -> T:
    """Do some work that calls show(done, total), with a bar from the first call on: input that is refused has none."""
    with contextlib.ExitStack() as stack:
        words, share = bars.TextColumn("{task.description}", markup=False), bars.TaskProgressColumn()
        bar = bars.Progress(words, bars.BarColumn(), share, bars.TimeRemainingColumn(), console=console)
        task = bar.add_task(what)

        def show(done: int, total: int, what: str = "") -> None:
            if not bar.live.is_started:
                stack.enter_context(bar)
            bar.update(task, completed=done, total=total, description=what or None)

        return work(show)


@contextlib.contextmanager
def with_spinner(console: Console, what: str) -> Iterator[Callable[[str], None]]:
    """Say what takes long: beside a spinner on a terminal, as a line in a pipe. What is given changes the words beside
    the spinner."""
    if console.is_terminal:
        with console.status(Text(what)) as status:
            yield lambda words: status.update(Text(words))
    else:
        console.print(what)
        yield lambda words: None


# --- the terminal ---
# The terminal, on which a text stands as it was written: rich would take `[focus]` for a colour and drop it.

PIPE_COLUMNS = 140  # a pipe is as wide as our widest table


def plain_console(stderr: bool = False) -> Console:
    """No markup and no emoji by name; lines with paths are not folded."""
    stream = sys.stderr if stderr else sys.stdout
    width = None if stream.isatty() else PIPE_COLUMNS
    return Console(stderr=stderr, soft_wrap=True, width=width, markup=False, emoji=False)


def meant(word: str, known: Iterable[str]) -> str | None:
    """Which of the words that are known was meant, probably."""
    return next(iter(difflib.get_close_matches(word, list(known), 1, 0.6)), None)


# --- exit code 1 ---
# What ends a command with exit code 1: the question was good, and the answer is no.


class Failed(RuntimeError):
    """What was asked for could not be done, through no mistake of the user's; one line that says why."""


# --- where a command writes ---
# Where a command writes: a new file, a folder that stays, and one that goes with the run.


def run_folder(out: Path | None) -> Path:
    """The folder that was asked for, else runs/<UTC>. Raises ConfigError if it holds anything or cannot be written."""
    folder = new_folder(out or Path("runs") / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); give --out another folder") from None
    return folder


def new_folder(path: Path) -> Path:
    """The path, where no folder is yet or an empty one. Raises ConfigError for anything else."""
    if path.is_symlink() or path.exists():
        if not path.is_dir():
            raise ConfigError(f"{path}: is there already, and is no folder; give --out a new folder")
        if any(path.iterdir()):
            raise ConfigError(f"{path}: not empty, and nothing is overwritten; give --out a new folder")
    return path


def new_file(path: Path) -> Path:
    """The path, where nothing is yet: no verb overwrites what is on the disk. Raises ConfigError where something is."""
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: is there already, and nothing is overwritten; give --out another name")
    return path


def free_name(path: Path) -> Path:
    """The path, or where something is there already the first of NAME.2.SUFFIX, NAME.3.SUFFIX, ... that is free."""
    number, free = 2, path
    while free.exists() or free.is_symlink():
        free, number = path.with_name(f"{path.stem}.{number}{path.suffix}"), number + 1
    return free


def new_recording(path: Path) -> Path:
    """The path of a recording, where nothing is yet. Raises ConfigError for what would not be found as one again."""
    if path.suffix != ".mcap":
        raise ConfigError(f"{path}: the name of a recording ends in .mcap; give --out such a name")
    return new_file(path)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder with a short path: that of a socket may not be longer than 107 bytes."""
    folder = Path(tempfile.mkdtemp(prefix="aucamp-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# --- fleet files that ship ---
# Fleet files that come with the package, found by name; and what goes with a file into another folder.

FLEETS = Path(str(resources.files("agent") / "fleets"))


def shipped_fleet(name: str = "tank") -> Path:
    """A fleet file that comes with the package."""
    return FLEETS / f"{name}.toml"


def shipped_names() -> list[str]:
    """The fleets that come with the package, by name."""
    return sorted(path.stem for path in FLEETS.glob("*.toml"))


def fleet_file(name: str) -> Path:
    """The path of a TOML file, or the name of a fleet that comes with the package. Raises ConfigError for neither."""
    if name.endswith(".toml"):
        return Path(name)
    if name not in shipped_names():
        raise ConfigError(
            f"--fleet {name}: no such fleet; give one of {', '.join(shipped_names())}, or the path of a .toml file"
        )
    return shipped_fleet(name)


def with_pictures(fleet: Fleet, folder: Path) -> Fleet:
    """The fleet as a file in this folder says it, once its targets' pictures have been copied there.

    A run's folder is given to others, who do not have what lay beside the file that it was made from.
    """
    targets = {}
    for name, target in fleet.target.items():
        if target.picture is not None:
            own = f"{name}{Path(target.picture).suffix}"
            write_whole(folder / own, read_file(Path(target.picture), 2**30, "give a picture"))
            target = msgspec.structs.replace(target, picture=own)
        targets[name] = target
    return msgspec.structs.replace(fleet, target=targets)


# --- options ---
# Arguments and options that several commands share, and where commands write to.

FleetFile = Annotated[Path, typer.Argument(metavar="FLEET", help="Fleet file (TOML).")]
FleetFiles = Annotated[list[Path], typer.Argument(metavar="FLEET...", help="Fleet file (TOML), or several.")]
RobotName = Annotated[str, typer.Option("--robot", help="Which robot of the fleet file.")]
Port = Annotated[int, typer.Option(min=1024, max=65535, help="WebSocket port on this machine.")]
Recordings = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings (MCAP).")]
Runs = Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of runs, or recordings (MCAP).")]

SLOWEST = 0.01  # slower than this nobody can tell from a clock that stands


def as_speed(text: str) -> float:
    """A positive number, or max: no limit. Raises typer.BadParameter."""
    try:
        speed = math.inf if text == "max" else float(text)
    except ValueError:
        speed = math.nan
    if not speed >= SLOWEST:
        raise typer.BadParameter(f"'{text}': write max, or a number from {SLOWEST:g} on")
    return speed


Speed = Annotated[
    float, typer.Option(parser=as_speed, metavar="NUMBER|max", help="Seconds of the dive in one of the wall, at most.")
]


def refuse_options(command: str, given: Mapping[str, object], takes: Collection[str]) -> None:
    """Raises ConfigError for an option that was given to a command of one kind and is for another kind.

    `given`: the value of each option by its name; None, False and an empty list: it was not given.
    """
    for option, value in given.items():
        if option not in takes and value is not None and value is not False and value != []:
            raise ConfigError(f"{command}: takes no {option}; leave it out")


def complain(line: str) -> None:
    """What a person should know but a program that reads our output should not."""
    typer.echo(line, err=True)


def terminal() -> Console:
    """Where results go."""
    return plain_console()
