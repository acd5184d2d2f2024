# The zero of the four pressure sensors: what they read in air, found before each dive and kept in flash.
from micropython import const

_LOWEST_PA = const(30000)  # what the sensors can say, see pressure.py
_HIGHEST_PA = const(120000)
_SAMPLES = const(200)  # 2 s
_SPREAD_mPa = const(200000)  # 2 mbar: more is handling, splashing, or a sensor that is not well
_DISAGREE_mPa = const(490000)  # 5 cm of water between two sensors in the same air


def whole(tare_pa):
    """Four pressures in Pa as whole mPa; None where they are no tare: numbers, each a pressure that there is in air."""
    if not isinstance(tare_pa, (list, tuple)) or len(tare_pa) != 4:
        return None
    if not all([isinstance(p, (int, float)) and _LOWEST_PA < p < _HIGHEST_PA for p in tare_pa]):
        return None
    return [int(p * 1000 + 0.5) for p in tare_pa]


class Tare:
    """Medians of 2 s, or None.

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
