"""`aucamp replay check --vision`: vision again on the recorded frames, against what it said at the time.

Vision is not promised bit by bit (other versions of OpenCV round differently), and a JPEG has lost some of what vision
saw; so the verdict is by tolerances, which differ for lossless frames and for JPEG. The function that sees is handed
in: replay does not know perception.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from agent.kernel.codec import decode
from agent.kernel.config import Fleet
from agent.kernel.ranging.calibration import CameraFit
from agent.kernel.ranging.focus import Peak, fit_peak
from agent.kernel.step_io import Outputs, Sighting, SweepOutcome
from replay.check.black_box import STEP_BYTES, BlackBox, open_boxes
from replay.files.channels import FRAME, VISION
from replay.files.frames import MAX_FRAME, Picture, pixels
from replay.files.log import info, parts, read
from replay.files.suspect import suspecting

See = Callable[[NDArray[np.uint8], tuple[int, int, int, int], Sighting, Sighting | None], Sighting]
MakeSee = Callable[[Fleet, CameraFit], See]


class Limit(NamedTuple):
    """Differences of one quantity that pass."""

    most: float  # of all frames but the odd ones
    median: float  # half of the frames are off only if vision has changed


class Tolerance(NamedTuple):
    """What passes, by what is compared."""

    odd: float  # share of frames that may be far off, or show a target that is only just there, or just not
    centre_px: Limit
    radius_px: Limit
    clarity: Limit  # relative
    peak: Limit  # lens positions, of the peak of a whole sweep


LOSSLESS = Tolerance(  # versions of OpenCV; else bit by bit
    odd=0.0,
    centre_px=Limit(0.01, 0.01),
    radius_px=Limit(0.01, 0.01),
    clarity=Limit(1e-4, 1e-4),
    peak=Limit(0.05, 0.05),
)
# Beside each limit what compression does at most to 99 % of the frames, and to half of them, in any of six recordings
# of the twin with one ball and with two: 3083 frames, 230 sweeps. Odd were two frames, of a ball half behind another at
# the edge of the picture, with a score below 0.5.
JPEG = Tolerance(
    odd=0.01,
    centre_px=Limit(0.5, 0.25),  # 0.35, 0.09
    radius_px=Limit(0.4, 0.15),  # 0.19, 0.05
    clarity=Limit(0.12, 0.02),  # 0.07, 0.009
    peak=Limit(1.0, 0.4),  # 0.49, 0.15 against the kernel's own peaks: nine recordings, 278 sweeps
)


class Quantity(NamedTuple):
    """One compared quantity over a recording."""

    worst: float
    most: float  # all but the odd ones are below
    median: float
    compared: int
    limit: Limit

    @property
    def passed(self) -> bool:
        return self.most <= self.limit.most and self.median <= self.limit.median


class VisionCheck(NamedTuple):
    """What came of one recording."""

    box: BlackBox
    frames: int  # compared
    lost: int  # sightings whose frame is not in the file
    missing: int  # found then, not now
    extra: int  # found now, not then
    quantities: dict[str, Quantity]
    odd: float  # share of frames that may be

    @property
    def passed(self) -> bool:
        within = all(quantity.passed for quantity in self.quantities.values())
        return self.frames > 0 and self.missing + self.extra <= self.odd * self.frames and within

    def __str__(self) -> str:
        verdict = "within tolerance" if self.passed else "differs" if self.frames else "holds no frames"
        lines = [f"{self.box.path}: vision {verdict}, {self.frames} frames" + (f", {self.lost} lost" * bool(self.lost))]
        lines += [f"  target {what}: {n}" for what, n in (("missed", self.missing), ("added", self.extra)) if n]
        for name, q in self.quantities.items():
            most = f"{1.0 - self.odd:.0%} within {q.most:.2g} ({q.limit.most:g} allowed)"
            found = f"median {q.median:.2g} ({q.limit.median:g} allowed), {most}, worst {q.worst:.2g}"
            lines.append(f"  {name}: {found}, {q.compared} compared" + ("" if q.passed else "  <- too large"))
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        return {
            "file": str(self.box.path),
            "passed": self.passed,
            **{name: getattr(self, name) for name in ("frames", "lost", "missing", "extra")},
            "quantities": {
                name: {**quantity._asdict(), "limit": quantity.limit._asdict()}
                for name, quantity in self.quantities.items()
            },
        }


def check_vision(paths: Sequence[Path], make_see: MakeSee, console: Console | None = None) -> list[VisionCheck]:
    """Check every black box among files and folders; `make_see` is agent.perception.rerun_vision.rerun_vision.

    Raises ConfigError for input that is no recording or whose frames do not decode.
    """
    boxes, found = open_boxes(paths), []
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=console is None, transient=True) as bar:
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
    picture: tuple[int, Picture] | None = None
    sweep: tuple[str, int] = ("", 0)
    first: Sighting | None = None  # of the sweep, with its target in it
    for record in read(box.path):
        if record.channel == FRAME.name:
            picture = record.sequence, decode(record.data, Picture, limit=MAX_FRAME)
        elif record.channel == VISION.name:
            then = decode(record.data, Sighting)
            if (then.target, then.sweep) != sweep:
                sweep, first = (then.target, then.sweep), None
            if picture is None or picture[0] != record.sequence:
                yield SightingPair(then, None, lossless=False)
            else:
                now = see(pixels(picture[1]), picture[1].roi, then, first)
                yield SightingPair(then, now, picture[1].format == "png")
            if then.sweep and first is None and then.found:
                first = then  # not that of now: else one difference would spread over its sweep


def compare(box: BlackBox, seen: Iterable[SightingPair]) -> VisionCheck:
    """The differences of all frames, and of the peaks of all sweeps in which the kernel found one."""
    apart: dict[str, list[float]] = {"centre, px": [], "radius, px": [], "clarity, relative": [], "peak, positions": []}
    frames = lost = missing = extra = 0
    lossless = True
    sweeps: defaultdict[tuple[str, int], list[Sighting | None]] = defaultdict(list)  # what the kernel had, seen now
    for then, now, exact in seen:
        if then.sweep and then.clarity is not None:
            sweeps[then.target, then.sweep].append(now)
        if now is None:
            lost += 1
            continue
        frames, lossless = frames + 1, lossless and exact
        missing += then.found and not now.found
        extra += now.found and not then.found
        if not (then.found and now.found):
            continue
        if then.centre_px and now.centre_px:
            apart["centre, px"].append(math.dist(then.centre_px, now.centre_px))
        if then.radius_px and now.radius_px:
            apart["radius, px"].append(abs(now.radius_px - then.radius_px))
        if then.clarity and now.clarity:
            apart["clarity, relative"].append(abs(now.clarity / then.clarity - 1.0))
    for outcome in _outcomes(box):
        now_peak = _peak(sweeps[outcome.target, outcome.sweep], outcome.held_width)
        if outcome.lens_position is not None and now_peak is not None:
            apart["peak, positions"].append(abs(now_peak - outcome.lens_position))
    limits = LOSSLESS if lossless else JPEG
    quantities = {
        name: quantity(values, limits.odd, limit)
        for (name, values), limit in zip(apart.items(), limits[1:], strict=True)
        if values
    }
    return VisionCheck(box, frames, lost, missing, extra, quantities, limits.odd)


def quantity(values: Sequence[float], odd: float, limit: Limit) -> Quantity:
    most = float(np.quantile(values, 1.0 - odd, method="higher"))  # of fewer than 1 / odd values: the largest
    return Quantity(max(values), most, float(np.median(values)), len(values), limit)


def _outcomes(box: BlackBox) -> Iterator[SweepOutcome]:
    """What the kernel made of each sweep, when it was recorded."""
    for step in box.steps():
        outputs = decode(step.outputs, Outputs, limit=STEP_BYTES) if step.outputs is not None else None
        if outputs is not None and outputs.outcome is not UNSET:
            yield outputs.outcome


def _peak(frames: Sequence[Sighting | None], held_width: float | None) -> float | None:
    """The peak of frames as they are seen now, found as the kernel found it then: in as many, the same width held."""
    good = [(float(f.focus), f.clarity) for f in frames if f and f.focus is not None and f.clarity is not None]
    if len(good) < len(frames):
        return None
    peak = fit_peak([rho for rho, _ in good], [clarity for _, clarity in good], held_width)
    return peak.lens_position if isinstance(peak, Peak) else None


def _frames(box: BlackBox) -> int:
    heads = [info(file).channels for file in parts(box.path)]
    return sum(head[VISION.name].messages for head in heads if VISION.name in head)
