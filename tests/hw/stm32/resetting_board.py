"""A control module on a pty that resets: boot.py, two sets of firmware, MicroPython's real prompt.

For the chip stand small modules (pyb, machine, stm, and sync of os), which MicroPython's Unix port finds; the timer and
the watchdog that boot.py sets are kept by us, in wall time.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Mapping
from pathlib import Path

from hw.firmware import bus
from tests.hw.desk import FIRMWARE, MICROPYTHON
from tests.hw.firmware.nominal_plant import AIR_PA

TO_PROMPT, RESET = 3, 7  # exit codes: of hal_unix, of our machine.reset()
AT_PROMPT = 0x0A12

# The chip, as files of the interpreter that runs on it; registers and what boot.py asks for are files too.
CHIP = {
    "machine": f"""
import sys
def reset(): sys.exit({RESET})
def WDT(timeout): open("/CHIP/watchdog_ms", "w").write(str(timeout))
""",
    "stm": """
RTC, RTC_BKP18R, RTC_BKP19R = 0, 18, 19
class Registers:
    def __getitem__(self, i):
        try: return int(open("/CHIP/register%d" % i).read())
        except OSError: return 0
    def __setitem__(self, i, value): open("/CHIP/register%d" % i, "w").write(str(value))
mem32 = Registers()
""",
    "os": """
from uos import *
def sync(): pass
""",
    "pyb": """
class Pin:
    IN = PULL_UP = 0
    def __init__(self, name, **_): pass
    def value(self): return 1
class Timer:
    def __init__(self, number, freq): pass
    def callback(self, count): open("/CHIP/timer", "w").close()
def usb_mode(mode): pass
def UART(number, baudrate, read_buf_len): return number
def repl_uart(uart): open("/CHIP/repl_uart", "w").close()
def main(path): open("/CHIP/main", "w").write(path)
""",
}


class ResettingBoard:
    """Runs in a thread from entry to exit."""

    def __init__(self, folder: Path, trial_s: float) -> None:
        self.flash, self.chip = folder / "flash", folder / "chip"
        self.trial_s = trial_s
        self.boots: list[str] = []  # what each boot ran
        self._stop = threading.Event()
        self._master, self._slave = os.openpty()
        self.path = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._live)

    def __enter__(self) -> ResettingBoard:
        tty.setraw(self._slave)
        tty.setraw(self._master)
        (self.flash / "a").mkdir(parents=True)
        self.chip.mkdir()
        for name, text in CHIP.items():
            (self.chip / f"{name}.py").write_text(text.replace("/CHIP", str(self.chip)))
        shutil.copy(FIRMWARE / "boot.py", self.flash)
        for name, content in sources().items():
            (self.flash / "a" / name).write_bytes(content)
        self.tables = folder_table(self.flash)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(10.0)
        os.close(self._master)
        os.close(self._slave)

    def register(self, number: int) -> int:
        path = self.chip / f"register{number}"
        return int(path.read_text() or "0") if path.exists() else 0

    def _live(self) -> None:
        while not self._stop.is_set():
            self._boot()

    def _boot(self) -> None:
        """From one reset to the next."""
        for name in ("timer", "watchdog_ms", "main"):
            (self.chip / name).unlink(missing_ok=True)
        assert MICROPYTHON is not None
        env = {**os.environ, "MICROPYPATH": str(self.chip), bus.TIMES: ""}
        subprocess.run([MICROPYTHON, "boot.py"], cwd=self.flash, env=env, check=True, stderr=subprocess.DEVNULL)
        main = self.flash / (self.chip / "main").read_text()
        until_s = time.monotonic() + (self.trial_s if (self.chip / "timer").exists() else 1e9)
        self.boots.append(str(main.relative_to(self.flash)) if main.is_file() else "prompt")
        if not main.is_file():
            self._prompt(env)
            return
        if not self._firmware(main, env, until_s) and (self.chip / "watchdog_ms").exists():
            self._stop.wait(0.2)  # it broke off, and nobody feeds the watchdog
        elif not self._stop.is_set() and time.monotonic() < until_s and self.register(19) != AT_PROMPT:
            self._stop.wait()  # a set that breaks off outside a trial: nothing wakes it

    def _prompt(self, env: Mapping[str, str]) -> None:
        assert MICROPYTHON is not None
        ends = {"stdin": self._master, "stdout": self._master, "stderr": subprocess.DEVNULL}
        with subprocess.Popen([MICROPYTHON, "-i"], cwd=self.flash, env=env, **ends) as process:  # type: ignore[call-overload]
            while process.poll() is None:
                if self._stop.wait(0.02):
                    process.kill()
        tty.setraw(self._master)

    def _firmware(self, main: Path, env: Mapping[str, str], until_s: float) -> bool:
        """Whether it ran until it was reset."""
        ours, theirs = socket.socketpair()
        ours.settimeout(1.0)
        os.set_blocking(self._master, False)
        command = [MICROPYTHON, str(main), str(self._master), str(theirs.fileno()), str(self.flash / "table.json")]
        fds = [self._master, theirs.fileno()]
        process = subprocess.Popen(command, cwd=main.parent, pass_fds=fds, env=env, stderr=subprocess.DEVNULL)  # type: ignore[arg-type]
        theirs.close()
        now_us = 5_000_000
        try:
            while not self._stop.is_set() and time.monotonic() < until_s:
                now_us += 10_000
                ours.sendall(bus.tick(now_us, [AIR_PA] * 4, 15000, 100, 0, 15))
                got = b""
                while len(got) < bus.ACT_SIZE:
                    chunk = ours.recv(bus.ACT_SIZE - len(got))
                    if not chunk:
                        raise OSError("it has ended")
                    got += chunk
                time.sleep(0.005)
            return True
        except OSError:  # it has ended, or hangs
            with contextlib.suppress(subprocess.TimeoutExpired):
                if process.wait(1.0) == TO_PROMPT:
                    (self.chip / "register19").write_text(str(AT_PROMPT))
                    return True
            return False
        finally:
            process.kill()
            process.wait()
            ours.close()
            os.set_blocking(self._master, True)


def sources() -> dict[str, bytes]:
    """This release's firmware as a set that the Unix port runs."""
    return {
        path.name: path.read_bytes() for path in FIRMWARE.glob("*.py") if path.name not in ("boot.py", "__init__.py")
    }


def folder_table(flash: Path) -> Path:
    """Parameters and tare, which no update touches."""
    path = flash / "table.json"
    path.write_text(json.dumps({"tare_pa": [AIR_PA] * 4}))
    return path
