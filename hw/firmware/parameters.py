# What a robot can be told about itself: one table for board and host. The row's number is the parameter's id.
# Units and what each one is: hw/stm32/driver.py, for on the board every text takes memory.
import binascii
import struct
from micropython import const

REAL, WHOLE = const(0), const(1)  # type of a PARAM_VALUE; on the wire all are float32

# name, default, lowest, highest, type
TABLE = (
    ("law", 2, 0, 2, WHOLE),
    ("pid_set", 0, 0, 1, WHOLE),
    ("heave_kg", 8, 1, 100, REAL),
    ("tilt_kgm2", 0.075, 0.005, 10, REAL),
    ("lag_s", 0.1, 0.02, 0.4, REAL),
    ("thrust_max_N", 10, 1, 60, REAL),
    ("net_weight_N", 0, -30, 30, REAL),
    ("water_kg_m3", 998.2, 990, 1040, REAL),
    ("curve_battery_mV", 14800, 6000, 26000, WHOLE),
    ("battery_min_mV", 12000, 0, 26000, WHOLE),
    ("slew_N", 2, 0.1, 120, REAL),
)
TABLE += tuple([("zero_%d_us" % j, 1500, 1400, 1600, WHOLE) for j in range(1, 9)])
TABLE += (
    ("pulse_frame_us", 5000, 2500, 20000, WHOLE),
    # From here on since version 3 of the protocol
    ("nudge_s", 1, 0, 60, REAL),
    ("wiring", 0, 0, 65535, WHOLE),
)

NAMES = [row[0] for row in TABLE]
LAWS = ("pi", "pid", "observer")


def in_range(i, value):
    """Whether parameter i can have this value: a number within its bounds, whole where it has to be."""
    _, _, lowest, highest, kind = TABLE[i]
    return lowest <= value <= highest and (kind == REAL or value == int(value))


def of_type(i, value):
    """A value of parameter i as it is kept: whole numbers take no memory."""
    return float(value) if TABLE[i][4] == REAL else int(value)


def crc(values):
    """CRC-32 of all values as they go over the wire, for HELLO_ACK."""
    return binascii.crc32(struct.pack("<%df" % len(TABLE), *values))


def from_flash(flash):
    """All values, in the order of the table: those of the flash by name, else the default; `law` may be a name.

    Raises ValueError that says which entry cannot be, short enough for a LOG line.
    """
    values = []
    for i, (name, default, lowest, highest, _) in enumerate(TABLE):
        value = flash.get(name, default)
        if name == "law" and value in LAWS:
            value = LAWS.index(value)
        if not isinstance(value, (int, float)) or not in_range(i, value):
            choice = " ".join(LAWS) if name == "law" else "%g to %g" % (lowest, highest)
            raise ValueError("flash: %s = %s; write %s" % (name, value, choice))
        values.append(of_type(i, value))
    return values


def into_flash(values, flash):
    """Write all values into the table that goes to flash."""
    for i, name in enumerate(NAMES):
        flash[name] = LAWS[int(values[i])] if name == "law" else values[i]
