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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet, Pose
from agent.core.estimation.protocols import dynamics
from agent.core.estimation.track import FixedLagFilter
from agent.core.estimation.track import Held as Sample
from agent.core.linear_algebra import full, upper
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.camera_model import apply, at_lens_position, camera_pose, pixel, to_camera
from agent.core.status import sigma_m
from agent.core.step_io import Inputs, Outputs, Sighting
from agent.core.topics import NEAR
from replay.check.reexecute import STEP_BYTES, BlackBox, open_boxes
from replay.report.page import Table, cell, percent

CREATURES, BOXES, PATHS = "creatures.csv", "boxes.csv", "paths.csv"  # as the twin leaves them
FRESH_NS = 300_000_000  # a newest frame that is older shows nothing of now: three of ten a second
EVERY_NS = 100_000_000  # from one moment to the next at which it is asked who sees
SETTLES_NS = 5_000_000_000  # after the first robot has found it a track ought to be good
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
    """A path: times, ns, and what is there (n, k): places."""

    t_ns: NDArray[np.int64]
    x_m: Array

    def at(self, t_ns: Sequence[int] | NDArray[np.int64]) -> Array:
        """(m, k) between its points; NaN beyond its ends."""
        t = np.asarray(t_ns, np.int64)
        base = self.t_ns[0]
        rel, own = (t - base).astype(float), (self.t_ns - base).astype(float)
        return np.column_stack([np.interp(rel, own, way, left=math.nan, right=math.nan) for way in self.x_m.T])


Belief = tuple[int, Vector, Symmetric]  # when, where, and its covariance


def errors(beliefs: Sequence[Belief], truth: Path3) -> tuple[Array, Array]:
    """Distance from the truth (n,), m, and its square in the stated covariance (n,), of those whose truth is known."""
    off_m = np.array([x_m for _, x_m, _ in beliefs]).reshape(-1, 3) - truth.at([t_ns for t_ns, _, _ in beliefs])
    known = np.isfinite(off_m).all(axis=1)
    off_m, cov_m2 = off_m[known], np.array([full(one) for _, _, one in beliefs]).reshape(-1, 3, 3)[known]
    nees = (off_m * np.linalg.solve(cov_m2, off_m[..., None])[..., 0]).sum(axis=1)
    return np.linalg.norm(off_m, axis=1), nees


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
    def first_ns(self) -> int | None:
        """When the first robot found it where it is; None: none ever did."""
        return min((look.t_ns for rows in self.looks.values() for look in rows if look.right), default=None)

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


# --- causes ---
# What each cause of a track's error was worth: the bearings that robots said, with what was wrong in them taken out.
#
# All go into one filter, with the fleet's own dynamics and without its vote, in the order in which they were said or,
# without latency, as they were exposed. Two things are wrong in a bearing: where in the picture the middle of the body
# was taken to be, which the twin's truth of body and camera tells; and where the robot took its camera to be and look.

LAG_NS = 1_000_000_000  # longer no bearing is on its way


class Cause(NamedTuple):
    """A track, and its error, rms in mm, and NEES, from SETTLES_NS on and from when a robot saw it first."""

    track: str
    settled: tuple[float, float]
    whole: tuple[float, float]


class Said(NamedTuple):
    """A bearing as a robot said it; vectors (3,) are information times a place, as in messages."""

    exposed_ns: int
    said_ns: int
    information: Array  # (3, 3)
    vector: Array
    by_picture: Array  # what of the vector comes of the picture's error
    exact: Array  # the vector of a bearing without any


def track_causes(folder: Path) -> list[Cause]:
    """Of the first target that swims in a run whose twin left the truth beside it. Raises ConfigError without one."""
    boxes = open_boxes([folder])
    fleet = boxes[0].fleet
    target = next((name for name, about in fleet.target.items() if about.speed_m_s is not None), None)
    if target is None:
        raise ConfigError(f"{folder}: nothing swims; --track is about a target with speed_m_s")
    track = creature_track(folder, boxes, target)
    if track is None or not (folder / PATHS).is_file():
        raise ConfigError(
            f"{folder}: {CREATURES} or {PATHS} is missing; give the folder of a demo, whose twin left them"
        )
    ways = true_ways(folder)
    unknown = ", ".join(sorted({box.robot for box in boxes} - ways.keys()))
    if unknown:
        raise ConfigError(f"{folder / PATHS}: has nothing of {unknown}; give the folder as the twin left it")
    said = [bearing for box in boxes for bearing in _said(box, target, track.truth, ways[box.robot])]
    if not said:
        raise ConfigError(f"{folder}: no robot said a bearing of {target} in the time of which {CREATURES} tells")
    moves, first_ns = dynamics(fleet.target[target]), min(bearing.exposed_ns for bearing in said)
    seen_ns = first_ns if track.first_ns is None else track.first_ns
    moments = sorted({held.t_ns for rows in track.held.values() for held in rows if held.t_ns > first_ns})

    def filtered(vector: Callable[[Said], Array], at_once: bool = False) -> list[Belief]:
        bearings = [(one.exposed_ns if at_once else one.said_ns, _as_held(one, vector(one))) for one in said]
        return _filtered(bearings, FixedLagFilter(moves, fleet.tank.size_m), moments)

    believed = [held[:3] for rows in track.held.values() for held in rows]
    tracks: dict[str, list[Belief]] = {
        "as the robots believed it": believed,
        "all bearings in one filter": filtered(lambda one: one.vector),
        "the same without latency": filtered(lambda one: one.vector, at_once=True),
        "with the true middle in each picture": filtered(lambda one: one.vector - one.by_picture),
        "with the true place and way of each camera": filtered(lambda one: one.exact + one.by_picture),
        "with both": filtered(lambda one: one.exact),
        "with both, without latency": filtered(lambda one: one.exact, at_once=True),
    }
    return [
        Cause(
            name,
            *(
                _means([belief for belief in beliefs if belief[0] >= from_ns], track.truth)
                for from_ns in (seen_ns + SETTLES_NS, seen_ns)
            ),
        )
        for name, beliefs in tracks.items()
    ]


def true_ways(folder: Path) -> dict[str, Path3]:
    """Of each robot that swam: x, y, z (m), roll, pitch, yaw, pan and tilt (degrees, without jumps), (n, 8).

    Raises ConfigError for a file that is not there or damaged.
    """
    columns = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "pan_deg", "tilt_deg")
    rows: dict[str, list[tuple[int, list[float]]]] = {}
    with _reading(folder / PATHS), (folder / PATHS).open(encoding="utf-8", newline="") as lines:
        for line in csv.DictReader(lines):
            place = [_finite(line[column]) for column in columns]
            rows.setdefault(line["robot"], []).append((int(line["t_ns"]), place))
        times = {robot: np.array([t_ns for t_ns, _ in way], np.int64) for robot, way in rows.items()}
    ways = {}
    for robot, way in rows.items():
        places = np.array([place for _, place in way])
        places[:, 3:] = np.degrees(np.unwrap(np.radians(places[:, 3:]), axis=0))
        ways[robot] = Path3(times[robot], places)
    return ways


def _said(box: BlackBox, target: str, truth: Path3, way: Path3) -> Iterator[Said]:
    """Each bearing of the robot's own, when it said it first."""
    frames: dict[int, Sighting] = {}
    told: set[int] = set()
    for step in box.steps():
        seen = decode(step.inputs, Inputs, limit=STEP_BYTES).sightings
        frames |= {one.t_ns: one for one in seen if one.target == target and one.found}
        says = () if step.outputs is None else decode(step.outputs, Outputs, limit=STEP_BYTES).says
        for sample in (one for word in says if word.target == target and word.gossip for one in word.gossip.samples):
            frame = frames.get(sample.t_ns)
            if sample.origin != box.robot or sample.number in told or frame is None:
                continue
            told.add(sample.number)
            there, pose = truth.at([sample.t_ns])[0], way.at([sample.t_ns])[0]
            aside_m = _aside_m(box, frame, there, pose)
            if aside_m is not None:
                L = np.array(full(sample.information))
                yield Said(sample.t_ns, step.now_ns, L, np.array(sample.vector), L @ aside_m, L @ there)


def _aside_m(box: BlackBox, frame: Sighting, there: Array, pose: Array) -> Array | None:
    """(3,) by how much, m, what was found in the picture is beside the body's middle; None where nobody knows."""
    if frame.centre_px is None or not (np.isfinite(there).all() and np.isfinite(pose).all()):
        return None
    x, y, z, roll, pitch, yaw, pan, tilt = pose.tolist()
    surface_m, camera = box.fleet.tank.surface_m, at_lens_position(box.calibration.camera, frame.focus)
    place = Pose(x_m=x, y_m=y, yaw_deg=yaw)
    eye = camera_pose(place, box.fleet.body, surface_m - z, roll, pitch, pan, tilt, surface_m)
    at_m = to_camera(eye, there.tolist())
    middle_px = pixel(camera, at_m)
    if middle_px is None:
        return None
    u, v = (at_m[2] * (found - true) / camera.f_px for found, true in zip(frame.centre_px, middle_px, strict=True))
    return np.array(apply(eye.rotation, (u, v, 0.0)))


def _as_held(of: Said, vector: Array) -> Sample:
    x, y, z = vector.tolist()
    return Sample(of.exposed_ns, upper(of.information), (x, y, z))


def _filtered(bearings: list[tuple[int, Sample]], through: FixedLagFilter, moments: Sequence[int]) -> list[Belief]:
    """What a filter believes at each of these moments, of bearings that it gets when they are due."""
    coming, window, frozen_ns = sorted(bearings, key=lambda one: one[0]), list[Sample](), 0
    due_ns, begin = [ns for ns, _ in coming], 0
    found: list[Belief] = []
    for now_ns in moments:
        end = bisect_right(due_ns, now_ns)
        window += [sample for _, sample in coming[begin:end]]
        window, begin = [sample for sample in window if sample.t_ns > frozen_ns], end
        track = through.run(window, now_ns - LAG_NS, now_ns)
        frozen_ns = now_ns - LAG_NS
        if track is not None:
            found.append((now_ns, track.x_m, track.A))
    return found


def _means(beliefs: Sequence[Belief], truth: Path3) -> tuple[float, float]:
    """Rms of the distance from the truth, mm, and mean of its square in the stated covariance."""
    off_m, nees = errors(beliefs, truth)
    return (1e3 * math.sqrt(float(np.mean(off_m**2))), float(nees.mean())) if len(off_m) else (math.nan, math.nan)


def causes_table(causes: Sequence[Cause]) -> str:
    """For people."""
    head = f"{'':44}{'from 5 s on':>18}{'whole dive':>18}\n{'track':44}" + f"{'rms, mm':>10}{'NEES':>8}" * 2
    rows = (
        f"{one.track:44}" + "".join(f"{mm:10.1f}{nees:8.2f}" for mm, nees in (one.settled, one.whole)) for one in causes
    )
    return "\n".join([head, *rows])
