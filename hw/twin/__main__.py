"""The twin as a process: `python -m hw.twin FLEET` is the dive, `--bench ROBOT` one robot's calibration bench."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import msgspec

from agent.clock.clock import RunClock
from agent.clock.keeper import how_it_went, start_clock
from agent.core.config import ConfigError, Fleet
from agent.robot.fleet_reader import load_fleet, load_robot, two_worlds
from hw.camera.camera import CameraError
from hw.camera.frame_socket import FrameServer
from hw.twin.board import Board, interpreter
from hw.twin.calibration_bench import Bench, serve
from hw.twin.camera_device import FRAME_NS, DiveCamera, FrameClock
from hw.twin.creatures import Lookout
from hw.twin.dive import Dive, run_by_clock
from hw.twin.optics.lens import Lens, Vcm, draw_lens, with_field
from hw.twin.optics.painter import Painter
from hw.twin.physics.body import euler_rad
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Scene, Solid, generator, in_daylight, lamp_place, scene_of, target_solids
from hw.twin.truth import PaintedTag, Watch, tags_as_json, true_tags
from hw.twin.twin_folder import clock_path, locked, twin_dir

SWITCH_S = 0.0005  # Python's own 5 ms, for which a camera's thread keeps the water waiting, are half a tick
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run(fleet_path: Path, *, bench: str | None = None, speed: float = 1.0) -> int:
    """Serve every robot of the fleet until SIGINT or SIGTERM; main thread only.

    `speed`: of the dive's clock against the wall's, at most; inf: as fast as the machine allows.
    Returns 0 after a signal and 2, with one line on stderr, for anything that the user can put right.
    """
    stop = threading.Event()

    def interrupt(number: int, frame: object) -> None:
        """While starting, which may compile for long; `stop` is for callbacks, where Python drops an exception."""
        stop.set()
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        fleet = load_fleet(fleet_path)
        if (why := two_worlds(fleet)) is not None:
            raise ConfigError(f"{fleet_path}: {why}")
        if bench is not None:
            load_robot(fleet, bench, fleet_path)
        with ExitStack() as stack:
            folder = stack.enter_context(locked(twin_dir(fleet)))
            try:
                if bench is None:
                    _dive(fleet, fleet_path, folder, stop, stack, speed)
                else:
                    _calibrate(fleet, bench, folder, stop, stack)
            finally:
                for number in SIGNALS:  # nothing interrupts the clearing up
                    signal.signal(number, signal.SIG_IGN)
    except KeyboardInterrupt:
        return 0
    except (ConfigError, CameraError) as error:
        sys.stderr.write(f"aucamp: {error}\n")
        return 2
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _dive(fleet: Fleet, fleet_path: Path, folder: Path, stop: threading.Event, stack: ExitStack, speed: float) -> None:
    robots = list(fleet.robot)
    if not any(robot.serial.startswith("twin:") for robot in fleet.robot.values()):
        raise ConfigError(f"{fleet_path}: no robot lives in the twin; set serial = 'twin:NAME', camera = 'twin:NAME'")
    scene = scene_of(fleet)
    solids = target_solids(fleet, scene, fleet_path)
    tags = true_tags(fleet.landmarks, fleet.twin.seed)
    optics = [_optics(fleet, scene, name, tags) for name in robots]
    Dive(fleet, robots, 0, scene=scene).move()  # compiles the physics before the clock starts
    clock = RunClock(clock_path(fleet))
    dive = Dive(fleet, robots, clock.now_ns(), scene=scene)
    runs = interpreter()
    sys.stdout.write(f"twin: {', '.join(robots)} in scene {scene.name}, firmware under {runs}, files in {folder}\n")
    sys.stdout.flush()  # into a file too it stands before what stderr says later
    dive.boards = [
        Board(name, folder, tare_pa, interpreter=runs) for name, tare_pa in zip(robots, dive.tare_pa, strict=True)
    ]
    keeper = start_clock(clock_path(fleet), robots, dive.now_ns, speed, TICK_NS)
    if scene.creature:
        dive.lookout = Lookout([creature.name for creature in scene.creature], folder)
        stack.callback(dive.lookout.close)
    servers: list[FrameServer] = []
    for i, (name, (lens, vcm, painter)) in enumerate(zip(robots, optics, strict=True)):
        shutter = FrameClock(dive.now_ns + int(generator(fleet.twin.seed, name, "shutter").integers(FRAME_NS)))
        rendering = partial(keeper.frame, name)
        at_m = fleet.body.camera_m
        seen = (dive.history, lens, vcm, painter, at_m, dive.stage)
        witness = partial(dive.lookout.frame, name) if dive.lookout is not None else None
        swims = (scene.creature, fleet.twin.seed, witness, lamp_place(fleet, scene))
        late_ns = round(fleet.twin.stamp_late_ms * 1e6)
        camera = DiveCamera(i, *seen, shutter, keeper.now_ns, rendering, scene.motion_blur, *swims, late_ns=late_ns)
        servers.append(FrameServer(folder / f"{name}.camera", camera))
    devices: list[Board | FrameServer] = [*dive.boards, *servers]
    stack.callback(_close_together, devices)
    stack.callback(dive.history.close)  # before that: cameras that wait for a frame give up
    stack.callback(keeper.close)
    for device in devices:
        device.start()
    _write_truth(folder / "truth.json", fleet, solids, dive)
    if not scene.moored:
        dive.watch = Watch(robots, fleet.tank.size_m, folder)
        stack.callback(dive.watch.close)
    _be_ready(folder, stop)
    sys.setswitchinterval(SWITCH_S)
    run_by_clock(dive, keeper, stop)
    sys.stderr.write(f"twin: {how_it_went(keeper.story())}\n")


def _calibrate(fleet: Fleet, robot: str, folder: Path, stop: threading.Event, stack: ExitStack) -> None:
    empty = in_daylight(msgspec.structs.replace(scene_of(fleet), solid=(), creature=()))  # nothing but the chessboard
    bench = Bench(fleet, robot, *_optics(fleet, empty, robot), RunClock(clock_path(fleet)).now_ns())
    bench.place(None, (fleet.body.servo_centre_us, fleet.body.servo_centre_us))
    server = FrameServer(folder / f"{robot}.camera", bench)
    stack.callback(server.close)
    server.start()
    serve(bench, folder / f"{robot}.bench", stop, lambda: _be_ready(folder, stop))


def _optics(fleet: Fleet, scene: Scene, robot: str, tags: Sequence[PaintedTag] = ()) -> tuple[Lens, Vcm, Painter]:
    """The camera that this robot has in this world, the same on the bench and in the dive."""
    twin, seed = fleet.twin, fleet.twin.seed
    lens = draw_lens(scene.camera, generator(seed, robot, "lens"))
    lens = with_field(lens, twin.sensor_tilt_deg, twin.field_um, generator(seed, robot, "sensor"))
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, robot, tags)
    painter.prepare()
    return lens, Vcm(lens, generator(seed, robot, "vcm"), 1e-3 * fleet.twin.lens_slow_ms), painter


def _close_together(devices: list[Board | FrameServer]) -> None:
    """Each may take its time to end; all of them take no longer than the slowest."""
    threads = [threading.Thread(target=device.close) for device in devices]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _write_truth(path: Path, fleet: Fleet, solids: dict[str, Solid], dive: Dive) -> None:
    """Where everything is at the start: for summaries and reports, never for an agent."""
    targets = {
        "target_m": {name: solid.position_m for name, solid in solids.items()},
        "target_radii_m": {name: solid.radii_m for name, solid in solids.items()},
    }
    robots = {
        name: {"position_m": state["position_m"].tolist(), "rpy_rad": euler_rad(state["quaternion"])}
        for name, state in zip(dive.robots, dive.states, strict=True)
    }
    creatures = {
        who.name: {"position_m": at[:3], "length_m": who.length_m}
        for who, at in zip(dive.school.creatures, dive.school.attitudes, strict=True)
    }
    swim = {"creature": creatures} if creatures else {}
    tags = {"tag": tags_as_json(true_tags(fleet.landmarks, fleet.twin.seed))} if fleet.landmarks else {}
    path.write_text(json.dumps({"seed": fleet.twin.seed, **targets, "robot": robots, **swim, **tags}, indent=1) + "\n")


def _be_ready(folder: Path, stop: threading.Event) -> None:
    """Say that all is served; from now on a signal ends the loop between two ticks instead of interrupting a call."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    (folder / "ready").touch()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hw.twin", description=__doc__)
    parser.add_argument("fleet", type=Path, metavar="FLEET", help="fleet.toml")
    parser.add_argument("--bench", metavar="ROBOT", help="serve this robot's camera in front of a calibration board")
    parser.add_argument("--speed", type=float, default=1.0, help="of the dive's clock, at most; inf: no limit")
    arguments = parser.parse_args()
    return run(arguments.fleet, bench=arguments.bench, speed=arguments.speed)


if __name__ == "__main__":
    sys.exit(main())
