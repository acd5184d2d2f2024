"""`aucamp calibrate camera`: intrinsics from photographs of a chessboard, taken in the water that will be dived in; and
the fit of a camera and of the servos of its gimbal.

A flat port bends rays much as a lens with some pincushion distortion would, so the water needs no model of its own:
focal length, centre and one radial term take it in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from agent.core.config import Body, ConfigError, write_whole
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit
from agent.process.command import Progress, with_bar
from agent.tools.focus_calibration import HUBER, Array, CalibrationRefused, check_file, gauss_newton, put, scale, solve
from hw.camera.files import folder_of_pictures, read_picture, turned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MIN_VIEWS = 6  # six unknowns of the camera; fewer views leave focal length and distance entangled
MAX_RESIDUAL_PX = 1.5  # beyond it the squares are not what was said, or the photographs are blurred
SAME_VIEW = 0.01  # of the picture's width: views whose corners differ by less are one, with the same errors
MOST_SIGMA = 0.005  # of the focal length, and of the picture's width for the centre: what ranges and tags can bear
NOISE_PX = 0.1  # of a corner at least, whatever the residuals say: print, paper and lens err alike in all views
TILT = "tilt the board by 20 degrees and more, to all sides, in four views at least"


# --- the board ---
# `aucamp calibrate board`: a chessboard to print. Its squares have grain, which focus sweeps measure: corners say where
# the board is, and edges alone make a poor peak (`board_peak` in bench_calibration).

MM_PER_INCH = 25.4
PAPERS_MM = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
RIM_MM = 15  # at least, between the squares and the edge of the paper: corners need white around them, printers too
GRAINS_MM = (0.5, 1.0, 2.0)  # a pixel at 0.5 m, 1 m and 2 m of a camera with f = 1000 px
GRAIN = 0.08  # standard deviation of each, share of white: squares stay dark or bright
PLAIN_MM = 3.0  # of a square along its edges: grain at a corner would move it
DARK, BRIGHT = 0.15, 0.85


def print_board(columns: int, rows: int, square_mm: float, out: Path, console: Console) -> None:
    """Write a PDF of one page with a board of `columns` x `rows` inner corners, true to size. Raises ConfigError where
    no paper is large enough, or the file is there already, or is named as no PDF."""
    if out.suffix.lower() != ".pdf":
        raise ConfigError(f"{out}: the board is a PDF; give --out a name that ends in .pdf")
    if out.exists():
        raise ConfigError(f"{out}: is there already; move it away, or name another file with --out")
    paper, drawn = board_figure(columns, rows, square_mm)
    drawn.savefig(page := BytesIO(), format="pdf")
    write_whole(out, page.getvalue())
    console.print(f"{out}: print it on {paper} at 100 %, matt, and glue it flat; its line has to be 100 mm long")


def board_figure(columns: int, rows: int, square_mm: float) -> tuple[str, Figure]:
    """The smallest paper that holds the board, and a figure of that size. Raises ConfigError."""
    from matplotlib.figure import Figure

    wide_mm, high_mm = (columns + 1) * square_mm, (rows + 1) * square_mm
    fits = [
        (paper, size)
        for paper, size in PAPERS_MM.items()
        if wide_mm + 2 * RIM_MM <= size[0] and high_mm + 2 * RIM_MM <= size[1]
    ]
    if not fits:
        raise ConfigError(f"a board of {wide_mm:g} x {high_mm:g} mm is larger than A0; take smaller squares")
    paper, (paper_mm, tall_mm) = fits[0]
    drawn = Figure(figsize=(paper_mm / MM_PER_INCH, tall_mm / MM_PER_INCH))
    whole = drawn.add_axes((0, 0, 1, 1), xlim=(0, paper_mm), ylim=(0, tall_mm), frame_on=False, xticks=[], yticks=[])
    left_mm, low_mm = (paper_mm - wide_mm) / 2, (tall_mm - high_mm) / 2
    place = (left_mm, left_mm + wide_mm, low_mm, low_mm + high_mm)
    whole.imshow(
        board_picture(columns, rows, square_mm), cmap="gray", vmin=0, vmax=1, extent=place, interpolation="none"
    )
    whole.set(xlim=(0, paper_mm), ylim=(0, tall_mm))
    whole.plot((left_mm, left_mm + 100), (low_mm - 5, low_mm - 5), color="black", linewidth=1, solid_capstyle="butt")
    said = f"100 mm.  Board {columns}x{rows}x{square_mm:g}, {paper}, printed at 100 %"
    whole.text(left_mm + 104, low_mm - 5, said, fontsize=8, verticalalignment="center")
    return paper, drawn


def board_picture(columns: int, rows: int, square_mm: float) -> NDArray[np.float64]:
    """The board alone, the finest grain a pixel: 0 is black, 1 white."""
    across = max(2, round(square_mm / GRAINS_MM[0]))  # pixels of a square
    squares = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    picture = np.kron(np.where(squares == 0, DARK, BRIGHT), np.ones((across, across)))
    plain = min(round(PLAIN_MM / GRAINS_MM[0]), across // 2)
    middle = np.zeros((across, across))
    middle[plain : across - plain, plain : across - plain] = 1.0
    inside = np.kron(np.ones_like(squares), middle)
    dice = np.random.default_rng(1)
    high, wide = picture.shape
    for grain_mm in GRAINS_MM:
        cell = round(grain_mm / GRAINS_MM[0])
        coarse = dice.normal(0.0, GRAIN, (-(-high // cell), -(-wide // cell)))
        picture += inside * np.kron(coarse, np.ones((cell, cell)))[:high, :wide]
    return np.clip(picture, 0.0, 1.0)


# --- intrinsics ---
#
# A robot's lens has one radial term. Fitted to corners of one that has more, such as a wide one behind a port, it makes
# up for them by its focal length and centre, which are then off by many times what is said of them. So a fuller lens is
# fitted as well. Where that fits clearly better, focal length and centre are its, and the one term is what fits best
# with these.


class Intrinsics(NamedTuple):
    """Pinhole with one radial term, as OpenCV defines them; pixels from the centre of the upper left pixel."""

    width_px: int
    height_px: int
    f_px: float
    cx_px: float
    cy_px: float
    k1: float
    residual_px: float
    views: int
    sigma_px: tuple[float, float, float]  # standard deviations of f, cx and cy
    fuller_px: float | None = None  # residual of a fuller lens, where f and the centre are of one


def calibrate_camera(
    folder: Path, columns: int, rows: int, square_mm: float, out: Path | None, console: Console
) -> Intrinsics:
    """Fit, print, and put the result into [camera] of `out` if given. Raises ConfigError, one line."""
    kept = check_file(out).get("camera", {}) if out is not None else {}
    shots = Photographs(folder)
    fit = with_bar(console, "looking for the board", lambda show: intrinsics(shots, columns, rows, square_mm, show))
    for line in shots.said:
        console.print(line)
    corner_px = 0.5 * float(np.hypot(fit.width_px, fit.height_px))
    radius = corner_px / fit.f_px
    bend_px = corner_px * abs(fit.k1) * radius**2
    f_sigma, x_sigma, y_sigma = fit.sigma_px
    console.print(
        f"{fit.views} views: f {fit.f_px:.1f} px, centre ({fit.cx_px:.1f}, {fit.cy_px:.1f}), residual "
        f"{fit.residual_px:.2f} px, distortion {bend_px:.1f} px in the corners; "
        f"standard deviations: f {f_sigma:.1f} px, centre {x_sigma:.1f} and {y_sigma:.1f} px"
    )
    if fit.fuller_px is not None:
        console.print(
            f"this lens bends otherwise than one radial term says: f and centre are of a fuller one (residual "
            f"{fit.fuller_px:.2f} px), and towards the picture's corners rays are less sure than these"
        )
    if out is not None:
        sizes = {"width_px": fit.width_px, "height_px": fit.height_px}
        lens = {"f_px": fit.f_px, "cx_px": fit.cx_px, "cy_px": fit.cy_px, "noise_px": max(fit.residual_px, 0.05)}
        # OpenCV's k1 is our bend; what else the old scale went with does not belong to the new one.
        unsure = [(f_sigma / fit.f_px) ** 2, 0.0, AHEAD_M**2]  # such pictures do not tell where rays meet
        fresh = {"bend": fit.k1, "ahead_m": 0.0, "lens": 0.0, "breathing": 0.0, "scale_covariance": unsure}
        kept = {key: value for key, value in kept.items() if key != "covariance"}  # it was of the old one
        console.print(put(out, "camera", {**kept, **sizes, **lens, **fresh}, folder))
    return fit


class Photographs:
    """The photographs of a folder, as the sensor has them; those that cannot be read are named in `said`.

    Raises ConfigError where there are none."""

    def __init__(self, folder: Path) -> None:
        found = folder_of_pictures(folder)
        self.folder, self.paths = folder, found.files
        line = turned(found.files)
        self.said = found.left_out if line is None else [*found.left_out, line]

    def unread(self) -> str:
        """The first that could not be read, for the end of a sentence."""
        return next((f"; {line}" for line in self.said if line.startswith("left out")), "")

    def read(self, progress: Progress, **how: bool) -> Iterator[tuple[Path, NDArray[np.uint8]]]:
        """Each that can be read; `how` as for read_picture."""
        for done, path in enumerate(self.paths, start=1):
            try:
                yield path, read_picture(path, **how)
            except ConfigError as error:
                self.said.append(f"left out: {error}")
            progress(done, len(self.paths))


CLEAR_OF = 3.0  # sides of a window to one between corners, so that none holds another's edges
WINDOW_PX = 2, 5  # half of a window's side, at least and at most
PLACED = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3  # px


def subpixel(grey: NDArray[np.uint8], corners: NDArray[Any], columns: int) -> NDArray[np.float32]:
    """The finder's corners (n, 1, 2), row by row, moved to where the edges around each meet: by itself it is off by a
    tenth of a pixel, alike all over the board, and a focal length by up to half a percent."""
    found = np.ascontiguousarray(corners, np.float32).reshape(-1, 1, 2)
    rows = found.reshape(-1, columns, 2)
    steps = [np.linalg.norm(np.diff(rows, axis=axis), axis=-1).min() for axis in (0, 1)]
    half = min(int(min(steps) / CLEAR_OF), WINDOW_PX[1])
    if half < WINDOW_PX[0]:
        return found
    return np.asarray(cv2.cornerSubPix(grey, found.copy(), (half, half), (-1, -1), PLACED), np.float32)


def intrinsics(shots: Photographs, columns: int, rows: int, square_mm: float, progress: Progress) -> Intrinsics:
    """Fit all photographs that show the whole board of columns x rows inner corners.

    Progress counts photographs. Raises ConfigError where they cannot be used or do not fit, one line.
    """
    folder, paths = shots.folder, shots.paths
    found: list[NDArray[np.float32]] = []
    size: tuple[int, int] | None = None
    shown = 0
    for path, grey in shots.read(progress, grey=True, stretch=True):  # each is looked at by itself
        if size not in (None, grey.shape[::-1]):
            raise ConfigError(f"{path}: is {grey.shape[1]}x{grey.shape[0]}, others are {size[0]}x{size[1]}")
        size = (grey.shape[1], grey.shape[0])
        seen, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        shown += seen
        view = subpixel(grey, corners, columns) if seen else None
        if view is not None and all(np.abs(view - other).max() > SAME_VIEW * size[0] for other in found):
            found.append(view)
    if size is None or len(found) < MIN_VIEWS:
        alike = f", of which {len(found)} differ" if len(found) < shown else ""
        raise ConfigError(
            f"{folder}: the board of {columns}x{rows} inner corners is whole in {shown} of {len(paths)} photographs"
            f"{alike}; {MIN_VIEWS} are needed, from different sides{shots.unread()}"
        )
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = square_mm * np.mgrid[0:columns, 0:rows].T.reshape(-1, 2)
    return of_corners(folder, board, found, size)


def of_corners(folder: Path, board: Any, found: Sequence[Any], size: tuple[int, int]) -> Intrinsics:
    """The lens that sees the board's corners (n, 3) where they were found in each view (n, 1, 2), px.

    size: width and height. Raises ConfigError, as `intrinsics`, in the folder's name."""
    start = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1]], float)
    fit = _fitted(board, found, size, start, 0.0, PLAIN)
    if fit.residual_px > MAX_RESIDUAL_PX:
        raise ConfigError(f"{folder}: corners miss by {fit.residual_px:.1f} px; check --board and the focus")
    sigma = max(fit.residual_px, NOISE_PX) * unit_sigma(board, *fit[1:])
    _check_known(folder, sigma, fit.matrix, size)
    try:
        fuller = _fitted(board, found, size, fit.matrix, fit.k1, FULLER)
    except cv2.error:  # its search has left the picture: these views tell nothing of more terms
        fuller = fit
    spare = 2 * len(board) * len(found) - 6 * len(found) - 4 - MORE
    clearly = fit.residual_px**2 > (1.0 + CLEARLY * MORE / spare) * fuller.residual_px**2
    if not clearly:
        fuller = fit
    else:
        sigma = max(fuller.residual_px, NOISE_PX) * unit_sigma(board, *fuller[1:], more=True)
        _check_known(folder, sigma, fuller.matrix, size)
    f_px = math.sqrt(fuller.matrix[0, 0] * fuller.matrix[1, 1])
    stretched = 0.5 * abs(fuller.matrix[0, 0] - fuller.matrix[1, 1])  # px, of the one that has to do for both
    if stretched > MOST_SIGMA * f_px:
        raise ConfigError(
            f"{folder}: pictures are stretched: f is {fuller.matrix[0, 0]:.1f} px across and "
            f"{fuller.matrix[1, 1]:.1f} px down; choose a size of the camera's that has square pixels"
        )
    if clearly:
        given = np.array([[f_px, 0, fuller.matrix[0, 2]], [0, f_px, fuller.matrix[1, 2]], [0, 0, 1]])
        fit = _fitted(board, found, size, given, fuller.k1, GIVEN)
    return Intrinsics(
        *size,
        float(fit.matrix[0, 0]),
        float(fit.matrix[0, 2]),
        float(fit.matrix[1, 2]),
        fit.k1,
        fit.residual_px,
        len(found),
        (math.hypot(sigma[0], stretched), float(sigma[1]), float(sigma[2])),
        fuller.residual_px if clearly else None,
    )


def _check_known(folder: Path, sigma: Array, matrix: Any, size: tuple[int, int]) -> None:
    """Raises ConfigError for views that leave focal length or centre open; sigma as of `unit_sigma`, px."""
    for what, share in (("focal length", sigma[0] / matrix[0, 0]), ("centre", sigma[1:3].max() / size[0])):
        if not share <= MOST_SIGMA:
            known = f"to {100 * share:.1f} %" if share < 0.2 else "at all"
            raise ConfigError(
                f"{folder}: these views do not determine the {what} {known}, and {100 * MOST_SIGMA:.1f} % is needed; "
                f"{TILT}"
            )


FULLER = cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS  # k2, p1, p2 and the shape of a pixel beside k1
PLAIN = FULLER | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_ASPECT_RATIO
GIVEN = PLAIN | cv2.CALIB_FIX_FOCAL_LENGTH | cv2.CALIB_FIX_PRINCIPAL_POINT
MORE = 4  # unknowns of the fuller lens
CLEARLY = 10.0  # Fisher's F of them: 1 where they tell nothing, and by chance above 5 in one calibration of a thousand


class _Fitted(NamedTuple):
    residual_px: float
    matrix: Any
    distortion: Any
    turns: Sequence[Any]
    places: Sequence[Any]

    @property
    def k1(self) -> float:
        return float(self.distortion.ravel()[0])


def _fitted(board: Any, found: Sequence[Any], size: tuple[int, int], start: Any, k1: float, flags: int) -> _Fitted:
    bends = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    boards = [board] * len(found)
    residual, matrix, distortion, turns, places = cv2.calibrateCamera(
        boards, found, size, start.copy(), bends, flags=flags
    )
    return _Fitted(float(residual), matrix, distortion, turns, places)


ROUNDING = 1e-9  # of the largest: what is less in a normal matrix is none


def unit_sigma(
    board: Any, matrix: Any, distortion: Any, turns: Sequence[Any], places: Sequence[Any], more: bool = False
) -> Array:
    """Standard deviations of f, cx, cy and k1 for corners that err by a pixel; infinite where they are not determined.

    more: of the fuller lens, of which those of pixels' shape, k2, p1 and p2 follow.

    The board's pose in each view is taken out of the normal equations by itself (Schur complement): what it can undo
    says nothing. OpenCV's own figures come of a pseudo-inverse, which makes what is not determined look certain.
    """
    normal = np.zeros((4 + more * MORE,) * 2)
    for turn, place in zip(turns, places, strict=True):
        J = cv2.projectPoints(board, turn, place, matrix, distortion)[1]
        lens = np.column_stack([J[:, 6] + J[:, 7], J[:, 8], J[:, 9], J[:, 10]])
        if more:
            lens = np.column_stack([lens, J[:, 6] - J[:, 7], J[:, 11:14]])
        pose, _ = np.linalg.qr(J[:, :6])
        left = lens - pose @ (pose.T @ lens)
        normal += left.T @ left
    size = np.sqrt(np.diag(normal)) + 1e-300
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    with np.errstate(divide="ignore"):
        shares = vectors**2 / np.where(values > ROUNDING, values, 0.0)
    shares[:, values <= ROUNDING] = np.where(vectors[:, values <= ROUNDING] ** 2 > ROUNDING, np.inf, 0.0)
    return np.asarray(np.sqrt(shares.sum(axis=1)) / size)


# --- fit of camera and gimbal ---
# Fit a camera and the servos of its gimbal to corners of a board at known places.
#
# The optical axis meets the sensor some pixels beside its middle. A turn of the gimbal moves the picture by as much,
# but bends it otherwise: towards the picture's edge the two differ by a third of a pixel where the axis is 6 px off,
# which puts a robot that goes by tags 10 mm beside its place. Half a thousand corners tell them apart.

COLUMNS, ROWS, SQUARE_M = 14, 9, 0.020  # inner corners of the bench's board of 15 x 10 squares
MIN_CORNERS = 40  # ten unknowns; half a board seen once
MIN_SETTINGS = 3  # of the gimbal: zero and gain of two axes
MAX_NOISE_PX = 2.0  # a wrong board is worse than this
# What to expect, give or take: a small port; growth of the picture from far to near; the axis, of the picture's width.
AHEAD_M, BREATHING, CENTRE = 0.005, 0.05, 0.01
PRIOR_PX = 0.1  # noise of one corner, to weigh that against the corners
PRIORS = 4  # of the unknowns, the last ones
ANGLES = 4  # that shifts of whole views tell: zero and gain of pan and tilt


class Corner(NamedTuple):
    """One corner of the board: pulses of pan and tilt, its place about the pivot in the body frame, its pixel."""

    servos_us: tuple[float, float]
    point_m: Vector
    px: tuple[float, float]
    lens_position: float = 0.0
    number: int | None = None  # of this corner on the board


def find_corners(grey: NDArray[np.uint8]) -> list[tuple[float, float]]:
    """Pixels of the board's inner corners, row by row from the upper left; empty if they are not all there."""
    found, corners = cv2.findChessboardCornersSB(grey, (COLUMNS, ROWS), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return []
    grid = subpixel(grey, corners, COLUMNS).reshape(ROWS, COLUMNS, 2)
    # The gimbal has no roll: whichever corner the finder starts from, left is left and up is up.
    if grid[0, 0, 0] > grid[0, -1, 0]:
        grid = grid[:, ::-1]
    if grid[0, 0, 1] > grid[-1, 0, 1]:
        grid = grid[::-1]
    return [(float(u), float(v)) for u, v in grid.reshape(-1, 2)]


def board_points(board_m: Vector) -> list[Vector]:
    """The same corners about the pivot, body frame: y to the left, z up."""
    x, y, z = board_m
    return [
        (x, y + SQUARE_M * ((COLUMNS - 1) / 2 - column), z + SQUARE_M * ((ROWS - 1) / 2 - row))
        for row in range(ROWS)
        for column in range(COLUMNS)
    ]


def fit_camera(corners: Sequence[Corner], body: Body, size: tuple[int, int]) -> CameraFit:
    """The picture's scale, centre and bend, and zero and gain of pan and tilt. Raises CalibrationRefused.

    Where rays meet shows in boards at different distances, breathing in different lens positions, the centre in boards
    that fill the picture; what the corners do not tell of these stays near nothing (priors of a millimetre's order, of
    a few percent over the lens's travel, and of some pixels).
    """
    settings = {corner.servos_us for corner in corners}
    if len(corners) < MIN_CORNERS or len(settings) < MIN_SETTINGS:
        raise CalibrationRefused(
            f"{len(corners)} corners at {len(settings)} gimbal settings; at least {MIN_CORNERS} at {MIN_SETTINGS} are "
            "needed: light the board, and show all of it"
        )
    middle_px = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    nominal = np.radians((np.array([c.servos_us for c in corners]) - body.servo_centre_us) / body.servo_us_per_deg)
    points, px = np.array([c.point_m for c in corners]), np.array([c.px for c in corners])
    for axis, name in enumerate(("pan", "tilt")):
        if float(np.ptp(nominal[:, axis])) < math.radians(5.0):
            raise CalibrationRefused(f"{name} moved by less than 5 degrees; use settings further apart")

    lens_positions = np.array([c.lens_position for c in corners])
    middle, travel = float(lens_positions.mean()), max(float(np.ptp(lens_positions)), 1.0)
    expected = AHEAD_M, BREATHING, CENTRE * size[0], CENTRE * size[0]

    def residual(p: Array) -> Array:
        """Pixels; p = f_px, pan zero, tilt zero (rad), pan gain, tilt gain, bend, ahead (m), growth over the travel,
        the axis from the picture's middle (px, px)."""
        pan, tilt = p[1] + p[3] * nominal[:, 0], p[2] + p[4] * nominal[:, 1]
        ahead = np.cos(pan) * points[:, 0] + np.sin(pan) * points[:, 1]
        left = np.cos(pan) * points[:, 1] - np.sin(pan) * points[:, 0]
        z = np.cos(tilt) * ahead + np.sin(tilt) * points[:, 2] - p[6]
        up = np.cos(tilt) * points[:, 2] - np.sin(tilt) * ahead
        f_px = p[0] * (1.0 + p[7] * (lens_positions - middle) / travel) * (1.0 + p[5] * (left**2 + up**2) / z**2)
        cx, cy = middle_px[0] + p[8], middle_px[1] + p[9]
        seen = [cx - f_px * left / z - px[:, 0], cy - f_px * up / z - px[:, 1]]
        return np.concatenate([*seen, PRIOR_PX * p[-PRIORS:] / expected])

    def jacobian(p: Array) -> Array:
        steps = np.array([1e-2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-5, 1e-6, 1e-6, 1e-2, 1e-2])
        both = [(residual(p + e), residual(p - e)) for e in np.diag(steps)]
        return np.stack([(plus - minus) / (2.0 * s) for (plus, minus), s in zip(both, steps, strict=True)])

    start = np.array([1.5 * size[0], 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    p, normal, weights = gauss_newton(start, residual, jacobian)
    r, weights = residual(p)[:-PRIORS], weights[:-PRIORS]
    noise_px = scale(weights * r, len(p))
    if noise_px > MAX_NOISE_PX:
        raise CalibrationRefused(f"corners miss by {noise_px:.1f} px; check the board's squares and where it stood")
    # A whole view that is off by the same shift is a servo that did not come back to the same angle.
    of_view = np.array([(*c.servos_us, round(c.point_m[0], 6)) for c in corners])
    view = np.unique(of_view, axis=0, return_inverse=True)[1].ravel()
    shift = np.array([r.reshape(2, -1)[:, view == k].mean(axis=1) for k in range(view.max() + 1)])
    return_rad = math.sqrt(float((shift * shift).sum()) / (shift.size - ANGLES)) / p[0]
    C = _covariance(p, residual, jacobian, normal, [corner.number for corner in corners], noise_px)
    C += _of_returns(jacobian(p), normal, view, return_rad)
    order = [0, 5, 8, 9, 6, 7, 1, 2, 3, 4]  # of CameraFit.covariance, and its units
    units = np.array([1.0 / p[0], 1.0, 1.0, 1.0, 1.0, 1.0 / travel, math.degrees(1.0), math.degrees(1.0), 1.0, 1.0])
    of_all = (units[:, None] * C[order][:, order] * units)[np.triu_indices(len(p))]
    return CameraFit(
        width_px=size[0],
        height_px=size[1],
        f_px=float(p[0]),
        cx_px=middle_px[0] + float(p[8]),
        cy_px=middle_px[1] + float(p[9]),
        bend=float(p[5]),
        ahead_m=float(p[6]),
        lens=middle,
        breathing=float(p[7]) / travel,
        scale_covariance=(float(C[0, 0] / p[0] ** 2), float(C[0, 6] / p[0]), float(C[6, 6])),
        pan_zero_deg=math.degrees(p[1]),
        tilt_zero_deg=math.degrees(p[2]),
        pan_gain=float(p[3]),
        tilt_gain=float(p[4]),
        noise_px=max(noise_px, 0.05),
        noise_deg=max(math.degrees(return_rad), 0.02),
        covariance=tuple(of_all.tolist()),
    )


def _covariance(
    p: Array,
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    normal: Array,
    numbers: Sequence[int | None],
    noise_px: float,
) -> Array:
    """Of p, px2 and so on. What the print and its grain shift a corner by, they do in every view: what is summed over
    the views of a corner is independent, not what is in each (Liang and Zeger 1986, the sandwich)."""
    inverse = solve(normal, np.eye(len(p)))
    known = [number for number in numbers if number is not None]
    if len(known) < len(numbers) or len(set(known)) <= 2 * len(p):
        return np.asarray(max(noise_px, PRIOR_PX) ** 2 * inverse, np.float64)
    r, J = residual(p), jacobian(p)
    limit = HUBER * noise_px
    r = np.clip(r, -limit, limit)
    values, group = np.unique(np.array(known), return_inverse=True)
    pulls = np.zeros((len(p), len(values)))
    for axis in range(2):
        part = slice(axis * len(known), (axis + 1) * len(known))
        for i in range(len(p)):
            pulls[i] += np.bincount(group, J[i, part] * r[part], len(values))
    K = len(values)
    meat = (pulls[:, None] * pulls[None]).sum(axis=-1) * K / (K - len(p))
    priors = J[:, -PRIORS:] * PRIOR_PX
    meat += (priors[:, None] * priors[None]).sum(axis=-1)
    out: Array = _times(_times(inverse, meat), inverse)
    return 0.5 * (out + out.T)


def _of_returns(J: Array, normal: Array, view: NDArray[np.intp], return_rad: float) -> Array:
    """What servos add to the covariance that come back to an angle within return_rad: each view is off as a whole."""
    inverse, meat = solve(normal, np.eye(len(J))), np.zeros((len(J),) * 2)
    for k in range(view.max() + 1):
        part = np.flatnonzero(np.tile(view == k, 2))
        for angle in J[1:3, part]:  # pan and tilt
            pull = return_rad * (J[:, part] * angle).sum(axis=1)
            meat += pull[:, None] * pull
    return _times(_times(inverse, meat), inverse)


def _times(a: Array, b: Array) -> Array:
    out: Array = (a[:, :, None] * b[None]).sum(axis=1)
    return out
