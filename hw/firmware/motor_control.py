# From pressures and set-point to pulses, armed or not. No bytes, no hardware: those are tether.py and the HAL.
import math

import failsafe
import law
import parameters
import pressure
import frames
import thrust

SENSOR_HALF_M = 0.13  # sensors sit at (+-0.13, +-0.13) m
GRAVITY_M_S2 = 9.80665
BATTERY_S = 1.0  # the voltage that thrust is scaled with is smoothed over this: the probe's noise is not the battery's
STEEPEST_RAD = 0.785  # net weight is carried along the robot's own axis up to this tilt
NEVER_US = 1 << 29  # an age that is past every limit and fits the board's 31 bit integers
# A cycle whose control broke off is made up for by so many good ones; where debts add up, the robot goes up.
FAULT_CYCLES, FAULTS_LIMIT = 20, 10
LOST_US = 500000  # without one good cycle, as long as a watchdog waits: nobody steers, and motors that do not obey stop
ABSURD = 1e6  # N and Nm: a law that asks for more has left the world of numbers
BENCH_US = 60  # over neutral: a propeller in air turns visibly and slowly


class SetPoint:
    """What the host asked for last, and how long ago."""

    def __init__(self):
        self.age_us = NEVER_US
        self.ttl_us = 0
        self.seq = 0  # of the frame that brought it
        self.host_ms = None  # the host's clock in it, modulo 2**32
        self.depth_100nm = 0
        self.tilt_100nrad = [0, 0]  # roll, pitch
        self.force_uN = [0, 0]  # forward, left
        self.yaw_uNm = 0

    @property
    def depth_m(self):
        return self.depth_100nm * 1e-7

    @depth_m.setter
    def depth_m(self, depth_m):
        self.depth_100nm = int(round(depth_m * 1e7))

    def is_neutral(self):
        return not (any(self.force_uN) or any(self.tilt_100nrad) or self.yaw_uNm)

    def level_out(self):
        """No tilt, no planar push."""
        self.tilt_100nrad[0] = self.tilt_100nrad[1] = self.force_uN[0] = self.force_uN[1] = self.yaw_uNm = 0


class Control:
    """State of the motors. Every buffer is made here, none in the cycle."""

    def __init__(self):
        self.state = frames.DISARMED
        self.mode = frames.HOLD
        self.bench_thruster = 0  # 1-8: turns in mode BENCH
        self.plane = pressure.Plane(frames.PA_PER_M, SENSOR_HALF_M, SENSOR_HALF_M)
        self.ladder = failsafe.Ladder()
        self.set_point = SetPoint()
        self.neutral_us = [thrust.NEUTRAL_US] * 8
        self.pulses_us = [thrust.NEUTRAL_US] * 8
        self.saturated = 0  # bit 0 central, bit 1 flat thrusters
        self.esc_us = 0  # for how long all pulses have been neutral
        self.leak = False
        self.battery_low = False
        self.tare_old = False
        self._owed = 0  # good cycles, after faults
        self._lost_us = 0  # since the last good cycle
        self._failed = False  # the last one was none
        self._battery_mv = 0.0  # smoothed
        self._forces_n = [0.0] * 8
        # one value each for depth, roll, pitch
        self._y = [0.0] * 3
        self._ref = [0.0] * 3
        self._want = [0.0] * 3
        self._realised = [0.0] * 3
        self.configure(parameters.from_flash({}))

    def configure(self, values):
        """Take new parameters, in the order of their table. For a disarmed robot: the law begins anew."""
        self.values = values
        of = {name: values[i] for i, name in enumerate(parameters.NAMES)}
        self.law = (
            law.Pi,
            lambda: law.Pid(int(of["pid_set"])),
            lambda: law.Observer(of["heave_kg"], of["tilt_kgm2"], of["lag_s"]),
        )[int(of["law"])]()
        self.plane.pa_per_m = of["water_kg_m3"] * GRAVITY_M_S2
        self._thrust_max_n = of["thrust_max_N"]
        self._net_weight_n = of["net_weight_N"]
        self._curve_battery_mv = of["curve_battery_mV"]
        self._battery_min_mv = of["battery_min_mV"]
        self._slew_n = of["slew_N"]
        for j in range(8):
            self.neutral_us[j] = self.pulses_us[j] = int(of["zero_%d_us" % (j + 1)])

    def sense(self, pressure_pa, answered, battery_mv, leak, dt_us):
        """Begin a cycle with what the sensors say."""
        self.set_point.age_us = min(self.set_point.age_us + dt_us, NEVER_US)
        self.leak = bool(leak)
        self.battery_low = battery_mv < self._battery_min_mv
        if self._battery_mv:
            self._battery_mv += (battery_mv - self._battery_mv) * min(1.0, dt_us * 1e-6 / BATTERY_S)
        else:
            self._battery_mv = float(battery_mv)
        self.plane.step(pressure_pa, answered, dt_us)

    def act(self, dt_us):
        """End a cycle: new pulses. Returns whether the ladder moved."""
        if self.state == frames.DISARMED:
            self.esc_us = min(self.esc_us + dt_us, NEVER_US)
            return False
        self.esc_us = 0
        if self._owed:
            self._recover()
        before = self.ladder.level
        level = self.ladder.step(
            dt_us, self.set_point.age_us, self.set_point.ttl_us, self.plane, self.leak, self.battery_low
        )
        if level >= failsafe.HOLD and self.mode == frames.BENCH:
            self.ladder.give_up()
            level = failsafe.DISARM
        if level >= failsafe.DISARM:
            self.disarm()
            return True
        if level >= failsafe.HOLD:
            self.set_point.level_out()
            if self.mode == frames.STABILISE:  # with nobody there, drifting up or down is no option
                self.hold_here()
        if level == failsafe.SURFACE:
            if before != level:
                self.set_point.depth_m = self.plane.depth_m
            self.set_point.depth_m = max(failsafe.AFLOAT_M, self.set_point.depth_m - failsafe.ASCENT_M_S * dt_us * 1e-6)
        if self.mode == frames.BENCH:
            self._turn_one()
        else:
            self._drive()
        return level != before

    def fail(self, dt_us):
        """End a cycle that broke off: the last pulses stand. Returns whether the ladder moved."""
        if self.state == frames.DISARMED:
            return False
        before = self.ladder.level
        self._owed = min(self._owed + FAULT_CYCLES, FAULTS_LIMIT * FAULT_CYCLES)
        self._lost_us += dt_us
        self._failed = True
        if self._lost_us >= LOST_US or self.mode == frames.BENCH:
            self.ladder.give_up(failsafe.FAULT)
            self.disarm()
        elif self._owed == FAULTS_LIMIT * FAULT_CYCLES:
            self.surface(failsafe.FAULT)
        return self.ladder.level != before

    def _recover(self):
        """Begin a cycle while good ones are owed: if the last was one it counts, else the law begins anew, for what
        it believed may be what broke it."""
        if self._failed:
            self._failed = False
            self._begin()
        else:
            self._owed -= 1
            self._lost_us = 0

    def surface(self, reason=failsafe.ORDER):
        """Go up level, whatever the set-point says, until an order to arm calls the robot back."""
        if self.ladder.level < failsafe.SURFACE:
            self.ladder.surface(reason)
            self.hold_here()
            self.set_point.level_out()

    def hold_here(self):
        """Keep the depth that there is."""
        self.mode = frames.HOLD
        self.set_point.depth_m = self.plane.depth_m

    def _turn_one(self):
        for j in range(8):
            self.pulses_us[j] = self.neutral_us[j] + (BENCH_US if j + 1 == self.bench_thruster else 0)

    def _drive(self):
        plane, set_point, y, want, realised = self.plane, self.set_point, self._y, self._want, self._realised
        y[0], y[1], y[2] = plane.depth_m, plane.roll_rad, plane.pitch_rad
        self._ref[0] = set_point.depth_m
        self._ref[1], self._ref[2] = [x * 1e-7 for x in set_point.tilt_100nrad]
        if self.mode == frames.STABILISE:
            self._ref[0] = y[0]
        self.law.step(y, self._ref, realised, want)
        if not -ABSURD < want[0] + want[1] + want[2] < ABSURD:  # no number is neither: it would run all motors full
            raise ValueError("law diverged")
        if self.mode == frames.STABILISE:
            want[0] = 0.0
        # What carries the weight is none of the law's: it neither asks for it nor learns of it.
        weight_n = self._net_weight_n
        if weight_n:
            weight_n /= math.cos(min(abs(y[1]), STEEPEST_RAD)) * math.cos(min(abs(y[2]), STEEPEST_RAD))
        want[0] += weight_n
        full = thrust.full_n(self._thrust_max_n, self._battery_mv / self._curve_battery_mv)
        self.saturated = 1 if thrust.central(want, 0.0, full, self._slew_n, self._forces_n, realised) else 0
        realised[0] -= weight_n
        if thrust.flat(
            set_point.force_uN[0] * 1e-6, set_point.force_uN[1] * 1e-6, set_point.yaw_uNm * 1e-6, full, self._forces_n
        ):
            self.saturated |= 2
        for j in range(8):
            self.pulses_us[j] = thrust.pulse_us(self._forces_n[j], self.neutral_us[j], full)

    def arm_faults(self, hello, loop_max_us):
        """What speaks against arming, as the bit mask of failsafe.arm_faults.

        For an armed robot, which is called back from surfacing, the ESCs and the set-point are as they shall be.
        """
        armed = self.state == frames.ARMED
        return failsafe.arm_faults(
            hello,
            self.plane,
            self.battery_low,
            self.leak,
            armed or self.set_point.is_neutral(),
            self.set_point.age_us,
            NEVER_US if armed else self.esc_us,
            self.ladder,
            loop_max_us,
            self.tare_old and not armed,
        )

    def arm(self):
        """Start the motors from rest, or go back to work from surfacing."""
        self.ladder.resume()
        if self.state == frames.ARMED:
            return
        self._owed = self._lost_us = 0
        self._failed = False
        self._begin()
        self.state = frames.ARMED

    def _begin(self):
        """Law and thrusters from rest, where the robot is."""
        self._y[0], self._y[1], self._y[2] = self.plane.depth_m, self.plane.roll_rad, self.plane.pitch_rad
        self.law.reset(self._y)
        for i in range(3):
            self._realised[i] = 0.0
        for j in range(8):
            self._forces_n[j] = 0.0

    def disarm(self):
        """All pulses to neutral, now."""
        self.state = frames.DISARMED
        self.mode = frames.HOLD
        self.saturated = 0
        for j in range(8):
            self.pulses_us[j] = self.neutral_us[j]
