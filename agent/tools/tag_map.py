"""`aucamp calibrate landmarks`: a map of the tank's tags from a film of them, and how well each is known: the pictures
that say something new, a start, the adjustment, and the result.

Some places must be measured by hand, or nobody knows where the tank is: of all tags that the fleet file lists, or of
those named by --known, what it says counts with the sigma that it states. All others are found, flat on their faces.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agent.capabilities.swim.landmarks import axes, corners, on_face, plane
from agent.core.codec import READABLE, decode
from agent.core.config import ConfigError, Fleet, Landmarks, Tag, Tank, read_toml, write_whole
from agent.core.ranging.camera_model import Calibration, at_lens_position, load_calibration
from agent.core.step_io import Inputs, SeenTag
from agent.perception.tags import Array, find_tags
from agent.process.command import Failed, Progress, free_name, with_bar
from agent.robot.fleet_reader import broken_landmark_rules, load_fleet
from agent.tools.enhance import pictures
from agent.tools.tag_bundle import CORNERS, HUBER, Bundle, Cameras, Prior, SurveyFrame, Tags, bundle, turned_by
from agent.tools.tags import check_size
from replay.check.reexecute import STEP_BYTES, BlackBox, open_boxes
from replay.files.recover import black_boxes

# --- the result ---
# What a survey of tags found: the table for people, and the table [landmarks] for robots, in a file of its own.

BAD_SHARE = 0.2  # of the views of a tag: something is wrong with it, not with them


class Surveyed(NamedTuple):
    """One line of the table."""

    tag: Tag
    sigma_m: float  # of each coordinate of its middle
    sigma_deg: float  # of each angle; how it leans from its face included
    moved_m: float | None  # from where the fleet file has it
    views: int
    bad: int  # of them


class Survey(NamedTuple):
    tags: list[Surveyed]
    frames: int
    bundle: Bundle  # the same tags, their errors and how these hang together
    unplaced: tuple[int, ...]


def table(found: Survey) -> Table:
    shown = Table()
    columns = ("tag", "face", "x m", "y m", "z m", "turn deg", "sigma mm", "sigma deg", "from the file mm", "views")
    for column in columns:
        shown.add_column(column, justify="left" if column == "face" else "right")
    for tag, sigma_m, sigma_deg, moved_m, views, bad in found.tags:
        shown.add_row(
            str(tag.id), tag.face, *(f"{value:.4f}" for value in tag.position_m), f"{tag.turn_deg:.2f}",
            f"{1e3 * sigma_m:.2f}", f"{sigma_deg:.2f}", "" if moved_m is None else f"{1e3 * moved_m:.1f}",
            f"{views}, {bad} bad" if bad else str(views),
        )  # fmt: skip
    return shown


def remarks(found: Survey, looked_at: int) -> list[str]:
    """How it went, in lines."""
    said = [f"{found.frames} of {looked_at} pictures used, corners miss by {found.bundle.misfit_px:.2f} px (rms)"]
    if found.unplaced:
        names = ", ".join(map(str, found.unplaced))
        said.append(f"no place for {names}: seen, but in no picture with a tag that has one, or on no wall or floor")
    for each in found.tags:
        if each.bad > BAD_SHARE * each.views:
            said.append(f"tag {each.tag.id} does not fit in {each.bad} of {each.views} views: loose, bent, or covered?")
    return said


def missing(found: Survey, landmarks: Landmarks, named: Sequence[int]) -> list[str]:
    """What the fleet file lists and the survey lacks, in lines. `named`: by --known.

    An old place is not copied into the survey: it is of another frame, and [landmarks] has one sigma for all tags.
    """
    found_ids = {each.tag.id for each in found.tags}
    said = []
    if silent := [str(one) for one in named if one not in found_ids]:
        said.append(f"--known {', '.join(silent)}: in no picture that is used, so that its place does not count")
    if lost := [str(tag.id) for tag in landmarks.tag if tag.id not in found_ids]:
        said.append(f"in the fleet file, and left out of the survey as no picture places them: {', '.join(lost)}")
        said[-1] += "; film them too, or robots lose them"
    return said


def block(found: Survey, fleet: Fleet) -> str:
    """The table [landmarks], as uncertain as the worst of its tags. Raises Failed for what no fleet file may say."""
    assert fleet.landmarks is not None
    sigma_m, sigma_deg = max(each.sigma_m for each in found.tags), max(each.sigma_deg for each in found.tags)
    tags = tuple(
        Tag(
            id=tag.id,
            face=tag.face,
            position_m=tuple(round(value, 5) + 0.0 for value in tag.position_m),  # type: ignore[arg-type]
            turn_deg=round(tag.turn_deg, 2) + 0.0,
        )
        for tag, *_ in found.tags
    )
    size_m = fleet.landmarks.size_m
    for _, wrong in broken_landmark_rules(Landmarks(size_m=size_m, tag=tags), fleet.tank):
        raise Failed(f"the survey cannot be right: {wrong}")
    head = f'[landmarks]\nfamily = "36h11"\nsize_m = {size_m:g}\nsigma_m = {sigma_m:.5f}\nsigma_deg = {sigma_deg:.3f}'
    lines = (
        f'  {{ id = {tag.id}, face = "{tag.face}", position_m = {list(tag.position_m)}, turn_deg = {tag.turn_deg} }},'
        for tag in tags
    )
    return "\n".join([head, "tag = [", *lines, "]", ""])


def check_out(path: Path) -> None:
    """Raises ConfigError for a file that is not a survey: what else is in it would be lost."""
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: give --out a name that ends in .toml")
    if path.exists() and read_toml(path).keys() != {"landmarks"}:
        raise ConfigError(f"{path}: holds more than [landmarks], and that would be lost; give --out another name")


def put(path: Path, text: str) -> str:
    """Write it; a survey that was there is kept beside it. Says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = free_name(path.with_name(path.name + ".before")) if path.exists() else None
    if kept is not None:
        shutil.copy2(path, kept)
    write_whole(path, text)
    said = f'written to {path}; in the fleet file: [landmarks] file = "{path.name}"'
    return said if kept is None else f"{said}; the survey as it was: {kept}"


# --- pictures ---
# The pictures of a survey: of a video, a folder or a dive's recordings, those that say something new of two tags.

FRESH = 0.05  # of the picture's width that tags move between two that are taken: nearer ones share their errors
FOCAL = 0.002  # relative sigma of a focal length of which nobody said how well it is known
ANY_FOCUS = 0.02  # the same where the lens may have been anywhere


class Views(NamedTuple):
    frames: list[SurveyFrame]
    looked_at: int  # pictures, of which those are some
    focal: float  # relative sigma of their focal lengths
    said: tuple[str, ...] = ()  # of what could not be read


def filmed(source: str, calibration: Path, lens: int | None, most: int | None, show: Progress) -> Views:
    """Of pictures. lens: the position at which all were taken; None: nobody knows. Raises ConfigError, CameraError."""
    camera, found = load_calibration(calibration), pictures(source, most)
    fit = at_lens_position(camera.camera, lens)
    looked_at, each = 0, []
    for picture in found.each:
        check_size(picture.image, camera.camera, calibration)
        looked_at += 1
        each.append(SurveyFrame(fit.f_px, fit.width_px, tuple(one.seen for one in find_tags(picture.image, fit))))
        show(looked_at, found.total or looked_at)
    known = lens is not None or fit.breathing == 0.0
    focal = _focal(camera) if known else ANY_FOCUS
    return Views(list(fresh(each)), looked_at, focal, (*found.notes, *found.problems))


def recorded(boxes: list[BlackBox]) -> Views:
    """Of what robots saw in a dive, each through its own calibration, lens at rest."""
    kept, looked_at = [], 0
    for box in boxes:
        each = []
        for step in box.steps():
            inputs = decode(step.inputs, Inputs, STEP_BYTES, READABLE)
            for seen in inputs.landmarks or ():
                looked_at += 1
                if seen.focus is not None:
                    fit = at_lens_position(box.calibration.camera, seen.focus)
                    each.append(SurveyFrame(fit.f_px, fit.width_px, seen.tags))
        kept += list(fresh(each))
    return Views(kept, looked_at, max(_focal(box.calibration) for box in boxes))


def recordings(source: str) -> list[BlackBox]:
    """The black boxes that a source is, or holds; none where it is something else. Raises ConfigError."""
    path = Path(source)
    if path.suffix == ".mcap" or (path.is_dir() and black_boxes(path)):
        return open_boxes([path])
    return []


def fresh(frames: Iterable[SurveyFrame]) -> Iterator[SurveyFrame]:
    """Those with two tags or more that have moved since the last one, or show none of its tags."""
    last: dict[int, np.ndarray] = {}
    for frame in frames:
        if len(frame.tags) < 2:
            continue
        here = {tag.id: frame.f_px * middle(tag) for tag in frame.tags}
        ways = [float(np.hypot(*(here[one] - last[one]))) for one in here.keys() & last.keys()]
        if not ways or np.mean(ways) >= FRESH * frame.width_px:
            last = here
            yield frame


def middle(tag: SeenTag) -> np.ndarray:
    return np.asarray(np.mean(tag.corners, axis=0))


def _focal(calibration: Calibration) -> float:
    variance = calibration.camera.scale_covariance[0]
    return float(np.sqrt(variance)) if variance > 0.0 else FOCAL


# --- a start for the adjustment ---
# Where cameras and tags about are, to begin a survey from: one picture after another, from the tags that are known.
#
# A picture that shows tags of known place has a pose (perspective-n-point); then its other tags have one too, each
# from its own four corners, and other pictures that show these. A square seen from afar or square on has two poses
# that look nearly alike. A tag takes the one in which it lies flat on a face; a picture of one known tag waits for
# another.
#
# Such a chain drifts, by decimetres from a few small tags. So it is adjusted again and again as it grows. A tag that
# does not fit then loses its place, and pictures take their poses anew from the others: what is far off is not found by
# adjusting it.

GROWN = 1.5  # pictures with a pose, from one adjustment to the next
APART = 2.0  # of the two poses' misfits: less does not tell which it is
OFF_M, LEAN_DEG = 0.05, 20.0  # from its face, as a single view has it: the other pose of a square is farther off


Pose = tuple[Array, Array]  # world to camera, (3, 3) and (3,)


class Start(NamedTuple):
    frames: tuple[SurveyFrame, ...]  # those that have a pose
    cameras: Cameras
    tags: Tags
    faces: tuple[Tag, ...]  # the same on their faces, in the same order
    unplaced: tuple[int, ...]  # ids that were seen, and no chain of pictures leads to


def start(
    frames: Sequence[SurveyFrame], known: Sequence[Tag], size_m: float, tank: Tank, prior_of: Callable[[Start], Prior]
) -> Start:
    """Raises ConfigError where no picture shows a tag of known place with another tag."""
    chain, most = Chain(frames, known, size_m, tank), 2.0
    while most < GROWN * len(frames) and any(tag.id not in chain.sure for frame in frames for tag in frame.tags):
        chain.grow(round(most))
        if chain.poses:
            here = chain.here()
            chain.adjusted(bundle(here.frames, here.cameras, prior_of(here), size_m))
        most *= GROWN
    chain.grow(len(frames))
    here = chain.here()
    if len(here.faces) < 2:
        names = ", ".join(str(tag.id) for tag in known)
        raise ConfigError(
            f"no picture shows a tag of known place ({names}) whole beside another; film slowly along them"
        )
    return here


class Chain:
    """Which pictures have a pose and which tags a place, as one leads to the other."""

    def __init__(self, frames: Sequence[SurveyFrame], known: Sequence[Tag], size_m: float, tank: Tank) -> None:
        self._frames, self._size_m, self._tank = frames, size_m, tank
        self.sure = {tag.id: tag for tag in known}
        self._placed = dict(self.sure)
        self.poses: dict[int, Pose] = {}  # by number of the picture

    def grow(self, most: int) -> None:
        """Give `most` pictures a pose, and their tags a place; those first that show the most placed tags."""
        for k in self.poses:  # they may be better than they were
            self._place_tags_of(k)
        waiting = set(range(len(self._frames))) - self.poses.keys()
        while len(self.poses) < most:
            order = sorted(waiting, key=lambda k: (-sum(tag.id in self._placed for tag in self._frames[k].tags), k))
            each = ((k, self._pose_of(k)) for k in order)
            k, pose = next((one for one in each if one[1] is not None), (0, None))
            if pose is None:
                return
            waiting.remove(k)
            self.poses[k] = pose
            self._place_tags_of(k)

    def adjusted(self, found: Bundle) -> None:
        """Take over the tags that fit; what hung on others loses its place."""
        before, self._placed = self._placed, that_fit(found, self._tank) | self.sure
        lost = before.keys() - self._placed.keys()
        for k in sorted(self.poses):
            pose = self._pose_of(k)
            if pose is not None:
                self.poses[k] = pose
            elif any(tag.id in lost for tag in self._frames[k].tags):
                del self.poses[k]

    def here(self) -> Start:
        """The pictures that have a pose, with the tags that they show and that have a place."""
        seen = {tag.id for frame in self._frames for tag in frame.tags}
        used = sorted(self.poses)
        shown = tuple(sorted(self._placed.keys() & {tag.id for k in used for tag in self._frames[k].tags}))
        faces = tuple(self._placed[one] for one in shown)
        rotation = np.array([np.column_stack([*axes(tag), np.cross(*axes(tag))]) for tag in faces])
        return Start(
            tuple(self._frames[k] for k in used),
            Cameras(*(np.array([self.poses[k][part] for k in used]) for part in (0, 1))),
            Tags(shown, np.array([tag.position_m for tag in faces]), rotation),
            faces,
            tuple(sorted(seen - set(shown))),
        )

    def _pose_of(self, k: int) -> Pose | None:
        return camera_pose(self._frames[k].tags, self._placed, self._size_m)

    def _place_tags_of(self, k: int) -> None:
        for tag in self._frames[k].tags:
            if tag.id not in self._placed:
                found = placed_by(tag, self.poses[k], self._size_m, self._tank)
                if found is not None:
                    self._placed[tag.id] = found


def that_fit(found: Bundle, tank: Tank) -> dict[int, Tag]:
    """The tags of an adjustment, but those that miss in many views and those that have left walls and floor."""
    fit = dict[int, Tag]()
    for k, (one, middle_m, rotation) in enumerate(zip(*found.tags, strict=True)):
        missed = found.doubtful[found.seen[:, 1] == k] > HUBER
        tag = flattened_on(one, middle_m, rotation, tank)
        if tag is not None and missed.mean() <= BAD_SHARE:
            fit[one] = tag
    return fit


def camera_pose(tags: Sequence[SeenTag], placed: dict[int, Tag], size_m: float) -> Pose | None:
    """World to camera, by the tags that have a place; None where the picture does not tell."""
    seen = [tag for tag in tags if tag.id in placed]
    if not seen:
        return None
    world = np.concatenate([corners(placed[tag.id], size_m) for tag in seen])
    slopes = np.concatenate([np.array(tag.corners) for tag in seen])
    method = cv2.SOLVEPNP_IPPE if len(seen) == 1 else cv2.SOLVEPNP_SQPNP
    found, turns, shifts, misfits = cv2.solvePnPGeneric(world, slopes, np.eye(3), None, flags=method)
    if not found:
        return None
    if len(seen) == 1 and found > 1 and misfits[1] < APART * misfits[0]:
        return None
    return np.asarray(cv2.Rodrigues(turns[0])[0], np.float64), np.asarray(shifts[0], np.float64).ravel()


def placed_by(seen: SeenTag, pose: Pose, size_m: float, tank: Tank) -> Tag | None:
    """A tag on its face, from one picture of known pose; None where it lies on none."""
    square = np.column_stack([0.5 * size_m * CORNERS, np.zeros(4)])
    found, turns, shifts, _ = cv2.solvePnPGeneric(
        square, np.array(seen.corners), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    for turn, shift in zip(turns, shifts, strict=True) if found else ():
        middle_m = pose[0].T @ (shift.ravel() - pose[1])
        tag = flattened_on(seen.id, middle_m, pose[0].T @ cv2.Rodrigues(turn)[0], tank)
        if tag is not None:
            return tag
    return None


def flattened_on(id: int, middle_m: Array, rotation: Array, tank: Tank) -> Tag | None:
    """A tag put flat on the face that it is on, or nearly; None where it is on none."""
    x, y, z = middle_m.tolist()
    right, up = ((a, b, c) for a, b, c in rotation[:, :2].T.tolist())
    tag = on_face(id, (x, y, z), right, up, tank, OFF_M, LEAN_DEG)
    if not isinstance(tag, Tag):
        return None
    axis, at_m = plane(tag.face, tank)
    x, y, z = (at_m if k == axis else value for k, value in enumerate((x, y, z)))
    return Tag(id=id, face=tag.face, position_m=(x, y, z), turn_deg=tag.turn_deg)


# --- `aucamp calibrate landmarks` ---

FLAT_M, FLAT_DEG = 0.002, 0.3  # sigma of a glued plate: how far off its face, and how it leans
PRINT = 0.001  # relative sigma of each print's size
MISFIT_PX = 1.0  # corners that miss by more were not seen by this camera, or on tags of this size


class Asked(NamedTuple):
    calibration: Path | None = None
    known: tuple[int, ...] = ()
    flat: bool = True
    lens: int | None = None
    frames: int | None = None
    out: Path | None = None


def run(source: str, fleet_path: Path, asked: Asked, console: Console) -> Survey:
    """Survey, print the table, and the block for the fleet file or where it was written. Raises ConfigError,
    CameraError and Failed, one line each."""
    fleet = load_fleet(fleet_path)
    if asked.out is not None:
        check_out(asked.out)
    known = known_tags(fleet, asked.known, fleet_path)
    if boxes := recordings(source):
        views = recorded(boxes)
    elif asked.calibration is None:
        raise ConfigError(f"{source}: pictures do not say which camera took them; give --calibration")
    else:
        file = asked.calibration
        views = with_bar(console, "looking for tags", lambda show: filmed(source, file, asked.lens, asked.frames, show))
    if not views.frames:
        raise ConfigError(f"{source}: no picture of {views.looked_at} shows two tags; film from farther away")
    found = survey(views, fleet, known, asked.flat)
    text = block(found, fleet)
    console.print(table(found))
    assert fleet.landmarks is not None
    for line in (*remarks(found, views.looked_at), *missing(found, fleet.landmarks, asked.known), *views.said):
        console.print(line)
    if asked.out is None:
        console.print(text, highlight=False)
    else:
        console.print(put(asked.out, text))
    return found


def known_tags(fleet: Fleet, names: Sequence[int], path: Path) -> list[Tag]:
    """Those whose place counts. Raises ConfigError."""
    if fleet.landmarks is None:
        raise ConfigError(
            f"{path}: has no table [landmarks]; add it with one tag at least, of which you know the place"
        )
    listed = {tag.id: tag for tag in fleet.landmarks.tag}
    for one in names:
        if one not in listed:
            raise ConfigError(f"--known {one}: {path} lists no such tag; add its place there, or take it out here")
    return [listed[one] for one in names] or list(listed.values())


def survey(views: Views, fleet: Fleet, known: Sequence[Tag], flat: bool) -> Survey:
    """Raises ConfigError where the pictures do not hang together, Failed where they do not fit."""
    landmarks = fleet.landmarks
    assert landmarks is not None
    prior_of = partial(priors, known=known, landmarks=landmarks, flat=flat, focal=views.focal)
    chain = start(views.frames, known, landmarks.size_m, fleet.tank, prior_of)
    result = bundle(chain.frames, chain.cameras, prior_of(chain), landmarks.size_m)
    if not result.misfit_px <= MISFIT_PX:
        raise Failed(
            f"corners miss by {result.misfit_px:.1f} px; check size_m, the places of known tags, and that this "
            "calibration is of this camera, in this water"
        )
    listed = {tag.id: tag for tag in landmarks.tag}
    tags = [one(result, chain, k, listed, fleet) for k in range(len(result.tags.ids))]
    return Survey(tags, len(chain.frames), result, chain.unplaced)


def priors(chain: Start, known: Sequence[Tag], landmarks: Landmarks, flat: bool, focal: float) -> Prior:
    sure = {tag.id for tag in known}
    place = {True: [landmarks.sigma_m] * 3, False: [np.inf, np.inf, FLAT_M if flat else np.inf]}
    lean = FLAT_DEG if flat else np.inf
    turn = {True: [landmarks.sigma_deg] * 3, False: [lean, lean, np.inf]}
    floor = 1e-6  # who states a sigma of 0 means that the place defines the frame
    sigma_m = np.maximum([place[one in sure] for one in chain.tags.ids], floor)
    sigma_rad = np.radians(np.maximum([turn[one in sure] for one in chain.tags.ids], floor))
    return Prior(chain.tags, chain.tags.rotation, sigma_m, sigma_rad, PRINT, focal)


def one(result: Bundle, chain: Start, k: int, listed: dict[int, Tag], fleet: Fleet) -> Surveyed:
    """The k-th tag. Raises Failed where it ended far from its face."""
    rotation, covariance = result.tags.rotation[k], result.covariance[k]
    x, y, z = result.tags.middle_m[k].tolist()
    right, up = ((a, b, c) for a, b, c in rotation[:, :2].T.tolist())
    tag = on_face(result.tags.ids[k], (x, y, z), right, up, fleet.tank)
    if isinstance(tag, str):
        raise Failed(f"{tag}; its print may be mirrored or another's, or the tank's size is wrong")
    lean = turned_by(rotation @ chain.tags.rotation[k].T)
    lean -= chain.tags.rotation[k][:, 2] * (chain.tags.rotation[k][:, 2] @ lean)  # without its turn
    turns = float(np.trace(covariance[3:, 3:]) + lean @ lean) / 3.0
    was = listed.get(tag.id)
    mine = result.seen[:, 1] == k
    return Surveyed(
        tag,
        math.sqrt(float(np.trace(covariance[:3, :3])) / 3.0),
        math.degrees(math.sqrt(turns)),
        None if was is None else math.dist(was.position_m, tag.position_m),
        int(mine.sum()),
        int((result.doubtful[mine] > HUBER).sum()),
    )
