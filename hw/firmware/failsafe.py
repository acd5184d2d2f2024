# What to do when the host falls silent, water comes in or the robot lies on its side: levels and arming checks.
# Pure: time comes as microseconds since the last cycle, so that a table can test it on any interpreter.
from micropython import const

OK, HOLD, SURFACE, DISARM, LATCHED = 0, 1, 2, 3, 4

_HOLD_AFTER_US = const(500000)  # 10 lost set-points at 20 Hz
_SURFACE_AFTER_US = const(3000000)  # as ArduSub's pilot input
_DISARM_AFTER_US = const(30000000)  # of surfacing without reaching the surface: it is held fast, or out of power
_SURFACED_100nm = const(1000000)  # 10 cm
_SURFACED_FOR_US = const(2000000)
_TILT_100nrad = const(7850000)  # 45 degrees
_TILT_FOR_US = const(2000000)
_BATTERY_FOR_US = const(2000000)  # sag under a burst of thrust is not an empty battery

_ARM_TILT_100nrad = const(3490000)  # 20 degrees
_ARM_PARITY_100nm = const(50000)  # 5 mm
_ESC_NEUTRAL_US = const(3000000)  # an ESC arms after 3 s of neutral pulses
_LOOP_LIMIT_US = const(9000)

WIRING = 5184  # number of wiring.py's table: of another one `aucamp board check` knows nothing

# Nudges of T1 to T4, cycles; how late thrusters and law show them; how much of them is a sign.
_NUDGE_PART = const(23)
_NUDGE_LATE = const(6)
_WEAK_SHOWS = const(4)
_WEAK_SHOWS_TWICE = const(14)  # both times together: currents show as much once
_CROSSED_SHOWS = const(14)
_SETTLES = const(2)  # nudges after one in which the robot leant: what the law learnt of the push has to be forgotten
_TIMES = const(2)  # in a row, of a robot that shall stay where it is
_TIMES_UNDER_WAY = const(4)  # of one that is asked to go somewhere: what pushes it changes as nudges do
_BENT_100nm = const(80000)  # out of the plane, where motion makes 4 mm

# Indices of wire.REASONS
_NONE = const(0)
_ORDER = const(1)
_SILENT = const(2)
_LEAK = const(3)
_BATTERY = const(4)
_SENSORS = const(5)
_SURFACED = const(6)
_STUCK = const(7)
_TILTED = const(8)
_TWO_BAD = const(9)
_NOT_HOLDING = const(15)
_OVERTURNED = const(16)
_CONTRADICTED = const(17)
_WEAK = const(18)  # T1; the next three are T2 to T4, or pairs round the hull
_REVERSED = const(22)
_CROSSED = const(26)
_SENSORS_CROSSED = const(30)
_STILL = const(31)
_BAD = const(32)

_ERROR_100nm = const(500000)  # 5 cm, 8 degrees: with all thrust spent on it, that is not held
_ERROR_100nrad = const(1400000)
_NOT_HOLDING_US = const(3000000)
_PUSHED_US = const(2000000)
_OVER_FOR_US = const(30000)
_PLANE_100nm = const(200000)  # four sensors in a plane within 2 cm, or no tilt is believed
_USELESS_100nm = const(2000000)  # 20 cm out of it: nobody knows how the robot lies
# The moment that it takes to hold a robot level: it is badly trimmed, a thruster works against it, or it is not level.
_MOMENT_uNm = const(150000)
# By how much that may change while a robot is at rest and nobody asks for anything. A pair of sensors that drift alike
# makes it lean, and leaning takes a moment.
_CHANGE_uNm = const(45000)
_CHANGED_US = const(1500000)
_SETTLES_US = const(2000000)
_USUAL_SHIFT = const(9)  # of what it takes usually, a look of 40 ms: forgotten in 20 s


class Ladder:
    """Levels are climbed by triggers; down leads a fresh set-point (1 to 0) or an order (2 and 3 to 0)."""

    def __init__(self):
        self.level = OK
        self.reason = _NONE
        self.finding = _NONE  # the first thing that it surfaced or stopped for and a person has to look at
        self._surfacing_us = self._shallow_us = self._tilt_us = self._battery_us = 0
        self._over_us = self._helpless_us = self._moment_us = 0
        self._usual_uNm = [0, 0]  # what it takes to hold the robot level, roll and pitch
        self._still_us = self._changed_us = 0

    def found(self):
        """Whether it surfaces, or has stopped, for something that the board found, and no host's silence nor order."""
        return self.finding != _NONE

    def resume(self):
        """Go back to normal, by order. False where only a reboot helps."""
        if self.level != LATCHED:
            self.__init__()
        return self.level == OK

    def surface(self, reason):
        """Go up. Who does so already keeps a reason for which a person has to look."""
        if self._may_find() and (self.level < SURFACE or reason != _ORDER):
            self._climb(SURFACE, reason)

    def _may_find(self):
        """Not so where the motors are off, or it rises for a finding: the first stands."""
        return self.level < SURFACE or self.level == SURFACE and not self.finding

    def give_up(self, reason=None):
        """Disarm; without a reason, for the one that stands."""
        self._climb(DISARM, self.reason if reason is None else reason)

    def latch(self, reason):
        """Neutral until reboot."""
        self._climb(LATCHED, reason)

    def step(self, dt_us, age_us, ttl_us, plane, leak, battery_low):
        """One cycle while armed; age_us is that of the newest set-point, plane a pressure.Plane. Returns the level."""
        if self.level >= DISARM:
            return self.level
        tilt = max(abs(plane.roll_100nrad), abs(plane.pitch_100nrad))
        self._tilt_us = self._tilt_us + dt_us if tilt > _TILT_100nrad else 0
        self._battery_us = self._battery_us + dt_us if battery_low else 0
        flat = -_PLANE_100nm < plane.parity_100nm < _PLANE_100nm
        self._over_us = self._over_us + dt_us if flat and plane.over else 0
        if plane.bad_count >= 2:
            self._climb(DISARM, _STILL if plane.still else _TWO_BAD)
        elif plane.upside_down or self._over_us >= _OVER_FOR_US:
            self._climb(DISARM, _OVERTURNED)
        elif plane.disagree and not -_USELESS_100nm < plane.parity_100nm < _USELESS_100nm:
            self._climb(DISARM, _SENSORS)
        elif self._tilt_us >= _TILT_FOR_US:
            self._climb(DISARM, _TILTED)
        elif self.level == SURFACE:
            self._surfacing_us += dt_us
            self._shallow_us = self._shallow_us + dt_us if plane.depth_100nm < _SURFACED_100nm else 0
            if self._shallow_us >= _SURFACED_FOR_US:
                self._climb(DISARM, _SURFACED)
            elif self._surfacing_us > _DISARM_AFTER_US:
                self._climb(DISARM, _STUCK)
            elif not self.finding:
                self._look(plane, leak)
        elif self._look(plane, leak):
            pass
        elif age_us > _SURFACE_AFTER_US:
            self._climb(SURFACE, _SILENT)
        elif age_us > min(_HOLD_AFTER_US, ttl_us):
            self._climb(HOLD, _SILENT)
        else:
            self._climb(OK, _NONE)
        return self.level

    def _look(self, plane, leak):
        """Go up for what is found; whether there is something."""
        reason = _NONE
        if leak:
            reason = _LEAK
        elif self._battery_us >= _BATTERY_FOR_US:
            reason = _BATTERY
        elif plane.disagree:
            reason = _SENSORS
        elif plane.leans:
            reason = _CONTRADICTED
        elif self._helpless_us >= _NOT_HOLDING_US:
            reason = _NOT_HOLDING
        elif plane.bad_count and self.level == SURFACE:  # one that dives is flown with the other three
            reason = _BAD
        if reason:
            self._climb(SURFACE, reason)
        return reason

    def watch(self, dt_us, depth_100nm, tilt_100nrad, saturated, push, still):
        """What control came to since the last look: the largest errors, whether all thrust was spent, the push that the
        law believes in, uN down and uNm, and whether the robot is at rest and shall be."""
        far = depth_100nm > _ERROR_100nm or tilt_100nrad > _ERROR_100nrad
        self._helpless_us = self._helpless_us + dt_us if far and saturated else 0
        _, roll, pitch = push
        self._moment_us = self._moment_us + dt_us if max(abs(roll), abs(pitch)) > _MOMENT_uNm else 0
        if self._moment_us >= _PUSHED_US:
            reason = pushed_by(*push)
            if reason != _CONTRADICTED or self._moment_us >= _NOT_HOLDING_US:  # nudges may still say whose it is
                self.suspect(reason)
        elif self._has_changed(dt_us, roll, pitch, still):
            self.suspect(_CONTRADICTED)

    def _has_changed(self, dt_us, roll, pitch, still):
        """Whether another moment holds the robot level than before, though nothing happened to it."""
        usual = self._usual_uNm
        if not still or self._still_us < _SETTLES_US:
            self._still_us = self._still_us + dt_us if still else 0
            self._changed_us = 0
            usual[0], usual[1] = roll, pitch
            return False
        roll -= usual[0]
        pitch -= usual[1]
        if -_CHANGE_uNm < roll < _CHANGE_uNm and -_CHANGE_uNm < pitch < _CHANGE_uNm:
            self._changed_us = max(0, self._changed_us - dt_us)
            usual[0] += roll >> _USUAL_SHIFT
            usual[1] += pitch >> _USUAL_SHIFT
        else:
            self._changed_us += dt_us
        return self._changed_us >= _CHANGED_US

    def suspect(self, reason):
        """Something does not do what it is told: up, or, where control pushes the wrong way, off."""
        if self._may_find():
            self._climb(DISARM if _REVERSED <= reason < _CROSSED else SURFACE, reason)

    def _climb(self, level, reason):
        self.level = level
        self.reason = reason
        if level >= SURFACE and not self.finding and reason not in (_ORDER, _SILENT, _SURFACED):
            self.finding = reason


class Probe:
    """Along one direction T1 to T4 push against each other and nothing moves. They are nudged along it again and again,
    and what moves then tells which of them does not do what it is told."""

    def __init__(self, every):
        """every: cycles from nudge to nudge, 100 or more."""
        self._every = every
        self.begin()

    def begin(self):
        """From the first nudge after arming."""
        self._at = self._named = self._times = self._roll = self._pitch = self._small = 0
        self._quiet = self._still = True  # since the nudge began
        self._unsettled = 0  # nudges that show nothing yet
        self._parity = None  # at the beginning
        self.rocking = True  # once, to see whether its sensors follow

    def sign(self):
        """Of the nudge in this cycle: + - - +, which no drift looks like."""
        at = self._at
        if at >= 4 * _NUDGE_PART:
            return 0
        return -1 if _NUDGE_PART <= at < 3 * _NUDGE_PART else 1

    def rock(self):
        """Sign of the moments in roll and pitch in this cycle: + + - -."""
        at = self._at
        return 0 if at >= 4 * _NUDGE_PART else -1 if at >= 2 * _NUDGE_PART else 1

    def rocked(self, parity_100nm):
        """An index of wire.REASONS where sensors do not follow, else 0: what two neighbours that are crossed should
        show of being rocked, they show as a plane that bends."""
        if self._parity is None:
            self._parity = parity_100nm
        bent = parity_100nm - self._parity
        return 0 if -_BENT_100nm < bent < _BENT_100nm else _SENSORS_CROSSED

    def step(self, roll, pitch, full_mN, level, quiet, still):
        """End a cycle with the moments that the law believes in, uNm, and the full thrust, mN. What does not do what it
        is told, as an index of wire.REASONS, where nudges in a row have shown the same; else 0. A nudge that was not
        given in quiet, the robot level and at its depth, shows nothing, nor do two after one in which it leant; still:
        nobody asks it to go anywhere either."""
        self._at = (self._at + 1) % self._every
        if not level:
            self._unsettled = _SETTLES + 1
        if not quiet:
            self._quiet = False
        if not still:
            self._still = False
        late = self._at - _NUDGE_LATE
        if 0 <= late < 4 * _NUDGE_PART:
            if _NUDGE_PART <= late < 3 * _NUDGE_PART:
                roll, pitch = -roll, -pitch
            self._roll += roll
            self._pitch += pitch
        elif late == 4 * _NUDGE_PART:
            full = full_mN * 125 >> 7  # of uN, 1024 at a time
            roll, pitch = self._roll * 5 // (24 * full), self._pitch * 5 // (32 * full)
            named = _moved(roll, pitch)
            if self._unsettled:
                self._unsettled -= 1
                named = 0
            if not self._quiet:
                named = 0
            self._roll = self._pitch = 0
            small = min(abs(roll), abs(pitch))
            self._times, self._named = self._times + 1 if named == self._named else 1, named
            again = self._times >= (_TIMES if self._still else _TIMES_UNDER_WAY)
            both, self._small = small + self._small, small
            self._quiet = self._still = True
            self.rocking = False
            return named if again and (named >= _CROSSED or both >= _WEAK_SHOWS_TWICE) else 0
        return 0


def _moved(roll, pitch):
    """What a nudge that moved the robot so says, in thirtieths of what one thruster gives: one that is dead shows a
    third of that in both, as far as the law sees it in so short a time, two that are crossed as much in one alone."""
    big, small = max(abs(roll), abs(pitch)), min(abs(roll), abs(pitch))
    if big >= _CROSSED_SHOWS and big >= 3 * small:
        if big == abs(roll):
            return _CROSSED + (3 if roll > 0 else 1)
        return _CROSSED + (2 if pitch > 0 else 0)
    if small >= _WEAK_SHOWS and big < 3 * small:
        return _WEAK + ((3 if pitch > 0 else 0) if roll > 0 else (2 if pitch > 0 else 1))
    return 0


def pushed_by(down, roll, pitch):
    """Whose a push is that does not end, by the law's belief in uN and uNm: a thruster's against it, or nobody's."""
    roll, pitch = roll // 6, pitch // 8
    big, small = max(abs(roll), abs(pitch)), min(abs(roll), abs(pitch))
    if 2 * big > 5 * small:
        return _CONTRADICTED
    lifts = down < 0
    if (roll > 0) == (pitch > 0):
        return _REVERSED + (1 if lifts == (roll > 0) else 3)
    return _REVERSED + (0 if lifts == (roll > 0) else 2)


def arm_faults(
    hello, plane, battery_low, leak, neutral, age_us, esc_us, ladder, loop_max_us, tare_old, killed, unchecked
):
    """Bit mask, in the order of wire.ARM_CHECKS, of all that speaks against arming; 0: go.

    hello: the handshake agreed; neutral: no planar push, no tilt is asked for; esc_us: for how long all pulses have
    been neutral, and ESCs there to hear them; tare_old: it was made more than 12 h ago; killed: the loop of the
    kill switch is open; unchecked: nobody has passed `aucamp board check` with this wiring.
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
        age_us > _HOLD_AFTER_US,
        esc_us < _ESC_NEUTRAL_US,
        ladder.level == LATCHED,
        loop_max_us >= _LOOP_LIMIT_US,
        tare_old,
        killed,
        unchecked,
        plane.upside_down,
    )
    mask = 0
    for i in range(len(checks)):
        if checks[i]:
            mask |= 1 << i
    return mask
