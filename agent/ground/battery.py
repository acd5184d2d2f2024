"""When a robot's battery is called low by whoever looks, in volts at its control module.

Both limits are others' own, those of four cells: below the one lamps stay dark, below the other the module surfaces. A
module whose parameter `battery_min_mV` was changed surfaces by that one, which nobody here is told.
"""

from __future__ import annotations

from agent.capabilities.light.allocate import EMPTY_V
from hw.firmware.parameters import NAMES, TABLE

NEAR_V = EMPTY_V
SURFACES_V = TABLE[NAMES.index("battery_min_mV")][1] * 1e-3
