# What the frames of frames.py mean: messages, fields and texts, and the checksum that both ends compare.
# For computers. The board holds the checksum as a number, and of the numbers those that it needs.
# ruff: noqa: F403, F405 - all that frames.py shows is shown here too
import binascii
import struct

try:
    from .frames import *
    from .parameters import TABLE as TABLE_OF_PARAMETERS
except ImportError:  # beside it, as on a board
    from frames import *
    from parameters import TABLE as TABLE_OF_PARAMETERS

# The newest; 1 has no yaw rate, 2 fewer parameters, and both tell the host's clock in ms, 3 in tenths of a second.
PROTOCOL = 3
OLDEST = 1
MAX_PLAIN = 95  # bytes of a frame before COBS
MAX_STUFFED = 97  # the same after COBS, without the closing zero
MAX_TEXT = 48  # bytes of a LOG line
OVERHEAD = 6  # type, seq, crc

TELEM_1, STATUS, EVENT, LOG = 0x01, 0x02, 0x03, 0x04
TELEM = 0x05  # in place of TELEM_1 since version 2
FORMAT[TELEM_1] = "<IBBH4ihhh3h8H4HHHBBBBH"
FORMAT[TELEM] = FORMAT[TELEM_1] + "h"
SETPOINT = 0x10
HELLO, HELLO_ACK = 0x20, 0x21
ACK, ARM, DISARM, MODE = 0x30, 0x31, 0x32, 0x33
PARAM_GET, PARAM_SET, PARAM_VALUE, PARAM_LIST, PARAM_SAVE = 0x34, 0x35, 0x36, 0x37, 0x38
TARE, REBOOT, ESTOP = 0x39, 0x3A, 0x3B

# type, name, fields with their units; "x4" repeats a field. LOG alone has a tail: its text in UTF-8.
_MEASURED = (
    "t_us state ladder flags zeta_dPa_x4 roll_cdeg pitch_cdeg depth_100um disturbance_mN_100uNm_x3 pulse_us_x8 "
    "servo_us_x4 light_permille battery_mV saturated sensors_bad set_point_seq parameters_dirty loop_us"
)
_FIELDS = (
    (TELEM_1, "TELEM_1", _MEASURED),
    (TELEM, "TELEM", _MEASURED + " yaw_rate_cdeg_s"),
    (
        STATUS,
        "STATUS",
        "t_us battery_mV current_10mA temperature_cC loop_max_us rx_ok rx_bad heap_free_16B late reset_cause leak",
    ),
    (EVENT, "EVENT", "t_us code from to severity arg count"),
    (LOG, "LOG", "level"),
    (
        SETPOINT,
        "SETPOINT",
        "depth_100um roll_cdeg pitch_cdeg fx_mN fy_mN mz_100uNm servo_us_x4 light_permille valid ttl_ms host_time",
    ),
    (HELLO, "HELLO", "protocol schema_crc host_boot"),
    (
        HELLO_ACK,
        "HELLO_ACK",
        "protocol schema_crc build uid boot_id reset_cause state parameter_crc parameters capabilities",
    ),
    (ACK, "ACK", "req_id type result boot_id"),
    (ARM, "ARM", "req_id boot_id"),
    (DISARM, "DISARM", "req_id boot_id"),
    (MODE, "MODE", "req_id boot_id mode thruster"),
    (PARAM_GET, "PARAM_GET", "req_id boot_id id"),
    (PARAM_SET, "PARAM_SET", "req_id boot_id id type flags value"),
    (PARAM_VALUE, "PARAM_VALUE", "req_id boot_id id type flags value"),
    (PARAM_LIST, "PARAM_LIST", "req_id boot_id"),
    (PARAM_SAVE, "PARAM_SAVE", "req_id boot_id"),
    (TARE, "TARE", "req_id boot_id depth_mm"),
    (REBOOT, "REBOOT", "req_id boot_id magic"),
    (ESTOP, "ESTOP", "req_id boot_id"),
)

TABLE = tuple([(kind, name, FORMAT[kind], fields) for kind, name, fields in _FIELDS])
SIZE = {kind: struct.calcsize(FORMAT[kind]) for kind in FORMAT}

# Pressure of one metre of fresh water at 20 C, 998.2 kg/m3 x 9.80665 m/s2. Both ends convert with this number.
PA_PER_M = 9789.0

DISARMED, ARMED = 0, 1  # TELEM state

# Bits of TELEM's flags
FLAG_HELLO, FLAG_DEGRADED, FLAG_TARED, FLAG_LEAK, FLAG_BATTERY, FLAG_FRESH = 1, 2, 4, 8, 16, 32
FLAG_FOUND = 128  # it surfaces, or has stopped, for something that the board found: a person has to look
FLAG_KILLED = 64  # the kill switch's loop is open, or was, and nobody has armed since: no thruster has pulses
MODE_SHIFT = 8  # two bits of the flags: the mode

# MODE: keep depth and level; keep level, no vertical thrust; go up and stop there; turn one thruster, law off
HOLD, STABILISE, SURFACE, BENCH = 0, 1, 2, 3

UNSAVED = 1  # PARAM_VALUE flags: it is not what is in flash

REBOOT_MAGIC = 0xB007B007  # a flipped bit in another command shall not restart a robot
PROMPT_MAGIC = 0xB0070EE1  # REBOOT with this one ends at MicroPython's prompt, on the tether (boot.py)

# HELLO_ACK capabilities, and reset causes as MicroPython's machine module numbers them on an STM32; 5 is ours
CAN_WATCHDOG, CAN_CURRENT, CAN_LEAK, CAN_KILL, SIMULATED = 1, 2, 4, 8, 16
CAN_VERSION_2 = 32  # who greets in it is told the yaw rate; a board of version 1 knows no such bit
CAN_VERSION_3 = 64
PARAMETER_COUNTS = {
    1: 20,
    2: 20,
    3: len(TABLE_OF_PARAMETERS),
}  # how many there are, by version; new ones stand at the end
NO_RATE = -32768  # TELEM yaw_rate_cdeg_s: no gyro, or it does not answer
POWER_ON, BY_PIN, BY_WATCHDOG, BY_ORDER = 1, 2, 3, 5

# SETPOINT valid bits: a part whose bit is clear keeps what was last set
VALID_DEPTH, VALID_ATTITUDE, VALID_FORCE, VALID_SERVO, VALID_LIGHT = 1, 2, 4, 8, 16
VALID_ALL = 31

# ACK results; RUNNING: begun, repeat the request until it brings another result
OK, REFUSED, UNKNOWN, STALE_BOOT, BUSY, RANGE, RUNNING = 0, 1, 2, 3, 4, 5, 6
RESULTS = ("ok", "refused", "unknown", "stale boot", "busy", "out of range", "running")

# EVENT codes; arg is an index of REASONS, for a refusal the bit mask of ARM_CHECKS that failed
EV_BOOT, EV_ARMED, EV_DISARMED, EV_LADDER, EV_ARM_REFUSED = 1, 2, 3, 4, 5
INFO, WARNING, ERROR = 0, 1, 2  # severity of an EVENT, level of a LOG

REASONS = (
    "none",
    "order",
    "host silent",
    "leak",
    "battery low",
    "sensors disagree",
    "surfaced",
    "surfacing took too long",
    "tilted",
    "two sensors bad",
    "emergency stop",
    "parameters unreadable",
    "watchdog",
    "control fault",
    "kill switch",
    "not holding: all thrust is spent on it",
    "overturned",
    "attitude contradicts the thrust that it takes",
    "T1 gives little or nothing",
    "T2 gives little or nothing",
    "T3 gives little or nothing",
    "T4 gives little or nothing",
    "T1 pushes the wrong way",
    "T2 pushes the wrong way",
    "T3 pushes the wrong way",
    "T4 pushes the wrong way",
    "T1 and T2 are crossed",
    "T2 and T3 are crossed",
    "T3 and T4 are crossed",
    "T4 and T1 are crossed",
    "neighbouring sensors are crossed",
    "sensors stand still",
    "a sensor is bad",
)

ARM_CHECKS = (
    "no handshake",
    "sensors not all good",
    "sensors disagree",
    "no tare in air",
    "tilted",
    "battery low",
    "leak",
    "set-point not neutral",
    "set-point old",
    "ESC neutral for less than 3 s",
    "fault latched",
    "control cycle too slow",
    "tare older than 12 h",
    "kill switch open",
    "wiring not checked: `aucamp board check`",
    "upside down",
)


def schema_crc(protocol=PROTOCOL):
    """CRC-32 of the message table of that version, which frames.SCHEMA_CRC has to be; since version 3 also of names and
    types of the parameters, in their order."""
    rows = TABLE
    if protocol == 1:  # whose one telemetry had this name
        rows = [(row[0], "TELEM") + row[2:] if row[0] == TELEM_1 else row for row in TABLE if row[0] != TELEM]
    if protocol < 3:  # where the host's clock counted ms
        rows = [row[:3] + (row[3].replace("host_time", "host_ms"),) for row in rows]
    text = "\n".join(["%02x %s %s %s" % row for row in rows])
    if protocol >= 3:
        text += "\n" + " ".join(["%s %d" % (row[0], row[4]) for row in TABLE_OF_PARAMETERS])
    return binascii.crc32(text.encode())


def fixed(value, scale, low=-32768, high=32767):
    """value * scale as an integer of the wire, clipped; what is not a number becomes 0."""
    if value != value:
        return 0
    scaled = value * scale
    return high if scaled >= high else low if scaled <= low else int(round(scaled))


def unpack(kind, payload):
    """The fields of a payload in the order of the table; of a LOG its level and its text."""
    if kind == LOG:
        return payload[0], bytes(payload[1:])
    return struct.unpack(FORMAT[kind], payload)
