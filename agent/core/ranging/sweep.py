"""Focus sweeps as a state machine: when to look everywhere, when around the last peak, and what a finished sweep gave.

A full sweep looks everywhere, once; tracking sweeps then visit a few positions around the last peak. After two without
a peak, the second one wider, the next one is a full sweep again. A sweep in which target or robot moved too far, or
whose frames came too slowly, is rejected, and the next one repeats it: a full one with half the positions, so that it
is over sooner. Where full sweeps keep giving nothing, there is a pause between them: a lens that always moves sees
nothing sharply for long.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec.structs import replace

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.fix import Outline
from agent.core.ranging.focus import Peak, fit_peak, phase_sigma
from agent.core.step_io import Sighting, SweepPlan, Telemetry
from agent.core.step_transaction import Revertible

WIDER = 2.0  # a tracking sweep after one that found nothing looks so much farther, once, before the next full sweep
STEP_LIMIT_PX = 12.0  # between frames that follow each other; above, they do not show the same patch
BOX_LIMIT = 0.12  # of a box's diagonal, if that is more: NanoTrack's box of a resting thing jumps by up to 0.06
# From the least to the most in a sweep, along the rows or the columns. Clarity is taken where the target is in each
# frame, so a steady drift costs little: 120 px move the peak by less than one lens position, its noise, in full and in
# tracking sweeps at 0.35, 0.6 and 1.0 m (twin); more was not measured. In its dives half of the tracking sweeps see
# less than 4 px, and the worst full one saw 97.
DRIFT_LIMIT_PX = 120.0
TILT_LIMIT_DEG = 2.0  # roll or pitch, from least to most in a sweep: 40 px, a sixth of the disc; hovering stays below 1
ALIKE = 0.07  # of a ball's radius: three times what blur does to it in one sweep
FOUND_SHARE = 0.7  # of a sweep's frames must show the target
SLACK_NS = 1_500_000_000  # a sweep that takes this much longer than it should, and has no more frames, is given up
STEP_NS = 200_000_000  # generous time for one position: lens at rest, exposure, transfer
FAILURES_BEFORE_FULL = 2  # tracking sweeps in a row without a peak
FEWEST_STEPS = 8  # of a full sweep that was halved: nine tenths of a peak's half width from one to the next
FAILURES_BEFORE_PAUSE = 3  # full sweeps in a row without a peak
PAUSE_NS = 2_000_000_000
TRACKED = 5  # tracking sweeps around a full one, by which timing is judged
TOGETHER_NS = 20_000_000_000  # how far from it they may be: a target at rest is moved now and then
LOST = 6  # sweeps without a peak of what one found: the lens is not where it is said
LATE_SIGMAS, LATE_S = 5.0, 0.02  # beyond which it is wrong; less lateness goes by while a frame waits for the lens


class Measurement(NamedTuple):
    """One accepted sweep, in lens and pixel terms; stamped with the time of its sharpest frame. Of a camera of fixed
    focus one frame."""

    sweep: int  # number of its plan
    t_ns: int
    lens_position: float | None  # of the peak; None: the focus is fixed
    sigma: float  # its standard deviation, lens positions
    width: float  # half width of the peak, lens positions
    held_width: float | None  # that the fit was told; None: it was free
    outline: Outline  # in the frame nearest to the peak: blur moves an edge
    quality: float  # correlation of curve and model, 0 to 1
    pace: float = 0.0  # of the lens, positions a second


class Paced(NamedTuple):
    """The peak of one sweep, and how fast the lens went: lens positions, a second."""

    t_ns: int
    lens_position: float
    sigma: float
    noise: float  # of any peak, by the calibration
    pace: float


class Rejected(NamedTuple):
    """Why a finished sweep gave nothing."""

    sweep: int  # number of its plan
    reason: str
    too_long: bool = False  # target or robot moved, or frames came slowly: fewer positions may succeed
    held_width: float | None = None  # as of a measurement, where a fit was made
    no_peak: bool = False  # the target was in view, and its clarity has no peak


class ByLight(NamedTuple):
    """What lamps change of a sweep in the dark."""

    around: float | None  # lens position at which the target is expected: what is far from sharp does not show; or none
    aside: bool  # others' lamps burn: some frames show the lit part of a ball as a ball of its own


SweepPhase = Literal["ready", "running", "pausing"]
SweepEvent = Literal["start", "end", "fail", "rest", "lose"]
SWEEP_PHASES: dict[tuple[SweepPhase, SweepEvent], SweepPhase] = {
    ("ready", "start"): "running",
    ("running", "end"): "ready",  # with a peak, or without one for the first or second time
    ("running", "fail"): "pausing",  # of full sweeps the third in a row without a peak, and each after it
    ("pausing", "rest"): "ready",  # the pause is over
    ("running", "lose"): "ready",  # the target is lost: the next sweep may start at once
    ("pausing", "lose"): "ready",
}


def next_phase(phase: SweepPhase, event: SweepEvent) -> SweepPhase:
    """An event that a phase does not know changes nothing."""
    return SWEEP_PHASES.get((phase, event), phase)


class Sweep(Revertible):
    """Plans sweeps and collects their frames. The caller decides when the next may start."""

    def __init__(self, fit: FocusFit, full_steps: int, waits_ns: int = 0) -> None:
        """waits_ns: how much longer a full one may take for its camera's timing."""
        self._fit, self._waits_ns = fit, waits_ns
        self._full_steps = full_steps
        self._number = 0
        self.phase: SweepPhase = "ready"
        self._plan: SweepPlan | None = None  # of phase running
        self._deadline_ns = 0
        self._rest_until_ns = 0  # of phase pausing
        self._frames: list[Sighting] = []
        self._tilts: list[tuple[float, float]] = []  # roll and pitch since the sweep began, degrees
        self._last: Measurement | None = None  # the peak to track
        self._by_light: ByLight | None = None
        self._before: Measurement | None = None  # the one before it
        self._failures = 0  # in a row, of tracking sweeps while there is a peak to track, of full ones else
        self._halvings = 0  # of the full sweep's positions
        self._remark: str | None = None
        self._remarked = False

    @property
    def running(self) -> bool:
        return self.phase == "running"

    def ready(self, now_ns: int) -> bool:
        """Whether the next sweep may start."""
        return not self.running and (self.phase == "ready" or now_ns >= self._rest_until_ns)

    def start(self, now_ns: int, by_light: ByLight | None = None) -> SweepPlan:
        """Begin the next sweep: full where there is no peak to track, and no hint where one may be."""
        self._by_light = by_light
        self.phase = next_phase(next_phase(self.phase, "rest"), "start")
        if self._last is not None:
            half_span = TRACK_SPAN * (WIDER if self._failures else 1.0)
            lens_positions = track_positions(self._last.lens_position or 0.0, self._last.width, half_span)
        elif by_light is not None and by_light.around is not None and self._failures % 2 == 0:
            lens_positions = expected_positions(by_light.around, self._fit.width, self._full_steps)
        else:
            fewest = min(FEWEST_STEPS, self._full_steps)
            lens_positions = full_positions(self._fit, max(self._full_steps >> self._halvings, fewest))
        self._number += 1
        self._frames, self._tilts = [], []
        self._plan = SweepPlan(sweep=self._number, focus=(home_position(lens_positions, self._fit), *lens_positions))
        self._deadline_ns = now_ns + SLACK_NS + len(lens_positions) * STEP_NS + self._waits_ns
        return self._plan

    def frame(self, sighting: Sighting) -> None:
        """Collect a frame of the running sweep; other frames are ignored."""
        if self._plan is not None and sighting.sweep == self._plan.sweep:
            self._frames.append(sighting)
            self._deadline_ns = max(self._deadline_ns, sighting.t_ns + SLACK_NS)

    def telemetry(self, telemetry: Telemetry) -> None:
        """Watch how still the robot is while a sweep runs."""
        if self._plan is not None:
            self._tilts.append((telemetry.roll_deg, telemetry.pitch_deg))

    def finish(self, now_ns: int) -> Measurement | Rejected | None:
        """The result once the last position has been seen or time has run out; None while the sweep runs."""
        if self._plan is None:
            return None
        complete = bool(self._frames) and self._frames[-1].index == len(self._plan.focus) - 1
        if not complete and now_ns < self._deadline_ns:
            return None
        number = self._plan.sweep
        result = self._result(number) if complete else Rejected(number, "not finished in time", too_long=True)
        self._plan = None
        if isinstance(result, Measurement):
            self.phase = next_phase(self.phase, "end")
            self._before, self._last, self._failures, self._halvings = self._last, result, 0, 0
        else:
            self._failed(result.too_long, now_ns)
        return result

    def take_back(self) -> None:
        """Forget the newest measurement: the light changed in it, and its peak may be none."""
        self._last = self._before

    @property
    def most_ns(self) -> int:
        """How long a full sweep may take, if its frames come in time."""
        return SLACK_NS + self._full_steps * STEP_NS + self._waits_ns

    def remark(self) -> str | None:
        """What a full sweep showed about the lens, once."""
        remark, self._remark = self._remark, None
        return remark

    def forget(self) -> None:
        """The target is lost: the next sweep is a full one, and may start at once."""
        self.phase = next_phase(self.phase, "lose")
        self._plan, self._last, self._failures, self._halvings = None, None, 0, 0

    def _failed(self, too_long: bool, now_ns: int) -> None:
        self._failures += 1
        pauses = self._last is None and self._failures >= FAILURES_BEFORE_PAUSE
        self.phase = next_phase(self.phase, "fail" if pauses else "end")
        if self._last is None:
            self._halvings = self._halvings + 1 if too_long else 0
            self._rest_until_ns = now_ns + PAUSE_NS
        elif self._failures >= FAILURES_BEFORE_FULL:
            self._last, self._failures, self._halvings = None, 0, int(too_long)

    def _result(self, number: int) -> Measurement | Rejected:
        aside = self._by_light is not None and self._by_light.aside
        good = usable(number, alike(self._frames) if aside else self._frames, self._tilts)
        if isinstance(good, Rejected):
            return good
        if self._last is None and not self._remarked:
            self._remark = short_of_infinity(self._fit, [f.focus for f in self._frames if f.focus is not None])
            self._remarked = True
        return peak_of(number, good, None if self._last is None else self._last.width)


class LateFrames(Revertible):
    """Whether sweeps contradict what the calibration says of the camera's timing.

    Frames that are later than it says show the lens where it was, so that peaks seem to lie farther on, by the more the
    faster it goes; and full sweeps have another pace than tracking ones, mostly half of it. For robots and targets at
    rest alone: what moves changes its range from one sweep to the next.
    """

    def __init__(self) -> None:
        self._full: Paced | None = None
        self._tracking: list[Paced] = []  # before that full one, or after it
        self._lost = 0  # sweeps of a target in view without a peak, since a tracking one had one

    def add(self, peak: Measurement | Rejected, noise: float) -> None:
        """Take note of a sweep. noise: of one peak, by the calibration, lens positions."""
        if isinstance(peak, Rejected):
            self._lost += peak.no_peak
            return
        if peak.lens_position is None:
            return
        paced = Paced(peak.t_ns, peak.lens_position, max(peak.sigma, noise), noise, peak.pace)
        if peak.held_width is None:
            self._full = paced
            self._tracking = [each for each in self._tracking[-TRACKED:] if peak.t_ns - each.t_ns < TOGETHER_NS]
            return
        self._lost = 0
        near = self._full is None or paced.t_ns - self._full.t_ns < TOGETHER_NS
        if near and (self._full is None or len(self._tracking) < TRACKED):
            self._tracking = [*self._tracking[1 - TRACKED :], paced]

    def contradiction(self) -> str | None:
        """What sweeps say against the calibration; None: nothing."""
        if self._full is not None and self._lost >= LOST:
            return f"{self._lost} sweeps did not find again the peak that one found"
        late = self.late_s()
        return late and f"sweeps show the lens {1e3 * late[0]:.0f} ms (+-{1e3 * late[1]:.0f}) later than calibrated"

    def late_s(self) -> tuple[float, float] | None:
        """By how much frames are later than believed, and its standard deviation; None where sweeps agree, or it is not
        known yet."""
        full, n = self._full, len(self._tracking)
        if full is None or n < TRACKED:
            return None
        pace = full.pace - sum(each.pace for each in self._tracking) / n
        if not pace:
            return None
        mean = sum(each.lens_position for each in self._tracking) / n
        # By how they scatter: a lens on its way at the start of a sweep makes each of them less sure than they all are.
        scatter = math.sqrt(sum((each.lens_position - mean) ** 2 for each in self._tracking) / (n - 1))
        late = (full.lens_position - mean) / pace
        sigma = math.hypot(full.sigma, max(scatter, full.noise) / math.sqrt(n)) / abs(pace)
        return (late, sigma) if abs(late) > max(LATE_SIGMAS * sigma, LATE_S) else None


def usable(
    number: int, frames: Sequence[Sighting], tilts_deg: Sequence[tuple[float, float]]
) -> list[Sighting] | Rejected:
    """The frames of a sweep that show the target, where they are enough and belong together."""
    good = [f for f in frames if f.found and f.focus is not None and f.clarity is not None]
    if len(good) < FOUND_SHARE * len(frames):
        return Rejected(number, f"target seen in {len(good)} of {len(frames)} frames")
    moved = how_moved(good, tilts_deg)
    return good if moved is None else Rejected(number, moved, too_long=True)


def peak_of(number: int, good: Sequence[Sighting], held_width: float | None) -> Measurement | Rejected:
    """What usable frames measure; `held_width`: of the peak that a tracking sweep follows, None: it is free."""
    peak = fit_peak([float(f.focus or 0) for f in good], [f.clarity or 0.0 for f in good], held_width)
    if not isinstance(peak, Peak):
        return Rejected(number, peak.reason, held_width=held_width, no_peak=True)
    sharpest = min(good, key=lambda f: (abs((f.focus or 0) - peak.lens_position), f.frame))
    return Measurement(
        sweep=number,
        t_ns=sharpest.t_ns,
        lens_position=peak.lens_position,
        sigma=math.hypot(peak.sigma, phase_sigma(peak.width, sharpest.area_px or 1.0)),
        width=peak.width,
        held_width=held_width,
        outline=outline_of(sharpest),
        quality=peak.quality,
        pace=pace_of(good),
    )


def pace_of(frames: Sequence[Sighting]) -> float:
    """How fast the lens went on the whole in the frames of a sweep, positions a second."""
    seconds = 1e-9 * (frames[-1].t_ns - frames[0].t_ns)
    return ((frames[-1].focus or 0) - (frames[0].focus or 0)) / seconds if seconds > 0.0 else 0.0


def outline_of(seen: Sighting) -> Outline:
    """What a frame with the target in it shows of that."""
    assert seen.centre_px is not None
    return Outline(seen.centre_px, seen.radius_px, seen.score, seen.focus, seen.size_px, seen.radius_sigma_px)


def how_moved(frames: Sequence[Sighting], tilts_deg: Sequence[tuple[float, float]]) -> str | None:
    """Why frames that show the target, with roll and pitch meanwhile, do not belong together; None where they do."""
    centres = [frame.centre_px for frame in frames if frame.centre_px is not None]
    step_px = max((span(pair) for pair in itertools.pairwise(centres)), default=0.0)
    if step_px > max((step_limit_px(frame) for frame in frames), default=0.0):
        return f"moved {step_px:.0f} px between frames"
    if span(centres) > DRIFT_LIMIT_PX:
        return f"moved {span(centres):.0f} px during the sweep"
    if span(tilts_deg) > TILT_LIMIT_DEG:
        return f"tilted by {span(tilts_deg):.1f} degrees during the sweep"
    return None


def alike(frames: Sequence[Sighting]) -> list[Sighting]:
    """The frames of a sweep by light from aside, in which most show the disc of a ball and some its lit part alone, or
    the other way round: those that are in the minority show nothing."""
    radii = sorted(f.radius_px for f in frames if f.found and f.radius_px is not None)
    if not radii:
        return list(frames)
    middle = radii[len(radii) // 2]
    return [
        f if f.radius_px is None or abs(f.radius_px - middle) <= ALIKE * middle else replace(f, found=False)
        for f in frames
    ]


def step_limit_px(sighting: Sighting) -> float:
    return max(STEP_LIMIT_PX, BOX_LIMIT * math.hypot(*(sighting.size_px or (0.0, 0.0))))


def span(points: Sequence[tuple[float, float]]) -> float:
    """Distance from the least to the most, along the axis on which that is more."""
    return max((max(axis) - min(axis) for axis in zip(*points, strict=True)), default=0.0)


# --- lens positions of a sweep ---
# Equal lens steps are equal steps in dioptres. All sweeps run towards larger positions and come from before their first
# one, so that the lens's play is the same constant in every sweep, and in the calibration.

TRACK_STEPS = 7
TRACK_SPAN = 1.5  # half span of a tracking sweep, peak half-widths: beyond it the flanks say little
EXPECTED_SPAN = 1.5  # half span of a first sweep around where neighbours say that a target is, likewise
HOME = 0.6  # how far before its first position a sweep starts, peak half-widths
FULL_MARGIN = 0.12  # a full sweep passes the calibrated positions at both ends by this share of their span
PAST_INFINITY = 0.5  # and infinity by so many peak half-widths: a far target's peak has two flanks, too


def full_positions(fit: FocusFit, steps: int) -> tuple[int, ...]:
    """Positions for all ranges in the water: past both ends of the calibrated positions, and past infinity."""
    margin = FULL_MARGIN * (fit.highest - fit.lowest)
    first, last = fit.lowest - margin, fit.highest + margin
    nearest = last if fit.b_m > 0.0 else first
    # By a step at least: a peak is believed from the second position on.
    beyond = max(PAST_INFINITY * fit.width, abs(nearest - fit.rho0) / max(steps - 2, 1))
    if fit.b_m > 0.0:  # larger positions are nearer
        return spread(min(first, fit.rho0 - beyond), last, steps)
    return spread(first, max(last, fit.rho0 + beyond), steps)


def track_positions(lens_position: float, width: float, span: float = TRACK_SPAN) -> tuple[int, ...]:
    """A few positions around the last peak, `span` half-widths to either side: wide enough to see both flanks."""
    return spread(lens_position - span * width, lens_position + span * width, TRACK_STEPS)


def expected_positions(lens_position: float, width: float, full_steps: int) -> tuple[int, ...]:
    """Half as many as of a full sweep, around where a target is believed to be: both flanks, and room for an error."""
    half_span = EXPECTED_SPAN * width
    return spread(lens_position - half_span, lens_position + half_span, max(full_steps // 2, 2 * TRACK_STEPS))


def home_position(lens_positions: Sequence[int], fit: FocusFit) -> int:
    """Where the lens waits before the first of `lens_positions`."""
    return max(round(lens_positions[0] - HOME * fit.width), 0)


def spread(first: float, last: float, steps: int) -> tuple[int, ...]:
    """`steps` whole lens positions from first, or from 0, the lowest of every driver, to last, rising."""
    first = max(first, 0.0)
    return tuple(round(first + (last - first) * k / (steps - 1)) for k in range(steps))


def short_of_infinity(fit: FocusFit, reported: Sequence[int]) -> str | None:
    """What it means that the lens, told to pass infinity, came to rest at these positions; None where it got there."""
    ordered = sorted(set(reported), reverse=fit.b_m < 0.0)  # the far end first
    if len(ordered) < 2 or (fit.rho0 - ordered[0]) * fit.b_m >= 0.0:
        return None
    # A peak is believed from the second position on; there the hyperbola has its farthest range.
    reach_m = fit.u_inf_m + fit.b_m / (ordered[1] - fit.rho0)
    return f"the lens stops at {ordered[0]}, infinity is at {fit.rho0:.0f}: no range to targets beyond {reach_m:.1f} m"
