"""A dive's clock without a dive: time by which all processes of a fleet live, kept by a thread of the test's own."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Thread

from agent.clock.clock import SystemClock
from agent.clock.keeper import Keeper, start_clock
from agent.core.config import Fleet
from hw.twin.physics.tank import TICK_NS
from hw.twin.twin_folder import clock_path


@contextmanager
def kept_time(fleet: Fleet, robots: Sequence[str]) -> Iterator[Keeper]:
    """As fast as these robots' agents can, once all of them are there; it waits for none that is dead."""
    now_ns, stop = SystemClock().now_ns(), Event()
    keeper = start_clock(clock_path(fleet), robots, now_ns, math.inf, TICK_NS)

    def keep() -> None:
        for k in range(1, 1 << 62):
            if stop.is_set():
                return
            keeper.advance(now_ns + k * TICK_NS, stop)

    thread = Thread(target=keep, name="kept time")
    thread.start()
    try:
        yield keeper
    finally:
        stop.set()
        thread.join()
        keeper.close()
