# Sensors' readings on whichever interpreter runs this: check_sensors.py FIRMWARE_DIR < ROWS
#
# A row: JSON of [seven words of a PROM, raw temperature, raw pressure]. Prints the check sum, hundredths of a degree,
# mPa, and which sensors had a reading: the second of four.
# ruff: noqa: T201 - MicroPython has no pathlib
import json
import sys
from array import array

sys.path.insert(0, sys.argv[1])
import ms5837

scale, raw, mPa = array("i", [0] * 12), bytearray(12), [0] * 4
for line in sys.stdin:
    words, d2, d1 = json.loads(line)
    prom = bytearray(16)
    for i in range(7):
        prom[2 * i], prom[2 * i + 1] = words[i] >> 8, words[i] & 255
    raw[3], raw[4], raw[5] = d1 >> 16, d1 >> 8 & 255, d1 & 255
    celsius = ms5837.temperature(words, d2, scale, 3)
    answered = ms5837.pressures(raw, scale, 0b1010, mPa)
    print(ms5837.check_sum(prom[0] & 15, prom), celsius, mPa[1], answered)
