# The yaw rate: a gyro of the kind ICM-42688-P on a bus of its own, so that one that fails takes no pressure sensor along.
#
# Registers, codes and times: data sheet DS-000347 (TDK InvenSense), "User bank 0 register map". Written from it;
# untested on hardware. The chip lies flat, marked side up: its z axis is the robot's, anticlockwise seen from above.
from micropython import const

_NO_RATE = const(-32768)  # of wire.py
_INVALID = const(-32768)  # what the chip has to show while it does not measure, after a reset too
_ICM_42688_P = const(0x47)
_PER_DEG_S = const(131)  # at a full scale of 250 degrees a second
_SETTLING = const(5)  # readings, of 20 ms, of which it takes 45 ms to start
WHO_AM_I, RATE = b"\xf5\x00", b"\xa9\x00\x00"  # reads of one byte, and of two
# What it is told, each a register and its value: 250 deg/s 100 times a second; low-pass at 25 Hz, half of how often
# telemetry goes out; the gyro on, in its quietest mode, the accelerometer off.
SETTINGS = (b"\x4f\x68", b"\x52\x15", b"\x4e\x0c")


class Gyro:
    """One that may be there or not, and may come and go. Each reading begins with who answers."""

    def __init__(self, spi, select):
        """spi: with write_readinto as machine.SPI; select(level): the chip listens while it is 0."""
        self._transfer, self._select = spi.write_readinto, select
        self._who, self._rate = bytearray(2), bytearray(3)
        self._wait = -1  # readings until it is believed; negative: not told what to do

    def rate_cdeg_s(self):
        """Hundredths of a degree a second, +-25013 where the chip is at its limit; _NO_RATE where there is none."""
        try:
            self._ask(WHO_AM_I, self._who)
            if self._who[1] != _ICM_42688_P:
                self._wait = -1
                return _NO_RATE
            if self._wait < 0:
                for setting in SETTINGS:
                    self._ask(setting, self._who)
                self._wait = _SETTLING
            self._ask(RATE, self._rate)
        except OSError:
            self._wait = -1
            return _NO_RATE
        raw = self._rate[1] << 8 | self._rate[2]
        if raw & 0x8000:
            raw -= 65536
        if self._wait:
            self._wait -= 1
            return _NO_RATE
        if raw == _INVALID:
            self._wait = -1
            return _NO_RATE
        return raw * 100 // _PER_DEG_S

    def _ask(self, order, answer):
        """One transfer."""
        self._select(0)
        try:
            self._transfer(order, answer)
        finally:
            self._select(1)
