"""`aucamp replay check --vision`: vision again on the recorded frames, against what it said at the time: what may
differ, and what the kernel decides by it.

Judged is what the kernel decides by vision, and what vision itself says of the frames that are kept losslessly; the
limits and their reasons stand first. A target that is followed from frame to frame is not judged where
frames are compressed: its tracker builds on all frames before. The function that sees is handed in: replay does not
know perception.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.linear_algebra import full
from agent.core.messages import State
from agent.core.ranging.camera_model import CameraFit, Eye, camera_pose
from agent.core.ranging.fix import CENTRE_NOISE_PX, EDGE_BIAS_PX, Fix, NoRange, locate
from agent.core.ranging.sweep import Measurement, Rejected, peak_of, usable
from agent.core.step_io import Outputs, Sighting, SweepOutcome
from replay.check.reexecute import STEP_BYTES, BlackBox, open_boxes
from replay.files.channels import VISION
from replay.files.frames import Frames, pixels
from replay.files.info import suspecting
from replay.files.log import info, parts, read

# --- what may differ ---
# What may differ when vision looks at recorded frames again, and why so much.
#
# Frames that are kept losslessly give the same numbers, but for versions of OpenCV. A JPEG is not what vision saw:
# its pixels are off by one to three grey levels (sd). An edge that a lens has smeared over 20 px climbs by two to
# four levels a pixel, so each of 96 rays finds it up to a pixel elsewhere, eight neighbours in a block alike, and a
# single outline of a defocused ball lies 0.1 px elsewhere (rms), now and then 0.7 px. That decides nothing: of a
# sweep the kernel takes the peak over all frames and the outline of the sharpest one. So what is held to limits is
# what the kernel decides, in units of its own standard deviation:
#
# * rms of the shifts of peaks and places: SHARE_RMS. An independent error of half a sigma makes a sigma 12 % larger;
#   that is as far as the kernel's sigmas are off themselves (`aucamp experiment consistency`: normalised error squared
#   3.79 instead of 3 beyond 0.9 m).
# * where robots swim, of peaks SWUM_RMS: as much as the sensor's noise. The blocks of a JPEG then lie elsewhere on the
#   texture in each frame of a sweep: 0.3 to 0.8 (93 sweeps of three robots), and 0.2 of robots that stand.
# * each of them: four times as much, which errors of that rms exceed once in 16,000 sweeps. What lies beyond is not
#   what compression does.
# * the mean shift of peaks, which compression does not move: what chance makes of that rms, at three sigma.
# * the mean shift of all outlines, which chance does not move: OUTLINE_PX, two standard deviations of what the kernel
#   takes for the noise of a centre and the bias of an edge.
#
# A change of vision by a hundredth of its clarity is none of this: it shows on the frames that are kept losslessly.

SHARE_RMS = 0.5
SWUM_RMS = 1.0
WORST = 4.0  # times the rms
CHANCE = 3.0  # sigma of a mean
OUTLINE_PX = 2.0 * math.hypot(CENTRE_NOISE_PX, EDGE_BIAS_PX)
ODD = 0.01  # share of compressed frames in which a ball may be seen that is only just there, or just not

EXACT_PX = 0.01  # lossless frames: versions of OpenCV round differently
EXACT_CLARITY = 1e-4  # relative
EXACT_SHARE = 0.01  # of a sweep's sigma, where every frame is lossless


class Quantity(NamedTuple):
    """One compared quantity over a recording."""

    value: float
    allowed: float
    compared: int  # how many it is of

    @property
    def passed(self) -> bool:
        return self.value <= self.allowed

    def __str__(self) -> str:
        return f"{self.value:.2g} ({self.allowed:.2g} allowed)" + ("" if self.passed else "  <- too large")


def worst(values: Sequence[float], allowed: float) -> Quantity:
    return Quantity(max(values), allowed, len(values))


def rms(values: Sequence[float], allowed: float) -> Quantity:
    return Quantity(math.sqrt(sum(value * value for value in values) / len(values)), allowed, len(values))


def mean_shift(shifts: Sequence[tuple[float, ...]], allowed: float) -> Quantity:
    """The largest component of the mean of vectors."""
    return Quantity(max(abs(sum(column)) / len(shifts) for column in zip(*shifts, strict=True)), allowed, len(shifts))


# --- what the kernel decides by it ---
# What the kernel decides of a sweep: the lens position of its peak and the place of the target, by what vision saw
# then and by what it sees now in the recorded frames. Both are worked out here in the same way, so that they differ
# by vision alone.

Key = tuple[str, int]  # target, number of the sweep
SweepFrames = Mapping[Key, Sequence[Sighting | None]]  # of each sweep; None: the frame is not in the file


class SweepPair(NamedTuple):
    """One sweep, then and now. Shifts are in standard deviations that the kernel gave to them then."""

    target: str
    sweep: int
    peak: float | None  # how far its peak is beyond where it was; None: there is none then or now
    place: float | None  # how far the target's place is from there; None: none that the kernel believes
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
        shift = ((after.lens_position or 0.0) - (before.lens_position or 0.0)) / before.sigma
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
    shift = np.subtract(now.position_m, then.position_m)
    return math.sqrt(float(shift @ np.linalg.solve(full(then.covariance_m2), shift)))


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


# --- vision again ---

See = Callable[[NDArray[np.uint8], tuple[int, int, int, int], Sighting, Sighting | None], Sighting]
MakeSee = Callable[[Fleet, CameraFit], See]


class VisionCheck(NamedTuple):
    """What came of one recording."""

    box: BlackBox
    frames: int  # compared
    exact: int  # of them judged to the last bit
    lost: int  # sightings whose frame is not in the file
    missing: int  # found then, not now; of targets that are judged
    extra: int  # found now, not then
    sweeps: int  # compared
    flipped: int  # of them give a measurement now and gave none then, or the other way round
    quantities: dict[str, Quantity]
    odd: float  # share of frames and sweeps that may be missing or extra
    followed: dict[str, float]  # targets that are not judged, and how far at most they are elsewhere, px

    @property
    def passed(self) -> bool:
        within = all(quantity.passed for quantity in self.quantities.values())
        few = self.missing + self.extra <= self.odd * self.frames and self.flipped <= math.ceil(self.odd * self.sweeps)
        return self.frames > 0 and within and few

    def __str__(self) -> str:
        if not self.frames:
            return f"{self.box.path}: holds no frames, so vision cannot be checked; agents record them, scripts do not"
        verdict = "within tolerance" if self.passed else "differs"
        head = f"{self.box.path}: vision {verdict}, {self.frames} frames, {self.sweeps} sweeps"
        lines = [head + (f", {self.lost} frames are not in the file" * bool(self.lost))]
        lines += [
            f"  target {what} in {n} frames" for what, n in (("missed", self.missing), ("added", self.extra)) if n
        ]
        if self.flipped:
            lines.append(f"  {self.flipped} sweeps give a measurement then or now, not both")
        lines += [f"  {name}: {quantity}, {quantity.compared} compared" for name, quantity in self.quantities.items()]
        if not self.exact and len(self.followed) < len(self.box.fleet.target):
            lines.append("  no frame is lossless: a change of vision too small to move a measurement does not show")
        for target, apart_px in self.followed.items():
            lines.append(
                f"  {target}: followed from frame to frame, which compressed frames do not repeat: up to "
                f"{apart_px:.0f} px elsewhere, not judged; `aucamp agent --lossless` records what can be"
            )
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        counts = ("frames", "exact", "lost", "missing", "extra", "sweeps", "flipped")
        return {
            "file": str(self.box.path),
            "passed": self.passed,
            **{name: getattr(self, name) for name in counts},
            "quantities": {
                name: {**quantity._asdict(), "passed": quantity.passed} for name, quantity in self.quantities.items()
            },
            "not_judged": self.followed,
        }


def check_vision(paths: Sequence[Path], make_see: MakeSee, console: Console | None = None) -> list[VisionCheck]:
    """Check every black box among files and folders; `make_see` is agent.perception.vision.rerun_vision.

    Raises ConfigError for input that is no recording or whose frames do not decode.
    """
    boxes, found = open_boxes(paths), []
    shown = console is not None and console.is_terminal  # else it leaves an empty line behind
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not shown, transient=True) as bar:
        for box in boxes:
            with suspecting(box.path):
                pairs = sighting_pairs(box, make_see)
                found.append(compare(box, bar.track(pairs, total=_frames(box), description=box.path.name)))
    return found


class SightingPair(NamedTuple):
    """What vision found in one frame, then and now."""

    then: Sighting
    now: Sighting | None  # None: the frame is not in the file
    lossless: bool


def sighting_pairs(box: BlackBox, make_see: MakeSee) -> Iterator[SightingPair]:
    """Every frame of a recording in the order in which vision saw them."""
    see = make_see(box.fleet, box.calibration.camera)
    frames = Frames()
    sweep: tuple[str, int] = ("", 0)
    first: Sighting | None = None  # of the sweep, with its target in it
    for record in read(box.path):
        frames.take(record.channel, record.sequence, record.data)
        if record.channel != VISION.name:
            continue
        then, picture = decode(record.data, Sighting), frames.at(record.sequence)
        if (then.target, then.sweep) != sweep:
            sweep, first = (then.target, then.sweep), None
        if picture is None:
            yield SightingPair(then, None, lossless=False)
        else:
            yield SightingPair(then, see(pixels(picture), picture.roi, then, first), picture.format == "png")
        if then.sweep and first is None and then.found:
            first = then  # not that of now: else one difference would spread over its sweep


def compare(box: BlackBox, seen: Iterable[SightingPair]) -> VisionCheck:
    """The differences of all frames, and of what the kernel makes of them."""
    pairs = list(seen)
    there = [pair for pair in pairs if pair.now is not None]
    lossless = bool(there) and all(pair.lossless for pair in there)
    followed = (
        {}
        if lossless
        else {t: _farthest_px(there, t) for t, about in box.fleet.target.items() if about.detector == "box"}
    )
    judged = [pair for pair in there if pair.then.target not in followed]
    alone = not box.fleet.camera.enhance  # else what is seen in a frame depends on those before
    exact = [pair for pair in judged if pair.lossless and (lossless or alone)]
    sweeps = [
        sweep
        for sweep in sweep_pairs(box, *by_sweep([(pair.then, pair.now) for pair in pairs]))
        if sweep.target not in followed
    ]
    return VisionCheck(
        box=box,
        frames=len(there),
        exact=len(exact),
        lost=len(pairs) - len(there),
        missing=sum(pair.then.found and not pair.now.found for pair in judged if pair.now),
        extra=sum(pair.now.found and not pair.then.found for pair in judged if pair.now),
        sweeps=len(sweeps),
        flipped=sum(sweep.flipped for sweep in sweeps),
        quantities={
            **_exactly(exact),
            **_on_average(judged, lossless),
            **_decided(sweeps, box.fleet.navigation is not None, lossless),
        },
        odd=0.0 if lossless else ODD,
        followed=followed,
    )


def _exactly(pairs: Sequence[SightingPair]) -> dict[str, Quantity]:
    """Frames that are kept losslessly."""
    limits = {"centre, px": EXACT_PX, "radius, px": EXACT_PX, "clarity, relative": EXACT_CLARITY}
    apart: dict[str, list[float]] = {name: [] for name in limits}
    alone = 0
    for then, now, _ in pairs:
        if now is None or then.found != now.found:
            alone += 1
            continue
        if then.centre_px and now.centre_px:
            apart["centre, px"].append(math.dist(then.centre_px, now.centre_px))
        if then.radius_px and now.radius_px:
            apart["radius, px"].append(abs(now.radius_px - then.radius_px))
        if then.clarity and now.clarity:
            apart["clarity, relative"].append(abs(now.clarity / then.clarity - 1.0))
    found = {f"lossless frames, {name}": worst(values, limits[name]) for name, values in apart.items() if values}
    return {
        **found,
        **({"lossless frames, target seen then or now alone": Quantity(alone, 0, len(pairs))} if alone else {}),
    }


def _on_average(pairs: Sequence[SightingPair], lossless: bool) -> dict[str, Quantity]:
    shifts = [
        (now.centre_px[0] - then.centre_px[0], now.centre_px[1] - then.centre_px[1], now.radius_px - then.radius_px)
        for then, now, _ in pairs
        if now and then.centre_px and now.centre_px and then.radius_px and now.radius_px
    ]
    return {} if lossless or not shifts else {"mean shift of the outlines, px": mean_shift(shifts, OUTLINE_PX)}


def _decided(sweeps: Sequence[SweepPair], swims: bool, lossless: bool) -> dict[str, Quantity]:
    found = {}
    for name, by_jpeg in (("peak", SWUM_RMS if swims else SHARE_RMS), ("place", SHARE_RMS)):
        shifts = [shift for sweep in sweeps if (shift := getattr(sweep, name)) is not None]
        if not shifts:
            continue
        what = f"{name} of each sweep, in its own sigma"
        limit, most = (EXACT_SHARE, EXACT_SHARE) if lossless else (by_jpeg, WORST * by_jpeg)
        found[f"{what}, rms"] = rms(shifts, limit)
        found[f"{what}, worst"] = worst([abs(shift) for shift in shifts], most)
        if name == "peak" and not lossless:
            by_chance = CHANCE * limit / math.sqrt(len(shifts))
            found[f"{what}, mean"] = mean_shift([(shift,) for shift in shifts], by_chance)
    return found


def _farthest_px(pairs: Sequence[SightingPair], target: str) -> float:
    return max(
        (
            math.dist(then.centre_px, now.centre_px)
            for then, now, _ in pairs
            if then.target == target and now and then.centre_px and now.centre_px
        ),
        default=0.0,
    )


def _frames(box: BlackBox) -> int:
    heads = [info(file).channels for file in parts(box.path)]
    return sum(head[VISION.name].messages for head in heads if VISION.name in head)
