# What the host may order, and the answer to each order: once executed, however often it is repeated.
import sys
from micropython import const

import failsafe

# Of wire.py, whose numbers these are
_DISARMED = const(0)
_ARMED = const(1)
_HOLD = const(0)
_STABILISE = const(1)
_SURFACE = const(2)
_BENCH = const(3)
_EV_LADDER = const(4)
_INFO = const(0)
_WARNING = const(1)
_ACK = const(0x30)
_ARM = const(0x31)
_DISARM = const(0x32)
_MODE = const(0x33)
_PARAM_GET = const(0x34)
_PARAM_SET = const(0x35)
_PARAM_VALUE = const(0x36)
_PARAM_LIST = const(0x37)
_PARAM_SAVE = const(0x38)
_TARE = const(0x39)
_ESTOP = const(0x3B)
_OK = const(0)
_REFUSED = const(1)
_STALE_BOOT = const(3)
_BUSY = const(4)
_RANGE = const(5)
_RUNNING = const(6)
_EV_ARMED = const(2)
_EV_DISARMED = const(3)
_EV_ARM_REFUSED = const(5)
_UNSAVED = const(1)
_REBOOT_MAGIC = const(0xB007B007)
_PROMPT_MAGIC = const(0xB0070EE1)

# Indices of wire.REASONS
_ORDER = const(1)
_SILENT = const(2)
_STOP = const(10)

_TARE_FOR_S = const(43200)  # the weather moves by 1 hPa, a centimetre of water, within hours
_TARE_AHEAD_S = const(600)  # a clock without a time server goes wrong by so much in months, and weather in hours
_HOST_ROUND = const(0x100000000)  # where the host's clock begins again
_REMEMBERED = const(8)  # results, so that a repeat is answered and not executed again


def put_away():
    """Drop the modules that only boot and orders to a robot at rest need: in a dive they take no memory."""
    for name in ("flash", "parameters", "gains"):
        sys.modules.pop(name, None)


class Orders:
    """Executes orders on `control`, with what the `hal` remembers; `line` is the tether that they came by."""

    def __init__(self, hal, control, line):
        self._hal = hal
        self._control = control
        self._line = line
        self.saved = []  # values of the parameters in flash
        self.tared = None  # when: how many of what the clock counts a second has, and the clock; None: nobody knows
        self._results = []  # (kind, fields, result) of the last orders
        self._tare = None  # collects, while one runs
        self._tare_fields = None  # of the order that began it
        self._list_req_id = self._list_next = 0
        self._listing = False
        self.dirty = False  # a value in force is not in flash
        self.reboot = 0  # at the end of this cycle: 1 into the firmware, 2 to the prompt

    def forget(self):
        """Another host: its request numbers begin again, and it asked for no mode. What a program on the bench left on
        would turn a thruster when the agent arms."""
        self._results = []
        control = self._control
        if control.mode == _BENCH:
            self._stop(_SILENT)
        elif control.mode == _STABILISE:
            control.hold_here()

    def take(self, kind, fields):
        """One order, as the table of wire.py has its fields.

        A repeat is an order that is the same in all of its fields: a host that restarts may use a number again.
        """
        if kind != _DISARM and kind != _ESTOP:  # these are for whatever boot there is, and never in vain
            if fields[1] != self._line.boot_id:
                self._reply(kind, fields, _STALE_BOOT)
                return
            for known in self._results:
                if known[0] == kind and known[1] == fields:
                    self._reply(kind, fields, known[2])
                    return
            if self._tare:
                again = kind == _TARE and fields == self._tare_fields
                self._reply(kind, fields, _RUNNING if again else _BUSY)
                return
        result = self._try(kind, fields)
        if result != _RUNNING:
            self._remember(kind, fields, result)
        self._reply(kind, fields, result)

    def _try(self, kind, fields):
        """The result of an order; one that breaks off is refused, and leaves no motor on that was off."""
        was = self._control.state
        try:
            return self._execute(kind, fields)
        except Exception as error:
            if was == _DISARMED:
                self._control.disarm()
            self._line.fault("order", error)
            return _REFUSED
        finally:
            put_away()

    def _execute(self, kind, fields):
        control = self._control
        if kind == _ARM:
            return self._arm()
        if kind == _DISARM or kind == _ESTOP:
            return self._stop(_STOP if kind == _ESTOP else _ORDER)
        if kind == _MODE:
            return self._mode(fields[2], fields[3])
        if kind == _PARAM_GET:
            return _OK if fields[2] < len(control.values) else _RANGE
        if kind == _PARAM_LIST:
            self._list_req_id, self._list_next, self._listing = fields[0], 0, True
            return _RUNNING  # the values are the answer; a repeat begins anew
        if control.state == _ARMED:
            return _REFUSED
        if kind == _PARAM_SET:
            return self._set(fields[2], fields[5])
        if kind == _PARAM_SAVE:
            import flash

            flash.save_values(self._hal, control.values)
            self.saved = list(control.values)
            self.dirty = False
            return _OK
        if kind == _TARE:
            import flash

            self._tare = flash.Tare()
            self._tare_fields = fields
            return _RUNNING
        self.reboot = 1 if fields[2] == _REBOOT_MAGIC else 2 if fields[2] == _PROMPT_MAGIC else 0
        return _OK if self.reboot else _RANGE

    def _arm(self):
        control = self._control
        before = control.ladder.level
        if control.killed and control.state == _DISARMED:
            self._line.revive()  # ESCs hear neutral again, and are armed once they have heard it for long enough
        control.tare_old = self._tare_is_old()
        faults = control.arm_faults(self._line.hello, self._line.slowest_us())
        if faults:
            self._line.event(
                _EV_ARM_REFUSED, before, before, _WARNING, (faults ^ 0x8000) - 0x8000
            )  # 16 bits and a sign
            return _REFUSED
        control.arm()
        self._line.event(_EV_ARMED, before, control.ladder.level, _INFO, _ORDER)
        return _OK

    def _tare_is_old(self):
        """Not made within 12 h, as far as anybody knows.

        The board has no calendar. The milliseconds of hosts of versions 1 and 2 come round after 49 days, the tenths of
        a second of version 3 after 13 years; the one says nothing of the other. One from a little ahead of the host's
        clock is fresh: that clock was set since, or it is another computer's.
        """
        time = self._control.set_point.host_time
        if time is None or not self.tared:  # nobody knows what time it is, and an old set-point is refused anyway
            return False
        unit, made = self.tared
        if unit != self._line.host_per_s() or not isinstance(made, int) or made < 0:
            return True
        return _TARE_FOR_S * unit < (time - made) & 0xFFFFFFFF < _HOST_ROUND - _TARE_AHEAD_S * unit

    def _stop(self, reason):
        control = self._control
        before, was = control.ladder.level, control.state
        control.disarm()
        if reason == _STOP:
            control.ladder.latch(reason)
        if was == _ARMED or before != control.ladder.level:
            self._line.event(_EV_DISARMED, before, control.ladder.level, _INFO, reason)
        return _OK

    def _mode(self, mode, thruster):
        control = self._control
        armed = control.state == _ARMED
        if mode > _BENCH or (mode == _BENCH and thruster > 8):
            return _RANGE
        if mode == _SURFACE:
            if not armed or control.mode == _BENCH:
                return _REFUSED
            before = control.ladder.level
            control.surface()
            if before != control.ladder.level:
                self._line.event(_EV_LADDER, before, control.ladder.level, _INFO, _ORDER)
            return _OK
        # Armed, a robot on the bench stays on the bench, and one in the water in the water.
        if armed and (mode == _BENCH) != (control.mode == _BENCH):
            return _REFUSED
        if armed and mode == _STABILISE and control.ladder.level != failsafe.OK:
            return _REFUSED
        if armed and mode == _HOLD and control.mode == _STABILISE:
            control.hold_here()
        control.mode = mode
        control.bench_thruster = thruster
        return _OK

    def _set(self, i, value):
        import flash

        values = flash.with_value(self._control.values, i, value)
        if values is None:
            return _RANGE
        frame_us = self._control.pulse_frame_us
        self._control.configure(values)
        self.dirty = values != self.saved
        if self._control.pulse_frame_us != frame_us:
            self._line.begin_pulses()
        return _OK

    def step(self, pressure_mPa):
        """Go on with what takes more than a cycle."""
        if self._listing:
            i = self._list_next  # one a cycle: half a millisecond with the line
            self._list_next = i + 1
            self._listing = i + 1 < len(self._control.values)
            self._say_value(self._list_req_id, i)
        if self._tare:
            self._go_on_taring(pressure_mPa)

    def _go_on_taring(self, pressure_mPa):
        fields, result = self._tare_fields, _REFUSED
        try:
            if not self._tare.step(pressure_mPa):
                return
            medians = self._tare.result()
            if medians and self._set_tare(medians, fields[2] * 1e-3):
                result = _OK
        except Exception as error:
            self._line.fault("tare", error)
        self._tare = None
        put_away()
        self._remember(_TARE, fields, result)
        self._line.say(_ACK, fields[0], _TARE, result, self._line.boot_id)

    def _set_tare(self, medians_mPa, depth_m):
        """Take these pressures for those at depth_m. False where that leaves no air above the water."""
        import flash

        plane, time = self._control.plane, self._control.set_point.host_time
        tare_mPa = flash.save_tare(self._hal, medians_mPa, depth_m * plane.pa_per_m, time, self._line.host_per_s())
        if tare_mPa is None:
            return False
        plane.set_tare(tare_mPa)
        self.tared = None if time is None else (self._line.host_per_s(), time)
        return True

    def _remember(self, kind, fields, result):
        self._results.append((kind, fields, result))
        if len(self._results) > _REMEMBERED:
            self._results.pop(0)

    def _reply(self, kind, fields, result):
        if result == _OK and (kind == _PARAM_GET or kind == _PARAM_SET):
            self._say_value(fields[0], fields[2])
        else:
            self._line.say(_ACK, fields[0], kind, result, self._line.boot_id)

    def _say_value(self, req_id, i):
        value, line = self._control.values[i], self._line
        flags = _UNSAVED if value != self.saved[i] else 0
        line.say(_PARAM_VALUE, req_id, line.boot_id, i, isinstance(value, int), flags, value)
