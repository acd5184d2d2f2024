# What goes over the tether, both ways: frames, what their payloads are made of, and nothing that does I/O.
# Board, firmware on the host and host driver import this same file. Fields and texts, which only people and the host
# need, are in wire.py: on the board every name takes memory.
#
#   frame = COBS( type u8 | seq u8 | payload, little-endian struct | crc32 u32 over type..payload ) 0x00
#
# COBS (Cheshire and Baker, 1999) keeps 0x00 for the end of a frame, so a reader is in step again at the next one.
import binascii
import micropython
import struct
from micropython import const

# Of wire.TABLE, by version of the protocol: two ends that disagree on any field never arm
SCHEMA_CRC = (0, 0xA725AA30, 0x9345DAF7, 0xDFDC3BD1)

_MAX_PLAIN = const(95)  # bytes of a frame before COBS
_MAX_STUFFED = const(97)  # the same after COBS, without the closing zero
_MAX_TEXT = const(48)  # bytes of a LOG line
_LOG = const(0x04)
_RESIDUE = const(0x2144DF1C)  # CRC-32 of anything with its own CRC-32 behind it

# Payloads by type. LOG alone has a tail: its text in UTF-8. TELEM and TELEM_1, which the board builds by hand, are in
# wire.py.
FORMAT = {
    0x02: "<IHHhHIIHHBB",  # STATUS
    0x03: "<IBBBBhH",  # EVENT
    _LOG: "<B",
    0x10: "<hhhhhh4HHHHI",  # SETPOINT
    0x20: "<HII",  # HELLO
    0x21: "<HI8s12sIBBIHH",  # HELLO_ACK
    0x30: "<HBBI",  # ACK
    0x31: "<HI",  # ARM
    0x32: "<HI",  # DISARM
    0x33: "<HIBB",  # MODE
    0x34: "<HIH",  # PARAM_GET
    0x35: "<HIHBBf",  # PARAM_SET
    0x36: "<HIHBBf",  # PARAM_VALUE
    0x37: "<HI",  # PARAM_LIST
    0x38: "<HI",  # PARAM_SAVE
    0x39: "<HIh",  # TARE
    0x3A: "<HII",  # REBOOT
    0x3B: "<HI",  # ESTOP
}


@micropython.viper
def stuff(plain: ptr8, n: int, out: ptr8) -> int:
    """COBS of the first n bytes of `plain` into `out`, without the closing zero; returns the length."""
    code_at = 0
    code = 1
    w = 1
    i = 0
    while i < n:
        byte = plain[i]
        i += 1
        if byte:
            out[w] = byte
            w += 1
            code += 1
        if byte == 0 or (code == 255 and i < n):
            out[code_at] = code
            code_at = w
            code = 1
            w += 1
    out[code_at] = code
    return w


@micropython.viper
def unstuff(buf: ptr8, n: int) -> int:
    """Undo COBS in place on the first n bytes of `buf`; returns the length, or -1 if it is no COBS."""
    r = 0
    w = 0
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


@micropython.viper
def gather(chunk: ptr8, i: int, n: int, buf: ptr8, at: int, room: int) -> int:
    """Copy chunk[i:n] to buf[at:room], as far as the next zero; returns where that is, or n where there is none."""
    while i < n:
        byte = chunk[i]
        if byte == 0:
            return i
        if at < room:
            buf[at] = byte
            at += 1
        i += 1
    return n


class Writer:
    """Builds frames in one buffer of its own and numbers them."""

    def __init__(self):
        self.seq = 0  # of the next frame
        self.plain = bytearray(_MAX_PLAIN + 1)  # type, seq, payload from byte 2 on, crc; whole words
        self._out = bytearray(_MAX_STUFFED + 1)
        # Views as long as they were needed last: a slice takes memory, and mostly the same frame comes again.
        self._checked = self._shown = b""

    def frame(self, kind, *fields):
        """One frame with its closing zero, as a view that is valid until the next call."""
        struct.pack_into(FORMAT[kind], self.plain, 2, *fields)
        return self.close(kind, 2 + struct.calcsize(FORMAT[kind]))

    def log(self, level, text):
        """A LOG frame; text (bytes) is cut to 48."""
        text = text[:_MAX_TEXT]
        self.plain[2] = level
        self.plain[3 : 3 + len(text)] = text
        return self.close(_LOG, 3 + len(text))

    def close(self, kind, n):
        """The frame whose payload stands in plain[2:n]."""
        plain, out = self.plain, self._out
        plain[0] = kind
        plain[1] = self.seq
        self.seq = (self.seq + 1) & 0xFF
        if len(self._checked) != n:
            self._checked = memoryview(plain)[:n]
        struct.pack_into("<I", plain, n, binascii.crc32(self._checked))
        n = stuff(plain, n + 4, out) + 1
        out[n - 1] = 0
        if len(self._shown) != n:
            self._shown = memoryview(out)[:n]
        return self._shown


class Framer:
    """Bytes in, whole frames out. Garbage is counted, never raised."""

    def __init__(self, on_frame):
        """on_frame(type, seq, payload): the payload is a view that is valid during the call only."""
        self.on_frame = on_frame
        self.rx_ok = 0
        self.rx_bad = 0
        self._buf = bytearray(_MAX_STUFFED)
        self._n = 0
        self._checked = self._payload = b""  # views as long as they were needed last

    def feed(self, chunk, n):
        """Take the first n bytes of `chunk`."""
        buf, at, i = self._buf, self._n, 0
        while i < n:
            end = gather(chunk, i, n, buf, at, _MAX_STUFFED)
            at += end - i
            if end < n and at:
                self._close(at)
                at = 0
            i = end + 1
        self._n = min(at, _MAX_STUFFED + 1)

    def _close(self, at):
        n = unstuff(self._buf, at) if at <= _MAX_STUFFED else -1
        if n < 6 or not self._known(n - 6):
            self.rx_bad += 1
            return
        if len(self._checked) != n:
            self._checked = memoryview(self._buf)[:n]
            self._payload = self._checked[2 : n - 4]
        if binascii.crc32(self._checked) != _RESIDUE:
            self.rx_bad += 1
            return
        self.rx_ok += 1
        self.on_frame(self._buf[0], self._buf[1], self._payload)

    def _known(self, size):
        kind = self._buf[0]
        if kind == _LOG:
            return 1 <= size <= 1 + _MAX_TEXT
        return kind in FORMAT and struct.calcsize(FORMAT[kind]) == size
