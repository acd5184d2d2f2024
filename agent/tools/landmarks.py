"""`aucamp calibrate landmarks`: a map of the tank's tags from a film of them, and how well each is known.

Some places must be measured by hand, or nobody knows where the tank is: of all tags that the fleet file lists, or of
those named by --known, what it says counts with the sigma that it states. All others are found, flat on their faces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from agent.capabilities.swim.landmarks import on_face
from agent.core.config import ConfigError, Fleet, Landmarks, Tag
from agent.process.command import Failed, with_bar
from agent.robot.fleet_reader import load_fleet
from agent.tools.rotation import turned_by
from agent.tools.survey_bundle import HUBER, Bundle, Prior, bundle
from agent.tools.survey_result import Survey, Surveyed, block, check_out, put, remarks, table
from agent.tools.survey_start import Start, start
from agent.tools.survey_views import Views, filmed, recorded, recordings

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
    for line in remarks(found, views.looked_at):
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
