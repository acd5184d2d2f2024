"""`aucamp replay check --vision`: vision again on the recorded frames, against what it said at the time.

Judged is what the kernel decides by vision, and what vision itself says of the frames that are kept losslessly; the
limits and their reasons are in vision_limits.py. A target that is followed from frame to frame is not judged where
frames are compressed: its tracker builds on all frames before. The function that sees is handed in: replay does not
know perception.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Sighting
from replay.check.black_box import BlackBox, open_boxes
from replay.check.sweeps_again import SweepPair, by_sweep, sweep_pairs
from replay.check.vision_limits import (
    EXACT_CLARITY,
    EXACT_PX,
    EXACT_SHARE,
    ODD,
    OUTLINE_PX,
    SHARE_RMS,
    SHARE_WORST,
    Quantity,
    mean_shift,
    rms,
    worst,
)
from replay.files.channels import VISION
from replay.files.frames import Frames, pixels
from replay.files.log import info, parts, read
from replay.files.suspect import suspecting

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
        quantities={**_exactly(exact), **_on_average(judged, lossless), **_decided(sweeps, lossless)},
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


def _decided(sweeps: Sequence[SweepPair], lossless: bool) -> dict[str, Quantity]:
    found = {}
    for name in ("peak", "place"):
        shifts = [shift for sweep in sweeps if (shift := getattr(sweep, name)) is not None]
        if shifts:
            what = f"{name} of each sweep, in its own sigma"
            found[f"{what}, rms"] = rms(shifts, EXACT_SHARE if lossless else SHARE_RMS)
            found[f"{what}, worst"] = worst(shifts, EXACT_SHARE if lossless else SHARE_WORST)
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
