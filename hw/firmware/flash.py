# What the board remembers over a power cut: parameters and tare, one table of names as the HAL stores it.
import sys
from micropython import const

_TIME_UNKNOWN = const(-1)
_TARE_FOR_S = const(43200)  # the weather moves by 1 hPa, a centimetre of water, within hours
_TARE_AHEAD_S = const(600)  # a clock without a time server goes wrong by so much in months, and weather in hours
_HOST_ROUND = const(0x100000000)  # where the host's clock begins again
_TARE_TIMES = {1000: "tare_host_ms", 10: "tare_host_ds"}  # by how many of them a second has


def put_away():
    """Drop the modules that only boot and orders to a robot at rest need: in a dive they take no memory."""
    for name in ("parameters", "tare", "gains"):
        sys.modules.pop(name, None)


class Flash:
    """The table, and which of the values in force are in it."""

    def __init__(self, hal):
        self._hal = hal
        self._table = {}
        self._tared_now = False  # in this boot
        self.saved = []

    def load(self):
        """Read it. Raises ValueError, in one line, where it is broken or holds what cannot be."""
        import parameters

        self.saved = parameters.from_flash({})
        self._table = self._hal.load_flash()
        self.saved = parameters.from_flash(self._table)

    def save_parameters(self, values):
        import parameters

        parameters.into_flash(values, self._table)
        self._hal.save_flash(self._table)
        self.saved = list(values)

    def tare_mPa(self):
        """The four zeros, or None; ValueError where there is something else."""
        import tare

        tare_pa = self._table.get("tare_pa")
        if tare_pa is None:
            return None
        tare_mPa = tare.whole(tare_pa)
        if tare_mPa is None:
            raise ValueError("tare_pa in flash is no tare: tare again")
        return tare_mPa

    def save_tare(self, tare_pa, host_time, per_s):
        """host_time: the host's clock, modulo 2**32, of which a second has so many; None where no host has told it."""
        for unit in _TARE_TIMES:
            self._table.pop(_TARE_TIMES[unit], None)
        self._table["tare_pa"] = tare_pa
        self._table[_TARE_TIMES[per_s]] = _TIME_UNKNOWN if host_time is None else host_time
        self._hal.save_flash(self._table)
        self._tared_now = True

    def tare_is_old(self, host_time, per_s):
        """Made before this boot and not within 12 h, as far as anybody knows.

        The board has no calendar. The milliseconds of hosts of versions 1 and 2 come round after 49 days, the tenths of
        a second of version 3 after 13 years; the one says nothing of the other. A tare that was written into flash
        without a time was put there by somebody who knew. One from a little ahead of the host's clock is fresh: that
        clock was set since, or it is another computer's.
        """
        table = self._table
        if self._tared_now or not [unit for unit in _TARE_TIMES if _TARE_TIMES[unit] in table]:
            return False
        made = table.get(_TARE_TIMES[per_s])
        if host_time is None or not isinstance(made, int) or made == _TIME_UNKNOWN:
            return True
        age = (host_time - made) & 0xFFFFFFFF
        return _TARE_FOR_S * per_s < age < _HOST_ROUND - _TARE_AHEAD_S * per_s
