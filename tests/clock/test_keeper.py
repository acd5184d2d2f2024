"""The twin's side: whom time waits for, and for how long. Real time passes here, as little as the facts need."""

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.clock import keeper as keeper_module
from agent.clock import machine
from agent.clock.clock import RunClock
from agent.clock.keeper import LOWEST, STANDING_NS, WINDOW_NS, Rate, how_it_went, start_clock
from tests.places import ROOT
from tests.waiting import until

START_NS = 1_000_000_000_000
TICK_NS = 10_000_000
SLACK_NS = 25_000_000


class Ticking:
    """A keeper that ticks in a thread, as a twin without water would."""

    def __init__(self, path: Path, speed: float, robots: tuple[str, ...] = ("r1", "r2")) -> None:
        self.keeper = start_clock(path, robots, START_NS, speed, TICK_NS)
        self.now_ns = START_NS
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._stop.is_set():
            self.keeper.advance(self.now_ns + TICK_NS, self._stop)
            self.now_ns += TICK_NS

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        self._thread.start()
        try:
            yield
        finally:
            self._stop.set()
            self._thread.join()
            self.keeper.close()


@pytest.fixture
def ticking(tmp_path: Path):
    return lambda speed=1.0, robots=("r1", "r2"): Ticking(tmp_path / "clock", speed, robots)


def standing(it: Ticking, wall_s: float = 0.1) -> bool:
    before_ns = it.now_ns
    machine.sleep(wall_s)
    return it.now_ns == before_ns


def test_time_goes_as_fast_as_asked_for(ticking) -> None:
    it = ticking(0.25)
    with it.running():
        began_ns, began_s = it.keeper.now_ns(), machine.monotonic_s()
        machine.sleep(0.4)
        took_s = machine.monotonic_s() - began_s
        assert 0.05 < (it.keeper.now_ns() - began_ns) * 1e-9 / took_s <= 0.27


def test_no_faster_than_the_wall_until_all_are_there(ticking, tmp_path) -> None:
    it, clock = ticking(float("inf")), RunClock(tmp_path / "clock")
    with it.running():
        clock.join("r1.loop", SLACK_NS)
        clock.reach("r1.loop", 1 << 62)
        began_ns, began_s = it.now_ns, machine.monotonic_s()
        machine.sleep(0.5)
        assert it.now_ns - began_ns <= (machine.monotonic_s() - began_s) * 1e9 + 2 * TICK_NS
        clock.join("r2.loop", SLACK_NS)
        clock.reach("r2.loop", 1 << 62)
        until(lambda: clock.rate() > 3.0)


def test_time_waits_for_who_is_behind_and_no_longer(ticking, tmp_path) -> None:
    it, clock = ticking(), RunClock(tmp_path / "clock")
    with it.running():
        clock.join("r1.loop", SLACK_NS)
        reached_ns = clock.now_ns()
        until(lambda: standing(it))
        assert it.keeper.now_ns() <= reached_ns + SLACK_NS
        assert clock.now_ns() <= reached_ns + SLACK_NS
        clock.reach("r1.loop", reached_ns + 100_000_000)
        until(lambda: it.now_ns >= reached_ns + 50_000_000)
        until(lambda: standing(it))
        assert it.keeper.now_ns() <= reached_ns + 100_000_000 + SLACK_NS
        clock.leave("r1.loop")
        until(lambda: it.now_ns > reached_ns + 300_000_000)
    assert it.keeper.story().waited_s["r1.loop"] > 0.1
    assert "waited for r1.loop" in how_it_went(it.keeper.story())


def test_who_makes_no_progress_is_given_up_until_he_does(ticking, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(keeper_module, "STALLED_S", 0.5)
    it, clock = ticking(), RunClock(tmp_path / "clock")
    with it.running():
        clock.join("r1.loop", SLACK_NS)
        reached_ns, began_s = clock.now_ns(), machine.monotonic_s()
        until(lambda: it.now_ns > reached_ns + 200_000_000)
        assert machine.monotonic_s() - began_s > 0.5  # and not before
        clock.reach("r1.loop", clock.now_ns())  # he is back, and is waited for again
        until(lambda: standing(it))
        clock.leave("r1.loop")


def test_nobody_hurries_past_one_that_is_given_up(ticking, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(keeper_module, "STALLED_S", 0.3)
    it, clock = ticking(float("inf"), ("r1",)), RunClock(tmp_path / "clock")
    with it.running():
        for part in ("r1.loop", "r1.camera"):
            clock.join(part, SLACK_NS)
            clock.reach(part, 1 << 62)
        until(lambda: clock.rate() > 3.0)
        clock.reach("r1.camera", clock.now_ns())
        until(lambda: standing(it))
        until(lambda: not standing(it))
        began_ns, began_s = it.now_ns, machine.monotonic_s()
        machine.sleep(0.3)
        assert it.now_ns - began_ns <= (machine.monotonic_s() - began_s) * 1e9 + 2 * TICK_NS
        clock.reach("r1.camera", 1 << 62)
        until(lambda: clock.rate() > 3.0)


def test_the_dead_are_not_waited_for(ticking, tmp_path) -> None:
    """A killed process is the machine's doing, so this is on the wall: time goes on at once, not after STALLED_S."""
    it = ticking()
    program = f"""
import pathlib, time
from agent.clock.clock import RunClock
clock = RunClock(pathlib.Path({str(tmp_path / "clock")!r}))
clock.join("r1.loop", {SLACK_NS})
print("joined", flush=True)
time.sleep(60)
"""
    with (
        it.running(),
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, cwd=ROOT) as process,
    ):
        try:
            assert process.stdout is not None and process.stdout.readline() == "joined\n"
            until(lambda: standing(it))
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            began_s = machine.monotonic_s()
            before_ns = it.now_ns
            until(lambda: it.now_ns > before_ns + 5 * TICK_NS)
            assert machine.monotonic_s() - began_s < 1.0
            assert not it.keeper.takes_part("r1.loop")
        finally:
            process.kill()


def test_a_frame_is_there_when_it_is_due_and_time_waits_for_its_rendering(ticking, tmp_path) -> None:
    it, clock = ticking(robots=("r1",)), RunClock(tmp_path / "clock")
    with it.running():
        clock.join("r1.camera", SLACK_NS)
        due_ns = it.keeper.now_ns() + 50_000_000
        with it.keeper.frame("r1", due_ns, due_ns + 30_000_000):
            until(lambda: standing(it))  # rendering takes long
            assert due_ns <= it.keeper.now_ns() <= due_ns + 30_000_000
        with it.keeper.frame("r1", due_ns + 100_000_000, due_ns + 130_000_000):
            clock.reach("r1.camera", 1 << 62)  # one that is rendered at once
        assert it.keeper.now_ns() >= due_ns + 100_000_000
        clock.leave("r1.camera")


def test_a_limit_of_the_twin_s_own_holds_time(ticking) -> None:
    it = ticking()
    limit_ns = START_NS + 100_000_000
    it.keeper.limits["r1.port"] = lambda: limit_ns
    with it.running():
        until(lambda: it.now_ns >= START_NS + 50_000_000)
        until(lambda: standing(it))
        assert it.keeper.now_ns() <= limit_ns
        limit_ns += 1_000_000_000
        until(lambda: it.now_ns > START_NS + 200_000_000)


# --- rate ---
# The rate by itself: steps at given times, no clock.


def run(rate: Rate, from_ns: tuple[int, int], seconds: float, wall_s_a_second: float, complete: bool = True):
    """Ticks of a machine that needs so much wall time for a second of run time; returns where it ends."""
    now_ns, wall_ns = from_ns
    expected = 0.0
    for _ in range(round(seconds * 1e9 / TICK_NS)):
        now_ns, wall_ns = now_ns + TICK_NS, wall_ns + round(TICK_NS * wall_s_a_second)
        expected = rate.step(now_ns, wall_ns, complete)
    return (now_ns, wall_ns), expected


def test_a_machine_that_keeps_up_gets_what_was_asked_for() -> None:
    _, expected = run(Rate(1.0, 0, 0), (0, 0), 3.0, 1.0)
    assert expected == 1.0


def test_it_gives_way_and_comes_back() -> None:
    rate = Rate(1.0, 0, 0)
    at, _ = run(rate, (0, 0), 2.0, 1.0)
    at, expected = run(rate, at, 2.0, 2.5)  # a machine that manages 0.4
    assert rate.achieved == pytest.approx(0.4, rel=0.05)
    assert 0.4 < expected <= 0.8  # with headroom: who sleeps too long holds up the others
    at, expected = run(rate, at, 2.0, 1.0)
    assert expected == 1.0
    assert min(rate.told) == pytest.approx(0.4, rel=0.1) and max(rate.told) == pytest.approx(1.0, rel=0.05)


def test_without_a_limit_it_grows_until_the_machine_is_the_limit() -> None:
    rate = Rate(math.inf, 0, 0)
    at, expected = run(rate, (0, 0), 1.0, 1.0)
    assert expected > 1.0
    for _ in range(20):
        at, expected = run(rate, at, 1.0, 1.0 / min(expected, 3.0))  # the machine manages 3
    assert rate.achieved == pytest.approx(3.0, rel=0.05) and 3.0 < expected < 7.0


def test_nobody_is_hurried_past_who_is_still_to_come() -> None:
    rate = Rate(math.inf, 0, 0)
    at, expected = run(rate, (0, 0), 2.0, 1.0, complete=False)
    assert expected == 1.0 and not rate.told
    _, expected = run(rate, at, 2.0, 0.5)
    assert expected > 1.0
    assert Rate(0.25, 0, 0).achieved == 0.25  # but slower, if slower was asked for


def test_a_twin_that_was_stopped_learns_nothing_from_it() -> None:
    rate = Rate(1.0, 0, 0)
    (now_ns, wall_ns), _ = run(rate, (0, 0), 2.0, 1.0)
    wall_s = rate.wall_s
    assert rate.step(now_ns + TICK_NS, wall_ns + 20 * STANDING_NS, True) == 1.0
    assert rate.wall_s == wall_s


def test_what_is_expected_has_a_floor() -> None:
    rate = Rate(1.0, 0, 0)
    now_ns = wall_ns = 0
    for _ in range(5):
        now_ns, wall_ns = now_ns + TICK_NS, wall_ns + WINDOW_NS
        expected = rate.step(now_ns, wall_ns, True)
    assert expected == LOWEST
