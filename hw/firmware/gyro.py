# The yaw rate: a gyro of the kind ICM-42688-P, on a bus of its own: one that fails takes no pressure sensor along.
#
# Registers, codes and times: data sheet DS-000347 (TDK InvenSense), "User bank 0 register map". Written from it;
# untested on hardware. The chip lies flat, marked side up: its z axis is the robot's, anticlockwise seen from above.
from micropython import const

_NO_RATE = const(-32768)  # of wire.py
_INVALID = const(0x8000)  # what the chip shows while it does not measure, after a reset too
_ICM_42688_P = const(0x47)
_PER_DEG_S = const(131)  # at a full scale of 250 degrees a second
_SETTLING = const(5)  # readings, of 20 ms, of which it takes 45 ms to start


class Gyro:
    """One that may be there or not, and may come and go. Each reading begins with who answers."""

    def __init__(self, spi, select):
        """spi: with write and write_readinto as machine.SPI; select(level): the chip listens while it is 0."""
        self._spi, self._select = spi, select
        self._answer = bytearray(3)
        self._wait = -1  # readings until it is believed; negative: not told what to do

    def rate_cdeg_s(self):
        """Hundredths of a degree a second, +-25013 where the chip is at its limit; _NO_RATE where there is none."""
        wait, self._wait = self._wait, -1  # where anything breaks off: anew
        try:
            if self._read(b"\xf5\0\0") >> 8 == _ICM_42688_P:
                if wait < 0:
                    # 250 deg/s 100 times a second; low-pass at 25 Hz, half of how often telemetry goes out; the gyro
                    # on, in its quietest mode, the accelerometer off.
                    for setting in (b"\x4f\x68", b"\x52\x15", b"\x4e\x0c"):
                        self._select(0)
                        self._spi.write(setting)
                        self._select(1)
                    wait = _SETTLING
                raw = self._read(b"\xa9\0\0")
                if wait:
                    self._wait = wait - 1
                elif raw != _INVALID:
                    self._wait = 0
                    return (raw - (raw >> 15 << 16)) * 100 // _PER_DEG_S
        except OSError:
            pass  # a gyro is not worth a telemetry frame
        return _NO_RATE

    def _read(self, order):
        """Two registers, the first one's number in the order; all bits set where nobody answers."""
        answer = self._answer
        self._select(0)
        self._spi.write_readinto(order, answer)
        self._select(1)
        return answer[1] << 8 | answer[2]
