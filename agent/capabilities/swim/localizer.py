"""What a swimming robot knows of where it is, between steps: landmarks in, poses at any time of the last seconds out.

The gyro's readings are checked first, and where the gimbal was told to point is remembered: both go into the pose.
Until landmarks have said once where it is, it knows nothing: the fleet file's pose is where it shall be.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec import UNSET

from agent.capabilities.swim.barrier import STILL as AT_REST
from agent.capabilities.swim.event_ring import (
    RING_NS,
    Event,
    EventRing,
    Seen,
    Smoother,
    asked,
    fix,
    flow,
    offset_m,
    rate,
)
from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.plane_odometry import Moved, by_things, odometry
from agent.capabilities.swim.pose_filter import Belief, Drift, Hull, Wrench, basin, begin, learnt
from agent.capabilities.swim.projection import readable, view
from agent.capabilities.swim.tag_fix import (
    TURNING_DEG,
    Map,
    NoFix,
    Priors,
    TagFix,
    first_fix,
    priors,
    tag_fix,
    wake_rad,
    whole,
)
from agent.core.attitude import TARED, Attitude, Zeros
from agent.core.capability import CameraView
from agent.core.config import Body, Fleet
from agent.core.estimation.interface import Prior
from agent.core.linear_algebra import minus, plus, times
from agent.core.messages import Vector, Whereabouts
from agent.core.ranging.camera_model import BodyFit, Calibration, CameraFit, gimbal_deg
from agent.core.ranging.fix import MEMORY_S, Fix, OwnPose, carried, kappa, longest_gap_s
from agent.core.ranging.pointing import APPROACH_NS, LAG_NS, PLAY_US, ServoModel, Stand
from agent.core.step_io import Flow, SeenTags, Telemetry
from agent.core.step_transaction import Revertible

# --- gyro ---
# Whether a module's gyro can be believed: what it says is checked before it becomes a measurement.
#
# A gyro that works is never still: its noise is a few of the wire's steps, so that a value which comes again and
# again for a second is no measurement. One at the end of its scale turns faster than it can say.

FULL_SCALE_RAD_S = math.radians(249.0)  # of 250 deg/s, hw/firmware/gyro.py
LATE_NS = 10_000_000  # its low-pass of 25 Hz, and half a cycle of 10 ms until it is told
STUCK_NS, STUCK_READINGS = 1_000_000_000, 10
SILENT_NS = 1_000_000_000  # without a reading that can be used: nothing to be told of a lost frame or two


class Rate(NamedTuple):
    """A yaw rate that can be believed, and when it was so."""

    t_ns: int
    rad_s: float


class Gyro(Revertible):
    """Of one robot of a fleet that has them."""

    def __init__(self) -> None:
        self._value: float | None = None  # newest, whatever it is worth
        self._same_ns: int | None = None  # since when it is this one
        self._same = 0  # readings
        self._good_ns: int | None = None  # of the newest that could be used, or of the first telemetry
        self._wrong = ""  # with the newest reading

    def read(self, telemetry: Telemetry) -> Rate | None:
        """What one telemetry frame says; None: nothing that can be used."""
        rate, t_ns = telemetry.rate_rad_s, telemetry.t_ns
        if self._good_ns is None:
            self._good_ns = t_ns
        if rate is UNSET:
            self._value, self._wrong = None, "no reading; fit one, or write gyro = false"
            return None
        if rate != self._value or self._same_ns is None:
            self._value, self._same_ns, self._same = rate, t_ns, 0
        self._same += 1
        self._wrong = self._what_is_wrong(rate, t_ns - self._same_ns)
        if self._wrong:
            return None
        self._good_ns = t_ns
        return Rate(t_ns - LATE_NS, rate)

    def _what_is_wrong(self, rate_rad_s: float, same_for_ns: int) -> str:
        if abs(rate_rad_s) >= FULL_SCALE_RAD_S:
            return "at the end of its scale"
        if same_for_ns >= STUCK_NS and self._same >= STUCK_READINGS:
            return f"stuck at {math.degrees(rate_rad_s):.2f} deg/s"
        return ""

    def fault(self, now_ns: int) -> str | None:
        """What to tell people; None while it works, or telemetry has just begun."""
        if not self._wrong or self._good_ns is None or now_ns - self._good_ns < SILENT_NS:
            return None
        return f"gyro: {self._wrong}"


# --- commanded gimbal history ---
# Where the camera's gimbal pointed at a given time of the last seconds, and how sure that is.
#
# Tags tell the camera's heading whatever the gimbal does, so a frame that was exposed while the gimbal settles says
# as well as any where the robot is, and its yaw as well as the gimbal is known. Servos do not say where they are:
# what counts is when they were told (pointing.Pointing), first to a little below the goal, then to the goal; or each
# step to another angle (pointing.ServoModel).

TURNS = 16  # that are remembered: more than a key frame's four seconds hold
REST_NS = 250_000_000  # after the last leg, which is short and takes up the play. (A sweep waits longer, for the body.)


class Gimbal(NamedTuple):
    deg: tuple[float, float]  # pan and tilt as the servos really do them
    rests: bool  # False: it settles still, and may be off by some tenths of a degree
    tracks: bool = False  # it goes with a target, and its play is taken up to no side
    lag_sigma_deg: float = 0.0  # and while it turns, by what its servos' lag leaves open


class Turn(NamedTuple):
    """What the gimbal was told once."""

    told_ns: int
    leg_ns: int  # when the last leg begins, from below the goal
    goal_us: tuple[int, int]


class GimbalHistory(Revertible):
    """Of one robot's camera."""

    def __init__(self, camera: CameraFit, body: Body) -> None:
        self._camera, self._body = camera, body
        self._turns: deque[Turn] = deque(maxlen=TURNS)
        self._path, self._tracked = ServoModel(), False

    def add(self, camera: CameraView) -> None:
        """Take note of where it is told to turn now."""
        if camera.goal_us is None:
            return
        if camera.tracks:
            if not self._tracked:
                self._path.begin(self._turns[-1].goal_us if self._turns else camera.goal_us)
            self._path.add(camera.told_ns, camera.goal_us)
        elif not self._turns or self._turns[-1].told_ns != camera.told_ns:
            turn = Turn(camera.told_ns, camera.last_leg_ns, camera.goal_us)
            self._turns.append(turn)
        self._tracked = camera.tracks

    def at(self, t_ns: int) -> Gimbal | None:
        """None: it was on its way, or that was too long ago."""
        turn = next((turn for turn in reversed(self._turns) if turn.told_ns <= t_ns), None)
        stand = self._path.at(t_ns)
        if stand is not None and (turn is None or stand.told_ns > turn.told_ns):
            return self._on_path(stand)
        return None if turn is None else self._in(turn, t_ns)

    def _on_path(self, stand: Stand) -> Gimbal | None:
        """Where it had come to on its way from set-point to set-point."""
        if math.isinf(stand.sigma_us):
            return None
        sigma_deg = stand.sigma_us / self._body.servo_us_per_deg
        return Gimbal(gimbal_deg(self._camera, self._body, stand.us), False, True, sigma_deg)

    def _in(self, turn: Turn, t_ns: int) -> Gimbal | None:
        pan_us, tilt_us = turn.goal_us
        if t_ns < turn.leg_ns:
            begins_ns, pan_us, tilt_us = turn.leg_ns - APPROACH_NS, pan_us - PLAY_US, tilt_us - PLAY_US
        else:
            begins_ns = turn.leg_ns
        if t_ns < begins_ns + LAG_NS:
            return None
        return Gimbal(gimbal_deg(self._camera, self._body, (pan_us, tilt_us)), t_ns >= turn.leg_ns + REST_NS)


# --- localizer ---

STILL: Wrench = (*AT_REST, 0.0)
UNSURE_M, UNSURE_DEG = 0.03, 3.0  # beyond this it is worth a look at landmarks
SURE_M, SURE_DEG = 0.006, 0.5  # which is over when it knows as well as this
SETTLED, SETTLE_NS = 3, 600_000_000  # fixes after a measurement that it awaits, and for how long
LOST_M, LOST_DEG = 0.15, 10.0  # and beyond this it does not know where it is
ADRIFT_M, ADRIFT_DEG = 0.5, 45.0  # nor, beyond this, which way to brake or where landmarks should be
# A rolling shutter shears what it sees of a robot that turns; the rows' own times are not modelled. At this rate, with
# 30 ms from the first row to the last, a tag of 80 px is sheared by half a pixel: four times what its corners err.
ROLLING_RAD_S = math.radians(5.0)
# Frames in a row in which the play of a gimbal that goes with a target lies to the same side, which it changes about
# once in a second: a filter that takes each for a witness of its own would count the same error so often.
ALIKE = 10.0
AWAY_S = 1.0  # for which a camera that turns away sees no landmarks
# For so long after tags, or points, agreed with what a robot believes it knows its own motion well enough to tell the
# tank from a thing that swims by. Later, where points have contradicted it meanwhile, only tags can tell.
TELLS_NS = 1_000_000_000
SWIFTLY_S = 0.5  # the same of one that goes with what swims, and has some behind that soon
# Frames with tags of the last time, and shares of them without a pose: suspect, contradicted.
JUDGED_NS, FEWEST = 30_000_000_000, 10
WITHOUT = (0.1, 0.4)
CHECK = "check tag size, map, lens or water level"
TOO_LATE = 0.5  # of them


class Carriage(NamedTuple):
    """Of the camera, at one moment."""

    level: Attitude
    gimbal: Gimbal
    zeros: Zeros = TARED


class Unsettled(NamedTuple):
    """A measurement of a target that awaits what later frames say of where the robot was."""

    seen: Seen
    until_ns: int
    own: OwnPose
    filtered: Prior  # by what was known when it was made


class Localizer(Revertible):
    """Of one robot."""

    def __init__(self, fleet: Fleet, calibration: Calibration) -> None:
        assert fleet.landmarks is not None and fleet.navigation is not None  # a rule of the fleet file
        self._camera, self._focus = calibration.camera, calibration.focus
        self._rolls = fleet.camera.row_time_us > 0.0
        self._body, self._surface_m = fleet.body, fleet.tank.surface_m
        self._water_m = fleet.tank.size_m[0], fleet.tank.size_m[1], fleet.tank.surface_m
        self._basin = basin(fleet.tank.size_m)
        self._map = Map(fleet.landmarks, markers(fleet.landmarks))
        self.hull, self._gyro = hull_of(calibration.body), fleet.navigation.gyro
        self._ring: EventRing | None = None
        self._smoother = Smoother(self.hull, self._basin)
        self._asked = STILL
        self._followed_ns = 0  # exposure of the newest frame whose points agreed with it, or contradicted it
        self._fixes_ns: deque[int] = deque()
        self._sampled_ns: int | None = None
        self._unsettled: Unsettled | None = None
        self.refused = ""  # why the newest frame with landmarks gave no pose
        self._judged: deque[tuple[int, Literal["place", "none", "late"]]] = deque()  # frames with tags: exposure, use

    def see(self, frame: SeenTags, carriage: Carriage) -> None:
        """The landmarks of a frame; level and gimbal at its exposure."""
        of = view(self._camera, self._body, self._surface_m, frame.focus)
        tags = readable(frame.tags, self._map.landmarks.size_m, self._focus, frame.focus)
        if not tags:
            return
        before = self.at(frame.t_ns)
        if self._ring is not None and (before is None or frame.t_ns in self._fixes_ns):
            return  # from before what is still remembered, or known already
        if self._rolls and before is not None and abs(before.x[5]) > ROLLING_RAD_S and not self._astray(before):
            self.refused = "it turns too fast for a rolling shutter"
            return
        if before is None or self._astray(before):
            found = first_fix(of, _priors(carriage, None), self._map, tags)
        else:
            found = tag_fix(of, _priors(carriage, before), self._map, tags, before.pose)
        if isinstance(found, TagFix) or not found.ambiguous:
            self._judged.append((frame.t_ns, "none" if isinstance(found, NoFix) else "place"))
        if not isinstance(found, TagFix):
            self.refused = found.reason
            return
        self.refused = ""
        pose = found.theta[0], found.theta[1], found.theta[2]
        if self._ring is None or before is None or adrift(before):
            begun = begin(frame.t_ns, pose, found.fluctuates, found.stays, self._gyro)
            begun = begun if before is None else learnt(before, begun)
            self._ring = EventRing(begun, self.hull, Drift(), self._basin)
            self._asked = STILL
            self._smoother.reset()
        elif not self._tell(fix(frame.t_ns, pose, found.fluctuates, found.stays, found.tags - found.odd)):
            self._judged[-1] = frame.t_ns, "late"
            return
        self._fixes_ns.append(frame.t_ns)

    def _astray(self, then: Belief) -> bool:
        """It did not know where it was then, nor have landmarks told it since: what it believed is no place to begin
        the search for a pose from."""
        return not within(then, LOST_M, LOST_DEG) and not any(t_ns > then.t_ns for t_ns in self._fixes_ns)

    def follow(self, seen: Flow, then: Carriage, now: Carriage, focus: int | None, others_m: Sequence[Vector]) -> None:
        """Points of a key frame in a later one; level and gimbal at either exposure. others_m: robots to leave out."""
        key, before = self.at(seen.since_ns), self.at(seen.t_ns)
        if self._ring is None or key is None or before is None or adrift(before):
            return
        if self._followed_ns > before.agreed_ns and seen.t_ns - before.agreed_ns > TELLS_NS:
            return
        of = view(self._camera, self._body, self._surface_m, focus)
        start, end = whole(key.pose, _priors(then, key)), whole(before.pose, _priors(now, before))
        settling = (not then.gimbal.rests) + (not now.gimbal.rests)
        wake = math.hypot(*(wake_rad(math.hypot(belief.x[3], belief.x[4])) for belief in (key, before)))
        unsettled = settling * math.radians(TURNING_DEG)
        if then.gimbal.tracks or now.gimbal.tracks:
            lags = math.radians(then.gimbal.lag_sigma_deg), math.radians(now.gimbal.lag_sigma_deg)
            unsettled = math.hypot(math.sqrt(ALIKE) * unsettled, *lags)
        moved = odometry(of, start, end, seen.pairs, self._water_m, unsettled, wake, others_m)
        if moved == "too few":
            return
        if isinstance(moved, Moved):
            covariance = moved.covariance
            if then.gimbal.tracks or now.gimbal.tracks:
                covariance = plus(covariance, times(ALIKE, by_things(moved.pose)))
            self._tell(flow(seen.t_ns, seen.since_ns, moved.pose, covariance))
            after = self.at(seen.t_ns)
            if after is None or after.key_ns != seen.since_ns:
                return  # nothing was compared: the key frame was let go
        self._followed_ns = max(self._followed_ns, seen.t_ns)

    def turning(self, measured: Rate) -> None:
        """A gyro's yaw rate; only of a fleet whose robots have one."""
        self._tell(rate(*measured))

    def sent(self, wrench: Wrench, now_ns: int) -> None:
        """What the thrusters are asked for from now on; zeros while motors may not turn."""
        if wrench != self._asked and self._ring is not None:
            self._tell(asked(now_ns, wrench))
            self._asked = wrench

    def _tell(self, event: Event) -> bool:
        """Whether it came in time."""
        if self._ring is None or not self._ring.add(event):
            return False
        self._smoother.add(event)
        return True

    def sight(self, target: str, seen: Fix, known: tuple[Belief, OwnPose], filtered: Prior, now_ns: int) -> None:
        """A target was measured. known: of_sample(); seen: from there, that pose taken for exact (fix.EXACT);
        filtered: with what that pose has wrong in it."""
        there, own = known
        offset = offset_m(there.pose, seen.position_m)
        sighting = Seen(target, filtered.t_ns, offset, seen.random_m2, seen.systematic_m2)
        self._unsettled = Unsettled(sighting, now_ns + SETTLE_NS, own, filtered)

    @property
    def settling(self) -> bool:
        """Whether a measurement still awaits fixes: no sweep ought to begin, which shows none."""
        return self._unsettled is not None

    def settled(self, now_ns: int) -> tuple[str, Prior] | None:
        """The newest measurement and its target, once, as soon as enough fixes later than it are in or it has waited
        long enough. A pose amid a sweep is known far better with the fixes of both its sides."""
        if self._unsettled is None:
            return None
        seen, until_ns, own, filtered = self._unsettled
        if now_ns < until_ns and sum(t_ns > seen.t_ns for t_ns in self._fixes_ns) < SETTLED:
            return None
        self._unsettled, before = None, self.at(seen.t_ns - 1)
        smoothed = None if before is None else self._smoother.place(seen, before)
        if before is None or smoothed is None:
            return seen.target, filtered
        place, spread_m2 = smoothed
        random_m2 = plus(seen.random_m2, times(own.kappa, minus(spread_m2, seen.random_m2)))
        arm_m = place[0] - before.x[0], place[1] - before.x[1], 0.0
        systematic_m2 = plus(seen.alike_m2, carried(arm_m, own.stays))
        return seen.target, filtered._replace(x_m=place, random_m2=random_m2, systematic_m2=systematic_m2)

    def advance(self, now_ns: int) -> None:
        """Let go of what is old."""
        if self._ring is not None:
            self._ring.advance(now_ns)
        self._smoother.advance(now_ns)
        while self._fixes_ns and self._fixes_ns[0] < now_ns - round(MEMORY_S * 1e9):
            self._fixes_ns.popleft()
        while self._judged and self._judged[0][0] < now_ns - JUDGED_NS:
            self._judged.popleft()

    def fault(self) -> str | None:
        """That frames come too late, or tags, map, lens and water level do not fit together, for people."""
        count = max(len(self._judged), 1)
        without, late = (sum(use == what for _, use in self._judged) / count for what in ("none", "late"))
        if len(self._judged) >= FEWEST and late > TOO_LATE:
            ask = "ease the computer's load, or lower navigation.follow_hz"
            return f"tags: {100.0 * late:.0f} % of their frames are of no use, later than {RING_NS * 1e-9:.1f} s: {ask}"
        if len(self._judged) < FEWEST or without <= WITHOUT[0]:
            return None
        word = "contradicted" if without > WITHOUT[1] else "suspect"
        return f"tags: {word}: {100.0 * without:.0f} % of the frames with tags give no place: {CHECK}"

    def at(self, t_ns: int) -> Belief | None:
        """Where it was or is; None: it is not known."""
        return None if self._ring is None else self._ring.at(t_ns)

    @property
    def fixed_ns(self) -> int:
        """Exposure of the newest frame whose landmarks told it where it was; 0: none of the last seconds did."""
        return max(self._fixes_ns, default=0)

    @property
    def events(self) -> tuple[Event, ...]:
        """What has told it of its motion in the last moments, oldest first: forces asked for, fixes, rates."""
        return () if self._ring is None else self._ring.events

    def shown(self, now_ns: int) -> Whereabouts | None:
        """For telemetry: with what stays the same in every fix. None where it is lost."""
        here = self.at(now_ns)
        if here is None or not within(here, LOST_M, LOST_DEG):
            return None
        xx, _, _, yy, _, pp = plus(here.covariance, here.stays)
        x_m, y_m, psi = here.pose
        return Whereabouts(
            x_m=x_m,
            y_m=y_m,
            yaw_deg=math.degrees(psi),
            place_sigma_m=math.sqrt(xx + yy),
            yaw_sigma_deg=math.degrees(math.sqrt(pp)),
        )

    def of_sample(self, t_ns: int, now_ns: int) -> tuple[Belief, OwnPose] | None:
        """Where it was when a target was measured, and how well it knew; None: not well enough to tell others."""
        there = self.at(t_ns)
        if there is None or not within(there, LOST_M, LOST_DEG):
            return None
        since_s = MEMORY_S if self._sampled_ns is None else (t_ns - self._sampled_ns) * 1e-9
        self._sampled_ns = t_ns
        factor = kappa(max(since_s, 0.1), longest_gap_s(self._fixes_ns, now_ns))
        return there, OwnPose(there.covariance, there.stays, factor)


def hull_of(fit: BodyFit | None) -> Hull:
    """A robot's own constants where they were measured (`aucamp calibrate body`), else those of robots like it."""
    if fit is None:
        return Hull()
    return Hull(fit.mass_kg, fit.drag, fit.drag2, fit.inertia_kgm2, fit.turn_drag, fit.turn_drag2, fit.lag_s)


def within(belief: Belief, place_m: float, yaw_deg: float) -> bool:
    """Whether it knows where it is that well: one standard deviation."""
    place_sigma_m, yaw_sigma_deg = sigmas(belief)
    return place_sigma_m <= place_m and yaw_sigma_deg <= yaw_deg


def sigmas(belief: Belief) -> tuple[float, float]:
    """One standard deviation of place, m, and of yaw, degrees, of what fluctuates."""
    xx, _, _, yy, _, pp = belief.covariance
    return math.sqrt(xx + yy), math.degrees(math.sqrt(pp))


def adrift(belief: Belief) -> bool:
    """It knows too little for what it believed to be of use: its filter has a yaw that may go round."""
    return not within(belief, ADRIFT_M, ADRIFT_DEG)


def foresees(belief: Belief, away_s: float = AWAY_S) -> bool:
    """Whether it will not be unsure after a turn of its camera: it knows how it moves, and what pushes it.

    A robot that was just found by one frame or two knows neither; with no landmark in sight it would swim where chance
    has it.
    """
    xx, yy, pp = (_variance_ahead(belief, i, away_s) for i in range(3))
    return xx + yy <= UNSURE_M * UNSURE_M and pp <= math.radians(UNSURE_DEG) ** 2


def _variance_ahead(belief: Belief, i: int, seconds: float) -> float:
    """Of x, y or psi after that time, by the velocity and the push of now."""
    P, weights = belief.P, ((i, 1.0), (i + 3, seconds), (i + 6, 0.5 * seconds * seconds))
    total = 0.0
    for j, a in weights:
        for k, b in weights:
            total += a * b * P[j][k]
    return total


def _priors(carriage: Carriage, moving: Belief | None) -> Priors:
    """moving: None of a robot that is not known to."""
    speed_m_s = 0.0 if moving is None else math.hypot(moving.x[3], moving.x[4])
    gimbal = carriage.gimbal
    return priors(
        carriage.level,
        gimbal.deg,
        speed_m_s,
        turning=not gimbal.rests,
        lag_deg=gimbal.lag_sigma_deg,
        zeros=carriage.zeros,
    )
