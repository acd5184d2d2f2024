"""`aucamp calibrate run`: sets up the bench, runs the procedure, writes the calibration file.

For a `twin:` camera the bench is the twin's own, started for the purpose. For any other camera a person moves the
board when told to, and the gimbal is moved through the robot's control module, its motors off.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
from rich.console import Console

from agent.config import ConfigError, Fleet, dump, load_fleet, load_robot
from agent.experiments.bench import Place, calibrate
from agent.launch import crew, temporary_folder, wait_for, with_bar
from agent.messages import SetPoint, Vector
from agent.ranging.calibration import Calibration
from hw.camera import Camera, open_camera
from hw.stm32 import Stm32, open_port_path
from hw.twin.bench import BenchClient
from hw.twin.place import twin_dir

READY_S = 120.0  # the first start compiles the twin's kernels


def run(fleet_path: Path, name: str, out: Path | None, console: Console) -> None:
    """Calibrate one robot of a fleet file. Raises ConfigError, CameraError and Failed, one line each."""
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    file = out or fleet_path.parent / robot.calibration
    if file.exists():
        raise ConfigError(f"{file}: exists already; move it away or give another --out")
    bench = twin_bench if robot.camera.startswith("twin:") else bench_by_hand
    with bench(fleet, name) as (camera, place):
        calibration = with_bar(console, f"calibrating {name}", lambda show: calibrate(fleet, name, camera, place, show))
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(dump(calibration), encoding="utf-8")
    console.print(describe(calibration))
    console.print(f"written to {file}")


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


@contextmanager
def twin_bench(fleet: Fleet, name: str) -> Iterator[tuple[Camera, Place]]:
    """The twin's bench in a process and a folder of its own, so that a dive may go on beside it."""
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
    """A real camera: asks for the board on the terminal."""
    robot = fleet.robot[name]
    with ExitStack() as stack:
        camera = open_camera(robot.camera, twin_dir(fleet), size(fleet))
        stack.callback(camera.close)
        board = stack.enter_context(Stm32(open_port_path(robot.serial, twin_dir(fleet)), time.monotonic_ns))
        asked: list[Vector | None] = [None]

        def place(board_m: Vector | None, servos_us: tuple[int, int]) -> None:
            board.send(SetPoint(depth_m=robot.depth_m, servos_us=(*servos_us, 1500, 1500)), time.monotonic_ns())
            if board_m is not None and board_m != asked[0]:
                x, y, z = board_m
                input(f"board {x:.3f} m ahead of the gimbal's pivot, {y:+.3f} m left, {z:+.3f} m up; then press Enter ")
            asked[0] = board_m
            time.sleep(1.5)  # the servos' longest way

        yield camera, place


def size(fleet: Fleet) -> tuple[int, int]:
    return fleet.camera.width_px, fleet.camera.height_px
