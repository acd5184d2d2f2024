# From pressures and set-point to pulses, armed or not. No bytes, no hardware: those are tether.py and the HAL.
from micropython import const

import failsafe
import law
import pressure
import thrust

# Of wire.py, whose numbers these are
_PA_PER_M = const(9789.0)
_DISARMED = const(0)
_ARMED = const(1)
_HOLD = const(0)
_STABILISE = const(1)
_BENCH = const(3)

# Indices of wire.REASONS
_ORDER = const(1)
_FAULT = const(13)
_KILLED = const(14)

_ASCENT_MM_S = const(70)
_AFLOAT_100nm = const(800000)  # where surfacing ends: a hull lifted out of the water would plunge when motors stop
_BATTERY_TICKS = const(100)  # all goes by a voltage smoothed over these: a probe's noise is not a battery's
_STEEPEST_100nrad = const(7850000)  # net weight is carried along the robot's own axis up to this tilt
_NEVER_US = const(1 << 29)  # an age that is past every limit and fits the board's 31 bit integers
# A cycle whose control broke off is made up for by so many good ones; where debts add up, the robot goes up.
_FAULT_CYCLES = const(20)
_FAULTS_LIMIT = const(10)
# Without one good cycle, as long as a watchdog waits: nobody steers, and motors that do not obey stop.
_LOST_US = const(500000)
_TICK_US = const(10000)
_TICKS_AT_ONCE = const(10)  # that a law makes up for, where cycles were lost
# Below this no ESC lives. One that is plugged in plays its tunes for so long before it hears what is neutral.
_ESC_LIVES_MV = const(6000)
_ESC_STARTS_US = const(2000000)
_WATCH_US = const(40000)
_NUDGE_SHIFT = const(5)  # of the full thrust
# A rotor turns the robot against itself, by 12 mm times its thrust (estimated, and off by a third or less): nudges are
# all along that. T5-T8 turn it back where they are at work: else a nudge a second sways the yaw by half a degree.
_REACTION_MM = const(12)
_ROCK_urad_s2 = const(1200000)  # half a degree of a robot whose sensors follow, and some of one whose do not
_STILL_uN = const(1000000)  # a push of less than 1 N is none: it may sit a few cm off the middle
_STILL_uNm = const(100000)
_QUIET_100nm = const(300000)  # where a robot within 3 cm and 10 degrees is at rest
_QUIET_100nrad = const(1740000)
_BENCH_US = const(60)  # over neutral: a propeller in air turns visibly and slowly


class SetPoint:
    """What the host asked for last, and how long ago."""

    def __init__(self):
        self.age_us = _NEVER_US
        self.ttl_us = 0
        self.seq = 0  # of the frame that brought it
        self.host_time = None  # the host's clock in it, modulo 2**32: ms, or since version 3 tenths of a second
        self.depth_100nm = 0
        self.tilt_100nrad = [0, 0]  # roll, pitch
        self.force_uN = [0, 0]  # forward, left
        self.yaw_uNm = 0

    def expire(self):
        """As if none had come."""
        self.age_us = _NEVER_US
        self.host_time = None

    def is_neutral(self, push_uN=0, turn_uNm=0):
        """Level, with no more of a push, and no more of a moment, than that."""
        x, y = self.force_uN
        return not any(self.tilt_100nrad) and abs(x) + abs(y) <= push_uN and abs(self.yaw_uNm) <= turn_uNm

    def level_out(self):
        """No tilt, no planar push."""
        self.tilt_100nrad[0] = self.tilt_100nrad[1] = self.force_uN[0] = self.force_uN[1] = self.yaw_uNm = 0


class Control:
    """State of the motors. Every buffer is made here, none in the cycle."""

    def __init__(self):
        self.state = _DISARMED
        self.mode = _HOLD
        self.bench_thruster = 0  # 1-8: turns in mode BENCH; 0: none
        self.plane = pressure.Plane(_PA_PER_M)
        self.ladder = failsafe.Ladder()
        self.set_point = SetPoint()
        self.neutral_us = [thrust.NEUTRAL_US] * 8
        self.pulses_us = [thrust.NEUTRAL_US] * 8
        self.saturated = 0  # bit 0 central, bit 1 flat thrusters
        self.esc_us = 0  # for how long ESCs have heard neutral pulses; negative: they start up
        self.killed = False  # the kill switch has the thrusters
        self.leak = False
        self.battery_low = False
        self.tare_old = False
        self.probe = None  # of the thrusters; a law that observes nothing has none
        self._owed = 0  # good cycles, after faults
        self._lost_us = 0  # since the last good cycle
        self._failed = False  # the last one was none
        self.battery_mv = 0  # smoothed
        self._battery_mv64 = 0  # in 1/64 mV
        self._forces_uN = [0] * 8
        # one value each for depth, roll, pitch
        self._y = [0] * 3
        self._ref = [0] * 3
        self._want = [0] * 3
        self._realised = [0] * 3
        self._push = [0] * 3
        self._unwatched_us = self._cut = 0  # since the last look; whether thrust was cut meanwhile
        self._level = True  # at the last look
        self._quiet = self._still = False  # then it was level and at its depth; and shall stay there
        self.values = []  # of the parameters; configure() comes before anything else
        self.law = None

    def configure(self, values):
        """Take new parameters, in the order of their table. For a disarmed robot: the law begins anew."""
        import parameters

        self.values = values
        self.values_crc = parameters.crc(values)
        of = {name: values[i] for i, name in enumerate(parameters.NAMES)}
        name = parameters.LAWS[int(of["law"])]
        self.probe = None
        if name == "observer":
            import gains

            if of["nudge_s"] >= 1.0:
                self.probe = failsafe.Probe(int(of["nudge_s"] * 100 + 0.5))
            self.law = law.Observer(gains.observer(of["heave_kg"], of["tilt_kgm2"], of["lag_s"]))
        elif name == "pid":
            import law_pid  # which takes no memory where it is not wanted

            self.law = law_pid.Pid(int(of["pid_set"]))
        else:
            import law_pid

            self.law = law_pid.Pi()
        self.plane.set_water(of["water_kg_m3"] * 9.80665)
        self._thrust_max_mN = int(of["thrust_max_N"] * 1e3 + 0.5)
        self._net_weight_uN = int(of["net_weight_N"] * 1e6)
        self._curve_battery_mv = int(of["curve_battery_mV"])
        self._battery_min_mv = int(of["battery_min_mV"])
        self.pulse_frame_us = of["pulse_frame_us"]
        self._checked = of["wiring"] == failsafe.WIRING
        self._rock_uNm = int(of["tilt_kgm2"] * _ROCK_urad_s2)
        self._slew_uN = int(of["slew_N"] * 1e6 + 0.5)
        for j in range(8):
            self.neutral_us[j] = self.pulses_us[j] = int(of["zero_%d_us" % (j + 1)])

    def sense(self, pressure_mPa, answered, battery_mv, leak, dt_us):
        """Begin a cycle with what the sensors say."""
        if self.set_point.age_us < _NEVER_US:
            self.set_point.age_us += dt_us
        self.leak = bool(leak)
        if battery_mv < _ESC_LIVES_MV:
            self.esc_us = -_ESC_STARTS_US
        elif self.killed and self.esc_us > 0:
            self.esc_us = 0
        if self.battery_mv >= _ESC_LIVES_MV:
            self._battery_mv64 += ((battery_mv << 6) - self._battery_mv64 + _BATTERY_TICKS // 2) // _BATTERY_TICKS
        else:  # it has just been plugged in
            self._battery_mv64 = battery_mv << 6
        self.battery_mv = self._battery_mv64 >> 6
        self.battery_low = self.battery_mv < self._battery_min_mv
        self.plane.step(pressure_mPa, answered, dt_us)

    def act(self, dt_us):
        """End a cycle: new pulses. Returns whether the ladder moved."""
        if self.state == _DISARMED:
            if self.esc_us < _NEVER_US:
                self.esc_us += dt_us
            return False
        self.esc_us = 0
        if self.killed:
            self.ladder.give_up(_KILLED)
            self.disarm()
            return True
        if self._owed:
            self._recover()
        before, reason = self.ladder.level, self.ladder.reason
        level = self.ladder.step(
            dt_us, self.set_point.age_us, self.set_point.ttl_us, self.plane, self.leak, self.battery_low
        )
        if level >= failsafe.HOLD and self.mode == _BENCH:
            self.ladder.give_up()
            level = failsafe.DISARM
        if level >= failsafe.DISARM:
            self.disarm()
            return True
        if level >= failsafe.HOLD:
            self.set_point.level_out()
            if self.mode == _STABILISE:  # with nobody there, drifting up or down is no option
                self.hold_here()
        if level == failsafe.SURFACE:
            if before != level:
                self.set_point.depth_100nm = self.plane.depth_100nm
            rise_100nm = _ASCENT_MM_S * dt_us // 100
            self.set_point.depth_100nm = max(_AFLOAT_100nm, self.set_point.depth_100nm - rise_100nm)
        if self.mode == _BENCH:
            self._turn_one()
        else:
            self._drive(min((dt_us + _TICK_US // 2) // _TICK_US, _TICKS_AT_ONCE))
            self._watch(dt_us)
            if self.ladder.level >= failsafe.DISARM:
                self.disarm()
            elif self.ladder.level != level:
                self.hold_here()
                self.set_point.level_out()
        return self.ladder.level != before or self.ladder.reason != reason

    def fail(self, dt_us):
        """End a cycle that broke off: the last pulses stand. Returns whether the ladder moved."""
        if self.state == _DISARMED:
            return False
        before, reason = self.ladder.level, self.ladder.reason
        self._owed = min(self._owed + _FAULT_CYCLES, _FAULTS_LIMIT * _FAULT_CYCLES)
        self._lost_us += dt_us
        self._failed = True
        if self._lost_us >= _LOST_US or self.mode == _BENCH:
            self.ladder.give_up(_FAULT)
            self.disarm()
        elif self._owed == _FAULTS_LIMIT * _FAULT_CYCLES:
            self.surface(_FAULT)
        return self.ladder.level != before or self.ladder.reason != reason

    def _recover(self):
        """Begin a cycle while good ones are owed: if the last was one it counts, else the law begins anew, for what
        it believed may be what broke it."""
        if self._failed:
            self._failed = False
            self._begin()
        else:
            self._owed -= 1
            self._lost_us = 0

    def surface(self, reason=_ORDER):
        """Go up level, whatever the set-point says, until an order to arm calls the robot back."""
        before = self.ladder.level
        self.ladder.surface(reason)
        if before < failsafe.SURFACE:
            self.hold_here()
            self.set_point.level_out()

    def hold_here(self):
        """Keep the depth that there is."""
        self.mode = _HOLD
        self.set_point.depth_100nm = self.plane.depth_100nm

    def _turn_one(self):
        for j in range(8):
            self.pulses_us[j] = self.neutral_us[j] + (_BENCH_US if j + 1 == self.bench_thruster else 0)

    def _drive(self, ticks):
        plane, set_point, y, want, realised = self.plane, self.set_point, self._y, self._want, self._realised
        y[0], y[1], y[2] = plane.depth_100nm, plane.roll_100nrad, plane.pitch_100nrad
        ref, tilt = self._ref, set_point.tilt_100nrad
        ref[0], ref[1], ref[2] = set_point.depth_100nm, tilt[0], tilt[1]
        if self.mode == _STABILISE:
            ref[0] = y[0]
        self.law.step(y, ref, realised, want, ticks)
        if self.mode == _STABILISE:
            want[0] = 0
        probe = self.probe
        if probe and probe.rocking and self.ladder.level < failsafe.SURFACE:
            rock_uNm = probe.rock() * self._rock_uNm
            want[1] += rock_uNm
            want[2] += rock_uNm
        # What carries the weight is none of the law's: it neither asks for it nor learns of it.
        weight = self._net_weight_uN
        if weight:
            weight = _along(_along(weight, y[1]), y[2])
            want[0] += weight
        full = thrust.full_uN(self._thrust_max_mN, (self._battery_mv64 << 8) // self._curve_battery_mv)
        forces, slew = self._forces_uN, self._slew_uN * ticks
        self.saturated = 1 if thrust.central(want, full, slew, forces, realised) else 0
        realised[0] -= weight
        fx, fy, turn = set_point.force_uN[0], set_point.force_uN[1], set_point.yaw_uNm
        nudge = probe.sign() * (full >> _NUDGE_SHIFT) if probe and not self.saturated else 0
        if nudge and (fx or fy or turn):
            turn -= nudge // 250 * _REACTION_MM
        if thrust.flat(fx, fy, turn, full, forces):
            self.saturated |= 2
            nudge = 0
        if not nudge:
            thrust.pulses(forces, self.neutral_us, full, self.pulses_us)
            return
        for j in range(4):
            forces[j] += nudge
            nudge = -nudge
        thrust.pulses(forces, self.neutral_us, full, self.pulses_us)
        for j in range(4):
            forces[j] -= nudge
            nudge = -nudge

    def _watch(self, dt_us):
        """Whether what was asked for comes to anything: nudges in each cycle, the rest in one of four."""
        self._unwatched_us += dt_us
        self._cut |= self.saturated & 1
        if self._unwatched_us >= _WATCH_US:
            self._look()
        probe, law = self.probe, self.law
        if probe and self.ladder.level < failsafe.SURFACE:
            _, roll, pitch = self._y
            calm = -_QUIET_100nrad < roll < _QUIET_100nrad and -_QUIET_100nrad < pitch < _QUIET_100nrad
            reason = probe.rocked(self.plane.parity_100nm) if probe.rocking and calm else 0
            if not reason:
                roll, pitch = law.disturbance(1), law.disturbance(2)
                reason = probe.step(roll, pitch, self._thrust_max_mN, self._level, self._quiet, self._still)
            if reason:
                self.ladder.suspect(reason)

    def _look(self):
        y, ref, law, push = self._y, self._ref, self.law, self._push
        for i in range(3):
            push[i] = law.disturbance(i)
        deep, roll, pitch = abs(y[0] - ref[0]), abs(y[1] - ref[1]), abs(y[2] - ref[2])
        off = roll if roll > pitch else pitch
        self._level = off < _QUIET_100nrad
        self._quiet = not self._cut and deep < _QUIET_100nm and self._level
        rests = self._quiet and self.ladder.level < failsafe.SURFACE
        self._still = rests and self.set_point.is_neutral(_STILL_uN, _STILL_uNm)
        self.ladder.watch(self._unwatched_us, deep, off, self._cut, push, self._still)
        self._unwatched_us = self._cut = 0

    def arm_faults(self, hello, loop_max_us):
        """What speaks against arming, as the bit mask of failsafe.arm_faults.

        For an armed robot, which is called back from surfacing, the ESCs and the set-point are as they shall be.
        """
        armed = self.state == _ARMED
        return failsafe.arm_faults(
            hello,
            self.plane,
            self.battery_low,
            self.leak,
            armed or self.set_point.is_neutral(),
            self.set_point.age_us,
            _NEVER_US if armed else self.esc_us,
            self.ladder,
            loop_max_us,
            self.tare_old and not armed,
            self.killed,
            self.mode != _BENCH and not self._checked,
        )

    def arm(self):
        """Start the motors from rest, or go back to work from surfacing."""
        self.ladder.resume()
        if self.state == _ARMED:
            return
        self._owed = self._lost_us = 0
        self._failed = False
        self._begin()
        if self.probe:
            self.probe.begin()
        self.state = _ARMED

    def _begin(self):
        """Law and thrusters from rest, where the robot is."""
        plane = self.plane
        self._y[:] = (plane.depth_100nm, plane.roll_100nrad, plane.pitch_100nrad)
        self.law.reset(self._y)
        for i in range(3):
            self._realised[i] = 0
        for j in range(8):
            self._forces_uN[j] = 0

    def disarm(self):
        """All pulses to neutral, now."""
        self.state = _DISARMED
        self.mode = _HOLD
        self.saturated = 0
        for j in range(8):
            self.pulses_us[j] = self.neutral_us[j]


def _along(weight_uN, tilt_100nrad):
    """The force along an axis which leans so far that carries this weight: it over the cosine, by its series."""
    x = min(abs(tilt_100nrad), _STEEPEST_100nrad) >> 8
    square = x * x // 46566  # of the angle, in 1/32768
    more = 6827 + (square * (2776 + (square * 1126 >> 15)) >> 15)
    return weight_uN + ((weight_uN >> 10) * (square * (16384 + (square * more >> 15)) >> 15) >> 5)
