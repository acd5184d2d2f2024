"""Which product files a walk enters: a profiler that knows what is entered without the datum that is followed.

The rule. A function is on the walk when it is entered with the datum and never without it, or when such a function is
entered beneath it: then it handed the datum on. What a step does anyway is not on the walk, and neither is a helper
that is called anyway. Only bodies of functions count; what a module or a class does while it is loaded does not. A file
is on the walk when one of its functions is: a function that moves to another file takes its part of the walk along.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Literal

from router_config.session import Session
from tests.places import ROOT

PRODUCT = ("agent", "hw", "replay", "router_config")


class Entered:
    """The functions of one walk. Follow it in a `watched` block: first `without` the datum, then `with_it`."""

    def __init__(self) -> None:
        self._phase: Literal["", "without", "with"] = ""
        # By identity: code of two files may be equal.
        self._without: dict[int, CodeType] = {}  # entered without the datum
        self._tried: dict[int, CodeType] = {}  # in the `without` block that is under way
        self._walk: dict[int, CodeType] = {}  # in the order in which they were entered first

    @property
    def files(self) -> tuple[str, ...]:
        """Product files on the walk, from the root of the repository, in the order of their first entry."""
        found = (product_file(code.co_filename) for code in self._walk.values())
        return tuple(dict.fromkeys(file for file in found if file is not None))

    def passes(self, function: Callable[..., Any]) -> bool:
        """Whether a function is on the walk."""
        return id(function.__code__) in self._walk

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Watch this thread, all that it starts from now on, and Zenoh's calls to sessions that are opened here."""
        sys.setprofile(self._profile)
        threading.setprofile(self._profile)
        try:
            with watched_callbacks(self._profile):
                yield
        finally:
            self._phase = ""
            threading.setprofile(None)
            sys.setprofile(None)

    @contextmanager
    def without(self, holds: Callable[[], bool] = lambda: True) -> Iterator[None]:
        """What is entered in this block is entered without the datum, if afterwards that `holds`."""
        self._tried, self._phase = {}, "without"
        try:
            yield
        finally:
            self._phase = ""
        if holds():
            self._without |= self._tried

    @contextmanager
    def with_it(self) -> Iterator[None]:
        """In this block the datum is on its way."""
        self._phase = "with"
        try:
            yield
        finally:
            self._phase = ""

    def _profile(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or id(code) in self._without or product_file(code.co_filename) is None:
            return
        if self._phase == "without":
            self._tried[id(code)] = code
        elif self._phase == "with":
            stack = list(product_stack(frame))
            if all(each.co_flags & CO_OPTIMIZED for each in stack):  # else a file is being loaded
                self._walk.update((id(each), each) for each in reversed(stack))


@contextmanager
def apart() -> Iterator[None]:
    """What this thread does in the block is not the walk's: a neighbour's mind, say, that is in the same process."""
    profile = sys.getprofile()
    sys.setprofile(None)
    try:
        yield
    finally:
        sys.setprofile(profile)


@contextmanager
def watched_callbacks(profile: Any) -> Iterator[None]:
    """Zenoh calls from threads of its own, which no profiler hears of: each call brings it along."""
    names = Session.subscribe.__globals__  # of the file that hands callbacks to Zenoh, wherever it lies
    callback = names["Callback"]

    def watched(function: Callable[[Any], None], *rest: Any, **options: Any) -> Any:
        def call(what: Any) -> None:
            before = sys.getprofile()  # it may be a thread of ours: what is there already is told at once
            sys.setprofile(profile)
            try:
                function(what)
            finally:
                sys.setprofile(before)

        return callback(call, *rest, **options)

    names["Callback"] = watched
    try:
        yield
    finally:
        names["Callback"] = callback


def product_stack(frame: FrameType | None) -> Iterator[CodeType]:
    """Product code that is under way, the innermost first."""
    while frame is not None:
        if product_file(frame.f_code.co_filename) is not None:
            yield frame.f_code
        frame = frame.f_back


@cache
def product_file(name: str) -> str | None:
    """The file from the root of the repository; None: it is not the product's."""
    path = Path(name)
    if not path.is_relative_to(ROOT):
        return None
    path = path.relative_to(ROOT)
    return str(path) if path.parts[0] in PRODUCT else None
