"""Functions compiled by numba at their first call and kept on disk, for processes that start together.

Numba numbers what it keeps of a function, a file for each signature, in an index without a lock. Two processes that
compile two signatures at once take the same number, and from then on each process, until somebody empties the cache,
runs code that was made for arrays of one kind on arrays of another: a TypeError where the items differ, reads beyond
the array's end where only the layout does (numba issue 4807). Agents, twin and benches start at once, so here an index
and its files are read and written under a lock.

An index also names the classes of the arguments. One that has another name by now cannot be read, and numba, which
would throw the index away as older than the source, fails before it has looked.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache

F = TypeVar("F", bound=Callable[..., Any])

LOCK = "numba.lock"  # in the folder of the cache, as a rule __pycache__


class LockedCache(FunctionCache):
    """Numba's cache of one function; who writes is alone in the folder that it is in."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            with self._locked(fcntl.LOCK_SH):
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # of sources in which a class was called, or lay, otherwise
            with self._locked(fcntl.LOCK_EX):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    @contextmanager
    def _locked(self, how: int) -> Iterator[None]:
        with (Path(self.cache_path) / LOCK).open("ab") as lock:  # the folder is there: numba has chosen one it can use
            fcntl.flock(lock, how)  # until it is closed
            yield


def compiled(**options: Any) -> Callable[[F], F]:
    """Numba's njit with `options` of its own, without the interpreter lock and with the cache above."""

    def compile_at_first_call(function: F) -> F:
        dispatcher: Any = njit(nogil=True, **options)(function)
        # As its enable_caching() does, which knows no cache but numba's own.
        dispatcher._cache = LockedCache(function)  # type: ignore[no-untyped-call]
        return cast(F, dispatcher)

    return compile_at_first_call
