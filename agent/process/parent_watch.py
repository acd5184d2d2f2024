"""A process that ends with the one that started it, however that ended: after SIGKILL nobody can stop his children.

They share a pipe. Only the parent can write to it, and it never does; when the parent has gone, the kernel closes its
end, and who reads at the other one wakes up. Linux could do the same with prctl, other systems could not.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from threading import Thread, main_thread
from typing import NamedTuple

from agent.clock import machine

VARIABLE = "AUCAMP_PARENT_WATCH"  # of the child's environment: the number of the descriptor to read from
GRACE_S = 20.0  # from SIGTERM to the end at once: under 2 s alone, but a recorder beside a load finishes its file


class ParentWatch(NamedTuple):
    """The pipe, in the parent: one for any number of children."""

    held: int
    given: int  # to be inherited, by Popen's pass_fds

    def environment(self) -> Mapping[str, str]:
        return {**os.environ, VARIABLE: str(self.given)}

    def drop(self) -> None:
        """Children that still run end."""
        os.close(self.held)
        os.close(self.given)


def watched_by_us() -> ParentWatch:
    """Only what is passed on by pass_fds is inherited: no child holds the end that is ours."""
    given, held = os.pipe()
    return ParentWatch(held, given)


def exit_with_parent() -> None:
    """Call it in a child's main thread: SIGTERM comes when the parent has gone. Without a watch it runs free."""
    number = os.environ.pop(VARIABLE, None)  # our own children have another parent
    if number is not None:
        Thread(target=_watch, args=(int(number),), name="parent watch", daemon=True).start()


def _watch(given: int) -> None:
    try:
        os.read(given, 1)
    except OSError:
        return  # not ours: a variable that somebody has handed on
    signal.pthread_kill(main_thread().ident or 0, signal.SIGTERM)  # to the main thread, so that it stops waiting
    machine.sleep(GRACE_S)
    os._exit(128 + signal.SIGTERM)  # it hangs, or compiles
