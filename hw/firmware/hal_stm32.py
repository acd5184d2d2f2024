# The hardware of the control module: an STM32F407VG under MicroPython. Wiring and pins: hw/README.md.
# Untested on hardware: it compiles for the board, its types are checked against the port's stubs, its arithmetic is
# tested in ms5837.py and pwm.py, and nothing of it has driven a pin.
import binascii
import gc
import json
import os
import time

import machine
import ms5837
import pwm
import pyb
import wire

FLASH = "flash.json"  # JSON in the first line, its CRC-32 in the second
USB_MARK = "usb"  # a file of this name: the tether is the board's own USB port, not UART 2
CYCLE_HZ = 100
BAUD = 1000000
RX_BUFFER = 1024  # a garbage collection of 9 ms at 1 Mbaud is 900 bytes
VCP_PATIENCE_MS = 2  # for a host that does not read
WATCHDOG_MS = 500
SAVING_MS = 8000  # erasing a sector stops the processor, for up to a second each
SAFE_CYCLES = 200  # before the watchdog, which never ends once begun: 2 s to interrupt a program that hangs at once

# Blue Robotics Power Sense Module, from its product page: 11.0 V/V, 37.8788 A/V from 0.330 V on.
ADC_V = 3.3 / 4095
BATTERY_V_PER_V, CURRENT_A_PER_V, CURRENT_ZERO_V = 11.0, 37.8788, 0.330


def is_button_held():
    """The user's way past main.py to a prompt: hold it while power comes."""
    return bool(pyb.Pin("PA0", mode=pyb.Pin.IN, pull=pyb.Pin.PULL_DOWN).value())


class Hal:
    """One board; main.py makes one. `wait_tick` begins a cycle, `end_cycle` shows its result on the pins."""

    capabilities = wire.CAN_WATCHDOG | wire.CAN_CURRENT | wire.CAN_LEAK | wire.CAN_KILL

    def __init__(self):
        self.pressure_mPa = [0] * 4
        self.dt_us = 10000  # absolute
        self.answered = 0
        self.battery_mv = self.current_10ma = self.leak = 0
        self.pulses_us = [1500] * 8
        self.servos_us = [1500] * 4
        self.light_permille = 0
        self.armed = 0
        self.late = 0  # ticks missed
        self._due = 0
        self._cycle = 0
        self._us = 0
        self._ticks = time.ticks_us()
        self._watchdog = None
        self._timers = {}
        self._thrusters = [self._channel(*row) for row in pwm.THRUSTERS]
        self._servos = [self._channel(*row) for row in pwm.SERVOS]
        self._lamp = self._channel(*pwm.LAMP)
        for timer, pin in pwm.KILL:
            function = pyb.Pin.AF1_TIM1 if timer == 1 else pyb.Pin.AF3_TIM8
            pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_UP, alt=function)
        self._battery = pyb.ADC(pyb.Pin("PC1"))
        self._current = pyb.ADC(pyb.Pin("PC2"))
        self._probe = pyb.Pin("PC4", mode=pyb.Pin.IN, pull=pyb.Pin.PULL_UP)
        self._sensors = ms5837.Sensors(machine.I2C(2, freq=400000))
        self._sensors.start()
        self._usb = pyb.USB_VCP()
        self._uart = None
        if USB_MARK in os.listdir():
            self._usb.setinterrupt(-1)  # the byte 3 is data
        else:
            self._uart = machine.UART(2, baudrate=BAUD, timeout=0, rxbuf=RX_BUFFER)
        self._clock = pyb.Timer(5, freq=CYCLE_HZ)
        self._clock.callback(self._on_tick)

    def _channel(self, timer, channel, pin):
        """A PWM output that stands at neutral."""
        if timer not in self._timers:
            made = pyb.Timer(timer, freq=1000000 // pwm.FRAME_US)  # the clock's frequency can be asked for from now on
            brk = pyb.Timer.BRK_LOW if timer in (1, 8) else pyb.Timer.BRK_OFF
            scale = pwm.prescaler(made.source_freq())
            made.init(prescaler=scale, period=pwm.FRAME_US - 1, brk=brk)  # type: ignore[call-overload] # brk is missing
            self._timers[timer] = made
        return self._timers[timer].channel(channel, pyb.Timer.PWM, pin=pyb.Pin(pin), pulse_width=1500)

    def _on_tick(self, _timer):
        """Runs in the interrupt: no allocation, no floats."""
        self._due += 1

    def wait_tick(self):
        """Sleep until the next tick, then read all sensors. There is always a next one."""
        while not self._due:
            pyb.wfi()
        self.late += self._due - 1
        self._due = 0
        self._cycle += 1
        self.answered = self._sensors.step(self.pressure_mPa)
        self.battery_mv = int(self._battery.read() * ADC_V * BATTERY_V_PER_V * 1000.0)
        amps = (self._current.read() * ADC_V - CURRENT_ZERO_V) * CURRENT_A_PER_V
        self.current_10ma = max(0, int(amps * 100.0))
        self.leak = 0 if self._probe.value() else 1  # water pulls it down
        return True

    @property
    def temperature_c(self):
        return self._sensors.temperature_c

    def write_pins(self):
        """Show pulses, servos and lamp."""
        for j in range(8):
            self._thrusters[j].pulse_width(self.pulses_us[j])
        for j in range(4):
            self._servos[j].pulse_width(self.servos_us[j])
        self._lamp.pulse_width(pwm.lamp_us(self.light_permille))
        return True

    def end_cycle(self):
        """Pins first, then the watchdog: with motors on, it gets its food only for sensors that have just answered."""
        self.write_pins()
        if self._watchdog is None:
            if self._cycle >= SAFE_CYCLES:
                self._watchdog = machine.WDT(timeout=WATCHDOG_MS)
        elif self.answered or not self.armed:
            self._watchdog.feed()

    def cycle_us(self):
        return 0

    def now_us(self):
        """The board's clock, 32 bits; ticks_us alone wraps after 30."""
        ticks = time.ticks_us()
        self._us = (self._us + time.ticks_diff(ticks, self._ticks)) & 0xFFFFFFFF
        self._ticks = ticks
        return self._us

    def read_into(self, buf):
        """Bytes from the tether, as many as there are; 0: none."""
        if self._uart is not None:
            return self._uart.readinto(buf) or 0
        return self._usb.recv(buf, timeout=0) if self._usb.any() else 0

    def write(self, frame):
        """A frame to the tether; returns when it is out (0.8 ms for telemetry at 1 Mbaud)."""
        if self._uart is not None:
            self._uart.write(frame)
        elif self._usb.isconnected():
            self._usb.send(frame, timeout=VCP_PATIENCE_MS)

    def collect(self):
        """Collect garbage, in the slack of the cycle; returns the time it took in us."""
        start = time.ticks_us()
        gc.collect()
        return time.ticks_diff(time.ticks_us(), start)

    def heap_free(self):
        """Bytes."""
        return gc.mem_free()

    def boot_info(self):
        """Unique id (12 bytes), a fresh random boot id, reset cause."""
        return machine.unique_id(), pyb.rng() << 2 & 0xFFFFFFFF, machine.reset_cause()

    def reboot(self):
        """Does not return."""
        machine.reset()

    def load_flash(self):
        """What survives a power cut: a dict, empty on a fresh board. ValueError: there is something, but damaged."""
        try:
            with open(FLASH) as file:
                text, crc = file.readline().strip(), file.readline().strip()
        except OSError:
            return {}
        if crc != "%08x" % binascii.crc32(text.encode()):
            raise ValueError("flash: checksum is wrong; set and save anew")
        return json.loads(text)

    def save_flash(self, flash):
        """Whole or not at all. The motors are off: the processor stands still meanwhile."""
        if self._watchdog is not None:
            machine.WDT(timeout=SAVING_MS)
        text = json.dumps(flash)
        with open(FLASH + ".new", "w") as file:
            file.write("%s\n%08x\n" % (text, binascii.crc32(text.encode())))
        os.rename(FLASH + ".new", FLASH)
        os.sync()
        if self._watchdog is not None:
            self._watchdog = machine.WDT(timeout=WATCHDOG_MS)
