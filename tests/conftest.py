"""Tests side by side, by pytest-xdist: `pytest -n 2` gives whole files to workers, as each of them has time.

Without -n tests run in one process, in the order in which they stand.
"""

import gc
import os
from collections import Counter
from collections.abc import Generator

import pytest

NETWORK, DIVES = "tests/network/", "tests/network/dives/"
NICE = 5  # a third of the other's share where both want more than there is
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")  # torch, numpy, OpenCV; read at import


def pytest_configure(config: pytest.Config) -> None:
    """Tests, and what they start, compute in one thread: their small arrays make several wait more than they work."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported and collected stays: nothing of it is garbage, neither now nor whenever it is looked for."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True, wrapper=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> Generator[None, int, int]:
    """What `-n auto` means: a worker more than xdist counts cores, for the one that has tests/network mostly waits."""
    return (yield) + 1


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order the work: what keeps time with the world, then files with the most slow tests, then with the most tests, so
    that the last are short."""
    if hasattr(config, "workerinput"):
        tests = Counter(item.path for item in items)
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        items.sort(key=lambda item: (not keeps_time(item.nodeid), -slow[item.path], -tests[item.path]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that computes stands back for the one that keeps time; whoever had those tests had them first."""
    if hasattr(item.config, "workerinput") and not keeps_time(item.nodeid) and os.nice(0) < NICE:
        os.nice(NICE - os.nice(0))


def keeps_time(nodeid: str) -> bool:
    """Whether a test's processes live by the wall's clock. Dives have one of their own, which waits for them."""
    return nodeid.startswith(NETWORK) and not nodeid.startswith(DIVES)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log):
    """A worker takes a file at a time, and all of tests/network but its dives as if it were one.

    There live whole fleets, several processes each, which must keep time with the world: beside a test that computes,
    or a dive, they do, but not beside each other.
    """
    from xdist.scheduler import LoadFileScheduling

    class ByFile(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return NETWORK if keeps_time(nodeid) else super()._split_scope(nodeid)

    config.option.loadscopereorder = False  # files stay in our order, not in that of how many tests they have
    return ByFile(config, log)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports whose figures are made, but not drawn, which takes seconds: for tests of what they say."""
    draw = "matplotlib.backends.backend_svg.FigureCanvasSVG.print_svg"
    monkeypatch.setattr(draw, lambda canvas, text, **about: text.write("<svg>\n</svg>\n"))
