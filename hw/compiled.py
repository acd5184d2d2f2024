"""Functions compiled by numba at their first call and kept on disk, for processes that start together.

Numba numbers what it keeps of a function, a file for each signature, in an index without a lock. Two processes that
compile two signatures at once take the same number, and from then on each process, until the cache is emptied, runs
code that was made for arrays of one kind on arrays of another: a TypeError where the items differ, reads beyond
the array's end where only the layout does (numba issue 4807). Agents, twin and benches start at once, so here an index
and its files are read and written under a lock.

Nor does numba mind that they all compile the same. Here the first process compiles, and the others wait for the file.

An index also names the classes of the arguments. Where a class has another name by now, the index cannot be read:
numba would throw it away as older than the source, but fails before it has looked.

Numba and LLVM are 70 MB and 0.4 s of a process. They are imported at the first call, so that who calls none of these
functions has none of that.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

LOCK = "numba.lock"  # in the folder of the cache, as a rule __pycache__
TURN = ".turn"  # behind the function's own name there: the lock of the process that compiles it


class LockedCache:
    """Numba's cache of one function; a process that writes is alone in the cache's folder."""

    def __init__(self, cache: Any, compiler_lock: Any) -> None:
        """`cache`: numba's own; `compiler_lock`: numba's, of this process."""
        self._cache, self._compiler_lock = cache, compiler_lock
        self._turn: ExitStack | None = None  # holds the lock from a miss until the file is there

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load(sig, target_context)
        if found is None and self._turn is not None:
            self._turn.enter_context(self._locked(fcntl.LOCK_EX, f"{self._cache._impl.filename_base}{TURN}"))
            found = self._load(sig, target_context)  # another process may have compiled it meanwhile
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            with self._locked(fcntl.LOCK_SH):
                return self._cache.load_overload(sig, target_context)
        except (AttributeError, ImportError):  # a class has another name or module by now
            with self._locked(fcntl.LOCK_EX):
                self._cache.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            self._cache.save_overload(sig, data)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """What compiles in here does so alone on this machine. A function that calls itself has its turn already.

        Numba's own lock, taken first, keeps out this process's other threads; functions call each other in one
        direction, so that no two processes wait for each other.
        """
        with self._compiler_lock:
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
        with (Path(self._cache.cache_path) / name).open(
            "ab"
        ) as lock:  # the folder is there: numba has chosen one it can use
            fcntl.flock(lock, how)  # until it is closed
            yield


class Compiled:
    """A function that numba compiles at its first call."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self._function, self._options = function, options
        self.__doc__ = function.__doc__

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's, with the cache above."""
        from numba import njit
        from numba.core.caching import FunctionCache
        from numba.core.compiler_lock import global_compiler_lock
        from numba.extending import typeof_impl

        typeof_impl.register(Compiled)(_as_dispatcher)  # for compiled functions that call this one
        dispatcher: Any = njit(nogil=True, **self._options)(self._function)
        # As its enable_caching() does, which knows no cache but numba's own.
        dispatcher._cache = cache = LockedCache(
            FunctionCache(self._function),  # type: ignore[no-untyped-call]
            global_compiler_lock,
        )
        compile_now = dispatcher.compile

        def compile_in_turn(signature: Any) -> Any:
            with cache.turn():
                return compile_now(signature)

        dispatcher.compile = compile_in_turn
        return dispatcher


def _as_dispatcher(function: Compiled, context: Any) -> Any:
    from numba.extending import typeof_impl

    return typeof_impl(function.dispatcher, context)


def compiled(**options: Any) -> Callable[[F], F]:
    """Numba's njit with `options` of its own, without the interpreter lock and with the cache above."""

    def compile_at_first_call(function: F) -> F:
        return cast(F, Compiled(function, options))

    return compile_at_first_call
