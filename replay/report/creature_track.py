"""A target that swims, as a run has it: where it truly was, where each robot believed it to be, and who saw it when.

The truth is the twin's, from creatures.csv and boxes.csv beside the recordings; all else is from black boxes. A robot
sees it while its newest frame shows it, and truly shows it: what vision took for it has to lie where it is. Times are
in ns by the dive's clock, places in metres, world frame.
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Symmetric, Vector
from agent.core.status import sigma_m
from agent.core.step_io import Inputs, Outputs
from agent.core.topics import NEAR
from replay.check.reexecute import STEP_BYTES, BlackBox
from replay.report.page import Table, cell, percent

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
    at_landmarks: bool  # the camera was looking for landmarks


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
    if not file.is_file():
        return None
    with _reading(file), file.open(encoding="utf-8", newline="") as rows:
        found = [
            (int(row["t_ns"]), _finite(row["x_m"]), _finite(row["y_m"]), _finite(row["z_m"]))
            for row in csv.DictReader(rows)
            if row["creature"] == creature and row["z_m"]
        ]
        times = np.array([row[0] for row in found], np.int64)
    return Path3(times, np.array([row[1:] for row in found])) if found else None


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    """Raises ConfigError for a table that no twin wrote."""
    try:
        yield
    except (ValueError, KeyError, TypeError, OverflowError, csv.Error):
        raise ConfigError(
            f"{file}: not as the twin wrote it; repair it, or remove it to do without the truth"
        ) from None


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError("no number")
    return value


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
    if not file.is_file():
        return {}
    with _reading(file), file.open(encoding="utf-8", newline="") as rows:
        return {
            (row["robot"], int(row["frame"])): (
                (_finite(row["x0"]), _finite(row["y0"]), _finite(row["x1"]), _finite(row["y1"])),
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
        glance_until_ns = max((said.glance_until_ns for said in outputs.said(NEAR)), default=glance_until_ns)
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


# --- tables ---
# Why a robot did not see a target that swims, and what it believed meanwhile: each time that it lost it.

LOST_S = 0.3  # out of sight for longer, it has been lost
MOST = 60  # rows


def followed_table(summary: Mapping[str, Any], target: str) -> Table:
    """Each robot's figures from summary.json."""
    about = summary["targets"][target]
    head = ["robot", "saw it", "times lost", "longest, s", "found / in the picture", "mistaken", "off, rms mm", "95 %"]
    rows = [[*head, "NEES"]]
    for name, row in about["agents"].items():
        saw, found = followed_cells(row), f"{row['found_of_these']} / {row['in_the_picture']}"
        rows.append([name, *saw[:3], found, *saw[3:]])
    by = f"one robot {percent(about['seen_by_one'])}, two {percent(about['seen_by_two'])}"
    return Table(
        f"{target}, from when all knew of it, {about['followed_s']:.0f} s: it was seen by at least {by} of the time. "
        "NEES is the squared error in the covariance that the robot stated: 3 where it knew how well it knew.",
        rows,
    )


def followed_cells(row: Mapping[str, Any]) -> list[str]:
    """Of one robot: saw it, times lost, longest, mistaken, off rms and 95 %, NEES."""
    counts = (("times_lost", "d"), ("longest_unseen_s", ".1f"), ("mistaken", "d"))
    figures = (("track_rms_mm", ".1f"), ("track_p95_mm", ".1f"), ("nees", ".2f"))
    return [percent(row["seen"]), *(cell(row[name], form) for name, form in (*counts, *figures))]


def lost_table(fleet: Fleet, track: CreatureTrack, start_ns: int) -> Table:
    """A row for each time that a robot lost sight of it."""
    moments = track.moments(track.known_ns if track.known_ns is not None else track.ends_ns)
    sees = {name: track.sees(name, moments) for name in fleet.robot if name in track.looks}
    rows: list[tuple[float, list[str]]] = []
    for name, mask in sees.items():
        edges = np.flatnonzero(np.diff(np.concatenate([[1], mask.astype(int), [1]]))).reshape(-1, 2)
        for a, b in edges.tolist():
            from_ns, for_s = int(moments[a]), (b - a) * EVERY_NS * 1e-9
            if for_s <= LOST_S:
                continue
            until_ns = from_ns + (b - a) * EVERY_NS
            looks = [look for look in track.looks[name] if from_ns - EVERY_NS <= look.t_ns < until_ns]
            others = [other for other, theirs in sees.items() if other != name and theirs[a:b].any()]
            rows.append(
                (
                    (from_ns - start_ns) * 1e-9,
                    [
                        name,
                        f"{for_s:.1f}",
                        why(looks),
                        ", ".join(others) or "nobody",
                        _believed(track, name, from_ns, until_ns),
                    ],
                )
            )
    rows.sort(key=lambda row: row[0])
    head = ["robot", "from, s", "for, s", "why", "seen meanwhile by", "it believed"]
    left = f" Only the first {MOST} of {len(rows)}." if len(rows) > MOST else ""
    return Table(
        "Each time that a robot had it out of sight for more than 0.3 s, why, and what its belief was made of at the "
        f"end of that.{left}",
        [head, *([row[0], f"{t_s:.1f}", *row[1:]] for t_s, row in rows[:MOST])],
    )


def why(looks: Sequence[Look]) -> str:
    """What most of the frames of a gap show."""
    if not looks:
        return "no frames"
    reasons = Counter(_reason(look) for look in looks)
    return ", ".join(f"{text} ({n} of {len(looks)})" for text, n in reasons.most_common(2))


def _reason(look: Look) -> str:
    if look.found and not look.right and look.there is not None:
        return "something else was taken for it"
    match look.there:
        case "hidden":
            return "hidden behind something"
        case "shows":
            return "seen again" if look.right else "in the picture, not found"
        case "outside":
            return "camera at landmarks" if look.at_landmarks else "not in the picture"
        case None:
            return "found again" if look.found else "not found"


def _believed(track: CreatureTrack, name: str, from_ns: int, until_ns: int) -> str:
    """The last of its beliefs in that time: made of whose word, how far off, how sure."""
    rows = [row for row in track.held.get(name, []) if row.t_ns < until_ns]
    if not rows:
        return "nothing"
    last: Held = rows[-1]
    if last.t_ns < from_ns:
        return "as before"
    shares = sorted(((share, other) for other, share in last.shares.items() if share >= 0.01), reverse=True)
    words = " ".join(f"{other} {100 * share:.0f} %" for share, other in shares) or "what it knew before"
    off_mm = 1e3 * float(np.linalg.norm(np.array(last.x_m) - track.truth.at([last.t_ns])[0]))
    sigma_mm = 1e3 * sigma_m(last.cov_m2)
    return f"{words}; {off_mm:.0f} mm off, says ± {sigma_mm:.0f}"
