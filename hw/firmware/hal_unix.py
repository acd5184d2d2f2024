# The board's hardware on a computer: a pty stands for the tether, a stream socket for sensors and pins.
# Runs under CPython and under MicroPython's Unix port. Time is what the bus says, so a lock-step run is exact. A cycle
# takes what it would take on the board, by the table of times in the environment; without one it takes nothing.
import gc
import json
import os
import struct
import sys

import bus
import wire

RESET_CAUSE = "AUCAMP_RESET_CAUSE"  # the environment variable that stands for the chip's register
FRAME_US = 5000  # the thrusters' pulse frame, until somebody asks for another
PROMPT = 3  # the exit code of a program that was ordered to its prompt
EIO, EAGAIN = 5, 11  # errno: nobody has the other end of the pty open; its buffer is full or empty


# The table's entries: a cycle that sends and hears nothing, armed or not; a frame sent, and each of its bytes, that
# many ns; a byte heard; a garbage collection; looking how much memory is free.
ARMED, DISARMED, FRAME, BYTE, HEARD, COLLECT, HEAP_FREE = range(7)


class Hal:
    """One board. `wait_tick` ends a cycle and begins the next."""

    capabilities = (
        wire.CAN_CURRENT | wire.CAN_LEAK | wire.CAN_KILL | wire.SIMULATED | wire.CAN_VERSION_2 | wire.CAN_VERSION_3
    )
    temperature_cC = 0  # the simulated bus has no thermometer

    def __init__(self, serial_fd, bus_fd, flash_path):
        """serial_fd: master of a raw, non-blocking pty; bus_fd: stream of the records in bus.py, blocking."""
        self._reset_cause = int(os.getenv(RESET_CAUSE) or wire.POWER_ON)
        self._serial = open(serial_fd, "r+b", buffering=0)
        self._bus = open(bus_fd, "r+b", buffering=0)
        self._flash_path = flash_path
        self._tick = bytearray(bus.TICK_SIZE)
        self._tick_view = memoryview(self._tick)
        self._act = bytearray(bus.ACT_SIZE)
        self._begun = False
        self._now_us = self._tick_us = self.us_low = self.us_high = 0
        self._frame_us = FRAME_US
        self._times = [int(ns) for ns in (os.getenv(bus.TIMES) or "0 0 0 0 0 0 0").split()]
        self._percent = 100
        self._ns = self._pins_us = self._waited_us = 0  # since this cycle began
        self.dt_us, self.ticks, self.late = bus.TICK_US, 1, 0
        self.pressure_mPa = [0] * 4  # absolute
        self.answered = 0  # bit mask of sensors that did
        self.battery_mv = self.current_10ma = self.leak = 0
        self._yaw_rate_cdeg_s = wire.NO_RATE
        self._open_loop, self._gravity_mg = 0, bus.NO_GRAVITY
        self._killed = False  # as the timers of the board: once their break input is high, until somebody revives them
        self.pulses_us = [1500] * 8
        self.servos_us = [1500] * 4
        self.light_permille = 0
        self.armed = 0  # the twin's crew let go of an armed robot

    def wait_tick(self):
        """Send the pins as they stand, then wait for the next sensor readings. False: the twin has gone."""
        if self._begun and not self.write_pins():
            return False
        self._begun = True
        got = 0
        while got < bus.TICK_SIZE:
            n = self._bus.readinto(self._tick_view[got:])
            if not n:
                return False
            got += n
        before_us = self._tick_us
        fields = struct.unpack(bus.TICK, self._tick)
        self._now_us, self._waited_us, self._percent = fields[:3]
        self.pressure_mPa[:] = fields[3:7]
        self.battery_mv, self.current_10ma, self.leak, self.answered = fields[7:11]
        self._yaw_rate_cdeg_s, self._open_loop, self._gravity_mg = fields[11], fields[12], fields[13:]
        if self._open_loop:
            self._killed = True
        self._tick_us = self._now_us - self._waited_us
        self.us_low, self.us_high = self._tick_us & 0xFFFF, self._tick_us >> 16 & 0xFFFF
        self.ticks = (self._tick_us - before_us) // bus.TICK_US if before_us else 1
        self.dt_us = self.ticks * bus.TICK_US
        self.late = (self.late + self.ticks - 1) & 0xFFFF
        self._ns = self._pins_us = 0
        return True

    def _took(self, which, times=1):
        """Let time pass for what has just been done: the table's entry, so many times."""
        self._ns += self._times[which] * times * self._percent // 100

    def write_pins(self):
        """Answer the tick. Last in a cycle: who has the answer finds all of the cycle's telemetry in the pty."""
        lamp_armed = self.light_permille, self.armed
        times = self._frame_us, self._pins_us, self._ns // 1000
        pulses_us = [0] * 8 if self._killed else self.pulses_us
        struct.pack_into(bus.ACT, self._act, 0, self._now_us, *pulses_us, *self.servos_us, *lamp_armed, *times)
        try:
            self._bus.write(self._act)
        except OSError:
            return False
        return True

    def begin_pulses(self, frame_us):
        """From now on a thruster's pulse begins every so many us."""
        self._frame_us = frame_us

    def killed(self):
        """Whether the kill switch's loop is open, or was: the thrusters have no pulses since."""
        return self._killed

    def revive(self):
        """Neutral pulses again after a kill, where its loop is closed. For a robot at rest."""
        if not self._open_loop:
            self._killed = False

    def now_us(self):
        """The board's clock at this cycle's tick, 32 bits."""
        return self._tick_us & 0xFFFFFFFF

    def yaw_rate_cdeg_s(self):
        """What the gyro says, wire.NO_RATE where there is none."""
        return self._yaw_rate_cdeg_s

    def gravity_mg(self):
        """What the accelerometer says, upwards and level; None where there is none."""
        return None if self._gravity_mg == bus.NO_GRAVITY else self._gravity_mg

    def cycle_us(self):
        """Since this cycle's tick, as far as it has come."""
        return self._waited_us + self._ns // 1000

    def read_into(self, buf):
        """Bytes from the tether, as many as there are; 0: none."""
        try:
            n = self._serial.readinto(buf) or 0
            self._took(HEARD, n)
            return n
        except OSError as error:
            if error.args[0] in (EIO, EAGAIN):
                return 0
            raise

    def write(self, frame):
        """A frame to the tether. What does not fit is lost, as on a wire that nobody listens to."""
        self._took(FRAME)
        self._took(BYTE, len(frame))
        try:
            self._serial.write(frame)
        except OSError as error:
            if error.args[0] not in (EIO, EAGAIN):
                raise

    def end_cycle(self):
        """Pins go out with the next wait_tick; and no watchdog: the twin sees by itself that no answer comes."""
        self._took(ARMED if self.armed else DISARMED)
        self._pins_us = self._ns // 1000

    def collect(self):
        """Collect garbage where the interpreter does not count references."""
        self._took(COLLECT)
        if hasattr(gc, "mem_free"):
            gc.collect()

    def heap_free(self):
        """Bytes; 0 where the interpreter has no bound."""
        self._took(HEAP_FREE)
        return gc.mem_free() if hasattr(gc, "mem_free") else 0

    def boot_info(self):
        """Unique id (12 bytes), a fresh random boot id, reset cause."""
        uid = (self._flash_path.encode() + bytes(12))[-24:-12]
        return uid, int.from_bytes(os.urandom(4), "little"), self._reset_cause

    def reboot(self, to_prompt=False):
        """Forget all but flash: main.py makes a new Firmware. A prompt comes from the program that started it."""
        if to_prompt:
            sys.exit(PROMPT)
        self._reset_cause = wire.BY_ORDER
        self.late = 0

    def load_flash(self):
        """What survives a power cut: a dict, empty on a fresh board. ValueError: there is something, but no JSON."""
        try:
            with open(self._flash_path) as file:
                flash = json.load(file)
        except OSError:
            return {}
        if not isinstance(flash, dict):
            raise ValueError("flash is no table")
        return flash

    def save_flash(self, flash):
        with open(self._flash_path + ".new", "w") as file:
            json.dump(flash, file)
        os.rename(self._flash_path + ".new", self._flash_path)
