"""`aucamp calibrate run`: sets up the bench, runs the procedure (bench_calibration.py), writes the calibration file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
from rich.console import Console

from agent.clock import machine
from agent.clock.clock import SystemClock
from agent.core.config import ConfigError, Fleet, dump, write_whole
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit
from agent.core.ranging.focus import in_direction
from agent.core.step_io import SetPoint
from agent.perception.vision import movable
from agent.process.command import Failed, Show, temporary_folder, with_bar, with_spinner
from agent.process.launch import crew, wait_for
from agent.robot.fleet_reader import load_fleet, load_robot
from agent.tools.bench_calibration import DISTANCES, SETTINGS, Place, Wait, calibrate, setting
from hw.camera import open_camera
from hw.camera.camera import Camera
from hw.module import Module
from hw.stm32 import open_module
from hw.twin.calibration_bench import BenchClient
from hw.twin.twin_folder import twin_dir

# --- the bench ---
# Where a camera is calibrated: the twin's own bench, or a board that a person moves when told to.
#
# Either yields the camera and what places board and gimbal before it. A real gimbal is moved through the robot's
# control module, its motors off.

READY_S = 120.0  # the first start compiles the twin's kernels
SERVO_S = 1.5  # the servos' longest way
ANSWERS_S, LOOK_S = 5.0, 0.1  # a board boots in two


@contextmanager
def twin_bench(fleet: Fleet, name: str) -> Iterator[tuple[Camera, Place, Wait]]:
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
            bench = stack.enter_context(BenchClient(folder / f"{name}.bench"))
            yield camera, bench.place, bench.wait


@contextmanager
def bench_by_hand(fleet: Fleet, name: str) -> Iterator[tuple[Camera, Place, Wait]]:
    """A real camera: asks for the board on the terminal. Raises CameraError, ConfigError for a port, Failed where no
    control module answers."""
    robot = fleet.robot[name]
    with ExitStack() as stack:
        camera = open_camera(robot.camera, twin_dir(fleet), size(fleet), mains_hz=fleet.camera.mains_hz)
        stack.callback(camera.close)
        clock = SystemClock()
        module = stack.enter_context(open_module(robot.serial, twin_dir(fleet), clock))
        wait_for_module(module, robot.serial)
        asked: Vector | None = None
        done = 0 if movable(camera) else DISTANCES

        def place(board_m: Vector | None, servos_us: tuple[int, int]) -> None:
            nonlocal asked, done
            turn(servos_us)
            if board_m is not None and board_m != asked:
                x, y, z = board_m
                where = f"{x:.3f} m ahead of the gimbal's pivot, {y:+.3f} m left, {z:+.3f} m up"
                input(f"{setting(done)} ({done + 1} of {SETTINGS} in all): put the board {where}; then press Enter ")
                done += 1
            asked = board_m

        def turn(servos_us: tuple[int, int]) -> None:
            """The gimbal. Where the module does not say that it does, a person is asked: nothing else shows it."""
            while True:
                module.drain()
                for _ in range(round(SERVO_S / LOOK_S)):
                    module.send(SetPoint(depth_m=robot.depth_m, servos_us=(*servos_us, 1500, 1500)), clock.now_ns())
                    machine.sleep(LOOK_S)
                telemetry, lines = module.drain()
                if telemetry and telemetry[-1].servos_us[:2] == servos_us:
                    return
                why = f" ({lines[-1].text})" if lines else ""
                input(f"the control module does not turn the gimbal{why}: put that right, then press Enter ")

        def wait(seconds: float) -> int:
            machine.sleep(seconds)
            return machine.monotonic_ns()

        yield camera, place, wait


def wait_for_module(module: Module, port: str) -> None:
    """Raises Failed where none answers."""
    said = "it says nothing"
    for _ in range(round(ANSWERS_S / LOOK_S)):
        telemetry, lines = module.drain()
        if telemetry:
            return
        said = lines[-1].text if lines else said
        machine.sleep(LOOK_S)
    raise Failed(f"no control module answers at {port} ({said}), and the gimbal would not turn; correct serial")


def size(fleet: Fleet) -> tuple[int, int]:
    """The width and height, pixels, that all cameras of a fleet have."""
    return fleet.camera.width_px, fleet.camera.height_px


# --- the command ---


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
        with bench_by_hand(fleet, name) as (camera, place, wait):  # its questions say how far it is
            calibration = calibrate(fleet, name, camera, place, lambda done, total: None, wait)
    write_whole(file, dump(calibration))
    console.print(describe(calibration))
    console.print(f"written to {file}")


def _on_the_twin(fleet: Fleet, name: str, console: Console) -> Calibration:
    with ExitStack() as stack:
        with with_spinner(console, f"calibrating {name}: starting the twin's bench"):
            camera, place, wait = stack.enter_context(twin_bench(fleet, name))

        def work(show: Show) -> Calibration:
            def told(done: int, total: int) -> None:
                show(done, total, f"calibrating {name}: {setting(done)}")

            return calibrate(fleet, name, camera, place, told, wait)

        return with_bar(console, f"calibrating {name}", work)


def describe(calibration: Calibration) -> str:
    """What the fit is worth, in three lines."""
    focus, camera = calibration.focus, calibration.camera
    seen = (
        f"camera: f {camera.f_px:.1f} px, pan zero {camera.pan_zero_deg:+.2f}° gain {camera.pan_gain:.4f}, "
        f"tilt zero {camera.tilt_zero_deg:+.2f}° gain {camera.tilt_gain:.4f}, residual {camera.noise_px:.2f} px"
    )
    if focus is None:
        return f"focus: fixed, ranges will be by the size of targets\n{seen}"
    timing = calibration.timing
    seen += (
        f"\ntiming: stamps {1e3 * timing.stamp_late_s:.0f} ± {1e3 * timing.stamp_late_sigma_s:.0f} ms late, "
        f"lens lags {1e3 * timing.lens_lag_s:.0f} ± {1e3 * timing.lens_lag_sigma_s:.0f} ms"
    )
    seen += f"\nfield: {_curving(focus, camera)}"
    nearer = "larger" if focus.b_m > 0.0 else "smaller"  # u = u_inf + b / (rho - rho0): 0 for infinity is custom only
    return (
        f"focus: R² {focus.r2:.4f}, rms {1e3 * focus.rmse_m:.1f} mm, held out {1e3 * focus.held_out_rmse_m:.1f} mm, "
        f"one peak ± {focus.noise:.2f} lens positions, "
        f"{nearer} ones are nearer\nmeasured: {calibration.source}\n{seen}"
    )


def _curving(focus: FocusFit, camera: CameraFit) -> str:
    """How far peaks are moved at the picture's corners."""
    if focus.field is None:
        return "not measured: too little of the picture showed the board; ranges aside are taken for those of the axis"
    sides = (0.0, camera.width_px - 1.0), (0.0, camera.height_px - 1.0)
    moved = [in_direction(focus, camera, corner, camera.lens) for corner in itertools.product(*sides)]
    shifts = [each.rho0 - focus.rho0 for each in moved]
    sigma = max(math.sqrt(max(each.covariance[5] - focus.covariance[5], 0.0)) for each in moved)
    return (
        f"peaks move by {min(shifts):+.0f} to {max(shifts):+.0f} lens positions at the picture's corners, ± {sigma:.1f}"
    )
