# Bytes that the sensors take from the heap in a thousand cycles, under MicroPython: sensor_cost.py FIRMWARE_DIR
# ruff: noqa: T201
import gc
import sys

sys.path.insert(0, sys.argv[1])
import ms5837

PROM = b"\x80\x00\xb5\x24\xab\xcd\x71\x83\x6c\xc2\x7b\x41\x6e\x05\x00\x00"


class Wires:
    """Four sensors with one reading, and nothing that would take memory."""

    def __init__(self):
        self.at = 0

    def writeto(self, address, data):
        if address == 0x76:
            self.at = data[0]

    def readfrom_into(self, address, buf):
        if self.at >= 0xA0:
            buf[0], buf[1] = PROM[self.at - 0xA0], PROM[self.at - 0x9F]
        else:
            buf[0], buf[1], buf[2] = 0x62, 0xA7, 0x64


wires = Wires()
sensors, mPa = ms5837.Sensors(wires, None), [0] * 4
for _ in range(100):
    sensors.step(mPa)
assert sensors.step(mPa) == 15, "the calibration above has its check sum"
gc.collect()
before = gc.mem_alloc()
for _ in range(1000):
    sensors.step(mPa)
print(gc.mem_alloc() - before)
