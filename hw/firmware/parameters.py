# What a robot can be told about itself: one table for board and host. The row's number is the parameter's id.
import binascii
import struct

REAL, WHOLE = 0, 1  # type of a PARAM_VALUE; on the wire all are float32

# name, unit, default, lowest, highest, type, what it is
TABLE = (
    ("law", "", 2, 0, 2, WHOLE, "0 pi, 1 pid, 2 observer"),
    ("pid_set", "", 0, 0, 1, WHOLE, "gains of pid: 0 for thrusters of 10 N and 0.10 s, 1 for 5 N and 0.15 s"),
    ("heave_kg", "kg", 8.0, 1.0, 100.0, REAL, "mass with the water that moves along"),
    ("tilt_kgm2", "kg m2", 0.075, 0.005, 10.0, REAL, "moment of inertia in roll and pitch, with the water"),
    ("lag_s", "s", 0.10, 0.02, 0.40, REAL, "first-order lag of a thruster with its ESC"),
    ("thrust_max_N", "N", 10.0, 1.0, 60.0, REAL, "of one thruster, forward, at 1900 us and curve_battery_mV"),
    ("net_weight_N", "N", 0.0, -30.0, 30.0, REAL, "weight less buoyancy; a robot that sinks has it positive"),
    ("water_kg_m3", "kg/m3", 998.2, 990.0, 1040.0, REAL, "998.2 fresh at 20 C, 1025 sea"),
    ("curve_battery_mV", "mV", 14800, 6000, 26000, WHOLE, "battery at which thrust_max_N was found"),
    ("battery_min_mV", "mV", 12000, 0, 26000, WHOLE, "below it the robot surfaces; 3.0 V a cell of four"),
    ("slew_N", "N", 2.0, 0.1, 120.0, REAL, "largest change of a thruster's force in one cycle of 10 ms"),
) + tuple([("zero_%d_us" % k, "us", 1500, 1400, 1600, WHOLE, "neutral pulse of T%d" % k) for k in range(1, 9)])

NAMES = [row[0] for row in TABLE]
IDS = {row[0]: i for i, row in enumerate(TABLE)}
LAWS = ("pi", "pid", "observer")


def in_range(i, value):
    """Whether parameter i can have this value: a number within its bounds, whole where it has to be."""
    _, _, _, lowest, highest, kind, _ = TABLE[i]
    return lowest <= value <= highest and (kind == REAL or value == int(value))


def crc(values):
    """CRC-32 of all values as they go over the wire, for HELLO_ACK."""
    return binascii.crc32(struct.pack("<%df" % len(TABLE), *values))


def from_flash(flash):
    """All values, in the order of the table: those of the flash by name, else the default; `law` may be a name.

    Raises ValueError that says which entry cannot be, short enough for a LOG line.
    """
    values = []
    for i, (name, _, default, lowest, highest, _, _) in enumerate(TABLE):
        value = flash.get(name, default)
        if name == "law" and value in LAWS:
            value = LAWS.index(value)
        if not isinstance(value, (int, float)) or not in_range(i, value):
            choice = " ".join(LAWS) if name == "law" else "%g to %g" % (lowest, highest)
            raise ValueError("flash: %s = %s; write %s" % (name, value, choice))
        values.append(float(value))
    return values


def into_flash(values, flash):
    """Write all values into the table that goes to flash."""
    for i, name in enumerate(NAMES):
        flash[name] = LAWS[int(values[i])] if name == "law" else values[i]
