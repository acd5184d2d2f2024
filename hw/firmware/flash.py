# What the board remembers over a power cut: parameters and tare, one table of names as the HAL stores it.
import sys
from micropython import const

import failsafe

_TIME_UNKNOWN = const(-1)
_HOST_ROUND_MS = const(0x100000000)  # where the host's milliseconds begin again


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

    def save_tare(self, tare_pa, host_ms):
        """host_ms: the host's clock, modulo 2**32, or None where no host has told it."""
        self._table["tare_pa"] = tare_pa
        self._table["tare_host_ms"] = _TIME_UNKNOWN if host_ms is None else host_ms
        self._hal.save_flash(self._table)
        self._tared_now = True

    def tare_is_old(self, host_ms):
        """Made before this boot and not within TARE_FOR_MS, as far as anybody knows.

        The board has no calendar; the host's milliseconds come round after 49 days. A tare that was written into
        flash without a time was put there by somebody who knew. One from a little ahead of the host's clock is fresh:
        that clock was set since, or it is another computer's.
        """
        if self._tared_now or "tare_host_ms" not in self._table:
            return False
        made_ms = self._table["tare_host_ms"]
        if host_ms is None or not isinstance(made_ms, int) or made_ms == _TIME_UNKNOWN:
            return True
        return failsafe.TARE_FOR_MS < (host_ms - made_ms) & 0xFFFFFFFF < _HOST_ROUND_MS - failsafe.TARE_AHEAD_MS
