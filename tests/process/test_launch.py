"""Who shall end, ends: whenever the signal comes, and whatever it interrupts."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from agent.process import launch
from agent.process.launch import Stop, until_signal
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
