"""What the kernel decides of a sweep: the lens position of its peak and the place of the target, by what vision saw
then and by what it sees now in the recorded frames. Both are worked out here in the same way, so that they differ by
vision alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import UNSET

from agent.core.codec import decode
from agent.core.control.sweep import Measurement, Rejected, peak_of, usable
from agent.core.messages import State
from agent.core.ranging.camera_model import Eye, camera_pose
from agent.core.ranging.fix import Fix, NoRange, locate
from agent.core.step_io import Outputs, Sighting, SweepOutcome
from replay.check.black_box import STEP_BYTES, BlackBox

Key = tuple[str, int]  # target, number of the sweep
SweepFrames = Mapping[Key, Sequence[Sighting | None]]  # of each sweep; None: the frame is not in the file


class SweepPair(NamedTuple):
    """One sweep, then and now. Shifts are in standard deviations that the kernel gave to them then."""

    target: str
    sweep: int
    peak: float | None  # how far its peak is from where it was; None: there is none then or now
    place: float | None  # and the place of the target; None: none that the kernel believes
    flipped: bool = False  # a measurement then or now, not both


def sweep_pairs(box: BlackBox, then: SweepFrames, now: SweepFrames) -> Iterator[SweepPair]:
    """The sweeps that gave the robot a measurement, and those that would now; those that lost a frame are left out."""
    for outcome, eye in _outcomes(box):
        key = outcome.target, outcome.sweep
        was, is_ = (_complete(of.get(key, ())) for of in (then, now))
        if not was or len(was) != len(is_):
            continue
        before, after = (_peak(outcome, frames) for frames in (was, is_))
        if outcome.lens_position is None and before is not None:
            continue  # the robot was tilted or its frames came late: not by what vision saw
        if before is None and after is None:
            continue
        if before is None or after is None:
            yield SweepPair(*key, None, None, flipped=True)
            continue
        shift = abs(after.lens_position - before.lens_position) / before.sigma
        places = [_fix(box, outcome.target, peak, eye) for peak in (before, after)]
        fixes = [place for place in places if isinstance(place, Fix)]
        yield SweepPair(*key, shift, _apart(*fixes) if len(fixes) == 2 else None, flipped=len(fixes) == 1)


def by_sweep(sightings: Sequence[tuple[Sighting, Sighting | None]]) -> tuple[SweepFrames, SweepFrames]:
    """Pairs of sightings, then and now, as frames of their sweeps."""
    then: defaultdict[Key, list[Sighting | None]] = defaultdict(list)
    now: defaultdict[Key, list[Sighting | None]] = defaultdict(list)
    for was, is_ in sightings:
        if was.sweep:
            then[was.target, was.sweep].append(was)
            now[was.target, was.sweep].append(is_)
    return then, now


def _complete(frames: Sequence[Sighting | None]) -> list[Sighting]:
    return [frame for frame in frames if frame is not None]


def _peak(outcome: SweepOutcome, frames: Sequence[Sighting]) -> Measurement | None:
    good = usable(outcome.sweep, frames, ())
    peak = good if isinstance(good, Rejected) else peak_of(outcome.sweep, good, outcome.held_width)
    return peak if isinstance(peak, Measurement) else None


def _fix(box: BlackBox, target: str, peak: Measurement, eye: Eye) -> Fix | NoRange:
    about, cues = box.fleet.target[target], box.fleet.ranging.cues
    return locate(box.calibration, eye, peak.outline, peak.lens_position, peak.sigma, about, cues)


def _apart(then: Fix, now: Fix) -> float:
    """How far one place is from the other, in standard deviations in that direction."""
    xx, xy, xz, yy, yz, zz = then.covariance_m2
    shift = np.subtract(now.position_m, then.position_m)
    return math.sqrt(float(shift @ np.linalg.solve([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], shift)))


def _outcomes(box: BlackBox) -> Iterator[tuple[SweepOutcome, Eye]]:
    """Each sweep that ended, and where the camera was, as near as the robot's own state says: both places are seen
    from there, and its few millimetres of sway are the same to them."""
    state: State | None = None
    for step in box.steps():
        outputs = decode(step.outputs, Outputs, limit=STEP_BYTES) if step.outputs is not None else None
        if outputs is None:
            continue
        if outputs.state is not None:
            state = outputs.state
        if outputs.outcome is not UNSET:
            yield outputs.outcome, _eye(box, state)


def _eye(box: BlackBox, state: State | None) -> Eye:
    robot, body, surface_m = box.fleet.robot[box.robot], box.fleet.body, box.fleet.tank.surface_m
    if state is None or state.depth_m is None:
        level = robot.depth_m, 0.0, 0.0
    else:
        level = state.depth_m, state.roll_deg or 0.0, state.pitch_deg or 0.0
    gimbal = (state.pan_deg, state.tilt_deg) if state is not None else (robot.look.pan_deg, robot.look.tilt_deg)
    return camera_pose(robot.pose, body, *level, *gimbal, surface_m)
