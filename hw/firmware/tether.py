# The conversation with the host: what it may order, what it is told.
import failsafe
import wire

BUILD = b"aucamp01"
REMEMBERED = 8  # results of commands, so that a repeat is answered and not executed again
EVENT_COPIES = 3  # events are not acknowledged
CDEG = 18000.0 / 3.141592653589793  # hundredths of a degree per radian


class Tether:
    """Frames in and out. Orders go to `control` at once, or, where they take time, to `tare_request`."""

    def __init__(self, hal, control, boot_info):
        self._hal = hal
        self._control = control
        self._uid, self.boot_id, self.reset_cause = boot_info
        self._writer = wire.Writer()
        self._framer = wire.Framer(self._on_frame)
        self._rx = bytearray(512)
        self._schema = wire.schema_crc()
        self._host_boot = None
        self._hello = False
        self._results = []  # (req_id, type, result) of the last commands
        self._events = []  # [copies left, fields]
        self._event_count = 0
        self._logs = []
        self.tare_request = None  # (req_id, true depth m) while one runs
        self.loop_us = self.loop_max_us = self.gc_max_us = 0

    def listen(self):
        """Take what has come since the last cycle."""
        self._framer.feed(self._rx, self._hal.read_into(self._rx))

    def _on_frame(self, kind, seq, payload):
        if kind == wire.SETPOINT:
            self._on_set_point(seq, wire.unpack(kind, payload))
        elif kind == wire.HELLO:
            self._on_hello(*wire.unpack(kind, payload))
        elif kind in (wire.ARM, wire.DISARM, wire.ESTOP, wire.TARE):
            self._on_command(kind, wire.unpack(kind, payload))

    def _on_set_point(self, seq, fields):
        depth, roll, pitch, fx, fy, mz, pan, tilt, lamp_pan, lamp_tilt, light, valid, ttl_ms, _ = fields
        set_point = self._control.set_point
        set_point.age_us = 0
        set_point.ttl_us = ttl_ms * 1000
        set_point.seq = seq
        if self._control.ladder.level != failsafe.SURFACE:  # which ends by an order only
            if valid & wire.VALID_DEPTH:
                set_point.depth_m = depth * 1e-4
            if valid & wire.VALID_ATTITUDE:
                set_point.tilt_rad[0], set_point.tilt_rad[1] = roll / CDEG, pitch / CDEG
            if valid & wire.VALID_FORCE:
                set_point.force_n[0], set_point.force_n[1], set_point.yaw_nm = fx * 1e-3, fy * 1e-3, mz * 1e-4
        if valid & wire.VALID_SERVO:
            servos = self._hal.servos_us
            servos[0], servos[1], servos[2], servos[3] = pan, tilt, lamp_pan, lamp_tilt
        if valid & wire.VALID_LIGHT:
            self._hal.light_permille = min(light, 1000)

    def _on_hello(self, protocol, schema, host_boot):
        self._hello = protocol == wire.PROTOCOL and schema == self._schema
        if host_boot != self._host_boot:  # another host: its request numbers begin again
            self._host_boot = host_boot
            self._results = []
            if not self._hello:
                self.log(wire.ERROR, "host speaks another protocol: no arming")
        state = self._control.state
        fields = (wire.PROTOCOL, self._schema, BUILD, self._uid, self.boot_id, self.reset_cause, state, 0, 0, 0)
        self._hal.write(self._writer.frame(wire.HELLO_ACK, *fields))

    def _on_command(self, kind, fields):
        req_id, boot_id = fields[0], fields[1]
        for known in self._results:
            if known[0] == req_id and known[1] == kind and boot_id == self.boot_id:
                self._acknowledge(req_id, kind, known[2])
                return
        if kind == wire.DISARM or kind == wire.ESTOP:  # these execute whatever boot they were meant for
            self._stop(failsafe.STOP if kind == wire.ESTOP else failsafe.ORDER)
            self.answer(req_id, kind, wire.OK)
        elif boot_id != self.boot_id:
            self._acknowledge(req_id, kind, wire.STALE_BOOT)
        elif self.tare_request:
            self._acknowledge(req_id, kind, wire.BUSY)
        elif kind == wire.ARM:
            self.answer(req_id, kind, self._arm())
        elif self._control.state == wire.ARMED:
            self.answer(req_id, kind, wire.REFUSED)
        else:
            self.tare_request = (req_id, fields[2] * 1e-3)

    def _arm(self):
        control = self._control
        before = control.ladder.level
        faults = control.arm_faults(self._hello, self.loop_max_us)
        if faults:
            self.event(wire.EV_ARM_REFUSED, before, before, wire.WARNING, faults)
            return wire.REFUSED
        control.arm()
        self.event(wire.EV_ARMED, before, control.ladder.level, wire.INFO, failsafe.ORDER)
        return wire.OK

    def _stop(self, reason):
        control = self._control
        before, was = control.ladder.level, control.state
        control.disarm()
        if reason == failsafe.STOP:
            control.ladder.latch(reason)
        if was == wire.ARMED or before != control.ladder.level:
            self.event(wire.EV_DISARMED, before, control.ladder.level, wire.INFO, reason)

    def answer(self, req_id, kind, result):
        """Acknowledge a command that was executed, and remember the result for its repeats."""
        self._results.append((req_id, kind, result))
        if len(self._results) > REMEMBERED:
            self._results.pop(0)
        self._acknowledge(req_id, kind, result)

    def _acknowledge(self, req_id, kind, result):
        self._hal.write(self._writer.frame(wire.ACK, req_id, kind, result, self.boot_id))

    def say_telemetry(self, now_us):
        hal, control = self._hal, self._control
        plane, law, set_point = control.plane, control.law, control.set_point
        flags = (
            (wire.FLAG_HELLO if self._hello else 0)
            | (wire.FLAG_DEGRADED if plane.bad or plane.disagree else 0)
            | (wire.FLAG_TARED if plane.tare_pa else 0)
            | (wire.FLAG_LEAK if control.leak else 0)
            | (wire.FLAG_BATTERY if control.battery_low else 0)
            | (wire.FLAG_FRESH if set_point.age_us <= failsafe.HOLD_AFTER_US else 0)
        )
        i16 = wire.fixed
        z1, z2, z3, z4 = [int(round(zeta * 10.0 * wire.PA_PER_M)) for zeta in plane.zeta_m]
        roll, pitch, depth = i16(plane.roll_rad, CDEG), i16(plane.pitch_rad, CDEG), i16(plane.depth_m, 1e4)
        push, roll_push, pitch_push = [i16(law.disturbance(i), 1e4 if i else 1e3) for i in range(3)]
        loop_us = min(self.loop_us, 65535)
        # fmt: off
        hal.write(
            self._writer.frame(
                wire.TELEM, now_us, control.state, control.ladder.level, flags, z1, z2, z3, z4, roll, pitch, depth,
                push, roll_push, pitch_push, *control.pulses_us, *hal.servos_us, hal.light_permille,
                hal.battery_mv, control.saturated, plane.bad, set_point.seq, 0, loop_us,
            )
        )
        # fmt: on

    def say_status(self, now_us):
        hal, framer = self._hal, self._framer
        no_thermometer = -32768
        loop_max_us, gc_max_us = min(self.loop_max_us, 65535), min(self.gc_max_us, 65535)
        heap_16 = min(hal.heap_free() >> 4, 65535)
        leak = 1 if self._control.leak else 0
        # fmt: off
        hal.write(
            self._writer.frame(
                wire.STATUS, now_us, hal.battery_mv, hal.current_10ma, no_thermometer, loop_max_us, gc_max_us,
                framer.rx_ok, framer.rx_bad, heap_16, self.reset_cause, leak,
            )
        )
        # fmt: on
        self.loop_max_us = self.gc_max_us = 0

    def say_one(self):
        """One waiting event or line of text."""
        if self._events:
            event = self._events[0]
            self._hal.write(self._writer.frame(wire.EVENT, *event[1]))
            event[0] -= 1
            if not event[0]:
                self._events.pop(0)
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

    def last_words(self, text):
        self._hal.write(self._writer.log(wire.ERROR, text.encode()))
