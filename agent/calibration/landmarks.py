"""`aucamp calibrate landmarks`: a map of the tank's tags from a film of them, and how well each is known.

Some places must be measured by hand, or nobody knows where the tank is: of all tags that the fleet file lists, or of
those named by --known, what it says counts with the sigma that it states. All others are found, flat on their faces.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from agent.calibration.rotation import turned_by
from agent.calibration.survey_bundle import HUBER, Bundle, Prior, bundle
from agent.calibration.survey_start import Start, start
from agent.calibration.survey_views import Views, filmed, recorded, recordings
from agent.failure import Failed
from agent.kernel.config import ConfigError, Fleet, Landmarks, Tag
from agent.kernel.fleet_reader import load_fleet
from agent.kernel.navigation.tags.landmark_rules import broken_landmark_rules
from agent.kernel.navigation.tags.on_face import on_face
from agent.kernel.toml_files import read_toml
from agent.progress import with_bar
from agent.run_folder import free_name

FLAT_M, FLAT_DEG = 0.002, 0.3  # sigma of a glued plate: how far off its face, and how it leans
PRINT = 0.001  # relative sigma of each print's size
MISFIT_PX = 1.0  # corners that miss by more were not seen by this camera, or on tags of this size
BAD_SHARE = 0.2  # of the views of a tag: something is wrong with it, not with them


class Asked(NamedTuple):
    calibration: Path | None = None
    known: tuple[int, ...] = ()
    flat: bool = True
    lens: int | None = None
    frames: int | None = None
    out: Path | None = None


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
    for line in remarks(found, views):
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
    begun = start(views.frames, known, landmarks.size_m, fleet.tank)
    prior = priors(begun, known, landmarks, flat, views.focal)
    result = bundle(begun.frames, begun.cameras, prior, landmarks.size_m)
    if not result.misfit_px <= MISFIT_PX:
        raise Failed(
            f"corners miss by {result.misfit_px:.1f} px; check size_m, the places of known tags, and that this "
            "calibration is of this camera, in this water"
        )
    listed = {tag.id: tag for tag in landmarks.tag}
    tags = [one(result, begun, k, listed, fleet) for k in range(len(result.tags.ids))]
    return Survey(tags, len(begun.frames), result, begun.unplaced)


def priors(begun: Start, known: Sequence[Tag], landmarks: Landmarks, flat: bool, focal: float) -> Prior:
    sure = {tag.id for tag in known}
    place = {True: [landmarks.sigma_m] * 3, False: [np.inf, np.inf, FLAT_M if flat else np.inf]}
    lean = FLAT_DEG if flat else np.inf
    turn = {True: [landmarks.sigma_deg] * 3, False: [lean, lean, np.inf]}
    floor = 1e-6  # who states a sigma of 0 means that the place defines the frame
    sigma_m = np.maximum([place[one in sure] for one in begun.tags.ids], floor)
    sigma_rad = np.radians(np.maximum([turn[one in sure] for one in begun.tags.ids], floor))
    return Prior(begun.tags, begun.tags.rotation, sigma_m, sigma_rad, PRINT, focal)


def one(result: Bundle, begun: Start, k: int, listed: dict[int, Tag], fleet: Fleet) -> Surveyed:
    """The k-th tag. Raises Failed where it ended far from its face."""
    rotation, covariance = result.tags.rotation[k], result.covariance[k]
    x, y, z = result.tags.middle_m[k].tolist()
    right, up = ((a, b, c) for a, b, c in rotation[:, :2].T.tolist())
    tag = on_face(result.tags.ids[k], (x, y, z), right, up, fleet.tank)
    if isinstance(tag, str):
        raise Failed(f"{tag}; its print may be mirrored or another's, or the tank's size is wrong")
    lean = turned_by(rotation @ begun.tags.rotation[k].T)
    lean -= begun.tags.rotation[k][:, 2] * (begun.tags.rotation[k][:, 2] @ lean)  # without its turn
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


def remarks(found: Survey, views: Views) -> list[str]:
    """How it went, in lines."""
    said = [f"{found.frames} of {views.looked_at} pictures used, corners miss by {found.bundle.misfit_px:.2f} px (rms)"]
    if found.unplaced:
        names = ", ".join(map(str, found.unplaced))
        said.append(f"no place for {names}: seen, but in no picture with a tag that has one, or on no wall or floor")
    for each in found.tags:
        if each.bad > BAD_SHARE * each.views:
            said.append(f"tag {each.tag.id} does not fit in {each.bad} of {each.views} views: loose, bent, or covered?")
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
    fresh = path.with_name(path.name + ".part")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)
    said = f'written to {path}; in the fleet file: [landmarks] file = "{path.name}"'
    return said if kept is None else f"{said}; the survey as it was: {kept}"
