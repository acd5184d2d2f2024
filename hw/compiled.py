"""Functions compiled by numba at their first call and kept on disk, for processes that start together.

Numba numbers what it keeps of a function, a file for each signature, in an index without a lock. Two processes that
compile two signatures at once take the same number, and from then on each process, until the cache is emptied, runs
code that was made for arrays of one kind on arrays of another: a TypeError where the items differ, reads beyond
the array's end where only the layout does (numba issue 4807). Agents, twin and benches start at once, so here an index
and its files are read and written under a lock.

Nor does numba mind that they all compile the same. Here the first process compiles, and the others wait for the file.

An index also names the classes of the arguments. Where a class has another name by now, the index cannot be read:
numba would throw it away as older than the source, but fails before it has looked.

Numba and LLVM are 130 MB and 0.4 s of a process. They are imported at the first call, so that a process that calls none
of these functions has none of that.

An agent calls a few. Where there is a C++ compiler, `python -m hw.compiled` links them into a library beside each
module, as `make run` does, and a process loads that in numba's place: the same machine code, by numba's own `pycc`.
The name of a library holds a digest of all that its code was made from. A process that finds no library of the right
name, or that calls with other types than the library's, goes by numba.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import importlib
import inspect
import platform
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, cached_property
from importlib.machinery import ExtensionFileLoader
from importlib.metadata import version
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

LINKED = ("agent.perception.clarity", "agent.perception.tags")  # modules whose functions every agent calls

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
    """A function that numba compiles at its first call, unless a linked library has it."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], linked: str = "") -> None:
        self._function, self._options, self.signature = function, options, linked
        self.__doc__ = function.__doc__

    def __call__(self, *arguments: Any) -> Any:
        return self._run(*arguments)

    @cached_property
    def _run(self) -> Callable[..., Any]:
        """The linked function for arguments of its types, numba's for all others; pycc's own code checks no types."""
        library = linked_library(self._function.__module__) if self.signature else None
        linked = getattr(library, self._function.__name__, None)
        if linked is None:
            return cast("Callable[..., Any]", self.dispatcher)
        kinds = [_kind(text) for text in _KIND.findall(self.signature.partition("(")[2])]

        def run(*arguments: Any) -> Any:
            if len(arguments) == len(kinds) and all(map(_is_of, arguments, kinds)):
                return linked(*arguments)
            return self.dispatcher(*arguments)

        return run

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


def compiled(linked: str = "", **options: Any) -> Callable[[F], F]:
    """Numba's njit with `options` of its own, without the interpreter lock and with the cache above.

    `linked`: the signature, as numba writes it, by which `python -m hw.compiled` links the function. Its module stands
    in LINKED, and arrays are in C order.
    """

    def compile_at_first_call(function: F) -> F:
        return cast(F, Compiled(function, options, linked))

    return compile_at_first_call


# --- linked ahead of time ---

_KIND = re.compile(r"([a-z]\d)(\[[:,1]*\])?")  # of an argument: i8, or u1[:,::1]
_SCALARS = {"i8": (int, np.integer), "f8": (float, np.floating), "b1": (bool, np.bool_)}
_LAID_OUT = 0x0001 | 0x0100  # numpy's flags: in C order and aligned
Kind = tuple[Any, int]  # an array's dtype and dimensions, or a number's classes and 0


def _kind(text: tuple[str, str]) -> Kind:
    name, array = text
    return (np.dtype(name), array.count(":") - 1) if array else (_SCALARS[name], 0)


def _is_of(argument: Any, kind: Kind) -> bool:
    what, dimensions = kind
    if not dimensions:
        return isinstance(argument, what)
    return (
        type(argument) is np.ndarray
        and argument.dtype is what  # numpy has one object for each of these; another that is equal goes by numba
        and argument.ndim == dimensions
        and argument.flags.num & _LAID_OUT == _LAID_OUT
    )


@cache
def linked_library(module: str) -> Any:
    """The library of a module's linked functions; None where there is none, or only one of other sources."""
    path = _library_path(module)
    if not path.exists():
        return None
    loader = ExtensionFileLoader(_short(module), str(path))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    try:
        library = module_from_spec(spec)
        loader.exec_module(library)
    except ImportError:  # it was linked on another system
        return None
    return library


def _short(module: str) -> str:
    return module.rpartition(".")[2]


def _library_path(module: str) -> Path:
    """Where its library is; the name says of which sources, versions and processor."""
    source = _source(module)
    nodes = ast.walk(ast.parse(source.read_bytes()))
    named = [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    digest = hashlib.sha256()
    for path in (Path(__file__), source, *map(_source, named)):  # constants of other modules are in the code, too
        digest.update(path.read_bytes() if path.is_file() else b"")
    digest.update(f"{sys.version} {version('numba')} {version('numpy')} {_processor()}".encode())
    return source.parent / "__pycache__" / f"{_short(module)}.{digest.hexdigest()[:16]}.linked.so"


def _source(module: str) -> Path:
    """The file of a module of ours."""
    return (Path(__file__).parents[1] / module.replace(".", "/")).with_suffix(".py")


@cache
def _processor() -> str:
    """Its kind, and which instructions it has."""
    try:
        known = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        known = []
    return platform.machine() + next((line for line in known if line.lower().startswith(("flags", "features"))), "")


def link(module: str) -> Path:
    """The library of a module's linked functions, made in the place of older ones. Raises what a compiler does."""
    path = _library_path(module)
    if path.exists():
        return path
    own = importlib.import_module(module)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pycc is to be replaced by something that is not there yet
        from numba.pycc import CC  # type: ignore[attr-defined]
    library = CC(_short(module))  # type: ignore[no-untyped-call]
    library.target_cpu = "host"
    for name, function in inspect.getmembers(own, lambda one: isinstance(one, Compiled) and one.signature != ""):
        names = ", ".join(inspect.signature(function._function).parameters)
        # A function that only calls: what is called keeps the options of its own, which pycc does not know.
        entry = eval(f"lambda {names}: function({names})", {"function": function.dispatcher})
        library.export(name, function.signature)(entry)  # type: ignore[no-untyped-call]
    path.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        library.output_dir = folder
        library.output_file = path.name
        library.compile()
        for old in path.parent.glob(f"{_short(module)}.*.linked.so"):
            old.unlink()
        (Path(folder) / path.name).replace(path)
    return path


def main() -> None:
    """Link what agents call; say so where that is not possible."""
    for module in LINKED:
        try:
            link(module)
        except Exception as error:  # noqa: BLE001 - no compiler, or a numba without pycc: agents are larger, no less right
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            sys.stdout.write(f"{module} is not linked, so agents load numba (130 MB): {reason}\n")


if __name__ == "__main__":
    importlib.import_module("hw.compiled").main()  # whose classes are those of the functions, unlike this module's own
