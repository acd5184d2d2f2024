# Yaw rate and where up is: gyro and accelerometer of the kind ICM-42688-P, on a bus of its own: one that fails takes no
# pressure sensor along.
#
# Registers, codes and times: data sheet DS-000347 (TDK InvenSense), "User bank 0 register map". Written from it;
# untested on hardware. The chip lies flat, marked side up: its z axis is the robot's, anticlockwise seen from above.
import math
from micropython import const

_NO_RATE = const(-32768)  # of wire.py
_INVALID = const(-32768)  # what the chip shows while it does not measure, after a reset too
_ICM_42688_P = const(0x47)
_PER_DEG_S = const(131)  # at a full scale of 250 degrees a second
_PER_G = const(8192)  # at one of 4 g
_SETTLING = const(5)  # readings, of 20 ms, of which it takes 45 ms to start


class Gyro:
    """One that may be there or not, and may come and go. Each reading begins with who answers."""

    def __init__(self, spi, select):
        """spi: with write and write_readinto as machine.SPI; select(level): the chip listens while it is 0."""
        self._spi, self._select = spi, select
        self._answer = bytearray(7)
        self._short = memoryview(self._answer)[:3]
        self._wait = -1  # readings until it is believed; negative: not told what to do

    def rate_cdeg_s(self):
        """Hundredths of a degree a second, +-25013 where the chip is at its limit; _NO_RATE where there is none."""
        if self._ask(b"\xa9\0\0", self._short):
            return self._word(1) * 100 // _PER_DEG_S
        return _NO_RATE

    def gravity_mg(self):
        """Thousandths of gravity, upwards and level, with what motion adds; None where there is none."""
        if self._ask(b"\x9f\0\0\0\0\0\0", self._answer):
            x, y = self._word(1) >> 3, self._word(3) >> 3
            return self._word(5) * 1000 // _PER_G, int(math.sqrt(x * x + y * y)) * 1000 // (_PER_G >> 3)
        return None

    def _word(self, at):
        raw = self._answer[at] << 8 | self._answer[at + 1]
        return raw - (raw >> 15 << 16)

    def _ask(self, order, answer):
        """Registers from the order's first byte on, into `answer`, behind its first byte. Whether they are believed."""
        wait, self._wait = self._wait, -1  # where anything breaks off: anew
        try:
            self._read(b"\xf5\0\0", self._short)
            if self._answer[1] == _ICM_42688_P:
                if wait < 0:
                    # 250 deg/s and 4 g, 100 times a second; low-pass at 25 Hz, half of how often telemetry goes out;
                    # both on, in their quietest mode.
                    for setting in (b"\x4f\x68", b"\x50\x48", b"\x52\x15", b"\x4e\x0f"):
                        self._select(0)
                        self._spi.write(setting)
                        self._select(1)
                    wait = _SETTLING
                self._read(order, answer)
                if wait:
                    self._wait = wait - 1
                elif self._word(1) != _INVALID:
                    self._wait = 0
                    return True
        except OSError:
            pass  # a gyro is not worth a telemetry frame
        return False

    def _read(self, order, answer):
        """As many registers as the order is long but for a byte; all bits set where nobody answers."""
        self._select(0)
        self._spi.write_readinto(order, answer)
        self._select(1)
