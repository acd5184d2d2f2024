# Four MS5837-02BA pressure sensors behind a TCA9548A multiplexer: they all have the same address.
#
# A conversion is begun in one cycle and fetched in the next, so that nobody waits for the 9 ms that it takes.
# Commands, PROM, CRC and compensation: data sheet of the MS5837-02BA (TE Connectivity), pages "Commands",
# "Pressure and temperature calculation" and "Cyclic redundancy check". Written from it; untested on hardware.
import micropython
import struct
from array import array
from micropython import const

_MUX = const(0x70)  # addresses on the bus
_SENSOR = const(0x76)
_READ_PROM = const(0xA0)
_RESET = const(b"\x1e")
_READ_ADC = const(b"\x00")
_CONVERT_PRESSURE = const(b"\x48")
_CONVERT_TEMPERATURE = const(b"\x58")  # at an oversampling of 4096: 9.04 ms at the most
_TEMPERATURE_EVERY = const(20)  # cycles: water does not warm up within 0.2 s
_SECOND = const(100)  # cycles
_NO_DEVICE = const(19)  # ENODEV: nobody acknowledged. Anything else, mostly ETIMEDOUT, is trouble with the wires


@micropython.viper
def check_sum(first: int, prom: ptr8) -> int:
    """The four check bits over the 7 words of a PROM and a zero behind them; `first` stands for the first byte."""
    rest = first
    i = 0
    while i < 16:
        if i:
            rest ^= prom[i]
        bit = 0
        while bit < 8:
            rest <<= 1
            if rest & 0x10000:
                rest ^= 0x13000
            bit += 1
        i += 1
    return rest >> 12


def is_sound(prom):
    """Whether what was read from a sensor carries its check sum, in the first four bits."""
    return check_sum(prom[0] & 15, prom) == prom[0] >> 4


def thousandths(x):
    """x * 1000 / 1024, in steps that do not grow."""
    return x - (3 * x >> 7)


def temperature(words, d2, scale, at):
    """Hundredths of a degree from a PROM and a raw temperature; what `pressures` needs goes into scale[at:at + 3].

    The data sheet's recipe in whole numbers that stay within 30 bits for all water that there is, for which the raw
    temperature is cut into 12 bits and the rest. With OFF and SENS as in the data sheet, what is kept is
    SENS * 1000 / 4096, cut as well, and OFF * 1000 / 32768: a pressure in thousandths of a pascal.
    """
    _, c1, c2, c3, c4, c5, c6 = words
    dt = d2 - (c5 << 8)
    high, low = dt >> 12, dt & 4095
    celsius = 2000 + ((c6 * high + (c6 * low >> 12)) >> 11)
    x, y = c3 * high, c4 * high
    slope_16 = (thousandths(c3 * low) >> 5) - 3 * x + 8  # what does not come out even, in sixteenths
    zero_64 = (thousandths(c4 * low) >> 5) - 3 * y + 32
    if celsius < 2000:  # second order, below 20 C
        cold = (celsius - 2000) * (celsius - 2000)
        slope_16 -= thousandths(63 * cold) >> 3
        zero_64 -= thousandths(31 * cold) >> 2
        dt >>= 9
        celsius -= 11 * dt * dt >> 17
    slope = c1 * 16000 + (x << 3) + (slope_16 >> 4)
    scale[at], scale[at + 1] = slope >> 12, slope & 4095
    scale[at + 2] = max(0, c2 * 4000 + (y << 1) + (zero_64 >> 6))
    return celsius


@micropython.viper
def pressures(raw: ptr8, scale: ptr32, of: int, out) -> int:
    """Absolute pressures in mPa of the sensors in the bit mask `of`; returns those that had one. 0 is no reading.

    Nothing in it passes 30 bits: a reading has 24, a slope 18 and 12 behind the point.
    """
    good = 0
    k = 0
    while k < 4:
        high = raw[3 * k] << 4 | raw[3 * k + 1] >> 4
        low = (raw[3 * k + 1] & 15) << 8 | raw[3 * k + 2]
        if of >> k & 1 and high + low:
            slope = scale[3 * k]
            part = scale[3 * k + 1]
            out[k] = high * slope + ((high * part + low * slope + (low * part >> 12) + 2048) >> 12) - scale[3 * k + 2]
            good |= 1 << k
        k += 1
    return good


class Sensors:
    """All four. A bus has the writeto and readfrom_into of machine.I2C."""

    def __init__(self, bus, free):
        """free(): what can be done for a bus that is stuck; returns it as new."""
        self.temperature_cC = 0  # of the water, at the first sensor that tells; 0: none has
        self._free = free
        self._write, self._read = bus.writeto, bus.readfrom_into
        self._select = (b"\x01", b"\x02", b"\x04", b"\x08")
        self._prom = bytearray(16)  # of the one that is being asked
        self._words = [None] * 4  # of those that are known
        self._scale = array("i", [0] * 12)
        self._raw = bytearray(12)
        self._places = [memoryview(self._raw)[3 * k : 3 * k + 3] for k in range(4)]
        self._word = bytearray(2)
        self._known = 0  # bit mask of sensors whose calibration has been read
        self._warm = 0  # of these, that have a temperature
        self._told = 0  # of these, whose raw temperature is still to be worked out
        self._d2 = [0] * 4
        self._cycle = 0  # of the 20 from temperature to temperature
        self._measures_pressure = True  # the conversion that is under way
        self._took = 0  # bit mask of sensors that were given it
        self._asked = 0  # whose calibration is being read, and how far it is; -1: to be reset
        self._at = -1
        self._boot = _SECOND  # cycles in which sensors are asked one upon the other
        self._ask_in = 0  # cycles
        self._stuck = False
        self._freed = False  # in this cycle

    def step(self, pressures_mPa):
        """Fetch what was begun, begin the next; fills `pressures_mPa`. Returns the bit mask of sensors that answered.

        In the cycle that brings a temperature, a pressure is the one before.
        """
        self._freed = self._stuck
        if self._stuck:
            bus = self._free()
            self._write, self._read = bus.writeto, bus.readfrom_into
            self._stuck = False
        measured = self._measures_pressure
        measures = self._measures_pressure = self._cycle > 0
        self._cycle = (self._cycle + 1) % _TEMPERATURE_EVERY
        took = self._exchange(_CONVERT_PRESSURE if measures else _CONVERT_TEMPERATURE)
        answered = took & self._took
        self._took = took
        if measured:
            answered = pressures(self._raw, self._scale, answered & self._warm, pressures_mPa)
            if self._told:
                self._work_out()
        else:
            answered = self._keep_temperatures(answered)
        if self._known != 15 and not self._stuck:
            self._ask()
        return answered

    def _exchange(self, order):
        """Read all sensors that are known, and give them the next order; returns those that took it."""
        write, read = self._write, self._read
        select, places = self._select, self._places  # four at once would take memory
        known, took = self._known, 0
        for k in range(4):
            if known >> k & 1:
                try:
                    write(_MUX, select[k])
                    write(_SENSOR, _READ_ADC)
                    read(_SENSOR, places[k])
                    write(_SENSOR, order)
                    took |= 1 << k
                except OSError as error:  # of one that is not there the bit stays clear, and pressure.py counts
                    if self._jams(error):
                        if self._freed:  # and now it is stuck again, so it is this one: go on without
                            self._known &= ~(1 << k)
                            self._warm &= self._known
                            self._told &= self._known
                        break
        return took

    def _jams(self, error):
        """Whether the bus is stuck, rather than nobody there. A timeout is enough for a cycle; the next frees it."""
        self._stuck = error.args[0] != _NO_DEVICE
        return self._stuck

    def _keep_temperatures(self, answered):
        """Note raw temperatures; returns the sensors that had one and a pressure before."""
        raw, before = self._raw, self._warm
        for k in range(4):
            d2 = raw[3 * k] << 16 | raw[3 * k + 1] << 8 | raw[3 * k + 2]
            if answered >> k & 1 and d2:
                self._d2[k] = d2
                self._told |= 1 << k
            else:
                answered &= ~(1 << k)
        return answered & before

    def _work_out(self):
        """The temperature of one sensor; the others wait a cycle each, so that no cycle is long."""
        k = 0
        while not self._told >> k & 1:
            k += 1
        celsius = temperature(self._words[k], self._d2[k], self._scale, 3 * k)
        self._told &= ~(1 << k)
        self._warm |= 1 << k
        if not self._warm & ((1 << k) - 1):  # no sensor before this one has told
            self.temperature_cC = celsius

    def _ask(self):
        """A step in reading the calibration of one that is not known: a reset, then a word a cycle.

        One that fails is asked again after the others, and, but for the first second, not before a second has passed.
        """
        if self._boot:
            self._boot -= 1
        if self._ask_in:
            self._ask_in -= 1
            return
        while self._known >> self._asked & 1:
            self._asked = (self._asked + 1) & 3
        k, i = self._asked, self._at
        try:
            self._write(_MUX, self._select[k])
            if i < 0:
                self._write(_SENSOR, _RESET)
            else:
                self._write(_SENSOR, bytes((_READ_PROM + 2 * i,)))
                self._read(_SENSOR, self._word)
                self._prom[2 * i], self._prom[2 * i + 1] = self._word
            self._at = i + 1
            if self._at < 7:
                return
            if is_sound(self._prom):
                self._words[k] = struct.unpack_from(">7H", self._prom)
                self._known |= 1 << k
                self._at = -1
                return
        except OSError as error:
            self._jams(error)
        self._at = -1
        self._asked = (k + 1) & 3
        if self._stuck or not self._boot:
            self._ask_in = _SECOND
