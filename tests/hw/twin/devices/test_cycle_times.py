"""The board's time in the twin: ticks lost, pulses late, telemetry at the end of a cycle; and the table itself."""

import math
import os
import struct

import numpy as np
import pytest

from hw.firmware import bus, wire
from hw.twin.board import NO_TIME, Boot, CycleTimes, read_table
from hw.twin.dive import run_in_lock_step
from hw.twin.physics.tank import STEP_S
from tests.bench.board import imposed
from tests.hw.twin.stand_ins import tell
from tests.places import ROOT

SET_POINT, TELEM, STATUS = (wire.SIZE[kind] + wire.OVERHEAD + 2 for kind in (wire.SETPOINT, wire.TELEM, wire.STATUS))
OVERRUN_US = 13_333


@pytest.fixture
def begun(monkeypatch):
    """(clock, waited) of each cycle that a firmware was given."""
    cycles = []
    plain = Boot.tick

    def tick(boot, clock_us, record):
        cycles.append(struct.unpack(bus.TICK, record)[:2])
        plain(boot, clock_us, record)

    monkeypatch.setattr(Boot, "tick", tick)
    return cycles


def test_a_board_that_keeps_its_cycle_is_given_each_tick(plunge, begun):
    run_in_lock_step(plunge(("r1",), takes_us=[5000, 9999]), 100)
    assert begun == [(10_000 * k, 0) for k in range(1, 101)]


def test_a_board_that_takes_13_ms_loses_every_fourth_tick_and_begins_at_once_when_it_is_free(plunge, begun):
    dive = plunge(("r1",), takes_us=[5000, OVERRUN_US])
    run_in_lock_step(dive, 101)
    clocks, waits = np.array(begun).T
    assert len(clocks) == 76
    assert set(np.diff(clocks)) == {OVERRUN_US}
    assert waits[:4].tolist() == [0, 3333, 6666, 9999]
    assert np.all((clocks - waits) % bus.TICK_US == 0)


def thrust_after(dive, ticks):
    """Of the first thruster, so long after the answer that arms and pushes up."""
    run_in_lock_step(dive, 10)  # the tick at 0.1 s is sent, its answer is still to come
    assert dive.states["thrust_n"][0, 0] == 0
    run_in_lock_step(dive, ticks)
    return dive.states["thrust_n"][0, 0], float(dive.bodies["thrust_lag_s"][0, 0])


@pytest.mark.parametrize(("pins_us", "shown_us"), [(0, 0), (1, 5000), (5000, 5000), (5001, 10_000), (12_000, 15_000)])
def test_pulses_change_with_the_next_frame_after_they_were_written(plunge, pins_us, shown_us):
    full_n, lag_s = thrust_after(plunge(("r1",), takes_us=[0, 0]), 300)
    thrust_n, _ = thrust_after(plunge(("r1",), takes_us=[pins_us, 0]), 2)
    assert thrust_n == pytest.approx(full_n * (1 - math.exp(-(0.02 - shown_us * 1e-6) / lag_s)), rel=0.01)


def test_what_a_board_says_is_there_when_its_cycle_is_over(plunge, monkeypatch):
    dive = plunge(("r1",), takes_us=[5000, 25_000])
    said = []
    monkeypatch.setattr(dive.boards[0]._cable, "send", lambda data: said.append((dive.ticks, data)))
    run_in_lock_step(dive, 1)
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tell(dive.boards[0], port, b"\x01")
        run_in_lock_step(dive, 10)
    finally:
        os.close(port)
    # The first cycle begins at tick 1 and ends at 35 ms; the second hears the byte, and is over at 60 ms.
    assert said == [(5, b"\x02")]


def test_the_water_moves_as_far_in_short_steps(plunge):
    """Splitting a tick where pulses change is no other physics: half steps differ by less than the steps themselves."""
    ends = []
    for pins_us in (4999, 5001):
        dive = plunge(("r1",), takes_us=[0, 0])
        run_in_lock_step(dive, 30)
        before_us = dive._advance(0, pins_us)
        dive._advance(before_us, 10_000)
        ends.append(dive.states["position_m"][0].copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=STEP_S * 1e-3)


# --- the table ----------------------------------------------------------------------------------------------------


def test_the_table_tells_of_a_board_that_keeps_its_cycle():
    times = read_table().times
    armed_us = times.armed_us + SET_POINT * times.heard_byte_us
    telemetry_us = times.sent_frame_us + TELEM * times.sent_byte_us
    assert telemetry_us > 10 * TELEM  # at 1 Mbaud it takes that long on the wire alone
    assert 0 < times.disarmed_us < times.armed_us
    status_us = times.sent_frame_us + STATUS * times.sent_byte_us
    for also_us in (telemetry_us, status_us, times.collect_us, times.heap_free_us):
        assert armed_us + also_us < bus.TICK_US


def test_the_table_is_of_this_firmware():
    if hint := imposed.hint(ROOT / "hw" / "firmware"):
        pytest.skip(hint)


def test_a_record_is_whole_nanoseconds_in_the_order_of_the_hal():
    times = CycleTimes(
        armed_us=1.5, disarmed_us=2, sent_frame_us=3, sent_byte_us=4.0004, heard_byte_us=5, collect_us=6, heap_free_us=7
    )
    assert times.record() == "1500 2000 3000 4000 5000 6000 7000"
    assert NO_TIME.record() == "0 0 0 0 0 0 0"
