"""Functions compiled by numba at their first call and kept on disk, for processes that start together.

Numba numbers what it keeps of a function, a file for each signature, in an index without a lock. Two processes that
compile two signatures at once take the same number, and from then on each process, until the cache is emptied, runs
code that was made for arrays of one kind on arrays of another: a TypeError where the items differ, reads beyond
the array's end where only the layout does (numba issue 4807). Agents, twin and benches start at once, so here an index
and its files are read and written under a lock.

Nor does numba mind that they all compile the same. Here the first process compiles, and the others wait for the file.

An index also names the classes of the arguments. Where a class has another name by now, the index cannot be read:
numba would throw it away as older than the source, but fails before it has looked.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock

F = TypeVar("F", bound=Callable[..., Any])

LOCK = "numba.lock"  # in the folder of the cache, as a rule __pycache__
TURN = ".turn"  # behind the function's own name there: the lock of the process that compiles it


class LockedCache(FunctionCache):
    """Numba's cache of one function; a process that writes is alone in the cache's folder."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._turn: ExitStack | None = None  # holds the lock from a miss until the file is there

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load(sig, target_context)
        if found is None and self._turn is not None:
            self._turn.enter_context(self._locked(fcntl.LOCK_EX, f"{self._impl.filename_base}{TURN}"))
            found = self._load(sig, target_context)  # another process may have compiled it meanwhile
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            with self._locked(fcntl.LOCK_SH):
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # a class has another name or module by now
            with self._locked(fcntl.LOCK_EX):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    @contextmanager
    def turn(self) -> Iterator[None]:
        """What compiles in here does so alone on this machine. A function that calls itself has its turn already.

        Numba's own lock, taken first, keeps out this process's other threads; functions call each other in one
        direction, so that no two processes wait for each other.
        """
        with global_compiler_lock:
            if self._turn is not None:
                yield
                return
            with ExitStack() as self._turn:
                try:
                    yield
                finally:
                    self._turn = None

    @contextmanager
    def _locked(self, how: int, name: str = LOCK) -> Iterator[None]:
        with (Path(self.cache_path) / name).open("ab") as lock:  # the folder is there: numba has chosen one it can use
            fcntl.flock(lock, how)  # until it is closed
            yield


def compiled(**options: Any) -> Callable[[F], F]:
    """Numba's njit with `options` of its own, without the interpreter lock and with the cache above."""

    def compile_at_first_call(function: F) -> F:
        dispatcher: Any = njit(nogil=True, **options)(function)
        # As its enable_caching() does, which knows no cache but numba's own.
        dispatcher._cache = cache = LockedCache(function)
        compile_now = dispatcher.compile

        def compile_in_turn(signature: Any) -> Any:
            with cache.turn():
                return compile_now(signature)

        dispatcher.compile = compile_in_turn
        return cast(F, dispatcher)

    return compile_at_first_call
