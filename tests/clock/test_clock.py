"""Robots with real devices live by the system's clock: a serial port that is a pty, a V4L2 camera that is a stand-in.

Nothing of a twin takes part, not even one that runs in the folder where theirs would be.
"""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from agent.clock import machine
from agent.clock.clock import (
    BASE,
    HEAD,
    NAME_WORD,
    RATE,
    ROWS,
    SEQUENCE,
    Line,
    Part,
    RunClock,
    StandingClock,
    SystemClock,
    attach,
    create,
    wait,
)
from agent.clock.keeper import start_clock
from agent.core.config import Fleet
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import SweepPlan
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.process.command import shipped_fleet
from agent.process.transport import fleet_clock
from agent.robot.fleet_reader import load_fleet
from hw.stm32.driver import Stm32
from hw.twin.twin_folder import clock_path
from tests.hw.camera.fake_v4l2 import FakeComputer
from tests.hw.conftest import put_on_desk  # noqa: F401 - a fixture
from tests.hw.stm32.driven_desk import Port, drive
from tests.places import ROOT
from tests.sightings import collect
from tests.waiting import until

CAMERA = CameraFit(width_px=96, height_px=64, f_px=150.0, cx_px=47.5, cy_px=31.5)


@pytest.fixture
def real_fleet(tmp_path) -> Fleet:
    """The shipped fleet with real devices; an hour ahead, a twin keeps time in its folder."""
    fleet = load_fleet(shipped_fleet())
    replace = msgspec.structs.replace
    robots = {
        name: replace(robot, serial=f"/dev/ttyACM{i}", camera=f"v4l2:/dev/video{i}")
        for i, (name, robot) in enumerate(fleet.robot.items())
    }
    fleet = replace(fleet, robot=robots, twin=replace(fleet.twin, dir=str(tmp_path)))
    start_clock(clock_path(fleet), list(robots), time.time_ns() + 3_600_000_000_000, 1.0, 10_000_000)
    return fleet


def is_now(t_ns: int) -> bool:
    return abs(t_ns - time.time_ns()) < 5_000_000_000


def test_a_control_module_on_a_port_is_stamped_with_the_time_of_day(real_fleet, put_on_desk, tmp_path):  # noqa: F811
    clock = fleet_clock(real_fleet)
    assert isinstance(clock, SystemClock) and is_now(clock.now_ns())
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether, not the desk
    with Stm32(str(Port(desk, tmp_path).path), clock, part="r1.serial") as driver:
        driver.arm()
        telemetry = drive(desk, driver, lambda: driver._protocol.armed)
    assert telemetry and all(is_now(t.t_ns) for t in telemetry)


def test_frames_of_a_camera_are_stamped_by_its_driver_and_told_in_the_time_of_day(real_fleet):
    computer = FakeComputer()
    clock = fleet_clock(real_fleet)
    vision = Vision(computer.open, real_fleet, CAMERA, load_detectors(real_fleet, CAMERA), clock, "r1")
    vision.start()
    try:
        vision.plan(SweepPlan(sweep=1, focus=(0, 5, 10)))
        seen = collect(vision, lambda seen: any(s.sweep == 1 for s in seen), 30.0)
    finally:
        vision.close()
    offset_ns = time.time_ns() - time.monotonic_ns()
    driver_ns = [s.t_ns - offset_ns for s in seen]  # the stand-in's own time, which began at 5 s
    assert all(4_900_000_000 < t_ns < 60_000_000_000 for t_ns in driver_ns)


# --- run clock ---
# What the followers of a clock see: a twin that comes, stands, dies and comes again. Time never steps back.

LEAD_NS = 3_600_000_000_000  # an hour: nobody takes it for the time of day
TICK_NS = 10_000_000

TWIN = """
import pathlib, sys, threading
from agent.clock.keeper import start_clock
start_ns = int(sys.argv[2])
keeper = start_clock(pathlib.Path(sys.argv[1]), ["r1"], start_ns, float(sys.argv[3]), 10_000_000)
print("ready", flush=True)
stop = threading.Event()
while True:
    start_ns += 10_000_000
    keeper.advance(start_ns, stop)
"""


class Twin:
    """A clock without water in a process of its own, to be stopped and killed."""

    def __init__(self, path: Path, start_ns: int, speed: float = 1.0) -> None:
        command = [sys.executable, "-c", TWIN, str(path), str(start_ns), str(speed)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        assert self.process.stdout is not None and self.process.stdout.readline() == "ready\n"

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        if self.process.stdout:
            self.process.stdout.close()


@pytest.fixture
def twin(tmp_path: Path):
    twins: list[Twin] = []

    def start(start_ns: int, speed: float = 1.0) -> Twin:
        twins.append(Twin(tmp_path / "clock", start_ns, speed))
        return twins[-1]

    yield start
    for one in twins:
        one.end()


@pytest.fixture
def clock(tmp_path: Path) -> RunClock:
    return RunClock(tmp_path / "clock")


def ahead_s(clock: RunClock) -> float:
    """Of the time of day."""
    return (clock.now_ns() - machine.unix_ns()) * 1e-9


def test_without_a_twin_it_is_the_system_s_clock(clock) -> None:
    assert ahead_s(clock) == pytest.approx(0.0, abs=0.1)
    assert clock.rate() == 1.0 and clock.start_ns is None
    assert 0.0 < clock.wall_s(clock.now_ns() + 10**12) <= 0.05  # a twin may come
    assert clock.wall_s(clock.now_ns()) == 0.0


def test_it_follows_a_twin_that_comes(clock, twin) -> None:
    clock.join("r1.loop", 1 << 60)
    start_ns = machine.unix_ns() + LEAD_NS
    twin(start_ns)
    until(lambda: ahead_s(clock) > 3000.0)
    assert clock.start_ns == start_ns
    stranger = RunClock(clock._path)
    assert abs(stranger.now_ns() - clock.now_ns()) < 100_000_000  # everybody's clock says the same


def test_it_runs_at_the_twin_s_rate_and_stands_with_it(clock, twin) -> None:
    it = twin(machine.unix_ns() + LEAD_NS, 0.5)
    until(lambda: ahead_s(clock) > 3000.0)
    began_ns, began_s = clock.now_ns(), machine.monotonic_s()
    machine.sleep(0.5)
    assert 0.2 < (clock.now_ns() - began_ns) * 1e-9 / (machine.monotonic_s() - began_s) < 0.6
    it.process.send_signal(19)  # SIGSTOP
    machine.sleep(0.1)
    stood_ns = clock.now_ns()
    machine.sleep(0.3)
    assert clock.now_ns() == stood_ns
    assert 0.0 < clock.wall_s(stood_ns + 1) <= 0.05  # who waits looks again, but not all the time
    it.process.send_signal(18)  # SIGCONT
    until(lambda: clock.now_ns() > stood_ns + 100_000_000)
    assert clock.now_ns() < stood_ns + 2_000_000_000  # nothing is caught up


def test_who_outlives_a_twin_goes_on_and_follows_the_next(clock, twin) -> None:
    twin(machine.unix_ns() + LEAD_NS).end()
    assert ahead_s(clock) > 3000.0  # it died ahead of the day: who comes now is not of yesterday
    before_ns, began_s = clock.now_ns(), machine.monotonic_s()
    machine.sleep(0.3)
    passed_s = (clock.now_ns() - before_ns) * 1e-9
    assert passed_s == pytest.approx(machine.monotonic_s() - began_s, abs=0.1)  # at the wall's pace
    second = twin(clock.now_ns() + LEAD_NS)
    until(lambda: ahead_s(clock) > 7000.0)
    second.end()
    last_ns = clock.now_ns()
    assert clock.now_ns() >= last_ns


def test_a_dead_twin_behind_the_day_is_not_followed(clock, twin) -> None:
    twin(machine.unix_ns() - LEAD_NS).end()
    assert ahead_s(clock) == pytest.approx(0.0, abs=0.1)


def test_it_never_steps_back(clock, twin) -> None:
    before_ns = clock.now_ns()
    twin(before_ns - LEAD_NS)  # a clock that begins in the past of those who are there
    machine.sleep(0.2)
    assert clock.now_ns() >= before_ns


def test_something_else_in_its_place_is_no_clock(tmp_path, clock) -> None:
    (tmp_path / "clock").write_bytes(os.urandom(4096))
    assert ahead_s(clock) == pytest.approx(0.0, abs=0.1)
    (tmp_path / "clock").write_bytes(b"")
    assert attach(tmp_path / "clock") is None


@pytest.mark.parametrize(
    ("word", "value"),
    [(SEQUENCE, 3), (RATE, 0), (RATE, -1), (BASE, 2**63 - 1), (ROWS, 2**60), (ROWS, -1), (HEAD + NAME_WORD, -1)],
    ids=["half a line", "no rate", "backwards", "too late", "rows that are not there", "fewer than none", "no text"],
)
def test_a_damaged_clock_is_none_and_holds_nobody_up(tmp_path, word: int, value: int) -> None:
    create(tmp_path / "clock", ["r1.loop"], 0, Line(0, 0, 1.0, 0)).close()
    with (tmp_path / "clock").open("rb+") as file:
        file.seek(8 * word)
        file.write(value.to_bytes(8, "little", signed=True))
    assert attach(tmp_path / "clock") is None


def test_a_twin_killed_between_two_halves_of_a_line_leaves_the_last_whole_one(tmp_path) -> None:
    file = create(tmp_path / "clock", ["r1.loop"], 0, Line(5, 5, 1.0, 5))
    reader = attach(tmp_path / "clock")
    assert reader is not None
    file.words[SEQUENCE] += 1
    file.words[BASE] = 99
    assert reader.line().base_ns == 5


def test_a_line_is_read_whole_while_it_changes(tmp_path) -> None:
    """Each line that is written has four equal numbers; a torn one would not."""
    file = create(tmp_path / "clock", ["r1.loop"], 0, Line(1, 1, 1e-6, 1, 1e-6))
    reader, done = attach(tmp_path / "clock"), threading.Event()
    assert reader is not None

    def write() -> None:
        k = 0
        while not done.is_set():
            k += 1
            file.publish(Line(k, k, k / 1e6, k, k / 1e6))

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(20_000):
            line = reader.line()
            assert line.base_ns == line.wall_ns == line.horizon_ns == round(line.rate * 1e6)
    finally:
        done.set()
        thread.join()


def test_names_are_as_long_as_a_robot_s_may_be(tmp_path) -> None:
    names = ["r" * 16 + ".camera", "ö" * 8 + ".serial"]
    create(tmp_path / "clock", names, 0, Line(0, 0, 1.0, 0))
    reader = attach(tmp_path / "clock")
    assert reader is not None and list(reader.rows) == names


@pytest.mark.parametrize("clock", [SystemClock(), StandingClock()])
def test_a_wait_ends_with_its_event(clock) -> None:
    event = threading.Event()
    threading.Timer(0.05, event.set).start()
    assert wait(clock, event, 30.0)


def test_waits_end_when_it_is_time(twin, clock) -> None:
    twin(machine.unix_ns() + LEAD_NS, 0.5)
    until(lambda: ahead_s(clock) > 3000.0)
    began_s = machine.monotonic_s()
    assert not wait(clock, threading.Event(), 0.1)
    assert machine.monotonic_s() - began_s > 0.15  # twice as long on the wall
    part = Part(clock, "r1.loop", 0.025)
    due_ns = clock.now_ns() + 100_000_000
    part.wait(threading.Event(), due_ns)  # while it waits, it holds up nobody
    assert clock.now_ns() >= due_ns
    changed = threading.Condition()
    with changed:
        due_ns = clock.now_ns() + 50_000_000
        while part.wait_changed(changed, due_ns):
            pass
        assert clock.now_ns() >= due_ns
    part.leave()
