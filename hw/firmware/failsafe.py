# What to do when the host falls silent, water comes in or the robot lies on its side: levels and arming checks.
# Pure: time comes as microseconds since the last cycle, so that a table can test it on any interpreter.
from micropython import const

OK, HOLD, SURFACE, DISARM, LATCHED = 0, 1, 2, 3, 4

HOLD_AFTER_US = 500000  # 10 lost set-points at 20 Hz
_SURFACE_AFTER_US = const(3000000)  # as ArduSub's pilot input
_DISARM_AFTER_US = const(30000000)  # of surfacing without reaching the surface: it is held fast, or out of power
_SURFACED_100nm = const(1000000)  # 10 cm
_SURFACED_FOR_US = const(2000000)
AFLOAT_100nm = 800000  # where surfacing ends: a hull lifted out of the water would plunge when the motors stop
_TILT_100nrad = const(7850000)  # 45 degrees
_TILT_FOR_US = const(2000000)
_BATTERY_FOR_US = const(2000000)  # sag under a burst of thrust is not an empty battery
ASCENT_MM_S = 70

_ARM_TILT_100nrad = const(3490000)  # 20 degrees
_ARM_PARITY_100nm = const(50000)  # 5 mm
_ESC_NEUTRAL_US = const(3000000)  # an ESC arms after 3 s of neutral pulses
_LOOP_LIMIT_US = const(9000)
TARE_FOR_MS = 12 * 3600 * 1000  # the weather moves by 1 hPa, a centimetre of water, within hours
TARE_AHEAD_MS = 600000  # a clock without a time server goes wrong by so much in months, and weather does not in minutes

# Indices of wire.REASONS
_NONE = const(0)
ORDER = 1
_SILENT = const(2)
_LEAK = const(3)
_BATTERY = const(4)
_SENSORS = const(5)
_SURFACED = const(6)
_STUCK = const(7)
_TILTED = const(8)
_TWO_BAD = const(9)
STOP, PARAMETERS, WATCHDOG, FAULT = 10, 11, 12, 13
KILLED = 14


class Ladder:
    """Levels are climbed by triggers; down leads a fresh set-point (1 to 0) or an order (2 and 3 to 0)."""

    def __init__(self):
        self.level = OK
        self.reason = _NONE
        self._surfacing_us = self._shallow_us = self._tilt_us = self._battery_us = 0

    def resume(self):
        """Go back to normal, by order. False where only a reboot helps."""
        if self.level != LATCHED:
            self.__init__()
        return self.level == OK

    def surface(self, reason):
        """Go up."""
        if self.level < SURFACE:
            self._climb(SURFACE, reason)

    def give_up(self, reason=None):
        """Disarm; without a reason, for the one that stands."""
        self._climb(DISARM, self.reason if reason is None else reason)

    def latch(self, reason):
        """Neutral until reboot."""
        self.level = LATCHED
        self.reason = reason

    def step(self, dt_us, age_us, ttl_us, plane, leak, battery_low):
        """One cycle while armed; age_us is that of the newest set-point, plane a pressure.Plane. Returns the level."""
        if self.level >= DISARM:
            return self.level
        tilt = max(abs(plane.roll_100nrad), abs(plane.pitch_100nrad))
        self._tilt_us = self._tilt_us + dt_us if tilt > _TILT_100nrad else 0
        self._battery_us = self._battery_us + dt_us if battery_low else 0
        if plane.bad_count >= 2:
            self._climb(DISARM, _TWO_BAD)
        elif self._tilt_us >= _TILT_FOR_US:
            self._climb(DISARM, _TILTED)
        elif self.level == SURFACE:
            self._surfacing_us += dt_us
            self._shallow_us = self._shallow_us + dt_us if plane.depth_100nm < _SURFACED_100nm else 0
            if self._shallow_us >= _SURFACED_FOR_US:
                self._climb(DISARM, _SURFACED)
            elif self._surfacing_us > _DISARM_AFTER_US:
                self._climb(DISARM, _STUCK)
        elif leak:
            self._climb(SURFACE, _LEAK)
        elif self._battery_us >= _BATTERY_FOR_US:
            self._climb(SURFACE, _BATTERY)
        elif plane.disagree:
            self._climb(SURFACE, _SENSORS)
        elif age_us > _SURFACE_AFTER_US:
            self._climb(SURFACE, _SILENT)
        elif age_us > min(HOLD_AFTER_US, ttl_us):
            self._climb(HOLD, _SILENT)
        else:
            self._climb(OK, _NONE)
        return self.level

    def _climb(self, level, reason):
        self.level = level
        self.reason = reason


def arm_faults(hello, plane, battery_low, leak, neutral, age_us, esc_us, ladder, loop_max_us, tare_old, killed):
    """Bit mask, in the order of wire.ARM_CHECKS, of all that speaks against arming; 0: go.

    hello: the handshake agreed; neutral: no planar push, no tilt is asked for; esc_us: for how long all pulses have
    been neutral, and ESCs there to hear them; tare_old: it was made more than TARE_FOR_MS ago; killed: the loop of the
    kill switch is open.
    """
    checks = (
        not hello,
        plane.bad_count > 0,
        abs(plane.parity_100nm) > _ARM_PARITY_100nm,
        plane.tare_mPa is None,
        max(abs(plane.roll_100nrad), abs(plane.pitch_100nrad)) > _ARM_TILT_100nrad,
        battery_low,
        leak,
        not neutral,
        age_us > HOLD_AFTER_US,
        esc_us < _ESC_NEUTRAL_US,
        ladder.level == LATCHED,
        loop_max_us >= _LOOP_LIMIT_US,
        tare_old,
        killed,
    )
    mask = 0
    for i in range(len(checks)):
        if checks[i]:
            mask |= 1 << i
    return mask
