"""A target that swims, as a run has it: where it truly was, where each robot believed it to be, and who saw it when.

The truth is the twin's, from creatures.csv and boxes.csv beside the recordings; all else is from black boxes. A robot
sees it while its newest frame shows it, and truly shows it: what vision took for it has to lie where it is. Times are
in ns by the dive's clock, places in metres, world frame.
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.core.codec import decode
from agent.core.messages import Symmetric, Vector
from agent.core.step_io import Inputs, Outputs
from replay.check.black_box import STEP_BYTES, BlackBox

CREATURES, BOXES = "creatures.csv", "boxes.csv"  # as the twin leaves them
FRESH_NS = 300_000_000  # a newest frame that is older shows nothing of now: three of ten a second
EVERY_NS = 100_000_000  # from one moment to the next at which it is asked who sees
BESIDE = 0.25  # of the true box's sides: where the middle of what was found may lie beyond it

Array = NDArray[np.float64]
TrueBox = tuple[float, float, float, float]


There = Literal["shows", "hidden", "outside"]  # in the picture, behind something in the picture, beside it


class Look(NamedTuple):
    """One frame: whether vision found the target in it, and whether it is there."""

    t_ns: int
    found: bool
    right: bool  # found where it is
    there: There | None  # by the twin; None: it does not say
    glances: bool  # the camera was looking for landmarks


class Held(NamedTuple):
    """What one robot believed after one iteration."""

    t_ns: int
    x_m: Vector
    cov_m2: Symmetric
    sees: bool  # in its own words
    shares: Mapping[str, float]  # of each robot's word in it
    status: str  # what the protocol said of those words


class Path3(NamedTuple):
    """A path: times, ns, and places (n, 3)."""

    t_ns: NDArray[np.int64]
    x_m: Array

    def at(self, t_ns: Sequence[int] | NDArray[np.int64]) -> Array:
        """(n, 3) between its points; NaN beyond its ends."""
        t = np.asarray(t_ns, np.int64)
        base = self.t_ns[0]
        rel, own = (t - base).astype(float), (self.t_ns - base).astype(float)
        return np.column_stack([np.interp(rel, own, self.x_m[:, k], left=math.nan, right=math.nan) for k in range(3)])


class CreatureTrack(NamedTuple):
    """One target over a run, by robot."""

    target: str
    truth: Path3
    held: Mapping[str, list[Held]]
    looks: Mapping[str, list[Look]]

    @property
    def known_ns(self) -> int | None:
        """Since when all robots know of it; None: one never did."""
        firsts = [rows[0].t_ns if rows else None for rows in self.held.values()]
        return None if not firsts or None in firsts else max(t for t in firsts if t is not None)

    @property
    def begins_ns(self) -> int:
        """The first frame of any robot."""
        return min((rows[0].t_ns for rows in self.looks.values() if rows), default=0)

    @property
    def ends_ns(self) -> int:
        """The last frame of the robot that stopped first."""
        return min((rows[-1].t_ns for rows in self.looks.values() if rows), default=0)

    def moments(self, from_ns: int) -> NDArray[np.int64]:
        return np.arange(from_ns, self.ends_ns + 1, EVERY_NS, dtype=np.int64)

    def sees(self, robot: str, moments: Iterable[int]) -> NDArray[np.bool_]:
        """At each moment, whether the robot's newest frame shows it, rightly found."""
        looks = self.looks[robot]
        times = [look.t_ns for look in looks]
        found = []
        for t_ns in moments:
            k = bisect_right(times, t_ns) - 1
            found.append(k >= 0 and t_ns - times[k] <= FRESH_NS and looks[k].right)
        return np.array(found, bool)


def true_path(folder: Path, creature: str) -> Path3 | None:
    """Where the middle of a creature was; None where no twin has left that."""
    file = folder / CREATURES
    if not file.exists():
        return None
    with file.open(encoding="utf-8", newline="") as rows:
        found = [
            (int(row["t_ns"]), float(row["x_m"]), float(row["y_m"]), float(row["z_m"]))
            for row in csv.DictReader(rows)
            if row["creature"] == creature and row["z_m"]
        ]
    if not found:
        return None
    return Path3(np.array([row[0] for row in found], np.int64), np.array([row[1:] for row in found]))


def creature_track(folder: Path, boxes: Sequence[BlackBox], target: str) -> CreatureTrack | None:
    """None where the twin has left no truth of it."""
    truth = true_path(folder, target)
    if truth is None:
        return None
    shown = _true_boxes(folder, target)
    held: dict[str, list[Held]] = {}
    looks: dict[str, list[Look]] = {}
    for box in boxes:
        its_held, its_looks = _told(box, target, shown)
        held.setdefault(box.robot, []).extend(its_held)
        looks.setdefault(box.robot, []).extend(its_looks)
    return CreatureTrack(target, truth, held, looks)


def _true_boxes(folder: Path, creature: str) -> dict[tuple[str, int], tuple[TrueBox, int]]:
    """By robot and number of the frame: the box around it, and how many of its pixels show. Frames that show nothing
    of it, even of what would be without what hides it, are not there."""
    file = folder / BOXES
    if not file.exists():
        return {}
    with file.open(encoding="utf-8", newline="") as rows:
        return {
            (row["robot"], int(row["frame"])): (
                (float(row["x0"]), float(row["y0"]), float(row["x1"]), float(row["y1"])),
                int(row["visible"]),
            )
            for row in csv.DictReader(rows)
            if row["creature"] == creature and row["visible"]
        }


def _told(
    box: BlackBox, target: str, shown: Mapping[tuple[str, int], tuple[TrueBox, int]]
) -> tuple[list[Held], list[Look]]:
    held: list[Held] = []
    looks: list[Look] = []
    newest_t, glance_until_ns = -1, 0
    for step in box.steps():
        for seen in decode(step.inputs, Inputs, limit=STEP_BYTES).sightings:
            if seen.target != target:
                continue
            at, visible = shown.get((box.robot, seen.frame), (None, 0))
            right = seen.found and visible > 0 and at is not None and _within(seen.centre_px, at)
            there: There = "outside" if at is None else "shows" if visible else "hidden"
            looks.append(Look(seen.t_ns, seen.found, right, there if shown else None, seen.t_ns < glance_until_ns))
        if step.outputs is None:
            continue
        outputs = decode(step.outputs, Outputs, limit=STEP_BYTES)
        if outputs.near is not UNSET:
            glance_until_ns = max((said.glance_until_ns for said in outputs.near), default=glance_until_ns)
        for said in outputs.says:
            if said.target == target and said.t != newest_t and said.x_m is not None and said.cov_m2 is not None:
                newest_t = said.t
                held.append(Held(step.now_ns, said.x_m, said.cov_m2, said.valid, {}, ""))
        state = outputs.state
        if state is not None and state.target == target and state.explain is not None and held and state.t == newest_t:
            shares = {**state.explain.weights, box.robot: state.explain.weights.get(box.robot, 0.0)}
            held[-1] = held[-1]._replace(shares=shares, status=state.explain.status)
    return held, looks


def _within(centre_px: tuple[float, float] | None, box: TrueBox) -> bool:
    if centre_px is None:
        return False
    x0, y0, x1, y1 = box
    beside, below = BESIDE * (x1 - x0), BESIDE * (y1 - y0)
    u, v = centre_px
    return x0 - beside <= u <= x1 + beside and y0 - below <= v <= y1 + below
