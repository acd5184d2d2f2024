"""Calibrate one robot's camera and gimbal against a board: the procedure of the bench, in water, at known distances.

Focus: at each distance one sweep, always towards larger lens positions after homing at the smallest, because play in
the lens is a constant only for one direction; whoever measures later has to sweep the same way. Camera: a chessboard
at two distances and several settings of the gimbal, always reached from the side of shorter pulses, for the same
reason. Sag of the lens: a few more sweeps, looking up and down. The board stands upright across the body's x axis;
distances count from the gimbal's pivot.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from agent.clock import machine
from agent.clock.clock import SystemClock
from agent.core.config import ConfigError, Fleet, dump, write_whole
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit, gimbal_deg, ray, servos_us
from agent.core.ranging.focus import Peak, TiltedPeak, fit_peak, lens_position, phase_sigma, with_sag
from agent.core.step_io import SetPoint
from agent.perception.depth_peaks import gradient_energy, luminance
from agent.process.command import Progress, Show, temporary_folder, with_bar, with_spinner
from agent.process.launch import crew, wait_for
from agent.robot.fleet_reader import load_fleet, load_robot
from agent.tools.camera_calibration import Corner, fit_camera
from agent.tools.focus_calibration import FocusRow, fit_focus
from hw.camera.camera import Camera, FocusRange, Roi
from hw.camera.open import open_camera
from hw.module import open_module
from hw.twin.calibration_bench import BenchClient
from hw.twin.twin_folder import twin_dir

Place = Callable[[Vector | None, tuple[int, int]], None]  # board's centre about the pivot (m), pulses of pan and tilt

NEAREST_M, FARTHEST_M, DISTANCES = 0.22, 1.2, 16  # equal steps of 1/u, as the lens sees them
SWEEP_PX = (280, 200)  # the picture's middle that a sweep reads: nearly all of the board at the far end
FLANKS = 1.5  # half widths on either side of the peak that the grain is fitted over
EDGE_SHARE, EDGE_RIM_PX = 0.3, 3  # of the steepest slope; leaves a fifth of the picture to the grain at 1.2 m
HOMING_S = 0.2  # the lens across its whole range

COLUMNS, ROWS, SQUARE_M = 14, 9, 0.020  # inner corners of a board of 15 x 10 squares
BOARD_AT_M = (0.68, 0.85)  # the whole board within 31 degrees, with room for a gimbal that is a degree off
VIEWS_DEG = ((0.0, 0.0), (-24.0, 0.0), (24.0, 0.0), (0.0, -8.0), (0.0, 8.0), (-16.0, -6.0), (16.0, 6.0))
SAG_AT_M, SAG_TILTS_DEG = (0.40, 0.43, 0.46), (-20.0, 20.0)  # near: an error of the distance matters least
LOOKS = DISTANCES + len(BOARD_AT_M) * len(VIEWS_DEG)  # settings of the board before those that look up and down
SETTINGS = LOOKS + len(SAG_AT_M) * len(SAG_TILTS_DEG)
BLURS = (-1.5, 0.0, 1.5)  # peak half-widths by which the lens is set off, looking straight: to see the picture grow
BACKLASH_US = 25  # the approach: two degrees, more than any gear has play


def calibrate(fleet: Fleet, robot: str, camera: Camera, place: Place, progress: Progress) -> Calibration:
    """Run the whole procedure; progress counts settings of the board, from 0 to SETTINGS.

    Raises CalibrationRefused, ConfigError for a camera without focus, CameraError.
    """
    progress(0, SETTINGS)
    focus = fit_focus(focus_rows(fleet, camera, place, lambda done, _: progress(done, SETTINGS)))
    corners: list[Corner] = []
    for done, view in enumerate(views(fleet, camera, focus, place), start=DISTANCES):
        corners += view
        progress(done + 1, SETTINGS)
    seen = fit_camera(corners, fleet.body, camera.size)
    tilted = tilted_peaks(fleet, camera, seen, place, lambda done, _: progress(LOOKS + done, SETTINGS))
    centre_us = round(fleet.body.servo_centre_us)
    place(None, (centre_us, centre_us))
    return Calibration(
        robot=robot,
        made=datetime.now(UTC).strftime("%Y-%m-%d"),
        source=f"board of {COLUMNS + 1} x {ROWS + 1} squares before {fleet.robot[robot].camera}",
        focus=with_sag(focus, tilted),
        camera=seen,
    )


def setting(done: int) -> str:
    """What comes after so many settings of the board."""
    if done < DISTANCES:
        return f"distance {done + 1} of {DISTANCES}"
    if done < LOOKS:
        return f"view {done - DISTANCES + 1} of {LOOKS - DISTANCES} of the board"
    return f"view up or down {done - LOOKS + 1} of {SETTINGS - LOOKS}" if done < SETTINGS else "done"


def focus_rows(fleet: Fleet, camera: Camera, place: Place, progress: Progress) -> list[FocusRow]:
    """The sharpest lens position at each distance; a distance without a clear peak is left out."""
    limits = camera.focus_range()
    if limits is None:
        raise ConfigError("the camera's focus cannot be set; a calibration needs one that can")
    rows: list[FocusRow] = []
    centre_us = round(fleet.body.servo_centre_us)
    for done, u_m in enumerate(1.0 / np.linspace(1.0 / FARTHEST_M, 1.0 / NEAREST_M, DISTANCES), start=1):
        approach(place, (float(u_m), 0.0, 0.0), (centre_us, centre_us))
        peak = board_peak(camera, limits, fleet.camera.sweep_steps, fleet.camera.settle_s)
        if peak is not None:
            rows.append(FocusRow(float(u_m), peak.lens_position, peak.width, peak.sigma))
        progress(done, DISTANCES)
    return rows


def tilted_peaks(fleet: Fleet, camera: Camera, seen: CameraFit, place: Place, progress: Progress) -> list[TiltedPeak]:
    """Peaks of the board looking up and down at it: what the lens's own weight does. `seen`: the gimbal's zero, and how
    far the optical axis is from the picture's middle, where a sweep reads: seen at 20 degrees, the board is nearer or
    farther there by 0.03 % for each pixel. Six of them are a third of a lens's sag."""
    limits = camera.focus_range()
    peaks: list[TiltedPeak] = []
    if limits is None:
        return peaks
    body, level_us = fleet.body, servos_us(seen, fleet.body, 0.0, 0.0)
    _, y, z = ray(seen, ((seen.width_px - 1) / 2, (seen.height_px - 1) / 2))
    for done, (ahead_m, tilt_deg) in enumerate(itertools.product(SAG_AT_M, SAG_TILTS_DEG), start=1):
        us = level_us[0], servos_us(seen, body, 0.0, tilt_deg)[1]
        tilt = math.radians(gimbal_deg(seen, body, us)[1])
        approach(place, (ahead_m, 0.0, ahead_m * math.tan(tilt)), us)
        peak = board_peak(camera, limits, fleet.camera.sweep_steps, fleet.camera.settle_s)
        if peak is not None:
            u_m = ahead_m / (math.cos(tilt) + y / z * math.sin(tilt))
            peaks.append(TiltedPeak(u_m, peak.lens_position, tilt))
        progress(done, len(SAG_AT_M) * len(SAG_TILTS_DEG))
    return peaks


def board_peak(camera: Camera, limits: FocusRange, steps: int, settle_s: float) -> Peak | None:
    """Sweep once over the whole range of the lens; where the grain of the board is sharpest, if anywhere.

    Grain, not edges: a board square to the camera has all its edges at one phase of the pixel grid, and the image
    grows by percents as the lens moves, so edges gain and lose gradient during the sweep. On the twin that scatters
    peaks by 2.6 lens positions, 5 mm at half a metre; the grain alone repeats to 0.5.
    """
    width, height = camera.size
    across, down = SWEEP_PX
    middle = Roi((width - across) // 2, (height - down) // 2, across, down)
    home(camera, limits, middle)
    lens_positions, pictures = [], []
    for wanted in np.linspace(limits.lowest, limits.highest, steps):
        lens_positions.append(camera.set_focus(round(wanted)))
        pictures.append(luminance(camera.read(middle, settle_s=settle_s).image))
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


def edges(grey: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The edges between squares and a few pixels around them, in a sharp picture of the board."""
    gx, gy = cv2.spatialGradient(cv2.GaussianBlur(grey, (0, 0), 2.0))
    slope = np.hypot(gx, gy)
    steep = (slope > EDGE_SHARE * np.quantile(slope, 0.98)).astype(np.uint8)
    return cv2.dilate(steep, np.ones((2 * EDGE_RIM_PX + 1,) * 2, np.uint8)) > 0


def views(fleet: Fleet, camera: Camera, focus: FocusFit, place: Place) -> Iterator[list[Corner]]:
    """The corners of each view of the board, sharp; an empty list where the board is not seen whole."""
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
            sharp, found = lens_position(focus, math.hypot(*board_m)), []
            for blur in BLURS if pan_deg == tilt_deg == 0.0 else (0.0,):
                reached = camera.set_focus(round(sharp + blur * focus.width))
                grey = luminance(camera.read(settle_s=HOMING_S).image)
                pairs = zip(board_points(board_m), find_corners(grey), strict=False)
                found += [Corner(us, point, px, float(reached), k) for k, (point, px) in enumerate(pairs)]
            yield found


def approach(place: Place, board_m: Vector, us: tuple[int, int]) -> None:
    """Set up the board and the gimbal, each servo coming from the side of shorter pulses."""
    place(board_m, (us[0] - BACKLASH_US, us[1] - BACKLASH_US))
    place(board_m, us)


def home(camera: Camera, limits: FocusRange, roi: Roi) -> None:
    """Bring the lens to rest at its smallest position."""
    camera.set_focus(limits.lowest)
    camera.read(roi, settle_s=HOMING_S)


def find_corners(grey: NDArray[np.uint8]) -> list[tuple[float, float]]:
    """Pixels of the board's inner corners, row by row from the upper left; empty if they are not all there."""
    found, corners = cv2.findChessboardCornersSB(grey, (COLUMNS, ROWS), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return []
    grid = corners.reshape(ROWS, COLUMNS, 2)
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


# --- the bench ---
# Where a camera is calibrated: the twin's own bench, or a board that a person moves when told to.
#
# Either yields the camera and what places board and gimbal before it. A real gimbal is moved through the robot's
# control module, its motors off.

READY_S = 120.0  # the first start compiles the twin's kernels
SERVO_S = 1.5  # the servos' longest way


@contextmanager
def twin_bench(fleet: Fleet, name: str) -> Iterator[tuple[Camera, Place]]:
    """The twin's bench in a process and a folder of its own, so that a dive may go on beside it.

    Raises Failed where it does not get ready, CameraError.
    """
    with temporary_folder() as folder:
        own = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, dir=str(folder)))
        path = folder / "fleet.toml"
        path.write_text(dump(own), encoding="utf-8")
        with crew(folder / "logs") as processes, ExitStack() as stack:
            processes.start("bench", "twin", str(path), "--bench", name)
            wait_for("the bench", (folder / "ready").exists, processes, READY_S)
            camera = open_camera(fleet.robot[name].camera, folder, size(fleet))
            stack.callback(camera.close)
            yield camera, stack.enter_context(BenchClient(folder / f"{name}.bench")).place


@contextmanager
def bench_by_hand(fleet: Fleet, name: str) -> Iterator[tuple[Camera, Place]]:
    """A real camera: asks for the board on the terminal. Raises CameraError, ConfigError for a port."""
    robot = fleet.robot[name]
    with ExitStack() as stack:
        camera = open_camera(robot.camera, twin_dir(fleet), size(fleet))
        stack.callback(camera.close)
        clock = SystemClock()
        module = stack.enter_context(open_module(robot.serial, twin_dir(fleet), clock))
        asked: Vector | None = None
        done = 0

        def place(board_m: Vector | None, servos_us: tuple[int, int]) -> None:
            nonlocal asked, done
            module.send(SetPoint(depth_m=robot.depth_m, servos_us=(*servos_us, 1500, 1500)), clock.now_ns())
            if board_m is not None and board_m != asked:
                x, y, z = board_m
                where = f"{x:.3f} m ahead of the gimbal's pivot, {y:+.3f} m left, {z:+.3f} m up"
                input(f"{setting(done)} ({done + 1} of {SETTINGS} in all): put the board {where}; then press Enter ")
                done += 1
            asked = board_m
            machine.sleep(SERVO_S)

        yield camera, place


def size(fleet: Fleet) -> tuple[int, int]:
    """The width and height, pixels, that all cameras of a fleet have."""
    return fleet.camera.width_px, fleet.camera.height_px


# --- `aucamp calibrate run` ---
# `aucamp calibrate run`: sets up the bench, runs the procedure, writes the calibration file.


def run(fleet_path: Path, name: str, out: Path | None, console: Console) -> None:
    """Calibrate one robot of a fleet file; the result goes to `out`, else where the fleet file says.

    Raises ConfigError, CameraError and Failed (CalibrationRefused is one), one line each.
    """
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    file = out or fleet_path.parent / robot.calibration
    if file.exists():
        raise ConfigError(
            f"{file}: is there already, and nothing is overwritten; move it away, or give --out another name"
        )
    file.parent.mkdir(parents=True, exist_ok=True)  # what cannot be made is said before the work
    if robot.camera.startswith("twin:"):
        calibration = _on_the_twin(fleet, name, console)
    else:
        with bench_by_hand(fleet, name) as (camera, place):  # its questions say how far it is
            calibration = calibrate(fleet, name, camera, place, lambda done, total: None)
    write_whole(file, dump(calibration))
    console.print(describe(calibration))
    console.print(f"written to {file}")


def _on_the_twin(fleet: Fleet, name: str, console: Console) -> Calibration:
    with ExitStack() as stack:
        with with_spinner(console, f"calibrating {name}: starting the twin's bench"):
            camera, place = stack.enter_context(twin_bench(fleet, name))

        def work(show: Show) -> Calibration:
            def told(done: int, total: int) -> None:
                show(done, total, f"calibrating {name}: {setting(done)}")

            return calibrate(fleet, name, camera, place, told)

        return with_bar(console, f"calibrating {name}", work)


def describe(calibration: Calibration) -> str:
    """What the fit is worth, in two lines."""
    focus, camera = calibration.focus, calibration.camera
    nearer = "larger" if focus.b_m > 0.0 else "smaller"  # u = u_inf + b / (rho - rho0): 0 for infinity is custom only
    return (
        f"focus: R² {focus.r2:.4f}, rms {1e3 * focus.rmse_m:.1f} mm, held out {1e3 * focus.held_out_rmse_m:.1f} mm, "
        f"one peak ± {focus.noise:.2f} lens positions, "
        f"{nearer} ones are nearer\n"
        f"camera: f {camera.f_px:.1f} px, pan zero {camera.pan_zero_deg:+.2f}° gain {camera.pan_gain:.4f}, "
        f"tilt zero {camera.tilt_zero_deg:+.2f}° gain {camera.tilt_gain:.4f}, residual {camera.noise_px:.2f} px"
    )
