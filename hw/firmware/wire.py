# What goes over the tether, both ways: frames, the table of messages, and nothing that does I/O.
# Board, firmware on the host and host driver import this same file: MicroPython has neither typing nor enum.
#
#   frame = COBS( type u8 | seq u8 | payload, little-endian struct | crc32 u32 over type..payload ) 0x00
#
# COBS (Cheshire and Baker, 1999) keeps 0x00 for the end of a frame, so a reader is in step again at the next one.
import binascii
import struct

PROTOCOL = 1
MAX_PLAIN = 255  # bytes of a frame before COBS
MAX_STUFFED = 257  # the same after COBS, without the closing zero
MAX_TEXT = 48  # bytes of a LOG line
OVERHEAD = 6  # type, seq, crc

# Pressure of one metre of fresh water at 20 C, 998.2 kg/m3 x 9.80665 m/s2. Both ends convert with this number.
PA_PER_M = 9789.0

TELEM, STATUS, EVENT, LOG = 0x01, 0x02, 0x03, 0x04
SETPOINT = 0x10
HELLO, HELLO_ACK = 0x20, 0x21
ACK, ARM, DISARM, MODE = 0x30, 0x31, 0x32, 0x33
PARAM_GET, PARAM_SET, PARAM_VALUE, PARAM_LIST, PARAM_SAVE = 0x34, 0x35, 0x36, 0x37, 0x38
TARE, REBOOT, ESTOP = 0x39, 0x3A, 0x3B

# type, name, payload, fields with their units; "x4" repeats a field. LOG alone has a tail: its text in UTF-8.
TABLE = (
    (
        TELEM,
        "TELEM",
        "<IBBH4ihhh3h8H4HHHBBBBH",
        "t_us state ladder flags zeta_dPa_x4 roll_cdeg pitch_cdeg depth_100um disturbance_mN_100uNm_x3 pulse_us_x8 "
        "servo_us_x4 light_permille battery_mV saturated sensors_bad set_point_seq parameters_dirty loop_us",
    ),
    (
        STATUS,
        "STATUS",
        "<IHHhHHIIHBB",
        "t_us battery_mV current_10mA temperature_cC loop_max_us gc_max_us rx_ok rx_bad heap_free_16B reset_cause leak",
    ),
    (EVENT, "EVENT", "<IBBBBhH", "t_us code from to severity arg count"),
    (LOG, "LOG", "<B", "level"),
    (
        SETPOINT,
        "SETPOINT",
        "<hhhhhh4HHHHI",
        "depth_100um roll_cdeg pitch_cdeg fx_mN fy_mN mz_100uNm servo_us_x4 light_permille valid ttl_ms host_ms",
    ),
    (HELLO, "HELLO", "<HII", "protocol schema_crc host_boot"),
    (
        HELLO_ACK,
        "HELLO_ACK",
        "<HI8s12sIBBIHH",
        "protocol schema_crc build uid boot_id reset_cause state parameter_crc parameters capabilities",
    ),
    (ACK, "ACK", "<HBBI", "req_id type result boot_id"),
    (ARM, "ARM", "<HI", "req_id boot_id"),
    (DISARM, "DISARM", "<HI", "req_id boot_id"),
    (MODE, "MODE", "<HIBB", "req_id boot_id mode thruster"),
    (PARAM_GET, "PARAM_GET", "<HIH", "req_id boot_id id"),
    (PARAM_SET, "PARAM_SET", "<HIHBBf", "req_id boot_id id type flags value"),
    (PARAM_VALUE, "PARAM_VALUE", "<HIHBBf", "req_id boot_id id type flags value"),
    (PARAM_LIST, "PARAM_LIST", "<HI", "req_id boot_id"),
    (PARAM_SAVE, "PARAM_SAVE", "<HI", "req_id boot_id"),
    (TARE, "TARE", "<HIh", "req_id boot_id depth_mm"),
    (REBOOT, "REBOOT", "<HII", "req_id boot_id magic"),
    (ESTOP, "ESTOP", "<HI", "req_id boot_id"),
)

FORMAT = {row[0]: row[2] for row in TABLE}
SIZE = {row[0]: struct.calcsize(row[2]) for row in TABLE}

# TELEM state, and bits of its flags
DISARMED, ARMED = 0, 1
FLAG_HELLO, FLAG_DEGRADED, FLAG_TARED, FLAG_LEAK, FLAG_BATTERY, FLAG_FRESH = 1, 2, 4, 8, 16, 32
MODE_SHIFT = 8  # two bits of the flags: the mode

# MODE: keep depth and level; keep level, no vertical thrust; go up and stop there; turn one thruster, law off
HOLD, STABILISE, SURFACE, BENCH = 0, 1, 2, 3

UNSAVED = 1  # PARAM_VALUE flags: it is not what is in flash

REBOOT_MAGIC = 0xB007B007  # a flipped bit in another command shall not restart a robot

# HELLO_ACK capabilities, and reset causes as MicroPython's machine module numbers them on an STM32
CAN_WATCHDOG, CAN_CURRENT, CAN_LEAK, CAN_KILL, SIMULATED = 1, 2, 4, 8, 16
POWER_ON, BY_PIN, BY_WATCHDOG, BY_ORDER = 1, 2, 3, 5

# SETPOINT valid bits: a part whose bit is clear keeps what was last set
VALID_DEPTH, VALID_ATTITUDE, VALID_FORCE, VALID_SERVO, VALID_LIGHT = 1, 2, 4, 8, 16
VALID_ALL = 31

# ACK results; RUNNING: begun, repeat the request until it brings another result
OK, REFUSED, UNKNOWN, STALE_BOOT, BUSY, RANGE, RUNNING = 0, 1, 2, 3, 4, 5, 6
RESULTS = ("ok", "refused", "unknown", "stale boot", "busy", "out of range", "running")

# EVENT codes; arg is an index of REASONS, for an arming refusal the bit mask of ARM_CHECKS that failed
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
)


def schema_crc():
    """CRC-32 of the message table: two ends that disagree on any field never arm."""
    text = "\n".join(["%02x %s %s %s" % row for row in TABLE])
    return binascii.crc32(text.encode())


def fixed(value, scale, low=-32768, high=32767):
    """value * scale as an integer of the wire, clipped; what is not a number becomes 0."""
    if value != value:
        return 0
    scaled = value * scale
    return high if scaled >= high else low if scaled <= low else int(round(scaled))


def stuff(plain, n, out):
    """COBS of the first n bytes of `plain` into `out`, without the closing zero; returns the length."""
    code_at = 0
    code = w = 1
    for i in range(n):
        byte = plain[i]
        if byte:
            out[w] = byte
            w += 1
            code += 1
        if not byte or (code == 255 and i + 1 < n):
            out[code_at] = code
            code_at = w
            code = 1
            w += 1
    out[code_at] = code
    return w


def unstuff(buf, n):
    """Undo COBS in place on the first n bytes of `buf`; returns the length, or -1 if it is no COBS."""
    r = w = 0
    while r < n:
        code = buf[r]
        end = r + code
        if code == 0 or end > n:
            return -1
        r += 1
        while r < end:
            buf[w] = buf[r]
            w += 1
            r += 1
        if code < 255 and r < n:
            buf[w] = 0
            w += 1
    return w


def unpack(kind, payload):
    """The fields of a payload in the order of the table; of a LOG its level and its text."""
    if kind == LOG:
        return payload[0], bytes(payload[1:])
    return struct.unpack(FORMAT[kind], payload)


class Writer:
    """Builds frames in one buffer of its own and numbers them."""

    def __init__(self):
        self.seq = 0  # of the next frame
        self._plain = bytearray(MAX_PLAIN)
        self._out = bytearray(MAX_STUFFED + 1)
        self._plain_view = memoryview(self._plain)
        self._out_view = memoryview(self._out)

    def frame(self, kind, *fields):
        """One frame with its closing zero, as a view that is valid until the next call."""
        struct.pack_into(FORMAT[kind], self._plain, 2, *fields)
        return self._close(kind, 2 + SIZE[kind])

    def log(self, level, text):
        """A LOG frame; text (bytes) is cut to MAX_TEXT."""
        text = text[:MAX_TEXT]
        self._plain[2] = level
        self._plain[3 : 3 + len(text)] = text
        return self._close(LOG, 3 + len(text))

    def _close(self, kind, n):
        self._plain[0] = kind
        self._plain[1] = self.seq
        self.seq = (self.seq + 1) & 0xFF
        struct.pack_into("<I", self._plain, n, binascii.crc32(self._plain_view[:n]))
        w = stuff(self._plain, n + 4, self._out)
        self._out[w] = 0
        return self._out_view[: w + 1]


class Framer:
    """Bytes in, whole frames out. Garbage is counted, never raised."""

    def __init__(self, on_frame):
        """on_frame(type, seq, payload): the payload is a view that is valid during the call only."""
        self.on_frame = on_frame
        self.rx_ok = 0
        self.rx_bad = 0
        self._buf = bytearray(MAX_STUFFED)
        self._view = memoryview(self._buf)
        self._n = 0

    def feed(self, chunk, n):
        """Take the first n bytes of `chunk`."""
        buf = self._buf
        at = self._n
        for i in range(n):
            byte = chunk[i]
            if byte:
                if at < MAX_STUFFED:
                    buf[at] = byte
                at = min(at + 1, MAX_STUFFED + 1)
            elif at:
                self._close(at)
                at = 0
        self._n = at

    def _close(self, at):
        n = unstuff(self._buf, at) - 4 if at <= MAX_STUFFED else -1
        if n < 2 or not self._known(n) or struct.unpack_from("<I", self._buf, n)[0] != binascii.crc32(self._view[:n]):
            self.rx_bad += 1
            return
        self.rx_ok += 1
        self.on_frame(self._buf[0], self._buf[1], self._view[2:n])

    def _known(self, n):
        kind = self._buf[0]
        size = SIZE.get(kind, -1)
        return n - 2 == size or (kind == LOG and 1 <= n - 2 <= 1 + MAX_TEXT)
