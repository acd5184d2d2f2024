"""A dive's clock when processes stop: the twin's standstill is time's, an agent's is its own fault.

Stops are of the machine and count on the wall; what follows from them counts in the run's time.
"""

import os
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest

from agent.clock.keeper import STALLED_S
from agent.core.codec import decode
from agent.core.step_io import Inputs
from hw.firmware.failsafe import OK, SURFACE
from replay.files.channels import STEP_IN
from replay.files.log import read
from tests.dive_timing import nothing_came_late, timing
from tests.network.dives.dive_of_two import dive_of_two

STOPPED_S = float(os.environ.get("AUCAMP_STOPPED_S", "6"))  # longer than Zenoh's lease and every time-out of ours
SURFACE_AFTER_S = 3.0  # without a set-point, hw/README.md
PATIENCE_S = 180.0  # of the wall, for what takes seconds of run time

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1000 + STOPPED_S)]


def test_a_dive_whose_twin_stands_still_goes_on_as_if_nothing_had_been(tmp_path: Path) -> None:
    with dive_of_two(tmp_path) as (dive, shown):
        began, logs = len(shown.all), {name: dive.log(name) for name in dive.fleet.robot}
        dive.signal("twin", signal.SIGSTOP)
        stopped_ns = dive.clock.now_ns()
        time.sleep(STOPPED_S)  # not for something to happen: that nothing does is the matter
        shown.listen()
        stood_ns = dive.clock.now_ns() - stopped_ns
        dive.signal("twin", signal.SIGCONT)
        goal_ns = stopped_ns + 6_000_000_000
        shown.until("another six seconds", lambda s: s.sent_ns > goal_ns, PATIENCE_S)
        dive.end()
    assert stood_ns < 0.1e9
    for state in shown.all[began:]:
        assert state.armed and state.faults == () and state.neighbours[0].age_s < 1.0, state
    assert all(b.seq == a.seq + 1 for a, b in pairwise(s for s in shown.all if s.robot == "r2"))
    nothing_came_late(dive.log("twin"), tmp_path / "r1.mcap", tmp_path / "r2.mcap")
    for name, before in logs.items():
        said = dive.log(name).removeprefix(before)
        assert not any(fault in said for fault in ("no frames", "no telemetry", "failsafe")), said


def test_an_agent_that_is_stopped_alone_is_its_own_fault(tmp_path: Path) -> None:
    """Time waits for it for STALLED_S of the wall; then its board finds it silent, holds, and surfaces."""
    with dive_of_two(tmp_path) as (dive, shown):
        began, began_s = len(shown.all), time.monotonic()
        dive.signal("r1", signal.SIGSTOP)
        silent_s = 1.5 * SURFACE_AFTER_S
        shown.until("silence", lambda s: s.neighbours[0].age_s > silent_s, PATIENCE_S, "r2")
        assert time.monotonic() - began_s > STALLED_S
        woken_ns = dive.clock.now_ns()
        dive.signal("r1", signal.SIGCONT)
        shown.until("r1 awake", lambda s: s.sent_ns > woken_ns, PATIENCE_S)
        shown.until("both well", lambda s: s.armed and not s.faults and s.neighbours[0].age_s < 1.0, PATIENCE_S)
        dive.end()
    for state in shown.all[began:]:
        assert state.robot == "r1" or (state.armed and state.faults == ()), state
    ladder = [
        telemetry.ladder
        for record in read(tmp_path / "r1.mcap")
        if record.channel == STEP_IN.name
        for telemetry in decode(record.data, Inputs, limit=1 << 20).telemetry
    ]
    assert SURFACE in ladder and ladder[-1] == OK
    assert timing(tmp_path / "r1.mcap").step_gap_s > silent_s - 1.0
    nothing_came_late(dive.log("twin"), tmp_path / "r2.mcap")
