"""Where cameras and tags about are, to begin a survey from: one picture after another, from the tags that are known.

A picture that shows tags of known place has a pose (perspective-n-point); then its other tags have one too, each from
its own four corners, and other pictures that show these. A square seen from afar or square on has two poses that look
nearly alike. A tag takes the one in which it lies flat on a face; a picture of one known tag waits for another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from agent.capabilities.swim.landmarks import axes, corners, on_face, plane
from agent.core.config import ConfigError, Tag, Tank
from agent.core.step_io import SeenTag
from agent.perception.landmarks.slopes import Array
from agent.tools.survey_bundle import CORNERS, Cameras, SurveyFrame, Tags

APART = 2.0  # of the two poses' misfits: less does not tell which it is
OFF_M, LEAN_DEG = 0.05, 20.0  # from its face, as a single view has it: the other pose of a square is farther off


class Start(NamedTuple):
    frames: tuple[SurveyFrame, ...]  # those that have a pose
    cameras: Cameras
    tags: Tags
    faces: tuple[Tag, ...]  # the same on their faces, in the same order
    unplaced: tuple[int, ...]  # ids that were seen, and no chain of pictures leads to


def start(frames: Sequence[SurveyFrame], known: Sequence[Tag], size_m: float, tank: Tank) -> Start:
    """Raises ConfigError where no picture shows a tag of known place with another tag."""
    placed, poses, waiting = {tag.id: tag for tag in known}, {}, dict(enumerate(frames))
    while waiting:
        order = sorted(waiting, key=lambda k: -sum(tag.id in placed for tag in waiting[k].tags))
        for k in order:
            there = [tag for tag in waiting[k].tags if tag.id in placed]
            pose = camera_pose(there, placed, size_m) if there else None
            if pose is not None:
                break
        else:
            break
        poses[k] = pose
        for tag in waiting.pop(k).tags:
            if tag.id not in placed and (found := placed_by(tag, pose, size_m, tank)) is not None:
                placed[tag.id] = found
    seen = {tag.id for frame in frames for tag in frame.tags}
    used = sorted(poses)
    shown = tuple(sorted(seen & placed.keys() & {tag.id for k in used for tag in frames[k].tags}))
    if len(shown) < 2:
        names = ", ".join(str(tag.id) for tag in known)
        raise ConfigError(
            f"no picture shows a tag of known place ({names}) whole beside another; film slowly along them"
        )
    faces = tuple(placed[one] for one in shown)
    rotation = np.array([np.column_stack([*axes(tag), np.cross(*axes(tag))]) for tag in faces])
    return Start(
        tuple(frames[k] for k in used),
        Cameras(*(np.array([poses[k][part] for k in used]) for part in (0, 1))),
        Tags(shown, np.array([tag.position_m for tag in faces]), rotation),
        faces,
        tuple(sorted(seen - set(shown))),
    )


def camera_pose(seen: Sequence[SeenTag], placed: dict[int, Tag], size_m: float) -> tuple[Array, Array] | None:
    """World to camera, (3, 3) and (3,); None where the picture does not tell."""
    world = np.concatenate([corners(placed[tag.id], size_m) for tag in seen])
    slopes = np.concatenate([np.array(tag.corners) for tag in seen])
    method = cv2.SOLVEPNP_IPPE if len(seen) == 1 else cv2.SOLVEPNP_SQPNP
    found, turns, shifts, misfits = cv2.solvePnPGeneric(world, slopes, np.eye(3), None, flags=method)
    if not found:
        return None
    if len(seen) == 1 and found > 1 and misfits[1] < APART * misfits[0]:
        return None
    return np.asarray(cv2.Rodrigues(turns[0])[0], np.float64), np.asarray(shifts[0], np.float64).ravel()


def placed_by(seen: SeenTag, pose: tuple[Array, Array], size_m: float, tank: Tank) -> Tag | None:
    """A tag on its face, from one picture of known pose; None where it lies on none."""
    square = np.column_stack([0.5 * size_m * CORNERS, np.zeros(4)])
    found, turns, shifts, _ = cv2.solvePnPGeneric(
        square, np.array(seen.corners), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    for turn, shift in zip(turns, shifts, strict=True) if found else ():
        rotation = pose[0].T @ cv2.Rodrigues(turn)[0]
        middle = pose[0].T @ (shift.ravel() - pose[1])
        x, y, z = middle.tolist()
        right, up = ((a, b, c) for a, b, c in rotation[:, :2].T.tolist())
        tag = on_face(seen.id, (x, y, z), right, up, tank, OFF_M, LEAN_DEG)
        if isinstance(tag, Tag):
            axis, at_m = plane(tag.face, tank)
            x, y, z = (at_m if k == axis else value for k, value in enumerate(middle.tolist()))
            return Tag(id=tag.id, face=tag.face, position_m=(x, y, z), turn_deg=tag.turn_deg)
    return None
