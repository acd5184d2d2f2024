"""Calibrate one robot's camera and gimbal against a board: the procedure of the bench, in water, at known distances.

Focus: at each distance one sweep, always towards larger lens positions after homing at the smallest, because play in
the lens is a constant only for one direction; later sweeps have to go the same way. Camera: a chessboard
at two distances and several settings of the gimbal, always reached from the side of shorter pulses, for the same
reason. Sag of the lens: a few more sweeps, looking up and down. The board stands upright across the body's x axis;
distances count from the gimbal's pivot.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.core.config import Fleet
from agent.core.messages import Vector
from agent.core.ranging.camera_model import (
    Calibration,
    CameraFit,
    FocusFit,
    TimingFit,
    at_lens_position,
    gimbal_deg,
    on_sensor,
    ray,
    servos_us,
)
from agent.core.ranging.focus import (
    Array,
    Peak,
    TiltedPeak,
    as_on_axis,
    fit_peak,
    lens_position,
    phase_sigma,
    port_share,
    shift,
    with_sag,
)
from agent.perception.clarity import gradient_energy, grid, luminance
from agent.perception.depth_peaks import measure_growth, middle_px
from agent.perception.vision import TimedCamera, movable
from agent.process.command import Progress
from agent.tools.camera_calibration import COLUMNS, ROWS, SQUARE_M, Corner, board_points, find_corners, fit_camera
from agent.tools.focus_calibration import (
    Aside,
    CalibrationRefused,
    FocusRow,
    fit_field,
    fit_focus,
    fit_timing,
    told_apart,
)
from hw.camera.camera import Camera, FocusRange, Roi

Wait = Callable[[float], int]  # lets so many seconds pass; returns the time then, ns, by the clock of frames' stamps
Place = Callable[[Vector | None, tuple[int, int]], None]  # board's centre about the pivot (m), pulses of pan and tilt

NEAREST_M, FARTHEST_M, DISTANCES = 0.22, 1.2, 16  # equal steps of 1/u, as the lens sees them
SWEEP_PX = (280, 200)  # the picture's middle that a sweep reads: of 31 degrees, nearly all of the board at the far end
WHOLE = range(6, DISTANCES + 1, 2)  # the distances, counted from 1, at which all of the picture is read: from 0.48 m on
FEWEST_PLACES = 12  # in these sweeps, to tell three numbers and some to check them with
WHOLE_FLANKS, WHOLE_STEPS = 1.8, 13  # half widths on either side of the peak of the middle, and pictures
BLOCKS_ACROSS = 10  # places in a row of the picture that tell how peaks aside differ; they are square
LEAST_PX = 32  # across and down, of a part of the board that is read
FLANKS = 1.5  # half widths on either side of the peak that the grain is fitted over
EDGE_SHARE, EDGE_RIM_PX = 0.3, 3  # of the steepest slope; leaves a fifth of the picture to the grain at 1.2 m
HOMING_S = 0.2  # the lens across its whole range

BOARD_AT_M = (0.68, 0.85)  # the whole board within 31 degrees, with room for a gimbal that is a degree off
VIEWS_DEG = ((0.0, 0.0), (-24.0, 0.0), (24.0, 0.0), (0.0, -8.0), (0.0, 8.0), (-16.0, -6.0), (16.0, 6.0))
SAG_AT_M, SAG_TILTS_DEG = (0.40, 0.43, 0.46), (-20.0, 20.0)  # near: an error of the distance matters least
LOOKS = DISTANCES + len(BOARD_AT_M) * len(VIEWS_DEG)  # settings of the board before those that look up and down
SETTINGS = LOOKS + len(SAG_AT_M) * len(SAG_TILTS_DEG)
BLURS = (-1.5, 0.0, 1.5)  # peak half-widths by which the lens is set off, looking straight: to see the picture grow
COARSE_PX = 9  # places across and down the part that is read, at which a port is asked
BACKLASH_US = 25  # the approach: two degrees, more than any gear has play


def calibrate(
    fleet: Fleet, robot: str, camera: Camera, place: Place, progress: Progress, wait: Wait | None = None
) -> Calibration:
    """Run the whole procedure; progress counts settings of the board, from 0 to SETTINGS.

    Of a camera of fixed focus the sweeps are left out. wait: None where frames have no time of their own, and timing is
    not measured. Raises CalibrationRefused, CameraError.
    """
    progress(0, SETTINGS)
    limits, focus, timing = movable(camera), None, TimingFit()
    if limits is not None and wait is not None:
        timing = measure_timing(fleet, camera, limits, place, wait)
    timed = TimedCamera(camera, timing, (lambda: 0) if wait is None else (lambda: wait(0.0)))
    rows, wrong, seen_aside = list[FocusRow](), list[FocusRow](), list[SeenAside]()
    if limits is not None:
        rows, seen_aside = focus_rows(fleet, timed, limits, place, lambda done, _: progress(done, SETTINGS))
        rows, wrong = told_apart(rows)
        focus = fit_focus(rows)  # near enough to find the board by
    corners: list[Corner] = []
    for done, view in enumerate(views(fleet, timed, focus, place), start=DISTANCES):
        corners += view
        progress(done + 1, SETTINGS)
    seen = fit_camera(corners, fleet.body, camera.size)
    if focus is not None and limits is not None:
        rows = [row._replace(u_m=as_on_axis(row.u_m, window_share(seen))) for row in rows]
        focus = with_field(rows, on_board(seen_aside, fleet, seen), seen)
        tilted = tilted_peaks(fleet, timed, limits, seen, place, lambda done, _: progress(LOOKS + done, SETTINGS))
        focus = with_sag(focus, tilted)
    centre_us = round(fleet.body.servo_centre_us)
    place(None, (centre_us, centre_us))
    without = f", without {', '.join(f'{row.u_m:.2f} m' for row in wrong)}" if wrong else ""
    return Calibration(
        robot=robot,
        made=datetime.now(UTC).strftime("%Y-%m-%d"),
        source=f"board of {COLUMNS + 1} x {ROWS + 1} squares before {fleet.robot[robot].camera}{without}",
        focus=focus,
        camera=seen,
        timing=timing,
    )


def setting(done: int) -> str:
    """What comes after so many settings of the board."""
    if done < DISTANCES:
        return f"distance {done + 1} of {DISTANCES}"
    if done < LOOKS:
        return f"view {done - DISTANCES + 1} of {LOOKS - DISTANCES} of the board"
    return f"view up or down {done - LOOKS + 1} of {SETTINGS - LOOKS}" if done < SETTINGS else "done"


class SeenAside(NamedTuple):
    """A peak somewhere in the picture of a board at a distance, or beside the board."""

    sweep: int
    ahead_m: float  # of the board
    lens_position: float  # of the picture in which it is at px
    px: tuple[float, float]
    peak: Peak


def focus_rows(
    fleet: Fleet, camera: TimedCamera, limits: FocusRange, place: Place, progress: Progress
) -> tuple[list[FocusRow], list[SeenAside]]:
    """The sharpest lens position at each distance; a distance without a clear peak is left out. And at some of them
    that of each place in the picture."""
    rows, aside = list[FocusRow](), list[SeenAside]()
    centre_us = round(fleet.body.servo_centre_us)
    for done, u_m in enumerate(1.0 / np.linspace(1.0 / FARTHEST_M, 1.0 / NEAREST_M, DISTANCES), start=1):
        approach(place, (float(u_m), 0.0, 0.0), (centre_us, centre_us))
        peak = board_peak(within_board(camera, sweep_middle(fleet, camera, limits)))
        if peak is not None:
            rows.append(FocusRow(float(u_m), peak.lens_position, peak.width, peak.sigma))
            if done in WHOLE:
                swept = sweep_whole(fleet, camera, limits, peak)
                midst = 0.5 * (swept.lens_positions[0] + swept.lens_positions[-1])
                aside += [SeenAside(done, float(u_m), midst, px, there) for px, there in peaks_aside(swept)]
        progress(done, DISTANCES)
    return rows, aside


def tilted_peaks(
    fleet: Fleet, camera: TimedCamera, limits: FocusRange, seen: CameraFit, place: Place, progress: Progress
) -> list[TiltedPeak]:
    """Peaks of the board looking up and down at it: what the lens's own weight does. `seen`: the gimbal's zero, and how
    far the optical axis is from the picture's middle, where a sweep reads: seen at 20 degrees, the board is nearer or
    farther there by 0.03 % for each pixel. Six of them are a third of a lens's sag."""
    peaks: list[TiltedPeak] = []
    body, level_us = fleet.body, servos_us(seen, fleet.body, 0.0, 0.0)
    _, y, z = ray(seen, ((seen.width_px - 1) / 2, (seen.height_px - 1) / 2))
    for done, (ahead_m, tilt_deg) in enumerate(itertools.product(SAG_AT_M, SAG_TILTS_DEG), start=1):
        us = level_us[0], servos_us(seen, body, 0.0, tilt_deg)[1]
        tilt = math.radians(gimbal_deg(seen, body, us)[1])
        approach(place, (ahead_m, 0.0, ahead_m * math.tan(tilt)), us)
        peak = board_peak(sweep_middle(fleet, camera, limits))
        if peak is not None:
            u_m = ahead_m / (math.cos(tilt) + y / z * math.sin(tilt))
            peaks.append(TiltedPeak(as_on_axis(u_m, window_share(seen)), peak.lens_position, tilt))
        progress(done, len(SAG_AT_M) * len(SAG_TILTS_DEG))
    return peaks


def with_field(rows: Sequence[FocusRow], places: Sequence[Aside], seen: CameraFit) -> FocusFit:
    """The curve of the axis, through what the picture's middle shows, and the field; None where too little of the
    picture shows the board."""
    plain = fit_focus(rows)
    if len(places) < FEWEST_PLACES:
        return plain
    field = fit_field(plain, places)
    in_window = over_window(seen, lambda px: shift(field, on_sensor(seen, px, seen.lens)))
    return replace(fit_focus([row._replace(rho=row.rho - in_window) for row in rows]), field=field)


def window_share(seen: CameraFit) -> float:
    """K of the part of the picture in which a board is read."""
    return over_window(seen, lambda px: port_share(seen, px))


def over_window(seen: CameraFit, of_px: Callable[[tuple[float, float]], float]) -> float:
    """The mean of something over the part of the picture in which a board is read, as pixels count there."""
    x, y, width, height = middle_of((seen.width_px, seen.height_px))
    fades = np.hanning(COARSE_PX + 2)[1:-1]
    middles = [(k + 0.5) / COARSE_PX for k in range(COARSE_PX)]
    values = [[of_px((x + i * width - 0.5, y + j * height - 0.5)) for i in middles] for j in middles]
    return float(np.average(values, weights=np.outer(fades, fades)))


def on_board(found: Sequence[SeenAside], fleet: Fleet, seen: CameraFit) -> list[Aside]:
    """Those that lie on the board, with the depth that it has there: the gimbal's zero turns it a little."""
    centre_us = fleet.body.servo_centre_us
    pan, tilt = (math.radians(deg) for deg in gimbal_deg(seen, fleet.body, (centre_us, centre_us)))
    half_m = (COLUMNS + 1) * SQUARE_M / 2, (ROWS + 1) * SQUARE_M / 2
    places: list[Aside] = []
    for sweep, ahead_m, midst, px, peak in found:
        camera = at_lens_position(seen, midst)
        m = ray(camera, px)
        x, y = m[0] / m[2], m[1] / m[2]
        across = x * math.sin(pan) + y * math.sin(tilt) * math.cos(pan)
        z_m = (ahead_m + seen.ahead_m * across) / (math.cos(pan) * math.cos(tilt) + across)
        rim_m = seen.width_px / BLOCKS_ACROSS / seen.f_px * z_m
        left_m = z_m * math.sin(pan) - (z_m - seen.ahead_m) * x
        up_m = z_m * math.sin(tilt) - (z_m - seen.ahead_m) * y
        if abs(left_m) < half_m[0] - rim_m and abs(up_m) < half_m[1] - rim_m:
            u_m, rho = as_on_axis(z_m, port_share(camera, px)), peak.lens_position
            places.append(Aside(sweep, u_m, on_sensor(camera, px, rho), rho, peak.sigma))
    return places


class BoardSweep(NamedTuple):
    """Grey pictures of a part of the frame, one a lens position."""

    lens_positions: list[float]
    pictures: list[NDArray[np.uint8]]


def sweep_middle(fleet: Fleet, camera: TimedCamera, limits: FocusRange) -> BoardSweep:
    """The picture's middle, over the whole range of the lens."""
    steps = np.linspace(limits.lowest, limits.highest, fleet.camera.sweep_steps)
    return sweep_board(fleet, camera, limits, middle_of(camera.size), steps)


def sweep_whole(fleet: Fleet, camera: TimedCamera, limits: FocusRange, peak: Peak) -> BoardSweep:
    """The whole picture, about a peak that is known."""
    ends = (peak.lens_position + side * WHOLE_FLANKS * peak.width for side in (-1.0, 1.0))
    first, last = (min(max(end, limits.lowest), limits.highest) for end in ends)
    return sweep_board(fleet, camera, limits, Roi(0, 0, *camera.size), np.linspace(first, last, WHOLE_STEPS))


def sweep_board(fleet: Fleet, camera: TimedCamera, limits: FocusRange, part: Roi, steps: Array) -> BoardSweep:
    """Pictures of a part of the frame at rising lens positions, after homing."""
    home(camera, limits)
    lens_positions, pictures = list[float](), list[NDArray[np.uint8]]()
    for wanted in steps:
        reported = camera.set_focus(round(wanted))
        frame = camera.read(part, settle_s=fleet.camera.settle_s)
        lens_positions.append(camera.lens_position(frame.t_ns) or reported)
        pictures.append(luminance(frame.image))
    return BoardSweep(lens_positions, pictures)


def within_board(camera: TimedCamera, swept: BoardSweep) -> BoardSweep:
    """What lies between the corners of the board, where a whole picture shows them all: walls have peaks, too."""
    clarity = [float(gradient_energy(picture).sum()) for picture in swept.pictures]
    camera.set_focus(round(swept.lens_positions[int(np.argmax(clarity))]))
    corners = find_corners(resting(camera))
    if not corners:
        return swept
    x, y, width, height = middle_of(camera.size)
    left, top = (np.ceil(np.min(corners, axis=0)).astype(int) - (x, y)).clip(0)
    right, bottom = (np.floor(np.max(corners, axis=0)).astype(int) - (x, y)).clip(0, (width, height))
    return swept._replace(pictures=[picture[top:bottom, left:right] for picture in swept.pictures])


def board_peak(swept: BoardSweep) -> Peak | None:
    """Where the grain of the board is sharpest, if anywhere.

    Grain, not edges: a board square to the camera has all its edges at one phase of the pixel grid, and the image grows
    as the lens moves, so edges gain and lose gradient. That scatters peaks by 2.6 lens positions; the grain by 0.5.
    """
    lens_positions, pictures = swept
    if min(pictures[0].shape) < LEAST_PX:
        return None
    window = np.outer(*map(np.hanning, pictures[0].shape))  # what grows over the border leaves no step
    energies = [gradient_energy(picture) for picture in pictures]
    clarity = [float((energy * window).sum()) for energy in energies]
    rough = fit_peak(lens_positions, clarity)
    if not isinstance(rough, Peak):
        return None
    window *= ~edges(pictures[int(np.argmax(clarity))])
    if window.sum() == 0:
        return None
    # Farther from the peak the blur of the edges covers the grain.
    near = [i for i, rho in enumerate(lens_positions) if abs(rho - rough.lens_position) < FLANKS * rough.width]
    fine = fit_peak([lens_positions[i] for i in near], [float((energies[i] * window).sum()) for i in near])
    if not isinstance(fine, Peak):
        return None
    area_px = float(window.sum() ** 2 / (window * window).sum())  # what is left of the grain at 1.2 m is little
    return fine._replace(sigma=math.hypot(fine.sigma, phase_sigma(fine.width, area_px)))


def peaks_aside(swept: BoardSweep) -> list[tuple[tuple[float, float], Peak]]:
    """Peaks of the grain all over the picture, which was read whole, by blocks, with their middles.

    The picture grows as the lens moves, and a block goes with the piece of the board that it shows in the midst of the
    sweep: else brighter or coarser pieces that come into it move its peak.
    """
    lens_positions, pictures = swept
    height, width = pictures[0].shape
    side, found = width // BLOCKS_ACROSS, list[tuple[tuple[float, float], Peak]]()
    growth = measure_growth(pictures) or 0.0  # unknown: as good as any
    size = 1.0 + growth * np.linspace(-0.5, 0.5, len(pictures))
    tops, lefts = (
        [np.clip(grid(length, side, k, cuts=2)[1::2] - side // 2, 0, length - side).tolist() for k in size]
        for length in (height, width)
    )
    for row, col in itertools.product(range(height // side), range(width // side)):
        corners = ((top[row], left[col]) for top, left in zip(tops, lefts, strict=True))
        blocks = [picture[y : y + side, x : x + side] for picture, (y, x) in zip(pictures, corners, strict=True)]
        peak = board_peak(BoardSweep(lens_positions, blocks))
        if peak is not None:
            found.append((middle_px(row, col, side), peak))
    return found


def middle_of(size: tuple[int, int]) -> Roi:
    """The part of a picture that a sweep reads."""
    (width, height), (across, down) = size, SWEEP_PX
    return Roi((width - across) // 2, (height - down) // 2, across, down)


def edges(grey: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The edges between squares and a few pixels around them, in a sharp picture of the board."""
    gx, gy = cv2.spatialGradient(cv2.GaussianBlur(grey, (0, 0), 2.0))
    slope = np.hypot(gx, gy)
    steep = (slope > EDGE_SHARE * np.quantile(slope, 0.98)).astype(np.uint8)
    return cv2.dilate(steep, np.ones((2 * EDGE_RIM_PX + 1,) * 2, np.uint8)) > 0


def views(fleet: Fleet, camera: TimedCamera, focus: FocusFit | None, place: Place) -> Iterator[list[Corner]]:
    """The corners of each view of the board, as sharp as the lens can make it (focus: None, it is fixed); an empty list
    where the board is not seen whole."""
    body = fleet.body
    for ahead_m in BOARD_AT_M:
        for pan_deg, tilt_deg in VIEWS_DEG:
            left_m = ahead_m * math.tan(math.radians(pan_deg))
            board_m = (ahead_m, left_m, math.hypot(ahead_m, left_m) * math.tan(math.radians(tilt_deg)))
            us = (
                round(body.servo_centre_us + body.servo_us_per_deg * pan_deg),
                round(body.servo_centre_us + body.servo_us_per_deg * tilt_deg),
            )
            approach(place, board_m, us)
            found: list[Corner] = []
            for wanted in lens_of_view(focus, math.hypot(*board_m), straight=pan_deg == tilt_deg == 0.0):
                reached = 0 if wanted is None else camera.set_focus(wanted)
                grey = resting(camera)
                pairs = zip(board_points(board_m), find_corners(grey), strict=False)
                found += [Corner(us, point, px, float(reached), k) for k, (point, px) in enumerate(pairs)]
            yield found


def lens_of_view(focus: FocusFit | None, away_m: float, straight: bool) -> list[int | None]:
    """The lens positions at which a view is looked at."""
    if focus is None:
        return [None]
    sharp = lens_position(focus, away_m)
    return [round(sharp + blur * focus.width) for blur in (BLURS if straight else (0.0,))]


def approach(place: Place, board_m: Vector, us: tuple[int, int]) -> None:
    """Set up the board and the gimbal, each servo coming from the side of shorter pulses."""
    place(board_m, (us[0] - BACKLASH_US, us[1] - BACKLASH_US))
    place(board_m, us)


def home(camera: TimedCamera, limits: FocusRange) -> None:
    """Bring the lens to rest at its smallest position."""
    camera.set_focus(limits.lowest)
    camera.read(middle_of(camera.size), settle_s=max(HOMING_S, camera.homing_s))


def resting(camera: TimedCamera) -> NDArray[np.uint8]:
    """The whole picture, grey, once the lens has come to rest."""
    return luminance(camera.read(settle_s=max(HOMING_S, camera.homing_s)).image)


# --- timing ---
# When frames were exposed, and how the lens moves: it is told to step up a flank of the clarity's peak, again and
# again, at other moments between two frames, and what the frames show then tells where the lens was.
#
# A time without any motion and an exponential way after it are told apart by the shape of the response. The first is
# taken for lateness of the stamps: what a driver takes to pass a command on is in it, a few milliseconds.

TIMED_AT_M = 0.40
RESTS_S = 1.0  # until frames show any lens at rest: 0.2 s late, and eight lags of 0.1 s
FLANK = (-1.2, -0.2)  # half widths from the peak, where a step begins and ends; clarity rises from one to the other
FLANK_STEPS, TIMED_STEPS, TIMED_FRAMES = 9, 8, 16
FRAME_S = 1 / 30  # of most cameras; steps begin at each eighth of it


def measure_timing(fleet: Fleet, camera: Camera, limits: FocusRange, place: Place, wait: Wait) -> TimingFit:
    """Lateness of the stamps and lag of the lens, before the board. Raises CalibrationRefused where it does not show a
    peak."""
    centre_us = round(fleet.body.servo_centre_us)
    approach(place, (TIMED_AT_M, 0.0, 0.0), (centre_us, centre_us))
    middle = middle_of(camera.size)

    def clarity(settle_s: float) -> tuple[int, float]:
        frame = camera.read(middle, settle_s=settle_s)
        return frame.t_ns, float(gradient_energy(luminance(frame.image)).sum())

    def at_rest(first: float, last: float, count: int) -> tuple[Array, Array]:
        camera.set_focus(limits.lowest)
        clarity(RESTS_S)
        found = [(camera.set_focus(round(at)), clarity(RESTS_S)[1]) for at in np.linspace(first, last, count)]
        return np.array([at for at, _ in found]), np.array([value for _, value in found])

    swept, seen_at = at_rest(limits.lowest, limits.highest, fleet.camera.sweep_steps // 2)
    rough = fit_peak(swept.tolist(), seen_at.tolist())
    if not isinstance(rough, Peak):
        raise CalibrationRefused(
            f"the lens's timing: {rough.reason}; put the board at {TIMED_AT_M:.2f} m, and light it"
        )
    first, last = (max(rough.lens_position + k * rough.width, limits.lowest) for k in FLANK)
    positions, curve = at_rest(first, last, FLANK_STEPS)
    since_s, seen = [], []
    for k in range(TIMED_STEPS):
        camera.set_focus(limits.lowest)
        clarity(RESTS_S)
        camera.set_focus(int(positions[0]))
        before = clarity(RESTS_S)
        told_ns = wait(k * FRAME_S / TIMED_STEPS)
        camera.set_focus(int(positions[-1]))
        for t_ns, value in (before, *(clarity(0.0) for _ in range(TIMED_FRAMES))):
            since_s.append(1e-9 * (t_ns - told_ns))
            seen.append(value)
    return fit_timing(positions, curve, np.array(since_s), np.array(seen))
