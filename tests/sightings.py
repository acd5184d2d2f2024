"""What a vision worker sees, waited for."""

import time
from collections.abc import Callable

from agent.core.step_io import Sighting
from agent.perception.vision import Vision


def collect(worker: Vision, enough: Callable[[list[Sighting]], bool], limit_s: float = 60.0) -> list[Sighting]:
    """Sightings until enough(sightings)."""
    seen, until = [], time.monotonic() + limit_s
    while not enough(seen):
        assert time.monotonic() < until, f"gave up after {len(seen)} sightings; fault: {worker.fault}"
        seen += worker.drain()
        time.sleep(0.002)
    return seen
