# What the host may order, and the answer to each order: once executed, however often it is repeated.
import failsafe
import parameters
import tare
import wire

REMEMBERED = 8  # results, so that a repeat is answered and not executed again
LISTED_AT_ONCE = 1  # parameters in a cycle: 0.9 ms of the line at 1 Mbaud

KINDS = (
    wire.ARM,
    wire.DISARM,
    wire.ESTOP,
    wire.MODE,
    wire.PARAM_GET,
    wire.PARAM_SET,
    wire.PARAM_LIST,
    wire.PARAM_SAVE,
    wire.TARE,
    wire.REBOOT,
)


class Orders:
    """Executes orders on `control` and `flash`; `line` is the tether that they came by."""

    def __init__(self, control, flash, line):
        self._control = control
        self._flash = flash
        self._line = line
        self._results = []  # (kind, fields, result) of the last orders
        self._tare = None  # collects, while one runs
        self._tare_fields = None  # of the order that began it
        self._list_req_id = self._list_next = 0
        self._listing = False
        self.reboot = False  # at the end of this cycle

    def forget(self):
        """Another host: its request numbers begin again."""
        self._results = []

    def take(self, kind, fields):
        """One order, as wire.unpack gives it.

        A repeat is an order that is the same in all of its fields: a host that restarts may use a number again.
        """
        if kind != wire.DISARM and kind != wire.ESTOP:  # these are for whatever boot there is, and never in vain
            if fields[1] != self._line.boot_id:
                self._reply(kind, fields, wire.STALE_BOOT)
                return
            for known in self._results:
                if known[0] == kind and known[1] == fields:
                    self._reply(kind, fields, known[2])
                    return
            if self._tare:
                again = kind == wire.TARE and fields == self._tare_fields
                self._reply(kind, fields, wire.RUNNING if again else wire.BUSY)
                return
        result = self._try(kind, fields)
        if result != wire.RUNNING:
            self._remember(kind, fields, result)
        self._reply(kind, fields, result)

    def _try(self, kind, fields):
        """The result of an order; one that breaks off is refused, and leaves no motor on that was off."""
        was = self._control.state
        try:
            return self._execute(kind, fields)
        except Exception as error:
            if was == wire.DISARMED:
                self._control.disarm()
            self._line.fault("order", error)
            return wire.REFUSED

    def _execute(self, kind, fields):
        control = self._control
        if kind == wire.ARM:
            return self._arm()
        if kind == wire.DISARM or kind == wire.ESTOP:
            return self._stop(failsafe.STOP if kind == wire.ESTOP else failsafe.ORDER)
        if kind == wire.MODE:
            return self._mode(fields[2], fields[3])
        if kind == wire.PARAM_GET:
            return wire.OK if fields[2] < len(parameters.TABLE) else wire.RANGE
        if kind == wire.PARAM_LIST:
            self._list_req_id, self._list_next, self._listing = fields[0], 0, True
            return wire.RUNNING  # the values are the answer; a repeat begins anew
        if control.state == wire.ARMED:
            return wire.REFUSED
        if kind == wire.PARAM_SET:
            return self._set(fields[2], fields[5])
        if kind == wire.PARAM_SAVE:
            self._flash.save_parameters(control.values)
            return wire.OK
        if kind == wire.TARE:
            self._tare = tare.Tare()
            self._tare_fields = fields
            return wire.RUNNING
        if fields[2] != wire.REBOOT_MAGIC:
            return wire.RANGE
        self.reboot = True
        return wire.OK

    def _arm(self):
        control = self._control
        before = control.ladder.level
        control.tare_old = self._flash.tare_is_old(control.set_point.host_ms)
        faults = control.arm_faults(self._line.hello, self._line.loop_max_us)
        if faults:
            self._line.event(wire.EV_ARM_REFUSED, before, before, wire.WARNING, faults)
            return wire.REFUSED
        control.arm()
        self._line.event(wire.EV_ARMED, before, control.ladder.level, wire.INFO, failsafe.ORDER)
        return wire.OK

    def _stop(self, reason):
        control = self._control
        before, was = control.ladder.level, control.state
        control.disarm()
        if reason == failsafe.STOP:
            control.ladder.latch(reason)
        if was == wire.ARMED or before != control.ladder.level:
            self._line.event(wire.EV_DISARMED, before, control.ladder.level, wire.INFO, reason)
        return wire.OK

    def _mode(self, mode, thruster):
        control = self._control
        armed = control.state == wire.ARMED
        if mode > wire.BENCH or (mode == wire.BENCH and not 1 <= thruster <= 8):
            return wire.RANGE
        if mode == wire.SURFACE:
            if not armed or control.mode == wire.BENCH:
                return wire.REFUSED
            before = control.ladder.level
            control.surface()
            if before != control.ladder.level:
                self._line.event(wire.EV_LADDER, before, control.ladder.level, wire.INFO, failsafe.ORDER)
            return wire.OK
        # Armed, a robot on the bench stays on the bench, and one in the water in the water.
        if armed and (mode == wire.BENCH) != (control.mode == wire.BENCH):
            return wire.REFUSED
        if armed and mode == wire.STABILISE and control.ladder.level != failsafe.OK:
            return wire.REFUSED
        if armed and mode == wire.HOLD and control.mode == wire.STABILISE:
            control.hold_here()
        control.mode = mode
        control.bench_thruster = thruster
        return wire.OK

    def _set(self, i, value):
        value = float("%.6g" % value)  # what somebody typed, before float32 made 0.4 into 0.40000001
        if i >= len(parameters.TABLE) or not parameters.in_range(i, value):
            return wire.RANGE
        values = list(self._control.values)
        values[i] = value
        self._control.configure(values)
        return wire.OK

    def is_dirty(self):
        """Whether a value in force is not in flash."""
        return self._control.values != self._flash.saved

    def step(self, pressure_mPa):
        """Go on with what takes more than a cycle."""
        if self._listing:
            first, last = self._list_next, min(self._list_next + LISTED_AT_ONCE, len(parameters.TABLE))
            self._list_next, self._listing = last, last < len(parameters.TABLE)
            for i in range(first, last):
                self._say_value(self._list_req_id, i)
        if self._tare:
            self._go_on_taring(pressure_mPa)

    def _go_on_taring(self, pressure_mPa):
        fields, result = self._tare_fields, wire.REFUSED
        try:
            if not self._tare.step(pressure_mPa):
                return
            medians = self._tare.result()
            if medians and self._set_tare(medians, fields[2] * 1e-3):
                result = wire.OK
        except Exception as error:
            self._line.fault("tare", error)
        self._tare = None
        self._remember(wire.TARE, fields, result)
        self._line.say(wire.ACK, fields[0], wire.TARE, result, self._line.boot_id)

    def _set_tare(self, medians, depth_m):
        """Take these pressures for those at depth_m. False where that leaves no air above the water."""
        control = self._control
        plane = control.plane
        tare_pa = [mPa * 1e-3 - depth_m * plane.pa_per_m for mPa in medians]
        tare_mPa = tare.whole(tare_pa)
        if tare_mPa is None:
            return False
        self._flash.save_tare(tare_pa, control.set_point.host_ms)
        plane.tare_mPa = tare_mPa
        return True

    def _remember(self, kind, fields, result):
        self._results.append((kind, fields, result))
        if len(self._results) > REMEMBERED:
            self._results.pop(0)

    def _reply(self, kind, fields, result):
        if result == wire.OK and (kind == wire.PARAM_GET or kind == wire.PARAM_SET):
            self._say_value(fields[0], fields[2])
        else:
            self._line.say(wire.ACK, fields[0], kind, result, self._line.boot_id)

    def _say_value(self, req_id, i):
        value, line = self._control.values[i], self._line
        flags = wire.UNSAVED if value != self._flash.saved[i] else 0
        line.say(wire.PARAM_VALUE, req_id, line.boot_id, i, parameters.TABLE[i][5], flags, value)
