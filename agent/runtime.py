"""The only loop: drain what arrived, step, log both, act. Everything with a thread or a clock is handed in.

On the way out the motors go off first, then the last state is shown, then links close, then the recording ends.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event
from typing import Protocol

import msgspec

from agent.aloud import Aloud, Network
from agent.config import ConfigError, Fleet, load_fleet, load_robot
from agent.core import Agent
from agent.messages import (
    SCHEMA,
    Inputs,
    Level,
    LogLine,
    Outputs,
    SetPoint,
    Sighting,
    SweepPlan,
    Telemetry,
    encode,
)
from agent.perception.enhance import default as default_enhancement
from agent.perception.preview import Preview
from agent.perception.seekers import seekers
from agent.perception.vision import Vision
from agent.ranging.calibration import Calibration, load_calibration
from agent.sweep_depth import sweep_depth
from agent.transport import Transport
from hw.camera import Frame, known_scheme, open_camera
from hw.firmware import wire
from hw.firmware.failsafe import SURFACE
from hw.stm32 import Stm32, open_port_path
from hw.twin.place import twin_dir
from replay.black_box_writer import BlackBoxWriter, black_box_log
from replay.environment import environment
from replay.leftovers import leftovers, mending

GIVEN_UP = "to start them, put right what stopped them, end this agent and start it again with --arm"
STEP_S = 0.05  # 20 Hz: set-points reach the control module often enough to be its heartbeat


class Eyes(Protocol):
    def drain(self) -> Sequence[Sighting]: ...
    def plan(self, plan: SweepPlan) -> None: ...


class Board(Protocol):
    def drain(self) -> tuple[Sequence[Telemetry], Sequence[tuple[Level, str]]]: ...
    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


BlackBox = Callable[[int, int, bytes, bytes | None], None]  # step, now_ns, inputs, outputs; None: the step raised


def run(fleet_path: Path, name: str, out: Path | None, arm: bool, lossless: bool = False, views: bool = True) -> None:
    """One agent process, from its fleet file until SIGTERM or Ctrl-C. Raises ConfigError or CameraError before
    anything moves.

    With `arm` the motors start once the control module agrees; without it everything else works and they stay off.
    `lossless` records frames bit by bit, `views` adds channels for viewers to the recording.
    """
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    known_scheme(robot.camera)
    calibration = own_calibration(fleet, name, fleet_path)
    sought = seekers(fleet, calibration.camera)
    offset_ns = time.time_ns() - time.monotonic_ns()
    sockets = twin_dir(fleet)

    def clock() -> int:
        """Unix time that never steps back: sampled once, then monotonic."""
        return offset_ns + time.monotonic_ns()

    incarnation = clock()
    agent = Agent(fleet, name, calibration, incarnation)
    with ExitStack() as stack:
        stop = stack.enter_context(until_signal())
        stack.enter_context(mending(leftovers((out or Path()) / f"{name}.mcap")))
        with ExitStack() as links:
            link = links.enter_context(Transport(fleet, name, clock))  # first: a start that fails leaves no recording
            log = stack.enter_context(
                black_box_log(
                    out or Path(), fleet, name, calibration, run_facts(fleet, name, incarnation), views, sweep_depth
                )
            )
            stack.push(links.pop_all())  # and closed before the recording
        box = BlackBoxWriter(log, clock, lossless)
        network = stack.enter_context(Aloud(link, tell))
        stack.callback(goodbye, agent, network, clock)  # after the motors are off, before the link closes
        size = (fleet.camera.width_px, fleet.camera.height_px)
        way = default_enhancement() if fleet.camera.enhance else None
        if way is not None and way.why:
            network.show(LogLine(robot=name, sent_ns=clock(), level="warning", text=f"enhancement: {way.why}"[:400]))

        def on_frame(frame: Frame, sightings: Sequence[Sighting]) -> None:
            box.frame(frame.image, frame.roi, *sightings)
            if not stop.is_set() and (image := preview.of(frame, sightings[0], clock())) is not None:
                network.show(image)

        eyes = Vision(
            lambda: open_camera(robot.camera, sockets, size),
            fleet,
            calibration.camera,
            sought,
            epoch_offset_ns=offset_ns,
            on_frame=on_frame,
            way=way,
        )
        preview = Preview(name, size, fleet.link.preview_hz, eyes.clear if fleet.camera.enhance else None)
        if way is not None:
            stack.callback(lambda: network.show(shown_raw(name, eyes, clock())))
        eyes.start()
        stack.callback(eyes.close)
        board = stack.enter_context(Stm32(open_port_path(robot.serial, sockets), clock, tap=box.serial))
        if arm:
            board.arm()
        resume = board.arm if arm else lambda: None
        motors = "motors start when the control module agrees" if arm else "motors stay off (--arm starts them)"
        tell(f"{name}: {motors}; recording {log.path}; Ctrl-C ends it\n")

        told: dict[str, str | None] = {}

        def black_box(step: int, now_ns: int, inputs: bytes, outputs: bytes | None) -> None:
            given_up = GIVEN_UP if arm and not board.wants_armed else None
            for what, fault in (("not recording", log.failed), ("no camera", eyes.fault), ("motors off", given_up)):
                if fault != told.get(what):
                    told[what] = fault
                    text = f"{what}: {fault}"[:400] if fault else f"over: {what}"
                    network.show(LogLine(robot=name, sent_ns=now_ns, level="warning" if fault else "info", text=text))
            box.step(step, now_ns, inputs, outputs)

        loop(agent, name, eyes, board, network, black_box, clock, stop, resume)
    tell(f"{name}: stopped; {f'not recorded to the end: {log.failed}' if log.failed else f'recorded {log.path}'}\n")


def tell(text: str) -> None:
    """To the person who started it, at once."""
    sys.stderr.write(text)
    sys.stderr.flush()


def own_calibration(fleet: Fleet, name: str, fleet_path: Path) -> Calibration:
    """The calibration of a robot's own camera. Raises ConfigError if there is none, or if it is of another camera."""
    path = fleet_path.parent / fleet.robot[name].calibration
    if not path.exists():
        raise ConfigError(f"{path}: no such file; make it with: aucamp calibrate run {fleet_path} --robot {name}")
    calibration = load_calibration(path)
    if calibration.robot != name:
        raise ConfigError(f"{path}: key 'robot': made for '{calibration.robot}', not '{name}'; take that robot's own")
    made = calibration.camera.width_px, calibration.camera.height_px
    asked = fleet.camera.width_px, fleet.camera.height_px
    if made != asked:
        raise ConfigError(
            f"{path}: made for pictures of {made[0]}x{made[1]}, [camera] of {fleet_path} has {asked[0]}x{asked[1]}; "
            f"calibrate again, or correct width_px and height_px"
        )
    return calibration


def loop(
    agent: Agent,
    name: str,
    eyes: Eyes,
    board: Board,
    network: Network,
    black_box: BlackBox,
    clock: Callable[[], int],
    stop: Event,
    resume: Callable[[], None] = lambda: None,
) -> None:
    """Step at 20 Hz until `stop`. `resume` is called when a robot rises for no other reason than our silence."""
    step, due_s = 0, time.monotonic()
    while not stop.is_set():
        telemetry, lines = board.drain()
        if telemetry and surfacing_for_silence(telemetry[-1]):
            resume()
        heard, refused = network.drain()
        inputs = Inputs(telemetry=tuple(telemetry), sightings=tuple(eyes.drain()), heard=heard, refused=refused)
        now_ns = clock()
        try:
            outputs = agent.step(inputs, now_ns)
        except Exception:
            black_box(step, now_ns, encode(inputs), None)  # inputs that break a step are what a black box is for
            raise
        black_box(step, now_ns, encode(inputs), encode(outputs))
        act(outputs, eyes, board, network, now_ns)
        for level, text in lines:
            network.show(LogLine(robot=name, sent_ns=now_ns, level=level, text=text[:400]))
        step += 1
        due_s = max(due_s + STEP_S, time.monotonic() - STEP_S)  # after a stall: no burst of late steps
        stop.wait(max(0.0, due_s - time.monotonic()))


def surfacing_for_silence(telemetry: Telemetry) -> bool:
    """Whether the module, still armed, rises only because the host was silent for 3 s. The host is back now, and who
    started it with --arm wants the dive to go on; a leak, a low battery or a bad sensor is for a person to judge."""
    own = wire.FLAG_LEAK | wire.FLAG_BATTERY | wire.FLAG_DEGRADED
    return telemetry.armed and telemetry.ladder == SURFACE and not telemetry.flags & own


def shown_raw(name: str, eyes: Vision, now_ns: int) -> LogLine:
    """How many frames could not be enhanced in time."""
    text = f"enhancement: {eyes.clear.raw} of {eyes.clear.frames} frames to be enhanced had no colours in time"
    return LogLine(robot=name, sent_ns=now_ns, level="info", text=text)


def goodbye(agent: Agent, network: Network, clock: Callable[[], int]) -> None:
    """The last state, of each target, tells a planned end from a crash."""
    for pursuit in agent.pursuits.values():
        if (state := pursuit.last_state) is not None:
            network.show(msgspec.structs.replace(state, mode="stopped", seq=state.seq + 1, sent_ns=clock()))


def act(outputs: Outputs, eyes: Eyes, board: Board, network: Network, now_ns: int) -> None:
    """Hand the outputs of a step to the devices and the network; nothing here waits."""
    board.send(outputs.set_point, now_ns)
    if outputs.sweep is not None:
        eyes.plan(outputs.sweep)
    for estimate in outputs.says:
        network.say(estimate)
    if outputs.state is not None:
        network.show(outputs.state)
    for line in outputs.log:
        network.show(line)


@contextmanager
def until_signal() -> Iterator[Event]:
    """An event that Ctrl-C, SIGTERM and a terminal that is closed set; a second one interrupts whatever still runs."""
    stop = Event()

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    ours = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup means it
        ours.append(signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in ours}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_facts(fleet: Fleet, name: str, incarnation: int) -> dict[str, str]:
    """What a reader of the recording needs to know about the run."""
    return {
        "kind": "black box",
        "fleet": fleet.fleet,
        "robot": name,
        "protocol": fleet.estimation.protocol,
        "seed": str(fleet.twin.seed),
        "schema": str(SCHEMA),
        "incarnation": str(incarnation),  # Unix time of the start, ns
        **environment(),
    }
