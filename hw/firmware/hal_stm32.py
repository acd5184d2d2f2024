# The hardware of the control module: an STM32F407VG under MicroPython. Wiring, pins, and what of this was and was not
# tried on a chip: hw/README.md.
import gc
import machine
import os
import pyb
from micropython import const
from time import sleep_us, ticks_diff, ticks_us

import gyro
import ms5837
import pins

# Of wire.py, whose numbers these are
_CAN_WATCHDOG = const(1)
_CAN_CURRENT = const(2)
_CAN_LEAK = const(4)
_CAN_KILL = const(8)
_CAN_VERSION_2 = const(32)
_CAN_VERSION_3 = const(64)
_BY_ORDER = const(5)

_CYCLE_US = const(10000)
_BAUD = const(1000000)
_RX_BUFFER = const(1024)  # a garbage collection of 9 ms at 1 Mbaud is 900 bytes
_VCP_PATIENCE_MS = const(2)  # for a host that does not read
_WATCHDOG_MS = const(500)
_SAVING_MS = const(8000)  # erasing a sector stops the processor, for up to a second each
_SAFE_CYCLES = const(200)  # before the watchdog, which never ends once begun: 2 s for whoever repairs what hangs

# The driver counts whole ticks of its millisecond clock: with 1 ms a tick that happens to come ends a sound transfer.
_I2C_TIMEOUT_US = const(2000)

_RESET_BY_PIN = const(2)  # what machine.reset_cause() says after machine.reset() too
_MARK = const(0x0A11)  # in the last backup register of the clock, which a reset leaves alone: it was by order
_AT_PROMPT = const(0x0A12)  # there too: boot.py shall not start the firmware


def open_bus():
    """The sensors' bus."""
    return machine.I2C(2, freq=400000, timeout=_I2C_TIMEOUT_US)


def free_bus():
    """A sensor that was cut short holds the data line until it has sent its byte: nine clocks and a stop, then the
    multiplexer's reset (where it is wired), then the bus anew."""
    clock = pyb.Pin("PB10", mode=pyb.Pin.OUT_OD, value=1)
    data = pyb.Pin("PB11", mode=pyb.Pin.OUT_OD, value=1)
    reset = pyb.Pin("PB12", mode=pyb.Pin.OUT_OD, value=0)
    for i in range(10):
        clock.value(0)
        data.value(i < 9)
        sleep_us(5)
        clock.value(1)
        sleep_us(5)
    data.value(1)
    reset.value(1)
    return open_bus()


class Hal(pins.Pins):
    """One board; main.py makes one. `wait_tick` begins a cycle, `end_cycle` shows its result on the pins."""

    capabilities = _CAN_WATCHDOG | _CAN_CURRENT | _CAN_LEAK | _CAN_KILL | _CAN_VERSION_2 | _CAN_VERSION_3

    def __init__(self):
        import wiring

        self._battery, self._current, self._probe, spi, select = wiring.connect_inputs()
        motion = gyro.Gyro(spi, select)
        self.yaw_rate_cdeg_s, self.gravity_mg = motion.rate_cdeg_s, motion.gravity_mg
        super().__init__()
        self.pressure_mPa = [0] * 4  # absolute
        self.answered = 0
        self.battery_mv = self.current_10ma = self.leak = 0
        self.armed = 0
        self.dt_us = _CYCLE_US  # since the cycle before
        self.ticks = 1  # the same, in ticks
        self.late = 0  # ticks lost since boot, modulo 65536
        self._fired = self._taken = 0  # ticks since boot, modulo 2**30
        self.us_low = self.us_high = 0  # of now_us, 16 bits each: beyond 30 bits a number is an object
        self._fired_at = self._began = ticks_us()
        self._safe = _SAFE_CYCLES
        self._watchdog = None
        self._sensors = ms5837.Sensors(open_bus(), free_bus)
        self._usb = pyb.USB_VCP()
        self._uart = None
        if "usb" in os.listdir():  # a file of this name: the tether is the board's own USB port
            self._usb.setinterrupt(-1)  # the byte 3 is data
        else:
            self._uart = machine.UART(2, baudrate=_BAUD, timeout=0, rxbuf=_RX_BUFFER)
        # Timer 5 is shared with the port's own servo driver, and its interrupt would stand above the UART's, whose
        # bytes come every 10 us and have no queue. All others get a priority far below it.
        self._clock = pyb.Timer(7, freq=1000000 // _CYCLE_US)
        self._clock.callback(self._on_tick)

    def _on_tick(self, _timer):
        """Runs in the interrupt: no allocation, no number beyond 30 bits."""
        self._fired_at = ticks_us()
        self._fired = (self._fired + 1) & 0x3FFFFFFF

    def wait_tick(self):
        """Sleep until the next tick, then read all sensors. There is always a next one."""
        while self._fired == self._taken:
            pyb.wfi()
        self._began = self._fired_at  # before the count: a tick between the two makes a cycle seem long, not short
        fired = self._fired
        ticks = (fired - self._taken) & 0x3FFFFFFF
        self._taken = fired
        low = self.us_low + ticks * _CYCLE_US
        self.us_low = low & 0xFFFF
        self.us_high = (self.us_high + (low >> 16)) & 0xFFFF
        if ticks != self.ticks:
            self.ticks = ticks
            self.dt_us = ticks * _CYCLE_US
        if ticks != 1:
            self.late = (self.late + ticks - 1) & 0xFFFF
        self.answered = self._sensors.step(self.pressure_mPa)
        # Blue Robotics Power Sense Module, from its product page: 11.0 V/V, 37.8788 A/V from 0.330 V on.
        if fired & 1:
            self.battery_mv = self._battery() * 36300 // 4095
        else:
            self.current_10ma = max(0, self._current() * 30525 // 10000 - 1250)
            self.leak = 0 if self._probe() else 1  # water pulls it down
        return True

    @property
    def temperature_cC(self):
        return self._sensors.temperature_cC

    def end_cycle(self):
        """Pins first, then the watchdog: with motors on, it gets its food only for sensors that have just answered."""
        self.write_pins()
        if self._safe:
            self._safe -= 1
        elif self._watchdog is None:
            self._watchdog = machine.WDT(timeout=_WATCHDOG_MS)
        elif self.answered or not self.armed:
            self._watchdog.feed()

    def now_us(self):
        """The board's clock at this cycle's tick, 32 bits."""
        return self.us_high << 16 | self.us_low

    def cycle_us(self):
        """Since this cycle's tick: at its end, the whole of it, with buses and collection."""
        return ticks_diff(ticks_us(), self._began)

    def read_into(self, buf):
        """Bytes from the tether, as many as there are; 0: none. To ask for more would wait for them, 1 to 2 ms."""
        if self._uart is not None:
            n = self._uart.any()
            return self._uart.readinto(buf, min(n, len(buf))) or 0 if n else 0
        return self._usb.recv(buf, timeout=0) if self._usb.any() else 0

    def write(self, frame):
        """A frame to the tether; returns when it is out (0.8 ms for telemetry at 1 Mbaud)."""
        if self._uart is not None:
            self._uart.write(frame)
        elif self._usb.isconnected():
            self._usb.send(frame, timeout=_VCP_PATIENCE_MS)

    def collect(self):
        """Collect garbage."""
        gc.collect()

    def heap_free(self):
        """Bytes."""
        return gc.mem_free()

    def boot_info(self):
        """Unique id (12 bytes), a fresh random boot id, reset cause."""
        cause = machine.reset_cause()
        if cause == _RESET_BY_PIN and self._mark(0) == _MARK:
            cause = _BY_ORDER
        return machine.unique_id(), pyb.rng() << 2 & 0xFFFFFFFF, cause

    def _mark(self, value):
        """Leave a number for the next boot; returns the one that was left for this."""
        import stm

        was = stm.mem32[stm.RTC + stm.RTC_BKP19R]
        stm.mem32[stm.RTC + stm.RTC_BKP19R] = value
        return was

    def reboot(self, to_prompt=False):
        """Does not return."""
        self._mark(_AT_PROMPT if to_prompt else _MARK)
        machine.reset()

    def load_flash(self):
        """What survives a power cut: a dict, empty on a fresh board. ValueError: there is something, but damaged."""
        import slots

        pins.forget("slots")
        return slots.newest()[1]

    def save_flash(self, flash):
        """The motors are off: the processor stands still meanwhile."""
        import slots

        pins.forget("slots")
        if self._watchdog is not None:
            machine.WDT(timeout=_SAVING_MS)
        slots.save(flash)
        if self._watchdog is not None:
            self._watchdog = machine.WDT(timeout=_WATCHDOG_MS)
