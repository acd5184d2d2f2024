# The conversation with the host: frames in, frames out. What an order does is in orders.py.
import micropython
import struct
from micropython import const

import failsafe
import frames
import orders

# Of wire.py, whose numbers these are
_ERROR = const(2)
_PROTOCOL = const(3)
_OLD_PARAMETERS = const(20)  # of versions 1 and 2
_TELEM_1 = const(0x01)
_TELEM = const(0x05)
_STATUS = const(0x02)
_EVENT = const(0x03)
_SETPOINT = const(0x10)
_HELLO = const(0x20)
_HELLO_ACK = const(0x21)
_ARM = const(0x31)  # the first of the orders, and the last; between them is one of ours
_PARAM_VALUE = const(0x36)
_ESTOP = const(0x3B)
_FLAG_HELLO = const(1)
_FLAG_DEGRADED = const(2)
_FLAG_TARED = const(4)
_FLAG_LEAK = const(8)
_FLAG_BATTERY = const(16)
_FLAG_FRESH = const(32)
_FLAG_KILLED = const(64)
_FLAG_FOUND = const(128)
_MODE_SHIFT = const(8)
_HOLD_AFTER_US = const(500000)  # of failsafe.py
_VALID_DEPTH = const(1)
_VALID_ATTITUDE = const(2)
_VALID_FORCE = const(4)
_VALID_SERVO = const(8)
_VALID_LIGHT = const(16)

_BUILD = const(b"aucamp06")
_TELEM_1_END = const(72)  # of the payload in the frame; behind it the yaw rate
_RX_BYTES = const(128)  # in a cycle: three set-points; what is more waits in the port
_EVENT_COPIES = const(3)  # events are not acknowledged
_FAULT_AGAIN_US = const(1000000)  # between two lines about faults: they may come with every frame
_SERVO_LOWEST_US = const(500)  # hw/README.md; a pulse beyond these is no servo's
_SERVO_HIGHEST_US = const(2500)
_U16 = const(0xFFFF)  # the longest cycle that the wire can tell, and the most memory


@micropython.viper
def write_telemetry(frame, head, zeta_100nm, pulses_us, servos_us):
    """The payload of a TELEM, from byte 2 on, as 35 words: struct would take four times as long.

    head: t_us (low and high word), state and ladder, flags; roll, pitch, depth, three disturbances; light, battery,
    saturated and bad sensors, set-point and dirty, loop_us. 100 nm of water are 41058 / 2**22 dPa; 21 m fit 2**31.
    """
    words = ptr16(frame)
    i = 0
    while i < 8:
        if i < 4:
            z = int(zeta_100nm[i])
            z = ((z >> 12) * 41058 + ((z & 4095) * 41058 >> 12) + 512) >> 10
            words[5 + 2 * i] = z & 0xFFFF
            words[6 + 2 * i] = z >> 16 & 0xFFFF
            words[1 + i] = int(head[i]) & 0xFFFF
            words[27 + i] = int(servos_us[i]) & 0xFFFF
        if i < 6:
            words[13 + i] = int(head[4 + i]) & 0xFFFF
        if i < 5:
            words[31 + i] = int(head[10 + i]) & 0xFFFF
        words[19 + i] = int(pulses_us[i]) & 0xFFFF
        i += 1


@micropython.viper
def read_set_point(payload, out):
    """The payload of a SETPOINT as 15 numbers: six with a sign, nine without, of which two are the host's clock."""
    words = ptr16(payload)
    i = 0
    while i < 15:
        word = words[i] & 0xFFFF
        if i < 6 and word > 32767:
            word -= 65536
        out[i] = word
        i += 1


class Tether:
    """Both directions of the line. Its buffers are made here, once."""

    def __init__(self, hal, control, boot_info):
        self._hal = hal
        self._control = control
        self.orders = orders.Orders(hal, control, self)
        self._uid, self.boot_id, self.reset_cause = boot_info
        self._writer = frames.Writer()
        self._framer = frames.Framer(self._on_frame)
        self._rx = bytearray(_RX_BYTES)
        self._words = [0] * 15  # of a set-point, or of telemetry
        self._host_boot, self.hello = None, False
        self._protocol = 1  # the host's, where this board speaks it
        self._events, self._event_count = [], 0  # [copies left, fields]
        self._logs, self._complaints = [], []  # about this boot, for each host that greets: none was there then
        self.faults, self._fault_us = 0, None  # since boot; when one was told last
        self.heap_free_16 = 0  # blocks of 16 bytes
        self.loop_us = 0  # the last cycle
        self.loop_max_us = self._loop_before_us = 0  # the longest since the last STATUS, and of the second before that
        self._late = self._late_before = hal.late  # at the last STATUS, and at the one before

    def took(self, us):
        """A cycle has ended, and lasted so long."""
        self.loop_us = us
        if us > self.loop_max_us:
            self.loop_max_us = us

    def listen(self):
        """Take what has come since the last cycle."""
        n = self._hal.read_into(self._rx)
        if n:
            self._framer.feed(self._rx, n)

    def _on_frame(self, kind, seq, payload):
        """One whole frame. One that breaks off is left out: the stop that comes behind it must be heard."""
        try:
            if kind == _SETPOINT:
                self._on_set_point(seq, payload)
            elif kind == _HELLO:
                self._on_hello(*struct.unpack(frames.FORMAT[kind], payload))
            elif _ARM <= kind <= _ESTOP and kind != _PARAM_VALUE:
                self.orders.take(kind, struct.unpack(frames.FORMAT[kind], payload))
        except Exception as error:
            self.fault("frame", error)

    def _on_set_point(self, seq, payload):
        read_set_point(payload, self._words)
        depth, roll, pitch, fx, fy, mz, pan, tilt, lamp_pan, lamp_tilt, light, valid, ttl_ms, host_low, host_high = (
            self._words
        )
        set_point = self._control.set_point
        set_point.age_us = 0
        set_point.ttl_us = ttl_ms * 1000
        set_point.seq = seq
        set_point.host_time = host_high << 16 | host_low
        if self._control.ladder.level != failsafe.SURFACE:  # which ends by an order only
            if valid & _VALID_DEPTH:
                set_point.depth_100nm = depth * 1000
            if valid & _VALID_ATTITUDE:
                tilt_100nrad = set_point.tilt_100nrad
                tilt_100nrad[0] = roll * 5236 // 3
                tilt_100nrad[1] = pitch * 5236 // 3
            if valid & _VALID_FORCE:
                force_uN = set_point.force_uN
                force_uN[0] = fx * 1000
                force_uN[1] = fy * 1000
                set_point.yaw_uNm = mz * 100
        if valid & _VALID_SERVO:
            if (
                _SERVO_LOWEST_US <= pan <= _SERVO_HIGHEST_US
                and _SERVO_LOWEST_US <= tilt <= _SERVO_HIGHEST_US
                and _SERVO_LOWEST_US <= lamp_pan <= _SERVO_HIGHEST_US
                and _SERVO_LOWEST_US <= lamp_tilt <= _SERVO_HIGHEST_US
            ):
                servos = self._hal.servos_us
                servos[0] = pan
                servos[1] = tilt
                servos[2] = lamp_pan
                servos[3] = lamp_tilt
        if valid & _VALID_LIGHT:
            self._hal.light_permille = light if light < 1000 else 1000

    def _on_hello(self, protocol, schema, host_boot):
        self.hello = 0 < protocol <= _PROTOCOL and schema == frames.SCHEMA_CRC[protocol]
        before = self._protocol
        self._protocol, says = (protocol, protocol) if self.hello else (1, _PROTOCOL)
        if self._protocol != before and not self._control.state:
            self._control.set_point.expire()  # its clock may count otherwise
        if host_boot != self._host_boot:  # another host: its request numbers begin again
            self._host_boot = host_boot
            self.orders.forget()
            if not self.hello:
                self.log(_ERROR, "host speaks another protocol: no arming")
            for text in self._complaints:
                self.log(_ERROR, text)
        count = len(self._control.values) if says == _PROTOCOL else _OLD_PARAMETERS
        # fmt: off
        self.say(
            _HELLO_ACK, says, frames.SCHEMA_CRC[says], _BUILD, self._uid, self.boot_id, self.reset_cause,
            self._control.state, self._control.values_crc, count, self._hal.capabilities,
        )
        # fmt: on

    def host_per_s(self):
        """How many of what the host's clock counts a second has."""
        return 10 if self._protocol == _PROTOCOL else 1000

    def begin_pulses(self):
        """Let the thrusters' pulses come as often as the parameter says."""
        self._hal.begin_pulses(self._control.pulse_frame_us)

    def revive(self):
        """Neutral pulses again, where the kill switch is closed."""
        self._hal.revive()
        self._control.killed = self._hal.killed()

    def say(self, kind, *fields):
        """One frame, now."""
        self._hal.write(self._writer.frame(kind, *fields))

    def say_telemetry(self):
        hal, control, writer = self._hal, self._control, self._writer
        plane, law, set_point = control.plane, control.law, control.set_point
        flags = control.mode << _MODE_SHIFT
        if self.hello:
            flags |= _FLAG_HELLO
        if plane.bad or plane.disagree:
            flags |= _FLAG_DEGRADED
        if plane.tare_mPa:
            flags |= _FLAG_TARED
        if control.leak:
            flags |= _FLAG_LEAK
        if control.battery_low:
            flags |= _FLAG_BATTERY
        if control.killed:
            flags |= _FLAG_KILLED
        if control.ladder.found():
            flags |= _FLAG_FOUND
        if set_point.age_us <= _HOLD_AFTER_US:
            flags |= _FLAG_FRESH
        roll = (3 * plane.roll_100nrad + 2618) // 5236  # of which 1745.329 are a hundredth of a degree
        pitch = (3 * plane.pitch_100nrad + 2618) // 5236
        depth = (plane.depth_100nm + 500) // 1000
        push = (law.disturbance(0) + 500) // 1000
        roll_push = (law.disturbance(1) + 50) // 100
        pitch_push = (law.disturbance(2) + 50) // 100
        if (depth + 32768 | push + 32768 | roll_push + 32768 | pitch_push + 32768) >> 16:  # one needs more than 16 bits
            depth, push, roll_push, pitch_push = [
                min(max(value, -32768), 32767) for value in (depth, push, roll_push, pitch_push)
            ]
        words = self._words
        words[0] = hal.us_low
        words[1] = hal.us_high
        words[2] = control.state | control.ladder.level << 8
        words[3] = flags
        words[4] = roll
        words[5] = pitch
        words[6] = depth
        words[7] = push
        words[8] = roll_push
        words[9] = pitch_push
        words[10] = hal.light_permille
        words[11] = control.battery_mv
        words[12] = control.saturated | plane.bad << 8
        words[13] = set_point.seq | self.orders.dirty << 8
        words[14] = self.loop_us if self.loop_us < _U16 else _U16
        write_telemetry(writer.plain, words, plane.zeta_100nm, control.pulses_us, hal.servos_us)
        if self._protocol == 1:
            hal.write(writer.close(_TELEM_1, _TELEM_1_END))
            return
        struct.pack_into("<h", writer.plain, _TELEM_1_END, hal.yaw_rate_cdeg_s())
        hal.write(writer.close(_TELEM, _TELEM_1_END + 2))

    def say_status(self):
        hal, framer, late = self._hal, self._framer, self._hal.late
        # fmt: off
        frame = self._writer.frame(
            _STATUS, hal.now_us(), hal.battery_mv, hal.current_10ma, hal.temperature_cC, min(self.loop_max_us, _U16),
            framer.rx_ok, framer.rx_bad, min(self.heap_free_16, _U16), late, self.reset_cause, self._control.leak,
        )
        # fmt: on
        hal.write(frame)
        self._loop_before_us = self.loop_max_us
        self.loop_max_us = 0
        self._late_before = self._late
        self._late = late

    def slowest_us(self):
        """The longest cycle of the last one to two seconds; where a tick was lost, longer than any."""
        if self._hal.late != self._late_before:
            return _U16
        return max(self.loop_max_us, self._loop_before_us)

    def say_one(self):
        """One waiting event or line of text."""
        if self._events:
            event = self._events[0]
            event[0] -= 1
            if not event[0]:
                self._events.pop(0)
            self.say(_EVENT, *event[1])
        elif self._logs:
            self._hal.write(self._writer.log(*self._logs.pop(0)))

    def event(self, code, before, after, severity, arg):
        """Tell of a transition; where too many wait, the newest is dropped and its number is missing."""
        self._event_count = (self._event_count + 1) & 0xFFFF
        if len(self._events) < 8:
            fields = (self._hal.now_us(), code, before, after, severity, arg, self._event_count)
            self._events.append([_EVENT_COPIES, fields])

    def log(self, level, text):
        """A line for people, at most four waiting."""
        if len(self._logs) < 4:
            self._logs.append((level, text.encode()))

    def complain(self, text):
        """A line about this boot."""
        self._complaints.append(text)

    def fault(self, where, error):
        """Count what broke off and was left out, and tell of the newest once a second. Never raises."""
        self.faults += 1
        try:
            now_us = self._hal.now_us()
            if self._fault_us is None or (now_us - self._fault_us) & 0xFFFFFFFF >= _FAULT_AGAIN_US:
                self._fault_us = now_us
                self.log(_ERROR, "fault %d, %s: %r" % (self.faults, where, error))
        except Exception:
            pass  # no memory for words: the count has it

    def last_words(self, text):
        self._hal.write(self._writer.log(_ERROR, text.encode()))
