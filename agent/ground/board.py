"""`aucamp board`: a person at the terminal and one control module, whose agent does not run.

Its zero, its parameters, what it says of itself, whether its wires are where the drawing has them, and its reboot. New
firmware: board_update.py.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Literal

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.clock.clock import Clock, wait
from agent.core.config import ConfigError
from agent.core.step_io import SetPoint, Telemetry
from agent.process.command import Failed
from agent.process.transport import fleet_clock
from agent.robot.fleet_reader import load_fleet, load_robot
from agent.robot.operator import WEATHER_M
from hw.firmware import wire
from hw.firmware.failsafe import LATCHED, WIRING
from hw.firmware.thrust import PITCH, ROLL
from hw.module import FLAGGED
from hw.stm32 import serial_port
from hw.stm32.driver import TEXTS, Stm32, checked_id
from hw.stm32.protocol import Outcome
from hw.twin.twin_folder import twin_dir

BoardOrder = Literal["info", "tare", "check", "params", "reboot"]
LIMIT_S = 10.0  # of the clock: to be greeted, to be answered, and to be greeted again
WORDS_S = 1.0  # a board that is greeted tells what is wrong with this boot
LOOK_S = 0.05
HANDS_S = 60.0  # a person has to turn a switch, or to press a corner down

CLOCK = 0.01  # share that a board's may differ: in the 20 s that pulses take, frames come late by less
# A robot that is to be pressed down: one corner by so much more than the others.
PRESSED_M = 0.02
CORNERS = ("front left", "back left", "back right", "front right")
# One pulse of a thruster, and what the robot takes to lie still after it.
PULSE_S, STILL_S = 0.6, 20.0
BEFORE_S, AFTER_S = 1.0, 0.1  # how long it is looked at
SWINGS_M = 0.003  # by less in BEFORE_S: it rests
NOTHING_M = 0.002  # that a corner moves: less is no pulse
FITS, ALIKE = 0.35, 0.05  # of what was seen, what a guess may leave; and by how much another may be worse


def run(
    order: BoardOrder,
    fleet_path: Path,
    name: str,
    say: Callable[[str], None],
    values: Mapping[str, float] | None = None,
    depth_m: float | None = None,
    hands: bool = True,
    limit_s: float = LIMIT_S,
) -> None:
    """Carry out an order at a robot's module and say what it says. Raises ConfigError, and Failed where it is armed,
    silent, or not as it should be. The port must be free: a robot's agent holds it.

    values: parameters to set and save; depth_m: of the sensors, for a tare; None: they are in air, and read as much;
    hands: of somebody beside the robot.
    """
    for key, value in (values or {}).items():
        checked_id(key, value)
    with greeted(fleet_path, name, say, limit_s) as bench:
        match order:
            case "info":
                bench.tell()
            case "tare":
                bench.tare(depth_m)
            case "params":
                bench.parameters(values or {})
            case "check":
                bench.check(hands)
            case "reboot":
                bench.reboot()


@contextmanager
def greeted(fleet_path: Path, name: str, say: Callable[[str], None], limit_s: float) -> Iterator[Bench]:
    """A board that has answered. Motors that this program has turned on are off at the end, whatever happens."""
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    clock = fleet_clock(fleet)
    board = Stm32(serial_port(robot.serial, twin_dir(fleet)), clock)
    board.start()
    bench = Bench(board, name, clock, say, limit_s)
    try:
        bench.greet()
        yield bench
    finally:
        if bench.pulsing:
            board.close()
        else:
            board.let_surface()  # not `close`: a robot that is found on its way up goes on


class Bench:
    """One board, from greeting to greeting."""

    def __init__(self, board: Stm32, name: str, clock: Clock, say: Callable[[str], None], limit_s: float) -> None:
        self._board, self._name, self._clock, self._say, self._limit_s = board, name, clock, say, limit_s
        self._newest: Telemetry | None = None
        self._status: Telemetry | None = None  # the newest with what comes once a second
        self._asks = SetPoint(depth_m=0.0)
        self._said = "not a word"  # the newest line of the board, or about it
        self._track: list[Telemetry] = []
        self._first: Telemetry | None = None
        self.pulsing = False  # this program may have motors on

    def greet(self) -> None:
        if not self._until(lambda: self._board.greeting is not None and self._newest is not None):
            raise Failed(f"{self._name}: no board answers ({self._said}); is it on, and its port free?")
        self._until(lambda: False, WORDS_S)

    # --- what it says, its zero, its parameters ---

    def tell(self) -> None:
        greeting, newest = self._board.greeting, self._newest
        assert greeting is not None and newest is not None
        self._until(lambda: self._status is not None)
        status = self._status or newest
        why = cause(greeting.reset_cause)
        self._tell(f"firmware {greeting.build}, chip {greeting.uid}, boot {greeting.boot_id:08x} by {why}")
        self._tell(
            f"motors {'on' if newest.armed else 'off'}, failsafe level {newest.ladder}; {', '.join(marks(newest))}"
        )
        self._tell("sensors " + " ".join(f"{depth:.3f}" for depth in newest.sensor_depth_m) + " m below their zero")
        amperes = "" if status.current_a is UNSET else f", {status.current_a:.1f} A"
        water = "" if status.temperature_c is UNSET else f", water {status.temperature_c:.1f} C"
        heap = "" if status.heap_free_b is UNSET else f", {status.heap_free_b / 1000:.1f} kB free"
        self._tell(f"battery {newest.battery_v:.2f} V{amperes}{water}; cycle {newest.loop_us / 1000:.1f} ms{heap}")

    def tare(self, depth_m: float | None) -> None:
        assert self._newest is not None
        now_m = statistics.median(self._newest.sensor_depth_m)
        if depth_m is None and abs(now_m) > WEATHER_M:
            raise Failed(
                f"{self._name}: no tare: its sensors read {now_m:+.2f} m by the zero that they have; take it out of "
                "the water. If it is in air, and the zero of another place or day, say --depth 0"
            )
        asked = self._settled(self._board.tare(depth_m or 0.0))
        if not asked.ok:
            raise Failed(f"{self._name}: no tare: {asked.result}; lay it down in air, still, its motors off")
        self._until(lambda: False, 2 * LOOK_S)
        depths_m = self._newest.sensor_depth_m
        self._tell("tared; sensors now " + " ".join(f"{depth:.3f}" for depth in depths_m) + " m")

    def parameters(self, values: Mapping[str, float]) -> None:
        """Set and save these, then show all."""
        self._save(values)
        listed = self._settled(self._board.parameters())
        if not listed.ok:
            raise Failed(f"{self._name}: its parameters were not told: {listed.result}")
        for key, value in listed.values.items():
            unit, meaning = TEXTS[key]
            self._say(f"{key:18} {value:g} {unit:6} {meaning}")

    def _save(self, values: Mapping[str, float]) -> None:
        for key, value in values.items():
            if not (done := self._settled(self._board.set_parameter(key, value))).ok:
                raise Failed(f"{self._name}: {key} = {value:g}: {done.result}; stop its motors first")
        if values and not (done := self._settled(self._board.save_parameters())).ok:
            raise Failed(f"{self._name}: nothing was saved: {done.result}")

    # --- wires ---

    def check(self, hands: bool) -> None:
        """Kill switch, sensors and T1 to T4: say which wire is wrong, or let the board know that it passed."""
        if not self._settled(self._board.parameter("wiring")).ok:
            raise Failed(f"{self._name}: its firmware knows no check; flash the one of this release")
        if hands:
            self._check_switch()
            self._check_sensors()
        leans_m = self._pulses()
        self._check_clock()
        if wrong := faults_of(leans_m):
            raise Failed(f"{self._name}: {' or '.join(wrong)}; put that right, then check again")
        self._save({"wiring": WIRING})
        seen, unseen = ("kill switch, sensors, T1 to T4", "") if hands else ("T1 to T4", "kill switch, sensors, ")
        self._tell(
            f"passed: {seen} are as the drawing has them, and it may be armed. Not seen: {unseen}T5 to T8, servos"
        )

    def _check_clock(self) -> None:
        """Against this computer's, since the greeting: pulses are as wrong as the board's crystal."""
        assert self._first is not None and self._newest is not None
        board_s = ((self._newest.board_us - self._first.board_us) & 0xFFFFFFFF) * 1e-6
        ours_s = (self._newest.t_ns - self._first.t_ns) * 1e-9
        if abs(board_s / ours_s - 1.0) > CLOCK:
            ratio = board_s / ours_s
            raise Failed(
                f"{self._name}: its clock runs {ratio:.3f} times as fast as ours; flash the build for its crystal"
            )

    def _check_switch(self) -> None:
        self._tell("open the kill switch")
        if not self._until(lambda: self._has(wire.FLAG_KILLED), HANDS_S):
            raise Failed(f"{self._name}: its kill switch was not seen to open: it would not stop the thrusters")
        self._tell("seen; close the kill switch")

    def _check_sensors(self) -> None:
        """Each corner pressed down by hand, the robot in the water."""
        for k, corner in enumerate(CORNERS):
            self._tell(f"press down the corner {k + 1}, {corner}, and let it come up again")
            if not self._until(lambda: pressed(self._depths()) is not None, HANDS_S):
                raise Failed(f"{self._name}: no sensor went down with the corner {k + 1}; is the robot in the water?")
            if (found := pressed(self._depths())) != k:
                raise Failed(
                    f"{self._name}: sensor {(found or 0) + 1} is at the corner {k + 1}, {corner}; swap their wires"
                )
            self._still()

    def _pulses(self) -> NDArray[np.float64]:
        """(n, 4): by how much each pulse of T1 to T4, one a row, sent each sensor down, m. Fewer than four where the
        board stopped: crossed sensors disagree as soon as something leans."""
        self._tell("hands off: T1 to T4 push for a second each, the robot free in the water")
        self.pulsing = True
        self._settled(self._board.mode("bench", 0))
        self._arm()
        leans_m: list[NDArray[np.float64]] = []
        while (k := len(leans_m)) < 4 and self._newest is not None and self._newest.armed:
            before = self._still()
            self._settled(self._board.mode("bench", k + 1))
            self._until(lambda: False, PULSE_S)
            lean_m = sent_down(before, self._watched(AFTER_S))
            if not leans_m or self._newest.armed:  # else the pulse was cut
                leans_m.append(lean_m)
            self._settled(self._board.mode("bench", 0))
        self._board.disarm()
        self._until(lambda: self._newest is not None and not self._newest.armed)
        return np.asarray(np.array(leans_m) - np.mean(leans_m, axis=1, keepdims=True))

    def _still(self) -> NDArray[np.float64]:
        """(n, 5) as `_watched`, of a robot that has come to rest, or swings on after STILL_S."""
        until_ns = self._clock.now_ns() + round(STILL_S * 1e9)
        while True:
            seen = self._watched(BEFORE_S)
            swings_m = np.ptp(seen[:, 1:] - seen[:, 1:].mean(axis=1, keepdims=True), axis=0).max() if len(seen) else 0.0
            if swings_m < SWINGS_M or self._clock.now_ns() >= until_ns:
                return seen

    def _watched(self, seconds: float) -> NDArray[np.float64]:
        """(n, 5): the board's time in s, and how deep each sensor was, for so long from now."""
        self._track.clear()
        self._until(lambda: False, seconds)
        return np.array([(told.board_us * 1e-6, *told.sensor_depth_m) for told in self._track])

    def _arm(self) -> None:
        """Asked again: a kill switch is being closed, and ESCs want to hear neutral."""
        until_ns = self._clock.now_ns() + round(HANDS_S * 1e9)
        while not (self._newest is not None and self._newest.armed):
            if self._clock.now_ns() >= until_ns:
                raise Failed(f"{self._name}: it cannot be armed ({self._said})")
            if not self._board.wants_armed:
                self._board.arm()
            self._until(lambda: self._newest is not None and self._newest.armed, 1.0)

    # --- reboot ---

    @property
    def build(self) -> str:
        """What its firmware calls itself."""
        assert self._board.greeting is not None
        return self._board.greeting.build

    def listen(self, seconds: float) -> None:
        """Pass on what it says."""
        self._until(lambda: False, seconds)

    def to_prompt(self) -> None:
        """MicroPython's prompt in place of the firmware; the port is free afterwards."""
        result = self._settled(self._board.reboot(to_prompt=True)).result
        if result == "refused":
            raise Failed(f"{self._name}: its motors are on, and it goes on; let it surface, or stop it first")
        if result == "out of range":
            raise Failed(f"{self._name}: its firmware knows no prompt over the tether; flash it by hand: hw/README.md")
        if result not in ("ok", "no answer"):  # an answer may be lost: the prompt shows it
            raise Failed(
                f"{self._name}: the order to go to its prompt ended with '{result}'; take its power off and on"
            )
        self._board.leave()

    def reboot(self) -> None:
        before = self._board.greeting
        result = self._settled(self._board.reboot()).result
        if result == "refused":
            raise Failed(f"{self._name}: its motors are on, and it goes on; let it surface, or stop it, then reboot it")
        if result != "ok":
            raise Failed(f"{self._name}: the order to reboot ended with '{result}'; take its power off and on")
        self._newest = None
        greeted = self._until(lambda: self._board.greeting != before and self._newest is not None)
        if not greeted or self._newest is None:
            raise Failed(f"{self._name}: rebooted, and silent since; take its power off and on")
        if self._newest.ladder == LATCHED:
            self._until(lambda: False, WORDS_S)
            raise Failed(f"{self._name}: rebooted, and latched again ({self._said}); put that right first")
        self._say(f"{self._name}: rebooted; arm it with: aucamp agent FLEET --robot {self._name} --arm")

    # --- the conversation ---

    def _tell(self, text: str) -> None:
        self._say(f"{self._name}: {text}")

    def _has(self, flag: int) -> bool:
        return self._newest is not None and bool(self._newest.flags & flag)

    def _depths(self) -> NDArray[np.float64]:
        assert self._newest is not None
        return np.array(self._newest.sensor_depth_m)

    def _settled(self, asked: Future[Outcome]) -> Outcome:
        self._until(asked.done)
        return asked.result(0) if asked.done() else Outcome("no answer")

    def _until(self, done: Callable[[], bool], limit_s: float | None = None) -> bool:
        """Whether it was so before the limit; what the board says meanwhile is passed on. Each look sends a set-point,
        for which pulses and a tare's age wait."""
        until_ns = self._clock.now_ns() + round((self._limit_s if limit_s is None else limit_s) * 1e9)
        while not done():
            if self._clock.now_ns() >= until_ns:
                return False
            wait(self._clock, Event(), LOOK_S)
            if self._newest is None or not self._newest.armed or self.pulsing:  # one that is at work has its own
                self._board.send(self._asks, self._clock.now_ns())
            telemetry, lines = self._board.drain()
            self._track += telemetry
            for told in telemetry:
                self._newest, self._first = told, self._first or told
                self._status = self._status if told.current_a is UNSET else told
            for line in lines:
                self._said = line.text
                self._say(f"{self._name}: {line.text}")
        return True


def cause(reset_cause: int) -> str:
    names = {wire.POWER_ON: "power", wire.BY_PIN: "its reset pin", wire.BY_WATCHDOG: "its watchdog"}
    return {**names, wire.BY_ORDER: "order"}.get(reset_cause, f"cause {reset_cause}")


def marks(telemetry: Telemetry) -> list[str]:
    """What its flags say, in words."""
    bad = " ".join(map(str, telemetry.bad_sensors))
    found = [kind for flag, (kind, _) in FLAGGED.items() if telemetry.flags & flag]
    if telemetry.flags & wire.FLAG_DEGRADED:
        found.append(f"sensors not believed: {bad or '?'}")
    return [*found, "tared" if telemetry.flags & wire.FLAG_TARED else "not tared"]


def pressed(depths_m: NDArray[np.float64]) -> int | None:
    """The sensor (4,) that is clearly deeper than all others, and its opposite the highest; None: none is."""
    k = int(depths_m.argmax())
    others = np.delete(depths_m, k)
    return k if depths_m[k] - others.mean() > PRESSED_M and depths_m[k] - others.max() > PRESSED_M / 2 else None


# --- which wire is wrong, by what pulses did ---


def sent_down(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,): by how much the sensors are deeper after a pulse than the robot would have gone without, m. Both (n, 5):
    time and depths; what swings or sinks goes on for a while as it does."""
    if len(before) < 3 or not len(after):
        raise Failed("the board fell silent during a pulse; check again")
    t_s = before[:, 0] - before[-1, 0]
    line = np.polynomial.polynomial.polyfit(t_s, before[:, 1:], 1)
    later_s = float(after[:, 0].mean() - before[-1, 0])
    return np.asarray(after[:, 1:].mean(axis=0) - line[0] - line[1] * later_s)


Guess = tuple[str, NDArray[np.float64]]


def guesses() -> list[Guess]:
    """Each single fault of thrusters and sensors, and what pulses of T1 to T4 would then send down, (4, 4), no unit."""
    x, y = np.array([1, -1, -1, 1]), np.array([1, 1, -1, -1])
    # A lifted left side is a positive roll, a lowered nose a positive pitch.
    right = np.outer(PITCH, x) - np.outer(ROLL, y)
    found: list[Guess] = [("", right)]
    for k in range(4):
        for gain, says in (
            (0.0, "gives nothing: its wire, its ESC or its propeller"),
            (-1.0, "pushes the wrong way: swap two of its motor wires"),
        ):
            scaled = right.astype(float)
            scaled[k] *= gain
            found.append((f"T{k + 1} {says}", scaled))
    for first, second in itertools.combinations(range(4), 2):
        order = list(range(4))
        order[first], order[second] = second, first
        pair = f"{first + 1} and {second + 1}"
        found.append((f"the signals of T{first + 1} and T{second + 1} are crossed", right[order]))
        found.append((f"sensors {pair} are crossed", right[:, order]))
    return found


def faults_of(leans_m: NDArray[np.float64]) -> Sequence[str]:
    """The single faults that may have made T1 to T4 send the sensors down as they did, (n, 4), each row's mean taken
    off: none, where all is right; more than one, where these pulses cannot tell them apart."""
    if np.abs(leans_m).max() < NOTHING_M:
        return ["no thruster moves the robot: battery, kill switch, or it lies on the floor"]
    left = []
    for says, all_four in guesses():
        would = all_four[: len(leans_m)]
        scale = max(float((would * leans_m).sum() / max((would * would).sum(), 1e-9)), 0.0)
        left.append((float(((leans_m - scale * would) ** 2).sum() / (leans_m**2).sum()), says))
    least, _ = min(left)
    if least > FITS:
        return ["no single wire explains how it moved: look at all of them, and whether something held the robot"]
    named = [says for rest, says in left if rest <= least + ALIKE]
    if "" not in named:
        return named
    return [] if len(leans_m) == 4 else ["the board stopped between two pulses: see what it said"]


def numbers(texts: Sequence[str]) -> dict[str, float]:
    """NAME=VALUE, as typed, each name once. Raises ConfigError."""
    found: dict[str, float] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if key in found:
            raise ConfigError(f"--set '{text}': {key} is given twice; write it once")
        try:
            found[key] = float(value)
        except ValueError:
            equals = ""
        if not key or not equals:
            raise ConfigError(f"--set '{text}': write NAME=VALUE, such as net_weight_N=1.2")
    return found
