# Four MS5837-02BA pressure sensors behind a TCA9548A multiplexer: they all have the same address.
#
# A conversion is begun in one cycle and fetched in the next, so that nobody waits for the 9 ms that it takes.
# Commands, PROM, CRC and compensation: data sheet of the MS5837-02BA (TE Connectivity), pages "Commands",
# "Pressure and temperature calculation" and "Cyclic redundancy check". Written from it; untested on hardware.
import time

MUX, SENSOR = 0x70, 0x76  # addresses on the bus
RESET, READ_ADC, READ_PROM = b"\x1e", b"\x00", 0xA0
CONVERT_PRESSURE, CONVERT_TEMPERATURE = b"\x48", b"\x58"  # at an oversampling of 4096: 9.04 ms at the most
RESET_MS = 10
TEMPERATURE_EVERY = 20  # cycles: water does not warm up within 0.2 s


def crc4(words):
    """The four check bits over the eight words of a PROM, those that hold the sum itself already cleared."""
    rest = 0
    for word in words:
        for byte in (word >> 8, word & 0xFF):
            rest ^= byte
            for _ in range(8):
                rest = (rest << 1 ^ 0x3000 if rest & 0x8000 else rest << 1) & 0xFFFF
    return rest >> 12 & 15


def is_sound(prom):
    """Whether seven words read from a sensor carry the sum that they should."""
    return crc4([prom[0] & 0x0FFF] + list(prom[1:7]) + [0]) == prom[0] >> 12


def temperature(prom, d2):
    """(degrees Celsius, pressure offset, pressure sensitivity) of a raw temperature; floats of 32 bits are enough."""
    dt = d2 - prom[5] * 256.0
    temp = 2000.0 + dt * prom[6] / 8388608.0
    offset = prom[2] * 131072.0 + prom[4] * dt / 64.0
    sensitivity = prom[1] * 65536.0 + prom[3] * dt / 128.0
    if temp < 2000.0:  # second order, below 20 C
        cold = (temp - 2000.0) * (temp - 2000.0)
        temp -= 11.0 * dt / 34359738368.0 * dt
        offset -= 31.0 * cold / 8.0
        sensitivity -= 63.0 * cold / 32.0
    return temp * 0.01, offset, sensitivity


def pressure_pa(d1, offset, sensitivity):
    """Absolute pressure of a raw reading: the sensor's 0.01 mbar is a pascal."""
    return (d1 * (sensitivity / 2097152.0) - offset) / 32768.0


class Sensors:
    """All four. `i2c` is machine.I2C or whatever has its writeto and readfrom_into."""

    def __init__(self, i2c):
        self.temperature_c = float("nan")  # of the water, at the first sensor that tells
        self._i2c = i2c
        self._select = [bytes([1 << k]) for k in range(4)]
        self._raw = bytearray(3)
        self._prom = [None] * 4
        self._offset = [0.0] * 4
        self._sensitivity = [0.0] * 4
        self._warm = 0  # bit mask of sensors with a temperature
        self._cycle = 0
        self._begun = None  # the conversion that is under way

    def start(self):
        """Reset, read the calibrations, begin. One that fails stays silent; returns the bit mask of the sound ones."""
        for k in range(4):
            try:
                self._i2c.writeto(MUX, self._select[k])
                self._i2c.writeto(SENSOR, RESET)
            except OSError:
                pass  # step() asks it again every cycle, and reports that it does not answer
        time.sleep(RESET_MS * 0.001)
        found = 0
        for k in range(4):
            try:
                self._i2c.writeto(MUX, self._select[k])
                prom = [self._word(i) for i in range(7)]
            except OSError:
                continue
            if is_sound(prom):
                self._prom[k] = prom
                found |= 1 << k
        return found

    def _word(self, i):
        word = bytearray(2)
        self._i2c.writeto(SENSOR, bytes([READ_PROM + 2 * i]))
        self._i2c.readfrom_into(SENSOR, word)
        return word[0] << 8 | word[1]

    def step(self, pressures_pa):
        """Fetch what was begun, begin the next; fills `pressures_pa`. Returns the bit mask of sensors that answered.

        In the cycle that brings a temperature, a pressure is the one before.
        """
        begun = self._begun
        self._begun = CONVERT_PRESSURE if self._cycle % TEMPERATURE_EVERY else CONVERT_TEMPERATURE
        self._cycle += 1
        answered = 0
        for k in range(4):
            if self._prom[k] is not None:
                try:
                    if self._exchange(k, begun, pressures_pa):
                        answered |= 1 << k
                except OSError:
                    pass  # no acknowledgement: its bit stays clear, and pressure.py counts
        return answered

    def _exchange(self, k, begun, pressures_pa):
        i2c, raw = self._i2c, self._raw
        i2c.writeto(MUX, self._select[k])
        i2c.writeto(SENSOR, READ_ADC)
        i2c.readfrom_into(SENSOR, raw)
        i2c.writeto(SENSOR, self._begun)
        value = raw[0] << 16 | raw[1] << 8 | raw[2]
        if not value or begun is None:  # 0: the conversion was not complete
            return False
        if begun == CONVERT_TEMPERATURE:
            celsius, self._offset[k], self._sensitivity[k] = temperature(self._prom[k], value)
            if not self._warm & ((1 << k) - 1):  # no sensor before this one has told
                self.temperature_c = celsius
            first = not self._warm >> k & 1
            self._warm |= 1 << k
            return not first
        if not self._warm >> k & 1:
            return False
        pressures_pa[k] = int(1000 * pressure_pa(value, self._offset[k], self._sensitivity[k]))
        return True
