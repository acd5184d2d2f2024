"""The sensors' bus at the level of bytes: a multiplexer, four sensors by their data sheet, and what can go wrong."""

from __future__ import annotations

from hw.firmware import ms5837

# The worked example of the MS5837-02BA's data sheet.
WORDS = (0, 46372, 43981, 29059, 27842, 31553, 28165)
D1, D2, CELSIUS, PASCAL = 6465444, 8077636, 20.00, 110002.0

TRANSFER_US, BIT_US = 14, 2.5
TIMEOUT_US = 2000.0
NO_DEVICE, TIMED_OUT = 19, 110


def prom_of(words: tuple[int, ...]) -> bytearray:
    """A PROM's bytes with their check sum, and the two zeros behind them."""
    prom = bytearray(b"".join(word.to_bytes(2, "big") for word in words) + bytes(2))
    prom[0] |= ms5837.check_sum(prom[0], prom) << 4
    return prom


class Sensor:
    """One of them; a conversion is complete when the next cycle asks."""

    def __init__(self) -> None:
        self.prom = prom_of(WORDS)
        self.answer, self.converted = b"", 0
        self.d1 = D1
        self.orders: list[int] = []

    def take(self, order: int) -> None:
        self.orders.append(order)
        if order == 0x00:
            self.answer, self.converted = self.converted.to_bytes(3, "big"), 0
        elif order >= 0xA0:
            self.answer = bytes(self.prom[order - 0xA0 :][:2])
        elif order in (0x48, 0x58):
            self.converted = self.d1 if order == 0x48 else D2


class Wires:
    """A machine.I2C. `us` is the time that all transfers took; `transfers` what they were."""

    def __init__(self) -> None:
        self.sensors = [Sensor() for _ in range(4)]
        self.dead: set[int] = set()  # do not acknowledge
        self.clinging: set[int] = set()  # pull the data line down as soon as they are let through
        self.shorted = False  # the line to the multiplexer itself
        self.channel = 0
        self.us = 0.0
        self.transfers: list[tuple[int, int]] = []
        self.freed = 0

    def free(self) -> Wires:
        """Clocks and the multiplexer's reset: no channel is let through."""
        self.freed += 1
        self.channel = 0
        return self

    @property
    def stuck(self) -> bool:
        return self.shorted or any(self.channel >> k & 1 for k in self.clinging)

    def _begin(self, address: int, n: int) -> None:
        self.transfers.append((address, n))
        if self.stuck:
            self.us += TIMEOUT_US
            raise OSError(TIMED_OUT)
        self.us += TRANSFER_US + (11 + 9 * n) * BIT_US

    def _sensor(self) -> Sensor:
        (k,) = (k for k in range(4) if self.channel == 1 << k)
        if k in self.dead:
            raise OSError(NO_DEVICE)
        return self.sensors[k]

    def writeto(self, address: int, data: bytes) -> None:
        self._begin(address, len(data))
        if address == 0x70:
            (self.channel,) = data
            if self.stuck:  # the stop of this very transfer does not come through
                self.us += TIMEOUT_US
                raise OSError(TIMED_OUT)
        else:
            assert address == 0x76
            self._sensor().take(data[0])

    def readfrom_into(self, address: int, buf: bytearray) -> None:
        self._begin(address, len(buf))
        assert address == 0x76
        buf[:] = self._sensor().answer
