"""What a person sees while something takes long: a bar where the end is known, else a spinner."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import Protocol, TypeVar

from rich import progress as bars
from rich.console import Console
from rich.text import Text

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


def step_by_step(progress: Progress, total: int) -> Callable[[], None]:
    """What is to be called after each of `total` parts; that none is done yet is shown at once."""
    done = itertools.count(1)
    progress(0, total)
    return lambda: progress(next(done), total)


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
