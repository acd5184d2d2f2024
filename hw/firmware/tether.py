# The conversation with the host: frames in, frames out. What an order does is in orders.py.
import failsafe
import orders
import parameters
import wire

BUILD = b"aucamp02"
EVENT_COPIES = 3  # events are not acknowledged
FAULT_AGAIN_US = 1000000  # between two lines about faults: they may come with every frame
SERVO_LOWEST_US, SERVO_HIGHEST_US = 500, 2500  # hw/README.md; a pulse beyond them is no servo's
CDEG = 18000.0 / 3.141592653589793  # hundredths of a degree per radian


class Tether:
    """Both directions of the line. Its buffers are made here, once."""

    def __init__(self, hal, control, flash, boot_info):
        self._hal = hal
        self._control = control
        self.orders = orders.Orders(control, flash, self)
        self._uid, self.boot_id, self.reset_cause = boot_info
        self._writer = wire.Writer()
        self._framer = wire.Framer(self._on_frame)
        self._rx = bytearray(512)
        self._schema = wire.schema_crc()
        self._host_boot = None
        self.hello = False
        self._events = []  # [copies left, fields]
        self._event_count = 0
        self._logs = []
        self._complaints = []  # about this boot, for each host that greets: none was there when it began
        self.faults = 0  # since boot
        self._fault_us = None  # when one was told last
        self.loop_us = self.loop_max_us = self.gc_max_us = 0
        self.heap_free_16 = 0

    def took(self, us):
        self.loop_us = us
        self.loop_max_us = max(self.loop_max_us, us)

    def listen(self):
        """Take what has come since the last cycle."""
        self._framer.feed(self._rx, self._hal.read_into(self._rx))

    def _on_frame(self, kind, seq, payload):
        """One whole frame. One that breaks off is left out: the stop that comes behind it must be heard."""
        try:
            if kind == wire.SETPOINT:
                self._on_set_point(seq, wire.unpack(kind, payload))
            elif kind == wire.HELLO:
                self._on_hello(*wire.unpack(kind, payload))
            elif kind in orders.KINDS:
                self.orders.take(kind, wire.unpack(kind, payload))
        except Exception as error:
            self.fault("frame", error)

    def _on_set_point(self, seq, fields):
        depth, roll, pitch, fx, fy, mz, pan, tilt, lamp_pan, lamp_tilt, light, valid, ttl_ms, host_ms = fields
        set_point = self._control.set_point
        set_point.age_us = 0
        set_point.ttl_us = ttl_ms * 1000
        set_point.seq = seq
        set_point.host_ms = host_ms
        if self._control.ladder.level != failsafe.SURFACE:  # which ends by an order only
            if valid & wire.VALID_DEPTH:
                set_point.depth_100nm = depth * 1000
            if valid & wire.VALID_ATTITUDE:
                set_point.tilt_100nrad[:] = (roll * 5236 // 3, pitch * 5236 // 3)
            if valid & wire.VALID_FORCE:
                set_point.force_uN[0], set_point.force_uN[1], set_point.yaw_uNm = fx * 1000, fy * 1000, mz * 100
        if valid & wire.VALID_SERVO:
            lowest_us, highest_us = min(pan, tilt, lamp_pan, lamp_tilt), max(pan, tilt, lamp_pan, lamp_tilt)
            if SERVO_LOWEST_US <= lowest_us and highest_us <= SERVO_HIGHEST_US:
                servos = self._hal.servos_us
                servos[0], servos[1], servos[2], servos[3] = pan, tilt, lamp_pan, lamp_tilt
        if valid & wire.VALID_LIGHT:
            self._hal.light_permille = min(light, 1000)

    def _on_hello(self, protocol, schema, host_boot):
        self.hello = protocol == wire.PROTOCOL and schema == self._schema
        if host_boot != self._host_boot:  # another host: its request numbers begin again
            self._host_boot = host_boot
            self.orders.forget()
            if not self.hello:
                self.log(wire.ERROR, "host speaks another protocol: no arming")
            for text in self._complaints:
                self.log(wire.ERROR, text)
        # fmt: off
        self.say(
            wire.HELLO_ACK, wire.PROTOCOL, self._schema, BUILD, self._uid, self.boot_id, self.reset_cause,
            self._control.state, parameters.crc(self._control.values), len(parameters.TABLE), self._hal.capabilities,
        )
        # fmt: on

    def say(self, kind, *fields):
        """One frame, now."""
        self._hal.write(self._writer.frame(kind, *fields))

    def say_telemetry(self):
        now_us = self._hal.now_us()
        hal, control = self._hal, self._control
        plane, law, set_point = control.plane, control.law, control.set_point
        flags = (
            (wire.FLAG_HELLO if self.hello else 0)
            | (wire.FLAG_DEGRADED if plane.bad or plane.disagree else 0)
            | (wire.FLAG_TARED if plane.tare_mPa else 0)
            | (wire.FLAG_LEAK if control.leak else 0)
            | (wire.FLAG_BATTERY if control.battery_low else 0)
            | (wire.FLAG_FRESH if set_point.age_us <= failsafe.HOLD_AFTER_US else 0)
            | control.mode << wire.MODE_SHIFT
        )
        i16 = wire.fixed
        z1, z2, z3, z4 = [(z + 50) // 100 * 9789 // 10000 for z in plane.zeta_100nm]
        roll, pitch, depth = i16(plane.roll_100nrad, CDEG * 1e-7), i16(plane.pitch_100nrad, CDEG * 1e-7), i16(plane.depth_100nm, 1e-3)
        push, roll_push, pitch_push = [i16(law.disturbance(i), 1e-2 if i else 1e-3) for i in range(3)]
        loop_us = min(self.loop_us, 65535)
        # fmt: off
        hal.write(
            self._writer.frame(
                wire.TELEM, now_us, control.state, control.ladder.level, flags, z1, z2, z3, z4, roll, pitch, depth,
                push, roll_push, pitch_push, *control.pulses_us, *hal.servos_us, hal.light_permille,
                hal.battery_mv, control.saturated, plane.bad, set_point.seq, self.orders.is_dirty(), loop_us,
            )
        )
        # fmt: on

    def say_status(self):
        now_us = self._hal.now_us()
        hal, framer = self._hal, self._framer
        temperature = wire.fixed(hal.temperature_c, 100.0)
        loop_max_us, gc_max_us = min(self.loop_max_us, 65535), min(self.gc_max_us, 65535)
        heap_16 = self.heap_free_16
        leak = 1 if self._control.leak else 0
        # fmt: off
        hal.write(
            self._writer.frame(
                wire.STATUS, now_us, hal.battery_mv, hal.current_10ma, temperature, loop_max_us, gc_max_us,
                framer.rx_ok, framer.rx_bad, heap_16, self.reset_cause, leak,
            )
        )
        # fmt: on
        self.loop_max_us = self.gc_max_us = 0

    def say_one(self):
        """One waiting event or line of text."""
        if self._events:
            event = self._events[0]
            event[0] -= 1
            if not event[0]:
                self._events.pop(0)
            self._hal.write(self._writer.frame(wire.EVENT, *event[1]))
        elif self._logs:
            self._hal.write(self._writer.log(*self._logs.pop(0)))

    def event(self, code, before, after, severity, arg):
        """Tell of a transition; where too many wait, the newest is dropped and its number is missing."""
        self._event_count = (self._event_count + 1) & 0xFFFF
        if len(self._events) < 8:
            fields = (self._hal.now_us(), code, before, after, severity, arg, self._event_count)
            self._events.append([EVENT_COPIES, fields])

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
            if self._fault_us is None or (now_us - self._fault_us) & 0xFFFFFFFF >= FAULT_AGAIN_US:
                self._fault_us = now_us
                self.log(wire.ERROR, "fault %d, %s: %r" % (self.faults, where, error))
        except Exception:
            pass  # no memory for words: the count has it

    def last_words(self, text):
        self._hal.write(self._writer.log(wire.ERROR, text.encode()))
