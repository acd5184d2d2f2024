"""Where a camera is calibrated: the twin's own bench, or a board that a person moves when told to.

Either yields the camera and what places board and gimbal before it. A real gimbal is moved through the robot's control
module, its motors off.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import msgspec

from agent.clock import machine
from agent.clock.clock import SystemClock
from agent.core.config import Fleet, dump
from agent.core.messages import Vector
from agent.core.step_io import SetPoint
from agent.process.command import temporary_folder
from agent.process.launch import crew, wait_for
from agent.tools.procedure import SETTINGS, Place, setting
from hw.camera.camera import Camera
from hw.camera.open import open_camera
from hw.stm32.driver import Stm32
from hw.stm32.port import open_port_path
from hw.twin.bench_socket import BenchClient
from hw.twin.devices.twin_folder import twin_dir

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
        module = stack.enter_context(Stm32(open_port_path(robot.serial, twin_dir(fleet)), clock))
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
