# From pressures and set-point to pulses, armed or not. No bytes, no hardware: those are tether.py and the HAL.
import failsafe
import law
import pressure
import thrust
import wire

SENSOR_HALF_M = 0.13  # sensors sit at (+-0.13, +-0.13) m
BATTERY_MIN_MV = 12000  # 3.0 V a cell of four; below it the ESCs brown out
NEVER_US = 1 << 29  # an age that is past every limit and fits the board's 31 bit integers


class SetPoint:
    """What the host asked for last, and how long ago."""

    def __init__(self):
        self.age_us = NEVER_US
        self.ttl_us = 0
        self.seq = 0  # of the frame that brought it
        self.depth_m = 0.0
        self.tilt_rad = [0.0, 0.0]  # roll, pitch
        self.force_n = [0.0, 0.0]  # forward, left
        self.yaw_nm = 0.0

    def is_neutral(self):
        return not (any(self.force_n) or any(self.tilt_rad) or self.yaw_nm)

    def level_out(self):
        """No tilt, no planar push."""
        self.tilt_rad[0] = self.tilt_rad[1] = self.force_n[0] = self.force_n[1] = self.yaw_nm = 0.0


class Control:
    """State of the motors. Every buffer is made here, none in the cycle."""

    def __init__(self):
        self.state = wire.DISARMED
        self.plane = pressure.Plane(wire.PA_PER_M, SENSOR_HALF_M, SENSOR_HALF_M)
        self.ladder = failsafe.Ladder()
        self.law = law.choose("observer")
        self.set_point = SetPoint()
        self.neutral_us = [thrust.NEUTRAL_US] * 8
        self.pulses_us = [thrust.NEUTRAL_US] * 8
        self.saturated = 0  # bit 0 central, bit 1 flat thrusters
        self.esc_us = 0  # for how long all pulses have been neutral
        self.leak = False
        self.battery_low = False
        # one value each for depth, roll, pitch
        self._y = [0.0] * 3
        self._ref = [0.0] * 3
        self._want = [0.0] * 3
        self._realised = [0.0] * 3
        self._forces_n = [0.0] * 8

    def sense(self, pressure_pa, answered, battery_mv, leak, dt_us):
        """Begin a cycle with what the sensors say."""
        self.set_point.age_us = min(self.set_point.age_us + dt_us, NEVER_US)
        self.leak = bool(leak)
        self.battery_low = battery_mv < BATTERY_MIN_MV
        self.plane.step(pressure_pa, answered, dt_us)

    def act(self, dt_us):
        """End a cycle: new pulses. Returns whether the ladder moved."""
        if self.state == wire.DISARMED:
            self.esc_us = min(self.esc_us + dt_us, NEVER_US)
            return False
        self.esc_us = 0
        before = self.ladder.level
        level = self.ladder.step(
            dt_us, self.set_point.age_us, self.set_point.ttl_us, self.plane, self.leak, self.battery_low
        )
        if level >= failsafe.DISARM:
            self.disarm()
            return True
        if level >= failsafe.HOLD:
            self.set_point.level_out()
        if level == failsafe.SURFACE:
            if before != level:
                self.set_point.depth_m = self.plane.depth_m
            self.set_point.depth_m = max(0.0, self.set_point.depth_m - failsafe.ASCENT_M_S * dt_us * 1e-6)
        self._drive()
        return level != before

    def _drive(self):
        plane, set_point = self.plane, self.set_point
        self._y[0], self._y[1], self._y[2] = plane.depth_m, plane.roll_rad, plane.pitch_rad
        self._ref[0], self._ref[1], self._ref[2] = set_point.depth_m, set_point.tilt_rad[0], set_point.tilt_rad[1]
        self.law.step(self._y, self._ref, self._realised, self._want)
        self.saturated = 1 if thrust.central(self._want, 0.0, self._forces_n, self._realised) else 0
        if thrust.flat(set_point.force_n[0], set_point.force_n[1], set_point.yaw_nm, self._forces_n):
            self.saturated |= 2
        for j in range(8):
            self.pulses_us[j] = thrust.pulse_us(self._forces_n[j], self.neutral_us[j])

    def arm_faults(self, hello, loop_max_us):
        """What speaks against arming, as the bit mask of failsafe.arm_faults.

        For an armed robot, which is called back from surfacing, the ESCs and the set-point are as they shall be.
        """
        armed = self.state == wire.ARMED
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
        )

    def arm(self):
        """Start the motors from rest, or go back to work from surfacing."""
        self.ladder.resume()
        if self.state == wire.ARMED:
            return
        self.state = wire.ARMED
        self._y[0], self._y[1], self._y[2] = self.plane.depth_m, self.plane.roll_rad, self.plane.pitch_rad
        self.law.reset(self._y)
        self._realised[0] = self._realised[1] = self._realised[2] = 0.0

    def disarm(self):
        """All pulses to neutral, now."""
        self.state = wire.DISARMED
        self.saturated = 0
        for j in range(8):
            self.pulses_us[j] = self.neutral_us[j]
