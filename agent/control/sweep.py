"""Focus as a state machine: which lens positions to visit, and the peak that a finished sweep gave.

A full sweep looks everywhere, once; tracking sweeps then visit a few positions around the last peak. All run in one
direction and start beyond their first position, so that the lens's play is the same constant in every sweep, and in
the calibration.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

from agent.messages import Sighting, SweepPlan, Telemetry
from agent.ranging.calibration import FocusFit
from agent.ranging.cues import Outline
from agent.ranging.focus import Peak, fit_peak

TRACK_STEPS = 7
TRACK_SPAN = 1.5  # half span of a tracking sweep, peak half-widths: beyond it the flanks say little
WIDER = 2.0  # a tracking sweep after one that found nothing looks so much farther, once, before the next full sweep
HOME = 0.6  # how far before its first position a sweep starts, peak half-widths
FULL_MARGIN = 0.12  # a full sweep passes the calibrated positions at both ends by this share of their span
MOTION_LIMIT_PX = 12.0  # between frames that follow each other; above, they do not show the same patch
BOX_LIMIT = 0.12  # of a box's diagonal, if that is more: NanoTrack's box of a resting thing jumps by up to 0.06
TILT_LIMIT_DEG = 2.0  # roll or pitch, from least to most in a sweep: 40 px, a sixth of the disc; hovering stays below 1
FOUND_SHARE = 0.7  # of a sweep's frames must show the target
SLACK_NS = 1_500_000_000  # a sweep that takes this much longer than it should, and has no more frames, is given up
STEP_NS = 200_000_000  # generous time for one position: lens at rest, exposure, transfer
FAILURES_BEFORE_FULL = 2  # tracking sweeps in a row without a peak


class Measurement(NamedTuple):
    """One accepted sweep, in lens and pixel terms; stamped with the time of its sharpest frame."""

    t_ns: int
    focus: float  # lens position of the peak
    sigma: float  # its standard deviation, lens positions
    width: float  # half width of the peak, lens positions
    outline: Outline  # in the frame nearest to the peak: blur moves an edge
    score: float


class Rejected(NamedTuple):
    """Why a finished sweep gave nothing."""

    reason: str


class Sweep:
    """Plans sweeps and collects their frames. The caller decides when the next may start."""

    def __init__(self, fit: FocusFit, full_steps: int) -> None:
        self._fit = fit
        self._full_steps = full_steps
        self._number = 0
        self._plan: SweepPlan | None = None
        self._deadline_ns = 0
        self._frames: list[Sighting] = []
        self._tilts: list[tuple[float, float]] = []  # roll and pitch since the sweep began, degrees
        self._last: Measurement | None = None
        self._failures = 0

    @property
    def running(self) -> bool:
        return self._plan is not None

    @property
    def focus(self) -> float | None:
        """Lens position of the last accepted peak."""
        return None if self._last is None else self._last.focus

    def start(self, now_ns: int) -> SweepPlan:
        """Begin the next sweep: full when there is no peak to track."""
        if self._last is not None and self._failures < FAILURES_BEFORE_FULL:
            span = TRACK_SPAN * (WIDER if self._failures else 1.0)
            positions = track_positions(self._last.focus, self._last.width, span)
        else:
            self._last = None
            positions = full_positions(self._fit, self._full_steps)
        home = round(positions[0] - HOME * self._fit.width)
        self._number += 1
        self._frames, self._tilts = [], []
        self._plan = SweepPlan(sweep=self._number, focus=(max(home, 0), *positions))
        self._deadline_ns = now_ns + SLACK_NS + len(positions) * STEP_NS
        return self._plan

    def frame(self, sighting: Sighting) -> None:
        """Collect a frame of the running sweep; others pass by."""
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
        result = self._result() if complete else Rejected("not finished in time")
        self._plan = None
        if isinstance(result, Measurement):
            self._last, self._failures = result, 0
        else:
            self._failures += 1
        return result

    def forget(self) -> None:
        """The target is lost: the next sweep is a full one."""
        self._plan, self._last, self._failures = None, None, 0

    def _result(self) -> Measurement | Rejected:
        good = [f for f in self._frames if f.found and f.focus is not None and f.clarity is not None]
        if len(good) < FOUND_SHARE * len(self._frames):
            return Rejected(f"target seen in {len(good)} of {len(self._frames)} frames")
        for a, b in itertools.pairwise(good):
            if distance_px(a, b) > motion_limit_px(b):
                return Rejected(f"moved {distance_px(a, b):.0f} px between frames")
        turned_deg = max((max(axis) - min(axis) for axis in zip(*self._tilts, strict=True)), default=0.0)
        if turned_deg > TILT_LIMIT_DEG:
            return Rejected(f"tilted by {turned_deg:.1f} degrees during the sweep")
        width = None if self._last is None else self._last.width
        peak = fit_peak([float(f.focus or 0) for f in good], [f.clarity or 0.0 for f in good], width)
        if not isinstance(peak, Peak):
            return Rejected(peak.reason)
        sharpest = min(good, key=lambda f: (abs((f.focus or 0) - peak.position), f.frame))
        assert sharpest.centre_px is not None
        return Measurement(
            t_ns=sharpest.t_ns,
            focus=peak.position,
            sigma=peak.sigma,
            width=peak.width,
            outline=Outline(sharpest.centre_px, sharpest.radius_px, sharpest.score, sharpest.focus, sharpest.size_px),
            score=peak.quality,
        )


def full_positions(fit: FocusFit, steps: int) -> tuple[int, ...]:
    """Equal lens steps, which are equal steps in dioptres, past both ends of the calibrated positions."""
    margin = FULL_MARGIN * (fit.highest - fit.lowest)
    return spread(max(fit.lowest - margin, 0.0), fit.highest + margin, steps)


def track_positions(peak: float, width: float, span: float = TRACK_SPAN) -> tuple[int, ...]:
    """A few positions around the last peak, `span` half-widths to either side: wide enough to see both flanks."""
    return spread(max(peak - span * width, 0.0), peak + span * width, TRACK_STEPS)


def spread(first: float, last: float, steps: int) -> tuple[int, ...]:
    """`steps` whole lens positions from first to last, rising."""
    return tuple(round(first + (last - first) * k / (steps - 1)) for k in range(steps))


def motion_limit_px(sighting: Sighting) -> float:
    return max(MOTION_LIMIT_PX, BOX_LIMIT * math.hypot(*(sighting.size_px or (0.0, 0.0))))


def distance_px(a: Sighting, b: Sighting) -> float:
    assert a.centre_px is not None and b.centre_px is not None
    return max(abs(a.centre_px[0] - b.centre_px[0]), abs(a.centre_px[1] - b.centre_px[1]))
