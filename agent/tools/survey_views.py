"""The pictures of a survey: of a video, a folder or a dive's recordings, those that say something new of two tags."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agent.core.codec import READABLE, decode
from agent.core.ranging.camera_model import Calibration, at_lens_position, load_calibration
from agent.core.step_io import Inputs, SeenTag
from agent.perception.landmarks.tags import find_tags
from agent.process.command import Progress
from agent.tools.list_tags import check_size
from agent.tools.sources import pictures
from agent.tools.survey_bundle import SurveyFrame
from replay.check.black_box import STEP_BYTES, BlackBox, black_boxes, open_boxes

FRESH = 0.05  # of the picture's width that tags move between two that are taken: nearer ones share their errors
FOCAL = 0.002  # relative sigma of a focal length of which nobody said how well it is known
ANY_FOCUS = 0.02  # the same where the lens may have been anywhere


class Views(NamedTuple):
    frames: list[SurveyFrame]
    looked_at: int  # pictures, of which those are some
    focal: float  # relative sigma of their focal lengths


def filmed(source: str, calibration: Path, lens: int | None, most: int | None, show: Progress) -> Views:
    """Of pictures. lens: the position at which all were taken; None: nobody knows. Raises ConfigError, CameraError."""
    camera, found = load_calibration(calibration), pictures(source, most)
    fit = at_lens_position(camera.camera, lens)
    looked_at, each = 0, []
    for picture in found.each:
        if not looked_at:
            check_size(picture.image, camera.camera, calibration)
        looked_at += 1
        each.append(SurveyFrame(fit.f_px, fit.width_px, tuple(one.seen for one in find_tags(picture.image, fit))))
        show(looked_at, found.total or looked_at)
    known = lens is not None or fit.breathing == 0.0
    return Views(list(fresh(each)), looked_at, _focal(camera) if known else ANY_FOCUS)


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
