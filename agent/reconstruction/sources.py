"""Views from recordings (black boxes), or from a folder of pictures in nerfstudio's layout.

Each whole sweep of a recording gives one view: what it shows, and where the camera was at its clearest frame. A moored
robot is where the fleet file says, at the depth, roll and pitch that its pressure sensors tell; one that swims is where
it logged that it was. While the lens moves the robot drifts by some pixels. The target's centre says where the frames
lie on each other; where there is none they are registered.
"""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import cv2
import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from agent.core.attitude import zeros
from agent.core.codec import as_text
from agent.core.config import ConfigError, Pose, check_depth, convert, inside, read_file
from agent.core.ranging.camera_model import CameraFit, at_lens_position, camera_pose, gimbal_deg
from agent.perception.clarity import gradient_energy, luminance
from agent.process.command import Progress, Show
from agent.reconstruction.refine_poses import DEPTH_M, LEVEL_RAD, Sigmas, covariance_of
from agent.reconstruction.views import (
    Camera,
    Floats,
    Swept,
    View,
    diagonal_prior,
    keyframe,
    linear,
    reduction,
    shrunk_frame,
    steady,
)
from hw.camera.files import read_picture, turned
from replay.check.reexecute import BlackBox, open_boxes
from replay.viewers.viewer_channels import SweepFrame
from replay.whole_sweeps import Motion, TakenSweep, taken_sweeps, told

MOORED = (3e-3, math.radians(0.5))  # of a survey by hand and tape: m in x and in y, rad of yaw
LEAST_PX = 128  # of the part that all frames of a sweep show, across and down
MOST_DRIFT_PX = 0.1  # of the picture's width from one frame to the next: more is no drift


class Recorded(NamedTuple):
    """Views, and in words why sweeps gave none."""

    views: list[View]
    passed_over: dict[str, int]


def recorded_views(paths: Sequence[Path], progress: Progress) -> Recorded:
    """Views of all whole sweeps in black boxes and folders of them; progress counts recordings.

    Raises ConfigError where there is none, one is damaged, or they are of tanks of two sizes.
    """
    boxes = open_boxes(paths)
    for box in boxes:
        if box.fleet.tank.size_m != boxes[0].fleet.tank.size_m:  # the surface may rise from dive to dive
            raise ConfigError(f"{box.path}: is of another tank than {boxes[0].path}; give those of one tank alone")
    views: dict[tuple[str, str, int], View] = {}
    passed_over: Counter[str] = Counter()
    for done, box in enumerate(boxes):
        progress(done, len(boxes))
        for found in _views_of(box):
            if isinstance(found, str):
                passed_over[found] += 1
            elif found.key in views:
                passed_over["given twice"] += 1
            else:
                views[found.key] = found
    progress(len(boxes), len(boxes))
    return Recorded(list(views.values()), dict(passed_over))


def _views_of(box: BlackBox) -> Iterator[View | str]:
    steps = told(box)
    for sweep in taken_sweeps(box, steps.views):
        yield view_of(box, steps.motion, sweep)


def view_of(box: BlackBox, moved: Motion, sweep: TakenSweep) -> View | str:
    """The view of one sweep, or why there is none."""
    frames = sorted(sweep.frames, key=lambda frame: frame.sighting.focus or 0)
    if any(frame.sighting.focus is None for frame in frames):
        return "lens positions unknown"
    lens_positions = np.array([float(frame.sighting.focus or 0) for frame in frames])
    if len(np.unique(lens_positions)) < len(lens_positions):
        return "a lens position twice"
    cut = aligned(frames)
    if cut is None:
        return "frames that do not lie on each other"
    clearest = cut.clearest
    pose = _pose(box, moved, frames[clearest].sighting.t_ns)
    if pose is None:
        return "whereabouts unknown"
    corner = _corner_px(cut, clearest, box.calibration.camera, lens_positions)
    swept: Swept = keyframe(cut.images, lens_positions, box.calibration, pose.tilt_rad, corner, cut.grown_about_px)
    return View(
        robot=box.robot,
        incarnation=str(box.incarnation),
        seq=sweep.number,
        camera=swept.camera,
        rotation=pose.rotation,
        position_m=pose.position_m,
        pose_covariance=pose.shared,
        picture=swept.picture,
        depth_m=swept.depth.depth_m,
        sigma_m=swept.depth.sigma_m,
        own_covariance=pose.own,
    )


class Cut(NamedTuple):
    """The part that all frames of a sweep show, cut out of each where it lies in it."""

    images: list[np.ndarray]
    corners_px: list[tuple[int, int]]  # upper left one of each, in its whole picture
    grown_about_px: tuple[float, float] | None  # in the part; None: about the optical axis

    @property
    def clearest(self) -> int:
        """The frame of which a sharp picture shows most: where things are in it is where the camera was then."""
        return int(np.argmax([gradient_energy(luminance(image)).mean() for image in self.images]))


def _corner_px(cut: Cut, clearest: int, camera: CameraFit, lens_positions: Floats) -> tuple[float, float]:
    """Of the part in the whole picture, as it lies in the clearest frame, but for the size of the largest. Frames that
    are laid on a target grow about it, and the optical axis goes away from it as they do."""
    corner = cut.corners_px[clearest]
    if cut.grown_about_px is None:
        return corner
    f_px = [at_lens_position(camera, float(position)).f_px for position in lens_positions]
    growth = max(f_px) / f_px[clearest] - 1.0
    x, y = (
        at - growth * (axis - at - about)
        for at, axis, about in zip(corner, (camera.cx_px, camera.cy_px), cut.grown_about_px, strict=True)
    )
    return x, y


def aligned(frames: Sequence[SweepFrame]) -> Cut | None:
    """The part that all frames show; None where it cannot be told, or is too small."""
    seen = [frame.sighting.centre_px for frame in frames if frame.sighting.radius_px]
    by_target = len(seen) == len(frames)
    at = np.array(seen, float) if by_target else _drift(frames)
    if at is None:
        return None
    rois = np.array([frame.roi for frame in frames], float)
    anchor = np.rint(at - rois[:, :2]).astype(int)  # in each frame
    before = anchor.min(axis=0)
    after = (rois[:, 2:].astype(int) - anchor).min(axis=0)
    width, height = (before + after).tolist()
    if min(width, height) < LEAST_PX:
        return None
    images = [
        frame.image[y - before[1] : y + after[1], x - before[0] : x + after[0]]
        for frame, (x, y) in zip(frames, anchor.tolist(), strict=True)
    ]
    corners = [(int(x), int(y)) for x, y in rois[:, :2].astype(int) + anchor - before]
    return Cut(images, corners, (float(before[0]), float(before[1])) if by_target else None)


def _drift(frames: Sequence[SweepFrame]) -> Floats | None:
    """Where the first frame's middle is in each whole picture (n, 2), by registering each with the one before."""
    x, y, width, height = frames[0].roi
    if any(frame.roi[2:] != (width, height) for frame in frames):
        return None
    at = [np.array([x + width / 2.0, y + height / 2.0])]
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    before = luminance(frames[0].image).astype(np.float32)
    for last, frame in itertools.pairwise(frames):
        grey = luminance(frame.image).astype(np.float32)
        shift, _ = cv2.phaseCorrelate(before, grey, window)
        moved = np.array(shift) + np.array(frame.roi[:2], float) - np.array(last.roi[:2], float)
        if np.abs(moved).max() > MOST_DRIFT_PX * width:
            return None
        at.append(at[-1] + moved)
        before = grey
    return np.array(at)


class CameraPose(NamedTuple):
    """Where the camera is believed to be at one moment, and how wrong that may be."""

    rotation: Floats  # (3, 3) camera to world
    position_m: Floats  # (3,)
    shared: Floats  # (6, 6) covariance of (w, t): what the robot's camera is wrong by at all times
    own: Floats  # (6, 6) and at this moment
    tilt_rad: float  # how far it looks up


def _pose(box: BlackBox, moved: Motion, t_ns: int) -> CameraPose | None:
    """None: unknown. Where a moored robot is was surveyed once; one that swims is wrong anew each time."""
    level = moved.level(t_ns)
    if level is None:
        return None
    moored = box.fleet.navigation is None
    known = None if moored else moved.whereabouts(t_ns)
    fleet, camera = box.fleet, box.calibration.camera
    if known is not None:
        pose = Pose(x_m=known.x_m, y_m=known.y_m, yaw_deg=known.yaw_deg)
        always, now = (0.0, 0.0), (known.place_sigma_m / math.sqrt(2.0), math.radians(known.yaw_sigma_deg))
    elif moored:
        pose, always, now = fleet.robot[box.robot].pose, MOORED, (0.0, 0.0)
    else:
        return None
    pan, tilt = gimbal_deg(camera, fleet.body, level.servos_us)
    surface_m = fleet.tank.surface_m
    eye = camera_pose(pose, fleet.body, level.depth_m, level.roll_deg, level.pitch_deg, pan, tilt, surface_m)
    rotation, position = np.array(eye.rotation), np.array(eye.position_m)
    arm, by_pressure = position - np.array(eye.body_m), zeros(fleet.budget, level.on_s)
    level_rad, depth_m = max(LEVEL_RAD, by_pressure.tilt_rad), max(DEPTH_M, by_pressure.height_m)
    return CameraPose(
        rotation,
        position,
        covariance_of(rotation, arm, Sigmas(*always, math.radians(camera.noise_deg), level_rad, depth_m)),
        steady() + covariance_of(rotation, arm, Sigmas(*now, gimbal_rad=0.0, level_rad=0.0, depth_m=0.0)),
        math.asin(max(-1.0, min(1.0, float(rotation[2, 2])))),
    )


# --- pictures that others took: a folder in nerfstudio's layout -> views without depths of their own ---
#
# Nothing there says how far anything is. A view gets a depth range instead, as a prior as wide as the scene: the
# plane sweep then looks all along the line of sight. Scenes have any unit and any size.

DISTANCE_M = 0.7  # at which things are, once a scene has been brought to the size of a tank
TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
GAMMA = 2.2
FLAT = 1e-9  # of a determinant: no rotation has so little, at any scale of a scene
SHEARED = 0.02  # of what a rotation times its transpose is off from one: rounding leaves 1e-3
EDGE_PX = 0.5  # beyond the middles of the outermost pixels: as far as these reach
LEAST_SIDE = 0.25  # of the shorter side: what is left of a straightened picture
MOST_BYTES = 2**26  # of transforms.json: 1 kB a picture

Row = tuple[float, float, float, float]


Model = Literal[
    "SIMPLE_PINHOLE", "PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV",
    "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
]  # fmt: skip


class Lens(msgspec.Struct, frozen=True, kw_only=True):
    """Of all pictures, or of one."""

    w: Annotated[float, Meta(ge=1)] | None = None  # of the pictures that the numbers were found in
    h: Annotated[float, Meta(ge=1)] | None = None
    fl_x: Annotated[float, Meta(ge=1)] | None = None
    fl_y: Annotated[float, Meta(ge=1)] | None = None
    camera_angle_x: Annotated[float, Meta(gt=0, lt=math.pi)] | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    k5: float | None = None
    k6: float | None = None
    p1: float | None = None
    p2: float | None = None
    camera_model: Model | None = None  # by nerfstudio's and COLMAP's names; None: a plain lens
    is_fisheye: bool | None = None  # instant-ngp's word for OPENCV_FISHEYE


LENS = Lens.__struct_fields__
FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


class Frame(Lens, frozen=True, kw_only=True):
    file_path: str
    transform_matrix: tuple[Row, Row, Row, Row]


class Transforms(Lens, frozen=True, kw_only=True):
    frames: Annotated[tuple[Frame, ...], Meta(min_length=1)]


class Posed(NamedTuple):
    """Views, why others gave none, and what a person should know of the pictures."""

    views: list[View]
    passed_over: dict[str, int]
    notes: list[str]


def transforms_views(path: Path, show: Show) -> Posed:
    """Views of a transforms.json, or of the folder that has one. Pictures that are not there are passed over.

    Raises ConfigError with one line.
    """
    file = path / "transforms.json" if path.is_dir() else path
    data = read_transforms(file)
    places = [_picture(file, frame.file_path) for frame in data.frames]
    missing = sum(place is None for place in places)
    if missing == len(places):
        raise ConfigError(f"{file}: of {missing} pictures none is there, such as {data.frames[0].file_path}")
    views = []
    for n, (frame, place) in enumerate(zip(data.frames, places, strict=True)):
        show(n, len(data.frames), "reading pictures")
        if place is not None:
            views.append(_view(file, data, frame, n, place))
    line = turned([place for place in places if place is not None])
    return Posed(views, {"pictures that are not there": missing} if missing else {}, [] if line is None else [line])


class Length(NamedTuple):
    """How far apart two cameras were: by what the unit of a scene is known."""

    one: str  # picture as its file is called in transforms.json, with or without folder and ending
    other: str
    metres: float


def parse_length(text: str) -> Length:
    """A,B,METRES. Raises ConfigError."""
    one, other, metres = (*(part.strip() for part in text.split(",")), "", "", "")[:3]
    try:
        found = Length(one, other, float(metres))
    except ValueError:
        found = Length("", "", 0.0)
    if not (found.one and found.other and 0.0 < found.metres < math.inf) or text.count(",") != 2:
        raise ConfigError(f"--length {text}: write two pictures and how far apart their cameras were: A,B,METRES")
    return found


def unit_m(path: Path, length: Length) -> float:
    """What a unit of the scene is in metres. Raises ConfigError for pictures that are not there, or at one place."""
    file = path / "transforms.json" if path.is_dir() else path
    frames = read_transforms(file).frames
    places = [np.array(_named(file, frames, name).transform_matrix)[:3, 3] for name in length[:2]]
    apart = float(np.linalg.norm(places[0] - places[1]))
    if not apart > 0.0:
        raise ConfigError(f"--length: {length.one} and {length.other} were taken at one place; take two others")
    return length.metres / apart


def _named(file: Path, frames: Sequence[Frame], name: str) -> Frame:
    found = [frame for frame in frames if name in (path := frame.file_path, Path(path).name, Path(path).stem)]
    if len(found) != 1:
        why = f"{len(found)} pictures are called {name}" if found else f"no picture is called {name}"
        raise ConfigError(f"--length: {why} in {file}; write one as its file_path is there, as {frames[0].file_path}")
    return found[0]


def read_transforms(file: Path) -> Transforms:
    """Raises ConfigError for what is none, and for numbers that are not finite or are too large."""
    give = "give a folder in nerfstudio's layout, or its file"
    try:
        text = as_text(read_file(file, MOST_BYTES, give))
        check_depth(text, file)
        data = json.loads(text)  # which reads NaN, as other programs write it: it is named below
    except ValueError as error:
        raise ConfigError(f"{file}: no JSON ({error}); {give}") from None
    return convert(data, Transforms, file)


def _view(file: Path, data: Transforms, frame: Frame, n: int, place: Path) -> View:
    image = read_picture(place)
    f, camera, image = _pinhole(file, data, frame, image, n)
    height, width = image.shape[:2]
    pose = np.array(frame.transform_matrix)[:3] @ TO_OPENCV
    rotation = _rotation(pose[:, :3], f"{file}: frame {n} ({frame.file_path})")
    times = reduction(width)
    small = shrunk_frame(image, 1.0, (0.0, 0.0), times, GAMMA) if times > 1 else linear(image, GAMMA)
    half = (times - 1) / 2.0
    intrinsics = Camera(
        f / times, (camera[0] - half) / times, (camera[1] - half) / times, 0.0, 0.0, width // times, height // times
    )
    unknown = np.full(small.shape[:2], np.nan, np.float32)
    return View(
        "pictures", "", n, intrinsics, rotation, pose[:, 3], diagonal_prior(1e-3, 1e-3), small, unknown, unknown
    )


def _rotation(turn: Floats, where: str) -> Floats:
    """Without the scale that a scene may have. Raises ConfigError for what turns nothing, mirrors or shears."""
    volume = float(np.linalg.det(turn))
    if abs(volume) < FLAT:
        raise ConfigError(f"{where}: its transform_matrix turns nothing; take the frame out")
    rotation: Floats = turn / np.cbrt(volume)
    if volume < 0.0:
        raise ConfigError(f"{where}: its transform_matrix mirrors; write camera-to-world, x right, y up, z backwards")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > SHEARED:
        raise ConfigError(f"{where}: its transform_matrix is no rotation: its axes are not square to each other")
    return rotation


def _picture(file: Path, name: str) -> Path | None:
    """Where it is; nerfstudio leaves endings out, and names files by the paths of another system. None: nowhere."""
    path = inside(file.parent, name.replace("\\", "/"))
    found = [path, *(path.with_name(path.name + ending) for ending in (".png", ".jpg", ".jpeg"))]
    return next((one for one in found if one.exists()), None)


def _pinhole(
    file: Path, data: Transforms, frame: Frame, image: np.ndarray, n: int
) -> tuple[float, tuple[float, float], np.ndarray]:
    """Focal length and centre of the picture as a straight pinhole would have taken it, and that picture, cut to what
    the lens saw: a black border would be taken for a part of the scene."""
    height, width = map(int, image.shape[:2])
    about: dict[str, Any] = {}
    for lens in (data, frame):
        about |= {name: value for name in LENS if (value := getattr(lens, name)) is not None}
    _check_size(f"{file}: frame {n}", frame.file_path, (width, height), about)
    if "fl_x" in about:
        fx = about["fl_x"]
    elif "camera_angle_x" in about:
        fx = 0.5 * about.get("w", width) / math.tan(0.5 * about["camera_angle_x"])
    else:
        raise ConfigError(f"{file}: frame {n} has no fl_x and no camera_angle_x; add one of them")
    model = "OPENCV_FISHEYE" if about.get("is_fisheye") else about.get("camera_model", "OPENCV")
    if about.get("k4") and model not in ("FULL_OPENCV", *FISHEYES):
        raise ConfigError(f"{file}: frame {n} has k4, which {model} does not have; write camera_model, or leave it out")
    fy = about.get("fl_y", fx)
    cx, cy = about.get("cx", about.get("w", width) / 2.0), about.get("cy", about.get("h", height) / 2.0)
    scale = width / about.get("w", width)  # a folder of smaller copies has the intrinsics of the large ones
    fx, fy, cx, cy = fx * scale, fy * scale, cx * scale - 0.5, cy * scale - 0.5
    k1, k2, k3, k4, k5, k6, p1, p2 = (about.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"))
    flat = np.array([[fx, 0.0, cx], [0.0, fx, cy], [0.0, 0.0, 1.0]])
    bent = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size, kind = (width, height), cv2.CV_32FC1
    if model in FISHEYES:
        bends = np.array([k1, k2, k3, k4])
        x, y = cv2.fisheye.initUndistortRectifyMap(bent, bends, np.eye(3), flat, size, kind)
    elif any((k1, k2, k3, p1, p2, k4, k5, k6)) or fx != fy:
        bends = np.array([k1, k2, p1, p2, k3, k4, k5, k6])
        x, y = cv2.initUndistortRectifyMap(bent, bends, np.eye(3), flat, size, kind)
    else:
        return fx, (cx, cy), image
    left, top, right, bottom = within(x, y)
    if min(right - left, bottom - top) < LEAST_SIDE * min(size):
        raise ConfigError(f"{file}: frame {n}: straightened, next to nothing of its picture is left; check k1 to p2")
    part = np.s_[top:bottom, left:right]
    image = np.asarray(cv2.remap(image, x[part], y[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    return fx, (cx - left, cy - top), image


def within(x: NDArray[Any], y: NDArray[Any]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom (the last two exclusive) of a straightened picture without what the lens never saw.

    x, y: (height, width) where its pixels are in the picture of that size as taken. The side of which most was never
    seen goes first. Of a lens that bends inwards (barrel) nothing goes.
    """
    height, width = x.shape
    seen = (x >= -EDGE_PX) & (x <= width - 1 + EDGE_PX) & (y >= -EDGE_PX) & (y <= height - 1 + EDGE_PX)
    left, top, right, bottom = 0, 0, width, height
    while left < right and top < bottom:
        rows, columns = np.s_[top:bottom], np.s_[left:right]
        shares = [float(side.mean()) for side in
                  (seen[rows, left], seen[top, columns], seen[rows, right - 1], seen[bottom - 1, columns])]  # fmt: skip
        worst = int(np.argmin(shares))
        if shares[worst] == 1.0:
            break
        left, top, right, bottom = (
            left + (worst == 0), top + (worst == 1), right - (worst == 2), bottom - (worst == 3)
        )  # fmt: skip
    return left, top, right, bottom


def _check_size(where: str, name: str, size: tuple[int, int], about: dict[str, Any]) -> None:
    """Raises ConfigError for a picture that is no copy, larger or smaller, of one of w x h."""
    width, height = size
    w, h = about.get("w", width), about.get("h", height)
    if ("w" in about) != ("h" in about):  # the other follows from the picture
        w, h = (w, w * height / width) if "w" in about else (h * width / height, h)
    if abs(height - h * width / w) > 1.0 and abs(width - w * height / h) > 1.0:
        raise ConfigError(
            f"{where}: {name} has {width}x{height} pixels, which is no copy of {w:g}x{h:g} (w and h); "
            "give the pictures that the poses were found with, neither cut nor turned"
        )
