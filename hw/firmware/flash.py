# What the board remembers over a power cut: parameters and tare, one table of names as the HAL stores it.
# For boot, and for orders to a robot at rest: in a dive neither this nor the table takes memory (orders.put_away).
from micropython import const

import parameters

_LOWEST_PA = const(30000)  # what the sensors can say, see pressure.py
_HIGHEST_PA = const(120000)
_SAMPLES = const(200)  # 2 s
_SPREAD_mPa = const(200000)  # 2 mbar: more is handling, splashing, or a sensor that is not well
_DISAGREE_mPa = const(490000)  # 5 cm of water between two sensors in the same air
_TIME_UNKNOWN = const(-1)
_TARE_TIMES = {1000: "tare_host_ms", 10: "tare_host_ds"}  # by how many of them a second has


def values(hal):
    """Of the parameters. Raises ValueError, in one line, where the table is broken or holds what cannot be."""
    return parameters.from_flash(hal.load_flash())


def save_values(hal, values):
    table = _readable(hal)
    parameters.into_flash(values, table)
    hal.save_flash(table)


def with_value(values, i, value):
    """These values with another one of parameter i, if it can have it, else None."""
    value = float("%.6g" % value)  # what somebody typed, before float32 made 0.4 into 0.40000001
    if i >= len(parameters.TABLE) or not parameters.in_range(i, value):
        return None
    return values[:i] + [parameters.of_type(i, value)] + values[i + 1 :]


def tared(hal):
    """The four zeros, or None; and when they were made, as Orders.tared has it. ValueError: there is something else."""
    table = _readable(hal)
    made = None  # in flash without a time: by somebody who knew
    for unit in _TARE_TIMES:
        if _TARE_TIMES[unit] in table:
            made = unit, table[_TARE_TIMES[unit]]
    tare_pa = table.get("tare_pa")
    if tare_pa is None:
        return None, made
    tare_mPa = whole(tare_pa)
    if tare_mPa is None:
        raise ValueError("tare_pa in flash is no tare: tare again")
    return tare_mPa, made


def save_tare(hal, medians_mPa, depth_Pa, host_time, per_s):
    """Keep these pressures for those so far below the surface; the four zeros, or None where that leaves no air above
    the water. host_time: the host's clock, modulo 2**32, of which a second has so many; None where no host has told it.
    """
    tare_pa = [mPa * 1e-3 - depth_Pa for mPa in medians_mPa]
    tare_mPa = whole(tare_pa)
    if tare_mPa is not None:
        table = _readable(hal)
        for unit in _TARE_TIMES:
            table.pop(_TARE_TIMES[unit], None)
        table["tare_pa"] = tare_pa
        table[_TARE_TIMES[per_s]] = _TIME_UNKNOWN if host_time is None else host_time
        hal.save_flash(table)
    return tare_mPa


def _readable(hal):
    """The table; an empty one in place of a broken one, which the next save replaces."""
    try:
        return hal.load_flash()
    except ValueError:
        return {}


def whole(tare_pa):
    """Four pressures in Pa as whole mPa; None where they are no tare: numbers, each a pressure that there is in air."""
    if not isinstance(tare_pa, (list, tuple)) or len(tare_pa) != 4:
        return None
    if not all([isinstance(p, (int, float)) and _LOWEST_PA < p < _HIGHEST_PA for p in tare_pa]):
        return None
    return [int(p * 1000 + 0.5) for p in tare_pa]


class Tare:
    """The zero of the four sensors, what they read in air, before each dive: medians of 2 s, or None.

    Made on the host's order, with the motors off: the one place that may take memory as it goes.
    """

    def __init__(self):
        self._rows = [[], [], [], []]

    def step(self, pressure_mPa):
        """Take one reading; True once there are enough."""
        for k in range(4):
            self._rows[k].append(pressure_mPa[k])
        return len(self._rows[0]) >= _SAMPLES

    def result(self):
        """The four medians in mPa, or None where the readings spread or disagree too much."""
        rows = [sorted(row) for row in self._rows]
        medians = [row[len(row) // 2] for row in rows]
        spread = max([row[-1] - row[0] for row in rows])
        if spread > _SPREAD_mPa or max(medians) - min(medians) > _DISAGREE_mPa:
            return None
        return medians
