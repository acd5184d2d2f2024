"""The control module at the end of a serial port: a real /dev/ttyACM0 or the twin's pty, opened by the same code."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import threading
from concurrent.futures import Future
from types import TracebackType
from typing import Literal

import serial

from agent.clock import machine
from agent.clock.clock import Clock, Part, wait
from agent.core.config import ConfigError
from agent.core.step_io import SetPoint, Telemetry
from agent.core.step_transaction import named
from hw.firmware import parameters, wire
from hw.module import Level, StatusText, Tap
from hw.stm32.protocol import Counters, Greeting, HostProtocol, Outcome


def reason(error: OSError) -> str:
    """Why a port cannot be used, once: pyserial's own text has the path and the system's words twice."""
    if error.errno == errno.EWOULDBLOCK:
        return "another program uses this port; end that one"
    return os.strerror(error.errno) if error.errno else str(error)


# --- parameters of hw.firmware.parameters ---

TEXTS: dict[str, tuple[str, str]] = {  # name -> unit and meaning, as people read them
    "law": ("", "0 pi, 1 pid, 2 observer"),
    "pid_set": ("", "gains of pid: 0 for thrusters of 10 N and 0.10 s, 1 for 5 N and 0.15 s"),
    "heave_kg": ("kg", "mass with the water that moves along"),
    "tilt_kgm2": ("kg m2", "moment of inertia in roll and pitch, with the water"),
    "lag_s": ("s", "first-order lag of a thruster with its ESC"),
    "thrust_max_N": ("N", "of one thruster, forward, at 1900 us and curve_battery_mV"),
    "net_weight_N": ("N", "weight less buoyancy; a robot that sinks has it positive"),
    "water_kg_m3": ("kg/m3", "998.2 fresh at 20 C, 1025 sea"),
    "curve_battery_mV": ("mV", "battery at which thrust_max_N was found"),
    "battery_min_mV": ("mV", "below it, smoothed over a second, the robot surfaces; 3.0 V a cell of four"),
    "slew_N": ("N", "largest change of a thruster's force in one cycle of 10 ms"),
    **{f"zero_{k}_us": ("us", f"neutral pulse of T{k}") for k in range(1, 9)},
    "pulse_frame_us": ("us", "from one pulse of a thruster to the next, as short as its ESC takes"),
    "nudge_s": ("s", "from one test of T1-T4 in the dive to the next, 1 or more; 0: none"),
    "wiring": ("", "what `aucamp board check` has passed; 0: nothing"),
}

IDS: dict[str, int] = {name: i for i, name in enumerate(parameters.NAMES)}


def parameter_id(name: str) -> int:
    """Number of a parameter. Raises ConfigError that names those that there are."""
    if name not in IDS:
        raise ConfigError(f"parameter '{name}' is not known, write one of: {' '.join(parameters.NAMES)}")
    return IDS[name]


def checked_id(name: str, value: float) -> int:
    """Number of a parameter that may have this value. Raises ConfigError that says what it may have."""
    i = parameter_id(name)
    if not parameters.in_range(i, value):
        _, _, lowest, highest, kind = parameters.TABLE[i]
        unit, _ = TEXTS[name]
        whole = " whole" if kind == parameters.WHOLE else ""
        raise ConfigError(f"{name} = {value:g}: write a{whole} number from {lowest:g} to {highest:g} {unit}".rstrip())
    return i


# --- driver ---

BAUD = 1_000_000  # an exact divisor of the F407's bus clocks; at 115200 one telemetry frame takes 7 ms
BACK_OFF_S = (0.1, 1.0)  # first and longest pause between attempts to open the port
TURN_NS = 50_000_000  # the thread looks at least this often whether an order has to be repeated
MAX_WAITING = 1024  # bytes not yet taken by the port: beyond it a set-point is stale before it leaves
Mode = Literal["hold", "stabilise", "surface", "bench"]
MODES: tuple[Mode, ...] = ("hold", "stabilise", "surface", "bench")  # in the order of wire.HOLD ...
SLACK_S = 0.025  # how long an order may lie here before a dive's clock waits
SLOWEST = 0.2  # a dive's clock may be slower, but close() does not wait for it
LAST_ORDER_S = 0.3  # of the clock: how long close() waits for the board to say that the motors are off


class Stm32:
    """Owns the port in a thread of its own; every method returns at once, `close` within LAST_ORDER_S and a turn.

    The caller sends a set-point at 20 Hz or faster: it is the heartbeat, without it the board holds, then surfaces.
    Orders other than arm and stop answer with a future, which ends within 2 s (a tare: 5 s) whatever happens, with
    "no board" or "no answer" if need be. Poll it; callbacks would run in the driver's thread, under its lock.
    As a context manager it starts on entry, and on the way out it closes, motors first; but with an exception, which
    means that the host is broken and the robot perhaps at depth, it lets the robot surface.
    """

    def __init__(self, port: str, clock: Clock, baud: int = BAUD, tap: Tap | None = None, part: str = "") -> None:
        """`clock` stamps telemetry and waits for the thread as `part`; `tap` sees the bytes of both directions, until
        it raises."""
        self.port = port
        self._clock, self._name = clock, part
        self._part: Part | None = None
        self._tap = tap
        self._baud = baud
        self._protocol = HostProtocol(0)
        self._lock = threading.Lock()  # guards everything below and the protocol
        self._waiting = bytearray()
        self._connected = False
        self._closing = threading.Event()
        self._silent = threading.Event()  # the last order was answered
        self._thread: threading.Thread | None = None
        self._wake_read = self._wake_write = -1

    def start(self) -> None:
        """Begin to look for the board. A port that is missing or drops is tried again, for ever."""
        if self._thread is not None:
            return
        self._protocol = HostProtocol(int.from_bytes(os.urandom(4), "little"))
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name=f"serial {self.port}", daemon=True)
        self._thread.start()

    def drain(self) -> tuple[list[Telemetry], list[StatusText]]:
        """What arrived since the last call, oldest first. Raises RuntimeError if the thread has died of a fault."""
        if self._thread is not None and not self._thread.is_alive():
            raise RuntimeError(f"the driver of {self.port} has died; its own traceback says why")
        with self._lock:
            telemetry, lines = list(self._protocol.telemetry), list(self._protocol.lines)
            self._protocol.telemetry.clear()
            self._protocol.lines.clear()
        return telemetry, lines

    def send(self, set_point: SetPoint, now_ns: int) -> None:
        """Hand over a set-point. With no board there, or one that takes nothing, it is forgotten."""
        with self._lock:
            if self._connected and len(self._waiting) < MAX_WAITING:
                self._waiting += self._protocol.set_point(set_point, now_ns)
        self._wake()

    @property
    def wants_armed(self) -> bool:
        """Whether arming is asked for. Falls by itself when the board disarms, restarts, or refuses for good."""
        with self._lock:
            return self._protocol.wants_armed

    def arm(self) -> None:
        """Ask for arming; what came of it shows in the telemetry, refusals among the lines of `drain`."""
        with self._lock:
            self._protocol.arm()
        self._wake()

    def disarm(self) -> None:
        """Motors off."""
        self._stop(wire.DISARM)

    def surface(self) -> None:
        """Go up, ahead of any other order; arm() calls the robot back."""
        self._stop(wire.MODE, wire.SURFACE, 0)

    def emergency_stop(self) -> None:
        """Motors off, and no arming until the board was restarted, which `arm` does for this host, and for no other."""
        self._stop(wire.ESTOP)

    def mode(self, mode: Mode, thruster: int = 0) -> Future[Outcome]:
        """hold: depth and level; stabilise: level alone; surface: go up, until an order to arm calls the robot back;
        bench: as soon as it is armed, turn one thruster (1-8) slowly, to see which it is and which way it pushes."""
        return self._ask(wire.MODE, MODES.index(mode), thruster)

    def tare(self, depth_m: float = 0.0) -> Future[Outcome]:
        """Take the next 2 s of pressures for those at `depth_m`, 0 in air. Refused where they spread or disagree."""
        return self._ask(wire.TARE, wire.fixed(depth_m, 1e3))

    def parameter(self, name: str) -> Future[Outcome]:
        """One parameter, by its name in hw.firmware.parameters. Raises ConfigError for a name that there is not."""
        return self._ask(wire.PARAM_GET, parameter_id(name))

    def parameters(self) -> Future[Outcome]:
        """All parameters, by name."""
        return self._ask(wire.PARAM_LIST)

    def set_parameter(self, name: str, value: float) -> Future[Outcome]:
        """Set one until the next boot, or for good with `save_parameters`; refused while armed.

        Raises ConfigError for a name or value that cannot be. A board that restarts meanwhile is told again
        what was set and not saved.
        """
        i = checked_id(name, value)
        return self._ask(wire.PARAM_SET, i, parameters.TABLE[i][4], 0, value)

    def save_parameters(self) -> Future[Outcome]:
        """All values in force go to the board's flash."""
        return self._ask(wire.PARAM_SAVE)

    def reboot(self, to_prompt: bool = False) -> Future[Outcome]:
        """Refused while armed. The one way out of a latched fault short of pulling the plug.

        to_prompt: MicroPython's prompt follows in place of the firmware (agent.ground.board_update): then `leave`.
        """
        return self._ask(wire.REBOOT, wire.PROMPT_MAGIC if to_prompt else wire.REBOOT_MAGIC)

    @property
    def greeting(self) -> Greeting | None:
        """What the board said of itself when it last greeted."""
        with self._lock:
            return self._protocol.greeting

    @property
    def faults(self) -> dict[str, str]:
        """What is wrong at the board and on the line to it, as long as it is: kind -> words."""
        with self._lock:
            return self._protocol.faults

    @property
    def counters(self) -> Counters:
        with self._lock:
            return self._protocol.counters

    def close(self) -> None:
        """Motors off first, then the port. Returns after LAST_ORDER_S even without an answer."""
        self._end(wire.DISARM)

    def let_surface(self) -> None:
        """Order the robot up, then close the port: it goes up level by itself and switches its motors off there.

        A board that does not hear the order does the same after 3 s of silence; one on the bench stops its motor.
        """
        self._end(wire.MODE, wire.SURFACE, 0)

    def _end(self, kind: int, *fields: float) -> None:
        """A last order, then the port."""
        with self._lock:
            connected = self._connected
        if self._thread is not None and connected:
            self._stop(kind, *fields)
            machine.wait(self._silent, LAST_ORDER_S / min(max(self._clock.rate(), SLOWEST), 1.0))
        self.leave()

    def leave(self) -> None:
        """Close the port without a word: behind it is a prompt, or nobody."""
        if self._thread is None:
            return
        self._closing.set()
        self._wake()
        self._thread.join(2.0)
        self._thread = None
        with self._lock:
            os.close(self._wake_read)
            os.close(self._wake_write)
            self._wake_read = self._wake_write = -1

    def __enter__(self) -> Stm32:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception):  # Ctrl-C is none, nor is an exit that was asked for
            self.let_surface()
        else:
            self.close()

    def _ask(self, kind: int, *fields: float) -> Future[Outcome]:
        with self._lock:
            future = self._protocol.ask(kind, *fields)
        self._wake()
        return future

    def _stop(self, kind: int, *fields: float) -> None:
        with self._lock:
            self._protocol.stop(kind, *fields)
            self._waiting.clear()  # nothing goes before this
            self._waiting += b"\0"  # ends a frame that was cut
            self._silent.clear()
        self._wake()

    def _wake(self) -> None:
        with self._lock, contextlib.suppress(BlockingIOError):  # it is full of wake-ups already
            if self._part is not None:
                self._part.resume()
            if self._wake_write >= 0:
                os.write(self._wake_write, b"\0")

    # --- the thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause_s = BACK_OFF_S[0]
        while not self._closing.is_set():
            try:
                # The pty that a dead twin's link names belongs to another program by now, which would get the orders.
                if not self._clock.is_driven():
                    raise OSError(errno.ENODEV, "the twin has gone")
                # exclusive is a lock on the file: two agents on one board would fight over it
                with serial.Serial(self.port, self._baud, exclusive=True) as port:
                    pause_s = BACK_OFF_S[0]
                    self._serve(port.fileno())
            except OSError as error:
                self._lost("warning", reason(error))
            except Exception as error:  # noqa: BLE001 - a robot without a driver surfaces, whatever this was
                self._lost("error", f"the driver broke off: {named(error)}; the port is opened again")
            wait(self._clock, self._closing, pause_s)
            pause_s = min(2 * pause_s, BACK_OFF_S[1])

    def _lost(self, level: Level, why: str) -> None:
        with self._lock:
            self._connected = False
            self._protocol.hung_up()
            self._protocol.say(level, f"{self.port}: {why}")

    def _show(self, from_board: bool, chunk: bytes) -> None:
        """Show bytes to the tap; the caller holds the lock. A recording that breaks off takes no robot with it."""
        if self._tap is None:
            return
        try:
            self._tap(from_board, chunk)
        except Exception as error:  # noqa: BLE001
            self._tap = None
            self._protocol.say("error", f"{self.port}: no longer recorded: {named(error)}")

    def _serve(self, fd: int) -> None:
        """Carry bytes both ways until close(). Raises OSError when the port goes away."""
        os.set_blocking(fd, False)
        part = Part(self._clock, self._name, SLACK_S)
        try:
            self._carry(fd, part)
        finally:
            with self._lock:
                self._part = None
            part.leave()

    def _carry(self, fd: int, part: Part) -> None:
        with self._lock:
            self._protocol.connected()
            self._waiting.clear()
            self._connected, self._part = True, part
        while not self._closing.is_set():
            with self._lock:
                self._waiting += self._protocol.due(self._clock.now_ns())
                if self._waiting:
                    with contextlib.suppress(BlockingIOError):
                        sent = self._waiting[: os.write(fd, self._waiting)]
                        del self._waiting[: len(sent)]
                        self._show(False, bytes(sent))
                if self._protocol.is_answered():
                    self._silent.set()
                writable = [fd] if self._waiting else []
                part.rest()
            turn_s = self._clock.wall_s(self._clock.now_ns() + TURN_NS)
            readable, _, _ = select.select([fd, self._wake_read], writable, [], turn_s)
            if self._wake_read in readable:
                os.read(self._wake_read, 4096)
            if fd in readable:
                chunk = os.read(fd, 4096)
                if not chunk:
                    raise OSError("the port has gone")
                with self._lock:
                    self._show(True, chunk)
                    self._protocol.receive(chunk, self._clock.now_ns())
