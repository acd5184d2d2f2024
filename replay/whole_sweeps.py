"""Whole sweeps of the focus in a black box, each with where the robot was: what a scene is reconstructed from.

Two passes: the kernel's inputs and outputs tell depth, roll, pitch, servos and whereabouts at all times, then frames
are decoded sweep by sweep.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.attitude import LATE_NS, AttitudeLog
from agent.core.codec import decode
from agent.core.messages import Whereabouts
from agent.core.step_io import Inputs, Outputs, Sighting
from replay.check.reexecute import STEP_BYTES, BlackBox
from replay.files.channels import STEP_IN, STEP_OUT, VISION
from replay.files.frames import Frames, Picture, pixels
from replay.files.info import suspecting
from replay.files.log import read
from replay.viewers.viewer_channels import SweepAssembler, SweepFrame

MOST_GAP_NS = 1_500_000_000  # between two notes of where a robot is; in a longer gap it may have gone anywhere


class Level(NamedTuple):
    """Of the body and the gimbal at one moment."""

    depth_m: float
    roll_deg: float
    pitch_deg: float
    servos_us: tuple[float, float]  # of the camera: pan, tilt
    on_s: float  # how long the control module had been on


class TakenSweep(NamedTuple):
    """Frames in the order in which they were taken."""

    number: int  # of its plan
    frames: list[SweepFrame]


class Motion(NamedTuple):
    """All that a recording says of where its robot was, by time."""

    levels: NDArray[np.float64]  # (n, 6) depth, roll, pitch, pan and tilt pulses, seconds that the module has been on
    levels_ns: NDArray[np.int64]  # (n,) rising
    places: NDArray[np.float64]  # (m, 5) x, y, yaw (degrees, without jumps), sigma of the place and of the yaw
    places_ns: NDArray[np.int64]

    def level(self, t_ns: int) -> Level | None:
        """Linear between two telegrams; None where there is none near."""
        values = _at(self.levels, self.levels_ns, t_ns)
        if values is None:
            return None
        depth, roll, pitch, pan, tilt, on_s = values
        return Level(depth, roll, pitch, (pan, tilt), on_s)

    def whereabouts(self, t_ns: int) -> Whereabouts | None:
        """Of a robot that swims; None: it did not know, or is moored."""
        values = _at(self.places, self.places_ns, t_ns)
        return None if values is None else Whereabouts(**dict(zip(Whereabouts.__struct_fields__, values, strict=True)))


class WholeView(NamedTuple):
    """A survey's sweep, over whole frames: vision does not number these, for they are of no target."""

    number: int
    steps: int  # frames


class Told(NamedTuple):
    """What the kernel's inputs and outputs say."""

    motion: Motion
    views: dict[int, WholeView]  # by the exposure of the last frame, ns


def told(box: BlackBox) -> Told:
    """Read it from a recording. Raises ConfigError where that is damaged."""
    levels: list[tuple[int, tuple[float, ...]]] = []
    places: list[tuple[int, tuple[float, ...]]] = []
    steps: dict[int, int] = {}
    views: dict[int, WholeView] = {}
    attitude = AttitudeLog()
    with suspecting(box.path):
        for record in read(box.path):
            if record.channel == STEP_IN.name:
                inputs = decode(record.data, Inputs, STEP_BYTES)
                for one in inputs.telemetry:
                    attitude.add(one)
                    values = one.depth_m, one.roll_deg, one.pitch_deg, *one.servos_us[:2], attitude.on_s(one.t_ns)
                    levels.append((one.t_ns - LATE_NS, values))
                for peaks in inputs.blocks or ():
                    if peaks.sweep in steps:
                        views[peaks.t_ns] = WholeView(peaks.sweep, steps[peaks.sweep])
            elif record.channel == STEP_OUT.name:
                outputs = decode(record.data, Outputs, STEP_BYTES)
                state, plan = outputs.state, outputs.sweep
                if state is not None and isinstance(state.whereabouts, Whereabouts):
                    places.append((state.sent_ns, msgspec.structs.astuple(state.whereabouts)))
                if plan is not None and plan.block_px:
                    steps[plan.sweep] = len(plan.focus) - 1  # the lens comes from the first, where no frame is taken
    known, known_ns = _table(places, 5)
    known[:, 2] = np.degrees(np.unwrap(np.radians(known[:, 2])))
    table, table_ns = _table(levels, 6)
    return Told(Motion(table, table_ns, known, known_ns), views)


def taken_sweeps(box: BlackBox, views: Mapping[int, WholeView]) -> Iterator[TakenSweep]:
    """Every sweep whose frames are all there, of a target or of a survey, whose views `told` has. Raises ConfigError
    for a frame that does not decode."""
    steps = box.fleet.camera.sweep_steps
    frames, gathered = Frames(), SweepAssembler(steps)
    recent: deque[tuple[Picture, Sighting]] = deque(maxlen=max((view.steps for view in views.values()), default=1))
    with suspecting(box.path):
        for record in read(box.path):
            frames.take(record.channel, record.sequence, record.data)
            if record.channel != VISION.name:
                continue
            picture, sighting = frames.at(record.sequence), decode(record.data, Sighting)
            if whole := gathered.take(picture, sighting):
                yield TakenSweep(sighting.sweep, whole)
            if picture is None:
                recent.clear()
                continue
            recent.append((picture, sighting))
            view = views.get(sighting.t_ns)
            if view is not None and (found := rising(recent, view.steps)):
                yield TakenSweep(view.number, [SweepFrame(pixels(image), image.roi, seen) for image, seen in found])


def rising(recent: Sequence[tuple[Picture, Sighting]], steps: int) -> list[tuple[Picture, Sighting]]:
    """The newest frames, as many as a sweep has; none where some of these are missing."""
    found = list(recent)[-steps:]
    positions = [sighting.focus for _, sighting in found]
    known = [position for position in positions if position is not None]
    rises = all(a < b for a, b in pairwise(known))
    return found if len(known) == steps and rises else []


def _table(rows: list[tuple[int, tuple[float, ...]]], columns: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    rows = sorted(dict(rows).items())
    times = np.array([t_ns for t_ns, _ in rows], np.int64)
    return np.array([values for _, values in rows], float).reshape(len(rows), columns), times


def _at(table: NDArray[np.float64], times_ns: NDArray[np.int64], t_ns: int) -> list[float] | None:
    after = int(np.searchsorted(times_ns, t_ns))
    near = [n for n in (after - 1, after) if 0 <= n < len(times_ns) and abs(int(times_ns[n]) - t_ns) <= MOST_GAP_NS]
    if not near:
        return None
    first, last = near[0], near[-1]
    span = max(int(times_ns[last]) - int(times_ns[first]), 1)
    share = min(max((t_ns - int(times_ns[first])) / span, 0.0), 1.0)
    row: list[float] = (table[first] + share * (table[last] - table[first])).tolist()
    return row
