"""AprilTags of the family 36h11 in a frame: OpenCV finds and reads them, fitted edges say where their corners are."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.step_io import SeenTag, SeenTags
from agent.perception.landmarks.edge_line import Plane
from agent.perception.landmarks.edges import fit_corners, light_of_bytes, module_px
from agent.perception.landmarks.slopes import Array, cross, to_pixels, to_slopes
from hw.camera.camera import Image

WINDOW_PX = 21  # of the adaptive threshold: one does what OpenCV's three do, in a quarter of the time
LEAST_PERIMETER = 0.1  # of the picture's longer side: 16 px a side in 640
GRAZING = 0.45  # sine between neighbouring edges: beyond a view of about 75 degrees corners are off by pixels
MOST = 64  # tags in a frame's message: the largest
GREEN = 1  # where most of the light under water is, of which sensors have the most pixels, and no colour fringes
SEARCH = 0.5  # of a module: how far a corner finder looks, where no edges can be fitted

# Id 0 as published, upright: tag36h11.c and the pictures of AprilRobotics, 1 is white.
PUBLISHED_0 = ("110101", "011101", "011000", "101000", "010110", "000100")


class Found(NamedTuple):
    """A tag in a frame, and what only people want to know."""

    seen: SeenTag
    corners_px: Array  # (4, 2)
    blur_px: float | None  # diameter of the disc that would blur it as much; None without fitted edges
    alone: bool  # no other tag of the frame has its id


def seen_tags(image: Image, camera: CameraFit, lens_position: int | None, t_ns: int, frame: int) -> SeenTags:
    """The landmarks of a whole frame, by id. t_ns: middle of its exposure; lens_position: None while it moves."""
    found = find_tags(image, at_lens_position(camera, lens_position))
    largest = sorted(found, key=lambda one: -one.seen.size_px)[:MOST]
    tags = tuple(sorted((one.seen for one in largest), key=lambda tag: tag.id))
    return SeenTags(t_ns=t_ns, frame=frame, focus=lens_position, tags=tags)


def find_tags(image: Image, camera: CameraFit) -> list[Found]:
    """The tags of a whole frame (height, width, 3) that a robot may go by, by id. camera: at the frame's lens position.

    Of two with the same id one is a picture or a copy, and which one nobody can tell, so neither counts.
    """
    return [one for one in all_tags(image, camera) if one.alone]


def all_tags(image: Image, camera: CameraFit) -> list[Found]:
    """All tags of a whole frame, by id, but those in grazing views.

    A tag in a mirror is none: read backwards, no code is within 3 bits of another, and no more are corrected.
    """
    plane = green(image)
    corners, ids, _ = _detector().detectMarkers(plane)
    if ids is None:
        return []
    light, numbers = light_of_bytes(camera.gamma), [int(number) for number in ids.ravel()]
    found = []
    for number, corner in sorted(zip(numbers, corners, strict=True), key=lambda one: one[0]):
        rough_px = np.roll(corner.reshape(4, 2).astype(np.float64), -_first_corner(), axis=0)
        one = _found(plane, light, number, rough_px, camera)
        if one is not None:
            found.append(one._replace(alone=numbers.count(number) == 1))
    return found


def green(image: Image) -> Plane:
    """(height, width): the one colour that landmarks are looked for in."""
    return np.asarray(cv2.extractChannel(image, GREEN), np.uint8)


def _found(plane: Plane, light: Array, number: int, rough_px: Array, camera: CameraFit) -> Found | None:
    fitted = fit_corners(plane, light, rough_px, camera)
    if fitted is None:
        corners_px, blur_px = _searched(plane, rough_px), None
        slopes = to_slopes(camera, corners_px)
    else:
        slopes, blur_px = fitted.slopes, fitted.blur_px
        corners_px = to_pixels(camera, slopes)
    if _grazing(slopes):
        return None
    side = np.roll(corners_px, -1, axis=0) - corners_px
    middle = corners_px.mean(axis=0)
    tag = SeenTag(
        id=number,
        corners=tuple((float(x), float(y)) for x, y in slopes),  # type: ignore[arg-type]
        size_px=float(np.hypot(side[:, 0], side[:, 1]).min()),
        rho_px=float(np.hypot(middle[0] - camera.cx_px, middle[1] - camera.cy_px)),
        edges=fitted is not None,
    )
    return Found(tag, corners_px, blur_px, alone=True)


def _searched(plane: Plane, rough_px: Array) -> Array:
    """Corners by OpenCV's finder: some 0.8 px off in a defocused picture, always inwards."""
    reach = max(2, round(SEARCH * module_px(rough_px)))
    out = cv2.cornerSubPix(
        plane,
        rough_px.astype(np.float32).reshape(4, 1, 2),
        (reach, reach),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01),
    )
    return np.asarray(out, np.float64).reshape(4, 2)


def _grazing(corners: Array) -> bool:
    side = np.roll(corners, -1, axis=0) - corners
    along = side / np.hypot(side[:, :1], side[:, 1:])
    return bool(np.abs(cross(along, np.roll(along, 1, axis=0))).min() < GRAZING)


@lru_cache(maxsize=1)
def _detector() -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin = settings.adaptiveThreshWinSizeMax = WINDOW_PX
    settings.minMarkerPerimeterRate = LEAST_PERIMETER
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), settings)


@lru_cache(maxsize=1)
def _first_corner() -> int:
    """Which of OpenCV's corners is the upper left one of an upright tag: OpenCV is shown one.

    Its dictionaries had all tags upside down; which versions still have, or turn the corners instead, is not ours to
    remember (opencv pull request 28823).
    """
    bits = np.array([[int(bit) for bit in row] for row in PUBLISHED_0])
    drawn: NDArray[np.uint8] = np.kron(np.pad(np.pad(bits, 1), 1, constant_values=1), np.full((16, 16), 255)).astype(
        np.uint8
    )
    corners, ids, _ = _detector().detectMarkers(drawn)
    if ids is None or ids.ravel().tolist() != [0]:
        raise RuntimeError("this OpenCV does not read the published tag 36h11 of id 0")
    return int(corners[0].reshape(4, 2).sum(axis=1).argmin())
