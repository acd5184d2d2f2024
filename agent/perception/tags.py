"""AprilTags of the family 36h11 in a frame: OpenCV finds and reads them, fitted edges say where their corners are.

A slope is (x, y) / (z - ahead_m) in the camera frame, where a straight edge is straight: the lens's bending is undone.
Edges are fitted there, and corners are where they meet, sharp or defocused alike.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import UNBEND, CameraFit, at_lens_position
from agent.core.step_io import SeenTag, SeenTags
from hw.camera.camera import Image
from hw.compiled import compiled

# --- pixels to slopes and back: `camera_model.ray` and `pixel` for arrays ---

Array = NDArray[np.float64]


def to_slopes(camera: CameraFit, points_px: Array) -> Array:
    """(..., 2) pixels -> (..., 2) slopes."""
    seen: Array = (points_px - (camera.cx_px, camera.cy_px)) / camera.f_px
    slopes = seen
    for _ in range(UNBEND if camera.bend else 0):
        slopes = seen / (1.0 + camera.bend * (slopes * slopes).sum(axis=-1, keepdims=True))
    return slopes


def to_pixels(camera: CameraFit, slopes: Array) -> Array:
    """(..., 2) slopes -> (..., 2) pixels."""
    bend = 1.0 + camera.bend * (slopes * slopes).sum(axis=-1, keepdims=True)
    out: Array = camera.f_px * bend * slopes + (camera.cx_px, camera.cy_px)
    return out


def cross(a: Array, b: Array) -> Array:
    """(..., 2) x (..., 2) -> (...), positive where b lies clockwise of a as seen (y goes down)."""
    out: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


# --- one straight edge from black to white, compiled ---
#
# An edge is the line through the centroids of its gradient. Defocus is symmetric in linear light, so the centroid of
# the gradient across an edge stays where it is however blurred.
#
# Gradients are taken twice. First all rising ones within reach: they find the line, but noise rises everywhere, most
# on the white side, and draws the edges of a sharp tag outwards by 0.2 px (at a noise of 2 % of full light). So then
# all gradients, falling ones too, but only as far from that line as the edge's own blur goes; that leaves 0.02 px.

kernel = compiled(error_model="numpy")

Plane = NDArray[np.uint8]

PROFILES = 28  # across the edge
FIRST, LAST = 0.08, 0.92  # of its length: 0.6 modules from a corner no blur that can be read shows it
STEP_PX = 0.5
WEAK = 0.35  # of the edge's median contrast: something lies over the edge there
FEWEST = 14  # profiles that have the edge
BURNT = 0.99  # of full light, in half of the paper beside the edge: what it was before the sensor's limit is lost
LINE_ROUNDS, OUTLIER = 3, 2.5 * 1.48  # 1.48 medians of residuals are a standard deviation
FAINT, MARGIN_PX = 0.15, 0.75  # the blur ends where the mean gradient has fallen to this share, and so much beyond
SHARP_PX2 = 1.0 / 12.0 + 1.0 / 6.0 + STEP_PX**2 / 12.0  # variance of a perfect edge: pixel, interpolation, step


class Room(NamedTuple):
    """Where `fit_edge` works: numba takes seconds to compile what makes arrays of its own."""

    gradient: Array  # (2, PROFILES, n): across the edge, and what of it counts
    at_px: Array  # (PROFILES,) where the edge crosses each profile, NaN where it has none
    slopes: Array  # (PROFILES, 2) the same as slopes
    off: Array  # (PROFILES,) how far from the line that is, slopes
    ranked: Array  # (PROFILES,)


def room(reach_px: float) -> Room:
    """For edges that are looked for so far to either side."""
    steps = int(reach_px / STEP_PX)
    line, pair = np.empty(PROFILES), np.empty((PROFILES, 2))
    return Room(np.empty((2, PROFILES, 2 * steps)), line, pair, line.copy(), line.copy())


@compiled(
    "f8(u1[:,::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[:,:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], f8[::1])",
    error_model="numpy",
)
def fit_edge(
    plane: Plane, light: Array, start: Array, end: Array, lens: Array,
    gradient: Array, at_px: Array, slopes: Array, off: Array, ranked: Array, line: Array,
) -> float:  # fmt: skip
    """Line (4,), in slopes: a point of it and the unit vector along it from start to end.

    plane: one colour of the picture, a byte a pixel; light (256,): linear, of each byte, 1 at the sensor's limit.
    start, end (2,): roughly where the edge ends, pixels; the square is on the right of the way from start to end, y
    pointing down. lens: f_px, cx_px, cy_px, bend. gradient to ranked: a `Room`.
    Returns the variance of the blur, px2, or -1 where the edge leaves the picture, is covered or burnt out; then `line`
    means nothing.
    """
    room = Room(gradient, at_px, slopes, off, ranked)
    if not _across(plane, light, start, end, room.gradient):
        return -1.0
    rise, counted = room.gradient
    n = rise.shape[1]
    for again in range(2):
        reach_px = _half_width_px(rise, room.at_px) if again else 0.0
        for p in range(PROFILES):
            for k in range(n):
                if again:
                    near = abs(_place_px(k, n) - room.at_px[p]) <= reach_px
                    counted[p, k] = rise[p, k] if near else 0.0
                else:
                    counted[p, k] = max(rise[p, k], 0.0)
        if not _line_up(counted, start, end, lens, room, line):
            return -1.0
    total = moment = 0.0
    for p in range(PROFILES):
        if not math.isnan(room.at_px[p]):
            for k in range(n):
                total += counted[p, k]
                moment += counted[p, k] * (_place_px(k, n) - room.at_px[p]) ** 2
    return max(moment / total - SHARP_PX2, 0.0)


@kernel
def _place_px(k: int, n: int) -> float:
    """Where along its profile the k-th of n gradients is, from the rough edge outwards."""
    return STEP_PX * (k + 0.5 - n // 2)


@kernel
def _across(plane: Plane, light: Array, start: Array, end: Array, gradient: Array) -> bool:
    """Gradients along the profiles, outwards; False where one leaves the picture, or the paper is burnt out.

    (cv2.remap rounds places to 1/32 px, alike all along an edge.)
    """
    height, width = plane.shape
    n = gradient.shape[2]
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    burnt = 0
    for p in range(PROFILES):
        share = FIRST + (LAST - FIRST) * p / (PROFILES - 1)
        before = 0.0
        for k in range(n + 1):
            s = STEP_PX * (k - n // 2) / length
            x, y = start[0] + share * along_x + s * along_y, start[1] + share * along_y - s * along_x
            if not (x >= 0.0 and y >= 0.0 and x <= width - 1 and y <= height - 1):
                return False
            i, j = min(int(x), width - 2), min(int(y), height - 2)
            u, v = x - i, y - j
            upper = (1.0 - u) * light[plane[j, i]] + u * light[plane[j, i + 1]]
            lower = (1.0 - u) * light[plane[j + 1, i]] + u * light[plane[j + 1, i + 1]]
            here = (1.0 - v) * upper + v * lower
            if k:
                gradient[0, p, k - 1] = here - before
            before = here
            if 4 * k > 3 * n and here > BURNT:
                burnt += 1
    return bool(burnt <= PROFILES * n // 8)


@kernel
def _line_up(counted: Array, start: Array, end: Array, lens: Array, room: Room, line: Array) -> bool:
    """Fit the line to the centroids of the gradients; at_px becomes where it runs on each profile that has an edge."""
    n = counted.shape[1]
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    for p in range(PROFILES):
        contrast = 0.0
        for k in range(n):
            contrast += counted[p, k]
        room.off[p] = contrast
    least, count = WEAK * max(_median(room.off, room.ranked), 0.0), 0
    for p in range(PROFILES):
        contrast = room.off[p]
        if not contrast > least:
            room.at_px[p] = room.slopes[p, 0] = room.slopes[p, 1] = np.nan
            continue
        count += 1
        moment = 0.0
        for k in range(n):
            moment += counted[p, k] * _place_px(k, n)
        room.at_px[p] = moment / contrast
        share, s = FIRST + (LAST - FIRST) * p / (PROFILES - 1), moment / contrast / length
        seen_x = (start[0] + share * along_x + s * along_y - lens[1]) / lens[0]
        seen_y = (start[1] + share * along_y - s * along_x - lens[2]) / lens[0]
        x, y = seen_x, seen_y
        for _ in range(UNBEND):  # as `to_slopes`
            bend = 1.0 + lens[3] * (x * x + y * y)
            x, y = seen_x / bend, seen_y / bend
        room.slopes[p, 0], room.slopes[p, 1] = x, y
    if count < FEWEST:
        return False
    fit_line(room.slopes, line, room.off, room.ranked)
    for p in range(PROFILES):
        room.at_px[p] -= room.off[p] * lens[0]
    return True


@kernel
def fit_line(points: Array, line: Array, off: Array, ranked: Array) -> None:
    """Total least squares through (n, 2) points, some of them NaN, in rounds without those far off.

    line (4,): a point of it and the unit vector along it, from the first point to the last. off (n,): how far each
    point lies to the left of it.
    """
    n, limit = len(points), 0.0
    for round_ in range(LINE_ROUNDS + 1):
        if round_:
            for p in range(n):
                off[p] = abs(off[p])
            limit = OUTLIER * _median(off, ranked)
        count = x = y = 0.0
        for p in range(n):
            if not math.isnan(points[p, 0]) and (round_ == 0 or off[p] <= limit):
                count, x, y = count + 1.0, x + points[p, 0], y + points[p, 1]
        x, y = x / count, y / count
        across = difference = way_x = way_y = 0.0
        for p in range(n):
            if not math.isnan(points[p, 0]) and (round_ == 0 or off[p] <= limit):
                dx, dy = points[p, 0] - x, points[p, 1] - y
                across, difference = across + dx * dy, difference + dx * dx - dy * dy
                way_x, way_y = way_x + p * dx, way_y + p * dy
        turn = 0.5 * math.atan2(2.0 * across, difference)
        u, v = math.cos(turn), math.sin(turn)
        if u * way_x + v * way_y < 0.0:
            u, v = -u, -v
        line[0], line[1], line[2], line[3] = x, y, u, v
        for p in range(n):
            off[p] = (points[p, 0] - x) * v - (points[p, 1] - y) * u


@kernel
def _median(values: Array, ranked: Array) -> float:
    """Of those that are numbers; of two in the middle the lower one. ranked: room for them.

    np.median takes seconds to compile.
    """
    count = 0
    for value in values:
        if not math.isnan(value):
            ranked[count] = value
            count += 1
    for i in range(count // 2 + 1):
        for j in range(i + 1, count):
            if ranked[j] < ranked[i]:
                low = ranked[j]
                ranked[j] = ranked[i]
                ranked[i] = low
    return float(ranked[(count - 1) // 2])


@kernel
def _half_width_px(rise: Array, at_px: Array) -> float:
    """How far from its line the edge's gradient reaches, by the mean over all profiles."""
    n, peak, away = rise.shape[1], 0.0, 0
    while True:
        total = count = 0.0
        for p in range(PROFILES):
            if math.isnan(at_px[p]):
                continue
            for k in range(n):
                if int(abs(_place_px(k, n) - at_px[p]) / STEP_PX) == away:
                    total, count = total + rise[p, k], count + 1.0
        if away < 3:
            peak = max(peak, total / max(count, 1.0))
        elif total < FAINT * peak * count or away >= n // 2:
            return STEP_PX * away + MARGIN_PX
        away += 1


# --- corners of a printed black square, where its four edges meet ---

MODULES = 8  # along the square's side: six of code between two of border
REACH = 0.9  # of a module, to either side: behind the border comes code
# Of a module, by which corners may move in the last round. In oblique views of small tags rough corners are off by as
# much as edges are looked for, and what of a gradient lies beyond that is lost: corners were wrong by up to 2.6 px.
MOVED, ROUNDS = 0.2, 4
NARROWEST_PX = 2.5  # module: a sharp edge is 2 px wide, by the pixel and by the interpolation
# Radius of blur, of a module. From a half on the border's edge and the code's are one, and from 0.54 on the corners of
# small tags were off by up to 2.4 px.
MIXED = 0.45


class Corners(NamedTuple):
    slopes: Array  # (4, 2), in the order of the rough ones
    blur_px: float  # diameter of the disc that would blur the edges as much


def light_of_bytes(gamma: float) -> Array:
    """(256,) linear light, 1 at the sensor's limit, of a camera that codes light ** (1 / gamma)."""
    light: Array = np.linspace(0.0, 1.0, 256) ** gamma
    return light


def fit_corners(plane: Plane, light: Array, rough_px: Array, camera: CameraFit) -> Corners | None:
    """Corners of a black square on white, from rough ones.

    plane: (height, width), one colour of the picture. light: of its bytes, see `light_of_bytes`. rough_px: (4, 2),
    clockwise as seen. camera: at the lens position of the picture. None where an edge leaves the picture, is covered,
    burnt out, or blurred into the code.
    """
    module = module_px(rough_px)
    if module < NARROWEST_PX:
        return None
    for _ in range(ROUNDS):
        found = _fit_once(plane, light, rough_px, camera, module)
        if found is None:
            return None
        before_px, rough_px = rough_px, to_pixels(camera, found.slopes)
        if np.abs(rough_px - before_px).max() <= MOVED * module:
            return found
    return None


def _fit_once(plane: Plane, light: Array, rough_px: Array, camera: CameraFit, module: float) -> Corners | None:
    lens = np.array([camera.f_px, camera.cx_px, camera.cy_px, camera.bend])
    work, lines, most_px2 = room(REACH * module), np.empty((4, 4)), 0.0
    for k in range(4):
        spread = fit_edge(plane, light, rough_px[k], rough_px[(k + 1) % 4], lens, *work, lines[k])
        if spread < 0.0:
            return None
        most_px2 = max(most_px2, spread)
    blur_px = 4.0 * float(np.sqrt(most_px2))  # a disc's edge has a variance of a quarter of its radius squared
    corners = meeting_points(lines)
    if corners is None or blur_px > 2.0 * MIXED * module:
        return None
    return Corners(corners, blur_px)


def module_px(corners_px: Array) -> float:
    """Width of the narrowest module as its edge is crossed: in an oblique view less than an eighth of any side."""
    side = np.roll(corners_px, -1, axis=0) - corners_px
    opposite = np.roll(corners_px + 0.5 * side, -2, axis=0) - corners_px
    across = np.abs(cross(side, opposite)) / np.hypot(side[:, 0], side[:, 1])
    return float(across.min()) / MODULES


def meeting_points(lines: Array) -> Array | None:
    """(4, 2): where each of four lines (point, unit vector) meets the one before it; None where two run alike."""
    before = np.roll(lines, 1, axis=0)
    sine = cross(before[:, 2:], lines[:, 2:])
    if np.abs(sine).min() < 1e-3:
        return None
    way = cross(lines[:, :2] - before[:, :2], lines[:, 2:]) / sine
    out: Array = before[:, :2] + way[:, None] * before[:, 2:]
    return out


# --- tags of a frame ---

WINDOW_PX = 21  # of the adaptive threshold: one does what OpenCV's three do, in a quarter of the time
LEAST_PX = 16  # of a tag's side, in pictures of any size
SMALL_PX = 640  # of the longer side; in smaller pictures tags may be smaller by as much
LARGE_PX = 1600  # of the longer side: from here on tags are looked for in a picture of half the size as well, ...
GRAZING = 0.45  # sine between neighbouring edges: beyond a view of about 75 degrees corners are off by pixels
MOST = 64  # tags in a frame's message: the largest
GREEN = 1  # where most of the light under water is, of which sensors have the most pixels, and no colour fringes
SEARCH = 0.5  # of a module: how far a corner finder looks, where no edges can be fitted

# Id 0 as published, upright: tag36h11.c and the pictures of AprilRobotics, 1 is white.
PUBLISHED_0 = ("110101", "011101", "011000", "101000", "010110", "000100")


class Found(NamedTuple):
    """A tag in a frame, and what a display shows beside it."""

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

    Of two with the same id one is a picture or a copy, and nothing tells which, so neither counts.
    """
    return [one for one in all_tags(image, camera) if one.alone]


def all_tags(image: Image, camera: CameraFit) -> list[Found]:
    """All tags of a whole frame, by id, but those in grazing views.

    A tag in a mirror is none: read backwards, no code is within 3 bits of another, and no more are corrected.
    """
    plane = green(image)
    rough = _rough(plane)
    light, numbers, found = light_of_bytes(camera.gamma), [number for number, _ in rough], []
    for number, corner in sorted(rough, key=lambda one: one[0]):
        rough_px = np.roll(corner, -_first_corner(), axis=0)
        one = _found(plane, light, number, rough_px, camera)
        if one is not None:
            found.append(one._replace(alone=numbers.count(number) == 1))
    return found


def _rough(plane: Plane) -> list[tuple[int, Array]]:
    """Ids and corners (4, 2) as OpenCV has them.

    A large tag's edges are too soft for the threshold's window where the picture is large: such are found in the
    picture made smaller, whose work is a third of the picture's own. What is found in both is the finer one's.
    """
    longer = max(plane.shape)
    corners, ids, _ = _detector(longer).detectMarkers(plane)
    each = [] if ids is None else zip(ids.ravel().tolist(), corners, strict=True)
    found = [(int(number), corner.reshape(4, 2).astype(np.float64)) for number, corner in each]
    if longer < LARGE_PX:
        return found
    height, width = (length // 2 for length in plane.shape)
    small = cv2.resize(plane[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    for number, coarse in _rough(np.asarray(small, np.uint8)):
        corner = 2.0 * coarse + 0.5
        middle, side = corner.mean(axis=0), np.hypot(*(corner[1] - corner[0]))
        if all(number != other or np.hypot(*(middle - place.mean(axis=0))) > side for other, place in found):
            found.append((number, corner))
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


@lru_cache(maxsize=8)
def _detector(longer_px: int) -> cv2.aruco.ArucoDetector:
    """For pictures of this longer side."""
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin = settings.adaptiveThreshWinSizeMax = WINDOW_PX
    settings.minMarkerPerimeterRate = 4 * LEAST_PX / max(longer_px, SMALL_PX)
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
    corners, ids, _ = _detector(SMALL_PX).detectMarkers(drawn)
    if ids is None or ids.ravel().tolist() != [0]:
        raise RuntimeError("this OpenCV does not read the published tag 36h11 of id 0")
    return int(corners[0].reshape(4, 2).sum(axis=1).argmin())
