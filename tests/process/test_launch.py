"""Who shall end, ends: whenever the signal comes, and whatever it interrupts."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from agent.process import launch
from agent.process.command import Failed
from agent.process.launch import Crew, Stop, until_signal
from tests.places import ROOT
from tests.waiting import until

# A handler that sets the event every 50 us, while the main thread looks at it as often as it can.
WAITS = """
import signal, sys, threading, time
from agent.process.launch import Stop
event = Stop()
signal.signal(signal.SIGALRM, lambda *_: event.set())
signal.setitimer(signal.ITIMER_REAL, 5e-5, 5e-5)
for _ in range(30_000):
    event.wait(0.0)
signal.setitimer(signal.ITIMER_REAL, 0.0)
print("through")
"""


def test_a_signal_in_the_middle_of_a_wait_is_no_deadlock() -> None:
    """threading's own event hangs in this, or runs into itself until the stack is full."""
    done = subprocess.run([sys.executable, "-c", WAITS], capture_output=True, text=True, cwd=ROOT, timeout=100.0)
    assert done.stdout == "through\n", done.stderr


def test_a_stop_is_an_event() -> None:
    stop = Stop()
    assert not stop.wait(0.01) and not stop.is_set()
    threading.Timer(0.05, stop.set).start()
    began_s = time.monotonic()
    assert stop.wait(30.0) and stop.wait() and time.monotonic() - began_s < 20.0


def test_a_signal_that_was_forgotten_in_a_callback_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "_asked", [])
    with pytest.raises(launch.Leaving, match="143") as leaving:
        launch.leave(signal.SIGTERM, None)
    leaving.value.arrived = True
    with until_signal() as stop:
        assert stop.is_set()


# A verb during whose work a signal comes where Python drops what its handler raises.
DROPS = """
import signal, sys, time, weakref
import agent.__main__
class Thing: ...
def verb(**_):
    if sys.argv[1] == "callback":
        thing = Thing()
        watch = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGTERM))
        del thing
    else:
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException:
            pass
    time.sleep(60.0)
agent.__main__.command_line = lambda: verb
agent.__main__.main()
"""


@pytest.mark.parametrize("how", ["callback", "caught"])
def test_a_signal_that_python_drops_comes_again_and_ends_any_verb(how: str) -> None:
    began_s = time.monotonic()
    done = subprocess.run([sys.executable, "-c", DROPS, how], capture_output=True, cwd=ROOT, timeout=100.0)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert time.monotonic() - began_s < 40.0


# What was raised for a signal is kept until the interpreter ends.
KEEPS = """
import builtins, signal
from agent.process.launch import leave
try:
    leave(signal.SIGTERM, None)
except SystemExit as error:
    builtins.kept = error
"""


def test_a_signal_that_is_dropped_as_the_interpreter_ends_hangs_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", KEEPS], capture_output=True, cwd=ROOT, timeout=60.0)
    assert done.returncode == 0, done.stderr


def test_one_signal_asks_and_a_second_one_interrupts() -> None:
    with pytest.raises(KeyboardInterrupt), until_signal() as stop:
        signal.raise_signal(signal.SIGTERM)
        until(stop.is_set)
        signal.raise_signal(signal.SIGTERM)
        time.sleep(1.0)


@pytest.mark.parametrize("limit", ["-d 192000", "-d 512000", "-v 1500000"])
def test_an_agent_that_may_not_have_its_memory_says_so_and_does_not_start(limit: str) -> None:
    command = f"ulimit {limit}; exec {sys.executable} -m agent agent fleet.toml --robot r1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, cwd=ROOT, timeout=60.0)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and line.startswith("aucamp: a process may have ") and f"ulimit {limit[:2]} " in line


# --- work that is waited for ---


def test_who_works_may_take_as_long_as_the_machine_is_busy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second of a processor is allowed: work of a tenth is done, however long it takes by the wall."""
    now_s = [0.0]
    monkeypatch.setattr(launch.machine, "monotonic_s", lambda: now_s[0])
    worked = iter([0.0, *(0.15 * k for k in range(1, 7))])

    class Done:
        pid, returncode = 1, 0

        def poll(self) -> int | None:
            now_s[0] += 0.9  # by the wall, of each look
            return 0 if now_s[0] > 5.0 else None

    crew = Crew(tmp_path)
    crew._children = [launch.Child("calibrate_r1", Done(), tmp_path / "a.log")]
    monkeypatch.setattr(launch, "busy_s", lambda pid: next(worked))
    monkeypatch.setattr(launch.machine, "sleep", lambda s: None)
    crew.finish_one(1.0)
    assert crew._children == []


@pytest.mark.parametrize(("work", "how"), [(0.0, "stood still"), (0.6, "worked")])
def test_who_stands_still_or_works_for_ever_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, work: float, how: str
) -> None:
    now_s, worked_s = [0.0], [0.0]

    class Never:
        pid, returncode = 1, None

        def poll(self) -> None:
            now_s[0], worked_s[0] = now_s[0] + 0.4, worked_s[0] + work

    monkeypatch.setattr(launch.machine, "monotonic_s", lambda: now_s[0])
    monkeypatch.setattr(launch, "busy_s", lambda pid: worked_s[0])
    monkeypatch.setattr(launch.machine, "sleep", lambda s: None)
    crew = Crew(tmp_path)
    crew._children = [launch.Child("calibrate_r1", Never(), tmp_path / "a.log")]
    with pytest.raises(Failed, match=f"calibrate_r1 {how} for longer than 1 s; its output is in"):
        crew.finish_one(1.0)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_processors_time_is_that_of_all_below_a_process() -> None:
    burn = "import time; t = time.process_time()\nwhile time.process_time() - t < 0.2: pass"
    below = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burn!r}]); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", below], stdin=subprocess.PIPE) as process:
        until(lambda: launch.busy_s(process.pid) >= 0.2)
        process.communicate(b"")
    assert launch.busy_s(process.pid) == 0.0
