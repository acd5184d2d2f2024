"""The firmware without a process: its own main.Firmware on a board of numbers, cycle by cycle, under this Python."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from hw.firmware import failsafe, wire
from tests.hw.firmware.nominal_plant import AIR_PA, PA_PER_M

FIRMWARE = Path(wire.__file__).parent
CYCLE_US = 10_000
BOOT_ID = 77


def firmware_main() -> ModuleType:
    """The firmware's main module. On a board its files are no package, so its folder is looked through too: for good,
    as it imports some where it needs them."""
    if str(FIRMWARE) not in sys.path:
        sys.path.append(str(FIRMWARE))
    main = importlib.import_module("main")
    main.orders.put_away = lambda: None  # memory is not scarce here, and thousands of boards would read its files again
    return main


class BareHal:
    """Sensors that say what is written here, pins and a tether that can be read."""

    capabilities, late = 0, 0
    current_10ma, temperature_cC = 100, 2000
    took_us = 0  # what the hardware says of each cycle
    yaw_rate = 150

    def __init__(self, flash: dict[str, Any] | None = None) -> None:
        self.pressure_pa = [AIR_PA + 0.3 * PA_PER_M] * 4
        self.answered, self.battery_mv, self.leak = 15, 15000, 0
        self.open_loop = self.off = self.frozen = False
        self.gravity: tuple[int, int] | None = None
        self.pulses_us = [1500] * 8
        self.servos_us, self.light_permille, self.armed = [1500] * 4, 0, 0
        self.flash = {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING} if flash is None else flash
        self.us, self.dt_us = 0, CYCLE_US
        self.to_board = b""
        self.from_board = bytearray()

    def killed(self) -> bool:
        self.off = self.off or self.open_loop
        return self.off

    def gravity_mg(self) -> tuple[int, int] | None:
        return self.gravity

    def revive(self) -> None:
        self.off = self.open_loop

    def boot_info(self) -> tuple[bytes, int, int]:
        return bytes(12), BOOT_ID, wire.POWER_ON

    @property
    def pressure_mPa(self) -> list[int]:
        """With a ripple of 0.1 Pa: a sensor that stands still is none."""
        ripple = 0 if self.frozen else 100 * (self.us // CYCLE_US % 3 == 0)
        return [round(1000 * pa) + ripple for pa in self.pressure_pa]

    def begin_pulses(self, frame_us: int) -> None:
        self.frame_us = frame_us

    def cycle_us(self) -> int:
        return self.took_us

    def yaw_rate_cdeg_s(self) -> int:
        return self.yaw_rate

    @property
    def us_low(self) -> int:
        return self.us & 0xFFFF

    @property
    def us_high(self) -> int:
        return self.us >> 16 & 0xFFFF

    def now_us(self) -> int:
        return self.us & 0xFFFFFFFF

    def read_into(self, buf: bytearray) -> int:
        n = min(len(buf), len(self.to_board))
        buf[:n], self.to_board = self.to_board[:n], self.to_board[n:]
        return n

    def write(self, frame: Iterable[int]) -> None:
        self.from_board += bytes(frame)

    def write_pins(self) -> bool:
        return True

    def end_cycle(self) -> None:
        pass

    def collect(self) -> None:
        pass

    def heap_free(self) -> int:
        return 0

    def reboot(self) -> None:
        pass

    def load_flash(self) -> dict[str, Any]:
        return dict(self.flash)

    def save_flash(self, flash: dict[str, Any]) -> None:
        self.flash = dict(flash)


class BareBoard:
    """One boot. `tick` is a control cycle, `frames` what was said since they were last cleared."""

    def __init__(self, hal: BareHal | None = None) -> None:
        self.hal = hal or BareHal()
        self.boot_id = BOOT_ID
        self.ticked_us = self.hal.us
        self.reboot()
        self.writer = wire.Writer()
        self.frames: list[tuple[int, tuple[Any, ...]]] = []
        self.framer = wire.Framer(lambda kind, _seq, payload: self.frames.append((kind, wire.unpack(kind, payload))))

    def reboot(self) -> None:
        """Begin anew with what is in flash, as main.serve does."""
        self.firmware = firmware_main().Firmware(self.hal)
        self.firmware.boot()

    @property
    def control(self) -> Any:
        return self.firmware.control

    @property
    def faults(self) -> int:
        """How often something broke off and was left out."""
        return int(self.firmware.tether.faults)

    def say(self, kind: int, *fields: Any) -> None:
        self.hal.to_board += bytes(self.writer.frame(kind, *fields))

    def tick(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            before_us = self.ticked_us
            self.hal.us += CYCLE_US
            self.ticked_us = self.hal.us
            self.hal.dt_us = (self.hal.us - before_us) & 0xFFFFFFFF
            self.firmware.step()
            chunk = bytes(self.hal.from_board)
            self.hal.from_board.clear()
            self.framer.feed(chunk, len(chunk))

    def heard(self, kind: int) -> list[tuple[Any, ...]]:
        return [fields for got, fields in self.frames if got == kind]

    def answers(self, kind: int, *fields: Any) -> list[tuple[int, tuple[Any, ...]]]:
        """Say an order, its number first, and tick once: what is answered meanwhile."""
        self.frames.clear()
        self.say(kind, *fields)
        self.tick()
        return [(got, said) for got, said in self.frames if got in (wire.ACK, wire.PARAM_VALUE)]

    def greet(self, host: int = 1) -> None:
        self.say(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), host)
        self.tick()

    def set_point(self, depth_m: float = 0.3, host_ds: int = 7) -> None:
        """host_ds: the host's clock, tenths of a second."""
        fields = (round(depth_m * 1e4), 0, 0, 0, 0, 0, 1500, 1500, 1500, 1500, 0, wire.VALID_ALL, 500, host_ds)
        self.say(wire.SETPOINT, *fields)

    def arm(self, req_id: int = 1) -> None:
        """Greet, wait for the ESCs, arm."""
        self.greet()
        self.tick(301)
        self.set_point()
        self.tick()
        ((_, fields),) = self.answers(wire.ARM, req_id, self.boot_id)
        assert fields[2] == wire.OK, self.heard(wire.EVENT)

    def hold(self, cycles: int, host_ds: int = 7) -> None:
        """Tick with a set-point every 50 ms, as a host sends them."""
        for i in range(cycles):
            if i % 5 == 0:
                self.set_point(host_ds=host_ds)
            self.tick()
