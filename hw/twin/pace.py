"""How fast a dive goes: with the wall clock, for agents, or as fast as every firmware answers, for experiments."""

from __future__ import annotations

import threading
import time

from hw.twin.devices.board import PATIENCE_S
from hw.twin.dive import Dive
from hw.twin.physics.tank import TICK_NS

LOCK_STEP_S = 5.0  # in virtual time a firmware that is silent for longer is taken for dead
LATE_S = 0.1  # a tick that is later is an overrun: the machine cannot keep up


def run_at_wall_clock(dive: Dive, stop: threading.Event) -> int:
    """Tick with CLOCK_MONOTONIC until stopped; returns the overruns. No step is ever left out: time is caught up."""
    overruns = 0
    while not stop.is_set():
        ahead_s = (dive.now_ns + TICK_NS - time.monotonic_ns()) * 1e-9
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -LATE_S:
            overruns += 1
        dive.tick(PATIENCE_S)
    return overruns


def run_in_lock_step(dive: Dive, ticks: int) -> None:
    """Tick as fast as every firmware answers. Raises TimeoutError naming one that does not."""
    for _ in range(ticks):
        dive.tick(LOCK_STEP_S)
        for board in dive.boards:
            if board.overdue:
                raise TimeoutError(f"the firmware of {board.robot} did not answer for {LOCK_STEP_S} s")
