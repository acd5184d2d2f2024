"""What the firmware sees of an STM32F407: the modules pyb, machine, stm and the clock, at the level of calls.

`log` has the order of what was done to pins, timers, buses. Where the chip or the port has a rule that is easily
broken, the call that breaks it fails here too.
"""

from __future__ import annotations

import builtins
import gc
import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from hw.firmware import emitters_unix, wiring
from tests.hw.board.fake_gyro import FakeGyro
from tests.hw.board.wires import Wires

FIRMWARE = Path(wiring.__file__).parent
TICK_US = 10_000


class Reset(BaseException):
    """machine.reset() does not return."""


class Chip:
    """One chip with its clock."""

    def __init__(self) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.us = 2**30 - 25_000  # of the clock, whose reading wraps soon
        self.next_tick_us = 0
        self.on_tick: Callable[[object], None] | None = None
        # Of input pins; an open one with a pull reads as that. The loop of the kill switch is closed.
        self.levels: dict[str, int] = {"PE15": 0, "PA6": 0}
        self.volts = {"PC1": 1.4, "PC2": 0.5}
        self.timers: dict[int, Timer] = {}
        self.wires = Wires()
        self.gyro = FakeGyro()
        self.received = bytearray()
        self.cause = 1
        self.main = ""  # what boot.py has said shall run
        self.count: Callable[[object], None] | None = None  # timer 14, once a second
        self.backup: dict[int, int] = {}
        self.files_synced = 0

    def pass_us(self, us: int) -> None:
        """Time goes on; ticks fire in it."""
        end = self.us + us
        while self.on_tick and self.next_tick_us <= end:
            self.us = self.next_tick_us
            self.next_tick_us += TICK_US
            self.on_tick(None)
        self.us = end

    def sleep_until_interrupt(self) -> None:
        assert self.on_tick, "nothing would ever wake it"
        self.pass_us(self.next_tick_us - self.us)

    def modules(self) -> dict[str, Any]:
        chip = self

        class Pin:
            IN, OUT, ALT, OUT_OD, PULL_UP, PULL_DOWN = 0, 1, 2, 17, 1, 2

            def __init__(self, name: str, *, mode=None, pull=None, alt=None, value=None) -> None:
                self.name, self.pull = name, pull
                if mode is not None:
                    chip.log.append(("pin", name, mode, pull, alt, value))

            def value(self, level=None) -> int:
                if level is not None:
                    chip.log.append(("level", self.name, int(level)))
                    if self.name == "PE7":
                        chip.gyro.select(level)
                return chip.levels.get(self.name, 1 if self.pull == Pin.PULL_UP else 0)

        class I2C:
            def __init__(self, number: int, *, freq: int, timeout: int) -> None:
                chip.log.append(("i2c", number, freq, timeout))
                chip.wires.channel = 0  # by the multiplexer's reset

            def writeto(self, address: int, data: bytes) -> None:
                self._timed(chip.wires.writeto, address, data)

            def readfrom_into(self, address: int, buf: bytearray) -> None:
                self._timed(chip.wires.readfrom_into, address, buf)

            def _timed(self, transfer: Callable[..., None], *arguments: Any) -> None:
                before = chip.wires.us
                try:
                    transfer(*arguments)
                finally:
                    chip.pass_us(round(chip.wires.us - before))

        def spi(number: int, *, baudrate: int, polarity: int, phase: int) -> FakeGyro:
            assert baudrate <= 1_000_000 and polarity == phase  # for registers; modes 0 and 3
            chip.log.append(("spi", number))
            return chip.gyro

        class Uart:
            def __init__(self, number: int, *, baudrate: int, timeout: int, rxbuf: int) -> None:
                chip.log.append(("uart", number, baudrate, rxbuf))

            def any(self) -> int:
                return len(chip.received)

            def readinto(self, buf: bytearray, n: int) -> int | None:
                assert n <= len(chip.received), "the driver would wait for more"
                got = min(n, len(buf))
                buf[:got] = chip.received[:got]
                del chip.received[:got]
                return got or None

            def write(self, data: bytes) -> None:
                chip.pass_us(10 * len(data))
                chip.log.append(("sent", bytes(data)))

        class Watchdog:
            def __init__(self, *, timeout: int) -> None:
                chip.log.append(("watchdog", timeout))

            def feed(self) -> None:
                chip.log.append(("fed",))

        def timer(number: int, **settings: Any) -> Timer:
            return chip.timer(number, **settings)

        timer.BRK_OFF, timer.BRK_HIGH = Timer.BRK_OFF, Timer.BRK_HIGH  # type: ignore[attr-defined]

        def reset() -> None:
            chip.cause = 2  # whoever asks afterwards hears of the reset pin
            raise Reset

        pyb = SimpleNamespace(
            Pin=Pin,
            ADC=lambda pin: SimpleNamespace(read=lambda: round(chip.volts[pin.name] / 3.3 * 4095)),
            USB_VCP=lambda: SimpleNamespace(any=lambda: 0, isconnected=lambda: False),
            Timer=timer,
            rng=lambda: 0x3FFFFFFF,
            usb_mode=lambda mode: chip.log.append(("usb", mode)),
            UART=lambda number, baudrate, read_buf_len: SimpleNamespace(number=number),
            repl_uart=lambda uart: chip.log.append(("repl", uart.number)),
            main=lambda path: setattr(chip, "main", path),
            wfi=chip.sleep_until_interrupt,
        )
        machine = SimpleNamespace(
            I2C=I2C,
            SPI=spi,
            UART=Uart,
            WDT=Watchdog,
            reset=reset,
            unique_id=lambda: bytes(12),
            reset_cause=lambda: chip.cause,
        )
        stm = SimpleNamespace(
            RTC=0x40002800,
            RTC_BKP18R=152,
            RTC_BKP19R=156,
            mem32=Backup(self),
            TIM1=0x40010000,
            TIM8=0x40010400,
            TIM_BDTR=68,
            mem16=BreakRegisters(self),
        )
        return {"pyb": pyb, "machine": machine, "stm": stm, "micropython": emitters_unix}

    def timer(self, number: int, **settings: Any) -> Timer:
        made = self.timers.setdefault(number, Timer(self, number))
        if settings:
            made.init(**settings)
        return made


class Backup:
    """Registers that a reset leaves alone."""

    def __init__(self, chip: Chip) -> None:
        self._chip = chip

    def __getitem__(self, address: int) -> int:
        assert 0x40002850 <= address <= 0x4000289C
        return self._chip.backup.get(address, 0)

    def __setitem__(self, address: int, value: int) -> None:
        assert 0x40002850 <= address <= 0x4000289C
        self._chip.backup[address] = value


class BreakRegisters:
    """Of timers 1 and 8: whether their outputs are on."""

    def __init__(self, chip: Chip) -> None:
        self._chip = chip

    def __getitem__(self, address: int) -> int:
        timer = self._chip.timers.get({0x40010044: 1, 0x40010444: 8}[address])
        return 0x8000 if timer and timer.on else 0


class Timer:
    """One, by the rules of its registers. `on`: whether break, or nothing, keeps its outputs from the pins."""

    PWM, BRK_OFF, BRK_HIGH = 0, 0, 2
    BREAK_PINS = {1: "PE15", 8: "PA6"}  # noqa: RUF012

    def __init__(self, chip: Chip, number: int) -> None:
        self._chip, self.number = chip, number
        self.frame = 0
        self._on = False
        self.brk = Timer.BRK_OFF
        self.pulses: dict[int, int] = {}

    def source_freq(self) -> int:
        return 168_000_000 if self.number in (1, 8) else 84_000_000

    def init(self, *, freq=None, prescaler=None, period=None, brk=BRK_OFF) -> None:
        self.brk, self.on = brk, False
        self.pulses = {}
        if freq is None:
            assert (prescaler + 1) * 1_000_000 == self.source_freq() and period < 65536
            self.frame = period + 1
        else:
            self.frame = 1_000_000 // freq
        self._chip.log.append(("timer", self.number, self.frame, brk))

    def channel(self, channel: int, mode: int, *, pulse_width: int) -> Any:
        """Turns the outputs on, all of the timer's, unless break is active."""
        assert channel not in self.pulses and 1 <= channel <= 4
        self._chip.log.append(("channel", self.number, channel))
        self.pulses[channel] = pulse_width
        self.on = self.brk == Timer.BRK_OFF or not self.is_broken()

        def set_pulse(us: int) -> None:
            self._chip.log.append(("pulse", self.number, channel, us))
            self.pulses[channel] = us

        return SimpleNamespace(pulse_width=set_pulse)

    def is_broken(self) -> bool:
        """A break input that nothing pulls or ties is anything: high."""
        return bool(self._chip.levels.get(Timer.BREAK_PINS[self.number], 1))

    @property
    def on(self) -> bool:
        """Once broken it stays off, until something turns it on."""
        self._on = self._on and (self.brk == Timer.BRK_OFF or not self.is_broken())
        return self._on

    @on.setter
    def on(self, on: bool) -> None:
        self._on = on

    def period(self, value: int) -> None:
        self._chip.log.append(("period", self.number, value))
        self.frame = value + 1

    def callback(self, function: Callable[[object], None]) -> None:
        if self.number == 14:
            self._chip.count = function
            return
        self._chip.on_tick = function
        self._chip.next_tick_us = self._chip.us + TICK_US


@contextmanager
def firmware_on(chip: Chip, folder: Path) -> Iterator[ModuleType]:
    """The firmware's hal_stm32 as it is imported on this chip, `folder` being its flash."""
    names = [path.stem for path in FIRMWARE.glob("*.py")]
    kept = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    with pytest.MonkeyPatch.context() as patch:
        for name, module in chip.modules().items():
            patch.setitem(sys.modules, name, module)
        for name in ("ptr8", "ptr16", "ptr32"):  # which the board's compiler knows
            patch.setattr(builtins, name, getattr(emitters_unix, name), raising=False)
        patch.setattr(time, "ticks_us", lambda: chip.us & 0x3FFFFFFF, raising=False)
        patch.setattr(time, "ticks_diff", lambda a, b: ((a - b + 2**29) & 0x3FFFFFFF) - 2**29, raising=False)
        patch.setattr(time, "sleep_us", chip.pass_us, raising=False)
        patch.setattr(gc, "mem_free", lambda: 50_000, raising=False)
        patch.setattr(os, "sync", lambda: setattr(chip, "files_synced", chip.files_synced + 1))
        patch.syspath_prepend(FIRMWARE)
        patch.chdir(folder)
        try:
            yield importlib.import_module("hal_stm32")
        finally:
            for name in names:
                sys.modules.pop(name, None)
            sys.modules.update(kept)
