"""One agent process: a robot's devices, links and recording, opened around the one loop, and what the console says of
it.

On the way out the motors go off first, then the last state is shown, then links close, then the recording ends.
"""

from __future__ import annotations

import contextlib
import queue
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from shlex import quote
from threading import Condition, Event, Thread
from types import TracebackType
from typing import NamedTuple, Protocol, Self, TypeVar

import msgspec
from msgspec import UNSET

from agent.clock.clock import LOOP, SERIAL, Clock, Part, part_name
from agent.core.codec import encode
from agent.core.config import ConfigError, Fleet, Robot
from agent.core.messages import MAX_TEXT, SCHEMA, Answer, Estimate, Image, Level, LogLine, Mode, State
from agent.core.ranging.camera_model import Calibration, load_calibration
from agent.core.robot_view import robot_view
from agent.core.status import UNRECORDED
from agent.core.step_io import (
    BlockPeaks,
    DroppedPayloads,
    Flow,
    Heard,
    Inputs,
    Ordered,
    Outputs,
    Said,
    SeenTags,
    SetPoint,
    Sighting,
    SweepPlan,
    TargetBox,
    Telemetry,
)
from agent.core.step_io import Motors as MotorOrder
from agent.perception.depth_sweep import sweep_depth
from agent.perception.detection.detectors import BoxDetector, Detector, colours_too_alike, load_detectors
from agent.perception.enhancement.enhance import OnDemandEnhancer, default
from agent.perception.flow import LandmarkWatch
from agent.perception.tracking.appearance import Box
from agent.perception.vision import Preview, Vision, movable
from agent.process.certificates import credentials
from agent.process.keys import RobotKeys, Sign, robot_keys, unsigned
from agent.process.transport import Transport, fleet_clock
from agent.robot.fleet_reader import load_fleet, load_robot, with_behaviour
from agent.robot.step import Agent
from hw.camera import known_scheme, open_camera
from hw.camera.camera import Camera, CameraError, Frame
from hw.module import Motors
from hw.stm32 import open_module
from hw.twin.twin_folder import twin_dir
from replay.files.info import RateNotes
from replay.files.mcap_file import environment
from replay.files.recover import recovering, torn_files
from replay.recorder import BlackBoxWriter, black_box_log

# --- the loop ---
# The only loop: drain what arrived, step, log both, act. Everything with a thread or a clock is handed in.

STEP_NS = 50_000_000  # 20 Hz: set-points reach the control module often enough to be its heartbeat
SLACK_S = 0.025  # how late a step may come before a dive's clock waits for it
# A frame that shows a target is not kept waiting. Frames of 10 Hz take every second step to themselves: the one after
# next waits so much longer for them, or there would be three steps in each tenth of a second.
LATER_NS = 4_000_000

T = TypeVar("T")
Around = tuple[tuple[SeenTags, ...], tuple[Flow, ...]]  # what frames showed of what stays where it is
Record = Callable[[int, int, bytes, bytes | None], None]  # step, now_ns, inputs, outputs; None: the step raised


class Eyes(Protocol):
    """Vision, as the loop sees it; nothing waits."""

    def drain(self) -> Sequence[Sighting]: ...
    def plan(self, plan: SweepPlan) -> None: ...
    def rest(self, lens_position: int | None) -> None: ...
    def views(self) -> Sequence[BlockPeaks]: ...


class ControlModule(Protocol):
    """The board at the end of the tether, as the loop sees it; nothing waits."""

    def drain(self) -> tuple[Sequence[Telemetry], Sequence[tuple[Level, str]]]: ...
    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


class MotorSwitch(Protocol):
    """Whether motors shall turn, and seeing to it; nothing waits."""

    def feel(self, told: Sequence[Telemetry], now_ns: int) -> None: ...
    def obey(self, ordered: MotorOrder, now_ns: int) -> None: ...


class Runtime:
    """One robot's agent between its devices, its network and its recording."""

    def __init__(
        self,
        name: str,
        agent: Agent,
        eyes: Eyes,
        module: ControlModule,
        network: Network,
        record: Record,
        clock: Clock,
        *,
        faults: Callable[[], tuple[str, ...]] = tuple,
        motors: MotorSwitch | None = None,
        sign: Sign = unsigned,
        keys: Callable[[int], dict[str, bytes] | None] = lambda now_ns: None,
        landmarks: Callable[[], Around] = lambda: ((), ()),
        draw: Callable[[TargetBox], str | None] = lambda box: "nobody looks",
        preview_hz: Callable[[float], None] = lambda hz: None,
        keep: Callable[[LogLine], None] = lambda line: None,
    ) -> None:
        """`faults`: what is wrong now with what the agent does not see, each as "kind: what"; it goes into the step,
        and from there into State and the log. `motors`: who switches them as is ordered; None: nobody. `sign`: what it
        says as it shall leave; the recording has it as the kernel gave it. `keys`: the robots' public keys at the first
        call and when they have changed, else None. `landmarks`: what frames showed of tags, and how points of key
        frames moved, since the last call. `draw`: a box around a target, as somebody drew it; returns why not.
        `preview_hz`: how often pictures are shown from now on. `keep`: a line that no step says, for the recording.
        """
        self._name, self._agent, self._eyes, self._module = name, agent, eyes, module
        self._network, self._record, self._clock = network, record, clock
        self._faults, self._motors, self._sign, self._keys = faults, motors, sign, keys
        self._landmarks, self._draw, self._preview_hz, self._keep = landmarks, draw, preview_hz, keep
        self._broken: dict[str, str] = {}  # parts that raised when they were last asked
        self._changed = Condition()
        self._waits: Part | None = None  # the loop, while it does; guarded by _changed, as is the next
        self._shown = False  # a frame came that is not to be kept waiting

    def run(self, stop: Event) -> None:
        """Step at 20 Hz of the clock, and when a frame shows a target, until `stop` is set."""
        part = Part(self._clock, part_name(self._name, LOOP), SLACK_S)
        number, due_ns, by_frame = 0, self._clock.now_ns(), False
        try:
            while not stop.is_set():
                self.step(number)
                number += 1
                due_ns = max(due_ns + STEP_NS, self._clock.now_ns() - STEP_NS)  # after a stall: no burst of late steps
                by_frame = self._wait(part, stop, due_ns if by_frame else due_ns + LATER_NS)
                if by_frame:
                    due_ns = self._clock.now_ns()
        finally:
            part.leave()

    def _wait(self, part: Part, stop: Event, until_ns: int) -> bool:
        """Until then, or until a frame shows a target: whether one did."""
        with self._changed:
            self._waits = part
            while not (self._shown or stop.is_set()) and part.wait_changed(self._changed, until_ns):
                pass
            self._waits, shown, self._shown = None, self._shown, False
        return shown

    def show(self, sightings: Sequence[Sighting]) -> None:
        """Of a frame that is known; on vision's thread. One of a sweep can wait: only its last one matters."""
        if not any(sighting.found and sighting.index < 0 for sighting in sightings):
            return
        with self._changed:
            self._shown = True
            if self._waits is not None:
                self._waits.resume()
            self._changed.notify()

    def step(self, number: int) -> None:
        """Once around the loop."""
        telemetry, lines = self._part("control module", self._module.drain) or ((), ())
        if (motors := self._motors) is not None:
            self._part("motors", lambda: motors.feel(telemetry, self._clock.now_ns()))
        heard, refused = self._part("links", self._network.drain) or ((), ())
        sightings = tuple(self._part("vision", self._eyes.drain) or ())
        blocks = tuple(self._part("views", self._eyes.views) or ())
        tags, flow = self._part("landmarks", self._landmarks) or ((), ())
        orders = self._part("orders", self._network.orders) or ()
        now_ns = self._clock.now_ns()
        keys = self._part("keys", lambda: self._keys(now_ns))
        told = self._part("faults", self._faults) or ()
        faults = (*told, *(f"{name}: {what}" for name, what in self._broken.items()))
        inputs = Inputs(
            telemetry=tuple(telemetry),
            sightings=sightings,
            heard=heard,
            refused=refused,
            landmarks=tags or UNSET,
            flow=flow or UNSET,
            blocks=blocks or UNSET,
            faults=faults or UNSET,
            keys=UNSET if keys is None else keys,
            orders=orders or UNSET,
        )
        try:
            outputs = self._agent.step(inputs, now_ns)
        except Exception:
            self._record(number, now_ns, encode(inputs), None)  # inputs that break a step are what a black box is for
            raise
        self._part("recording", lambda: self._record(number, now_ns, encode(inputs), encode(outputs)))
        self._act(outputs, now_ns)
        for level, text in lines:
            self._log(level, text, now_ns)

    def _act(self, outputs: Outputs, now_ns: int) -> None:
        """Hand the outputs of a step to the devices and the network; nothing here waits. What a part is told has a name
        of its own: that it still answers does not mean that it takes orders."""
        if (ordered := outputs.motors) is not UNSET and (motors := self._motors) is not None:
            self._part("motors off or on", lambda: motors.obey(ordered, now_ns))
        self._part("set-points", lambda: self._module.send(outputs.set_point, now_ns))
        if (sweep := outputs.sweep) is not None:
            self._part("sweeps", lambda: self._eyes.plan(sweep))
        if (lens := outputs.lens) is not UNSET:
            self._part("lens", lambda: self._eyes.rest(lens))
        if (drawn := outputs.box) is not UNSET:
            why = self._part("box", lambda: self._draw(drawn))
            if why is not None:
                self._log("warning", f"box of '{drawn.target}': {why}", now_ns)
        if (hz := outputs.preview_hz) is not UNSET:
            self._part("previews", lambda: self._preview_hz(hz))
        if (answers := outputs.answers) is not UNSET:
            self._part("answers", lambda: self._network.answer(answers))
        self._part("words", lambda: self._say(outputs))

    def _say(self, outputs: Outputs) -> None:
        for estimate in outputs.says:
            self._network.say(self._sign(estimate))
        for said in outputs.outgoing or ():
            self._network.say(self._sign(said))
        for message in (*(() if outputs.state is None else (outputs.state,)), *outputs.log):
            self._network.show(message)

    def _part(self, name: str, work: Callable[[], T]) -> T | None:
        """What a part answers; one that raises is told as a fault until it works again, and the loop goes on."""
        try:
            done = work()
        except Exception as error:  # noqa: BLE001 - the robot is under water
            self._broken[name] = f"{type(error).__name__}: {error}"[: MAX_TEXT // 2]
            return None
        self._broken.pop(name, None)
        return done

    def _log(self, level: Level, text: str, now_ns: int) -> None:
        self._keep(line := LogLine(robot=self._name, sent_ns=now_ns, level=level, text=text[:MAX_TEXT]))
        self._network.show(line)


def say_goodbye(agent: Agent, network: Network, clock: Clock, mode: Mode = "stopped") -> None:
    """Show the last state of each target: it tells a planned end from one by a fault, and both from a crash."""
    for target in agent.targets.values():
        if (state := target.last_state) is not None:
            network.show(msgspec.structs.replace(state, mode=mode, seq=state.seq + 1, sent_ns=clock.now_ns()))


# --- devices, links and recording ---

OPEN = "the fleet is open: who reaches a port can read it and speak as any robot; docs/access.md says how to secure it"


class Setup(NamedTuple):
    """What the files say of one robot, read and checked before anything is opened."""

    fleet: Fleet
    name: str
    robot: Robot
    calibration: Calibration
    detectors: Mapping[str, Detector]
    keys: RobotKeys
    certificates: Path | None  # folder of those of a secured fleet
    clock: Clock


def run(
    fleet_path: Path,
    name: str,
    out: Path | None,
    arm: bool,
    stop: Event,
    lossless: bool = False,
    behaviour: str | None = None,
    doubts: Callable[[Fleet], str | None] = lambda fleet: None,
) -> None:
    """One agent process until `stop` is set. Raises ConfigError or CameraError before anything moves.

    With `arm` the motors start once the control module agrees; without it everything else works and they stay off.
    `lossless` records frames bit by bit. `behaviour`: what the robot does in place of what the file says, as the file
    would say it. `doubts`: what will go wrong though it starts.
    """
    setup = load_setup(fleet_path, name, behaviour)
    if (why := doubts(setup.fleet)) is not None:
        tell(f"{name}: before the dive: {why}\n")
    if stop.is_set():
        return
    with ExitStack() as stack:
        stack.enter_context(recovering(torn_files((out or Path()) / f"{name}.mcap")))
        process = AgentProcess(setup, stack, stop)
        process.open_links(out or Path(), lossless)
        process.open_eyes()
        process.open_module(arm)
        motors = "motors start when the control module agrees" if arm else "motors stay off (--arm starts them)"
        file = "nothing" if process.log.fault else process.log.path
        tell(f"{name}: {motors}; recording {file}; Ctrl-C ends it\n")
        process.runtime(arm).run(stop)
    fault = process.log.fault
    tell(f"{name}: stopped; {f'not all was recorded: {fault}' if fault else f'recorded {process.log.path}'}\n")


def load_setup(fleet_path: Path, name: str, behaviour: str | None = None) -> Setup:
    """Read all files. Raises ConfigError or CameraError, one line, for what a person has to mend first."""
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    fleet = fleet if behaviour is None else with_behaviour(fleet, name, behaviour)
    known_scheme(robot.camera)
    clock = fleet_clock(fleet)
    calibration = own_calibration(fleet, name, fleet_path)
    keys, certificates = robot_keys(fleet, name, fleet_path), credentials(fleet, name, fleet_path)
    detectors = load_detectors(fleet, calibration.camera)
    for line in colours_too_alike(fleet):
        tell(f"{name}: {line}\n")
    if not fleet.secured:
        tell(f"{name}: {OPEN}\n")
    return Setup(fleet, name, robot, calibration, detectors, keys, certificates, clock)


class AgentProcess:
    """The parts of one agent, each opened by a method of its own, in this order; `stack` closes them, last first."""

    def __init__(self, setup: Setup, stack: ExitStack, stop: Event) -> None:
        self._setup, self._stack, self._stop = setup, stack, stop
        self._size = setup.fleet.camera.width_px, setup.fleet.camera.height_px
        self._sockets = twin_dir(setup.fleet)
        self._clock = setup.clock
        self._incarnation = self._clock.now_ns()
        self._agent = Agent(setup.fleet, setup.name, setup.calibration, self._incarnation)
        self._loop: Runtime | None = None  # before the module is open

    def open_links(self, out: Path, lossless: bool) -> None:
        """Links to the neighbours, then the recording: a start that fails leaves none. The links close first."""
        fleet, name, calibration = self._setup.fleet, self._setup.name, self._setup.calibration
        with ExitStack() as links:
            self._link = links.enter_context(Transport(fleet, name, self._clock.now_ns, self._setup.certificates))
            facts = run_facts(fleet, name, self._incarnation)
            self.log = self._stack.enter_context(
                black_box_log(out, fleet, name, calibration, facts, views=True, depth=sweep_depth)
            )
            self._stack.push(links.pop_all())
        self._box = BlackBoxWriter(self.log, name, self._clock.now_ns, lossless, RateNotes(self._clock))
        self._network = self._stack.enter_context(ConsoleLog(self._link, tell))
        self._stack.push(self._say_goodbye)

    def _say_goodbye(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        mode: Mode = "stopped" if kind is None or issubclass(kind, (KeyboardInterrupt, SystemExit)) else "failed"
        say_goodbye(self._agent, self._network, self._clock, mode)

    def open_eyes(self) -> None:
        """The camera's thread, and previews of what it sees."""
        fleet, name = self._setup.fleet, self._setup.name
        enhancer = self._open_enhancer() if fleet.camera.enhance else None
        boxes = any(target.detector == "box" for target in fleet.target.values())
        self._preview = Preview(name, self._size, fleet.link.preview_hz, enhancer, keep=boxes)
        swims, known = fleet.navigation, self._setup.calibration
        self._landmarks = LandmarkWatch(known.camera, known.focus, swims.follow_hz) if swims else None
        self._eyes = Vision(
            self._open_camera,
            fleet,
            self._setup.calibration.camera,
            self._setup.detectors,
            self._clock,
            name,
            on_frame=self._on_frame,
            enhancer=enhancer,
            landmarks=self._landmarks,
            timing=known.timing,
        )
        self._eyes.start()
        self._stack.callback(self._eyes.close)

    def _open_camera(self) -> Camera:
        """Raises CameraError where there is none, and for one whose lens is nowhere if nothing sets it."""
        camera = open_camera(
            self._setup.robot.camera, self._sockets, self._size, self._clock, self._setup.fleet.camera.mains_hz
        )
        if self._setup.calibration.focus is None and movable(camera) is not None:
            camera.close()
            raise CameraError(
                "its focus can be set, and the calibration has no table [focus], as if it were fixed; "
                f"measure it by `aucamp calibrate run FLEET --robot {self._setup.name}`"
            )
        return camera

    def open_module(self, arm: bool) -> None:
        """The control module. Last, so that its motors are off before anything else ends."""
        part = part_name(self._setup.name, SERIAL)
        self._module = self._stack.enter_context(
            open_module(self._setup.robot.serial, self._sockets, self._clock, self._box.serial, part)
        )
        if arm:
            self._module.arm()

    def runtime(self, arm: bool) -> Runtime:
        """The loop over all of this."""
        keys, motors = self._setup.keys, Motors(self._module, arm)

        def faults() -> tuple[str, ...]:
            own = {UNRECORDED: self.log.fault, "motors off": motors.fault(), "keys": keys.fault()}
            found = {**own, **self._eyes.faults, **self._module.faults}
            return (*(f"{kind}: {what}" for kind, what in found.items() if what), *self._link.faults())

        self._loop = Runtime(
            self._setup.name,
            self._agent,
            self._eyes,
            self._module,
            self._network,
            self._box.step,
            self._clock,
            faults=faults,
            motors=motors,
            sign=keys.sign,
            keys=keys.changed,
            landmarks=self._landmarks.drain if self._landmarks else lambda: ((), ()),
            draw=self._draw,
            preview_hz=self._preview.set_rate,
            keep=self._box.line,
        )
        return self._loop

    def _draw(self, drawn: TargetBox) -> str | None:
        """Have vision look for what is in a box of a frame that was shown. Returns why not."""
        image, detector = self._preview.frame(drawn.frame), self._setup.detectors[drawn.target]
        if image is None or not isinstance(detector, BoxDetector):
            return f"frame {drawn.frame} was not shown, or too long ago; draw it in a newer picture"
        detector.expect(image, Box(*drawn.box))
        return None

    def _open_enhancer(self) -> OnDemandEnhancer:
        way = default()
        if way.why:
            self._log("warning", f"enhancement: {way.why}")
        enhancer = OnDemandEnhancer(way)
        self._stack.callback(self._log_shown_raw, enhancer)
        return enhancer

    def _log_shown_raw(self, enhancer: OnDemandEnhancer) -> None:
        """How many frames could not be enhanced in time."""
        text = f"enhancement: {enhancer.raw} of {enhancer.frames} frames to be enhanced had no colours in time"
        self._log("info", text)

    def _on_frame(self, frame: Frame, sightings: Sequence[Sighting]) -> None:
        """Vision's thread: tell the loop, record, and show to people who look."""
        if (loop := self._loop) is not None:
            loop.show(sightings)
        measured, coarse = self._eyes.measured(frame, sightings[0]), not (sightings[0].sweep or self._eyes.surveys)
        self._box.frame(frame.image, frame.roi, *sightings, measured=measured, coarse=coarse)
        if (
            not self._stop.is_set()
            and (image := self._preview.of(frame, sightings[0], self._clock.now_ns())) is not None
        ):
            self._network.show(image)

    def _log(self, level: Level, text: str) -> None:
        line = LogLine(robot=self._setup.name, sent_ns=self._clock.now_ns(), level=level, text=text[:MAX_TEXT])
        self._box.line(line)
        self._network.show(line)


def tell(text: str) -> None:
    """Say it to the person who started it, at once."""
    sys.stderr.write(text)
    sys.stderr.flush()


def own_calibration(fleet: Fleet, name: str, fleet_path: Path) -> Calibration:
    """The calibration of a robot's own camera. Raises ConfigError if there is none, or if it is of another camera."""
    path = fleet_path.parent / fleet.robot[name].calibration
    if not path.exists():
        remedy = f"aucamp calibrate run {quote(str(fleet_path))} --robot {name}"
        raise ConfigError(f"{path}: no such file; make it with: {remedy}")
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


# --- console log ---
# What an agent says to the person who started it: its log as it grows, and every ten seconds where it stands.

AGAIN_NS = 10_000_000_000  # between two lines about where it stands
WAITING = 256  # lines that a terminal has not taken; later ones are left out, the network has them all
LAST_S = 0.5  # how long the end waits for a terminal


class Network(Protocol):
    def drain(self) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]: ...
    def say(self, message: Estimate | Said) -> None: ...
    def show(self, message: State | LogLine | Image) -> None: ...
    def orders(self) -> tuple[Ordered, ...]: ...
    def answer(self, answers: Sequence[Answer]) -> None: ...


class ConsoleLog:
    """A network whose shown messages a person can follow as well. Context manager.

    `write` gets whole lines in a thread of its own: a terminal held with Ctrl-S may block it for ever, and a loop that
    waited for a terminal would let the control module believe that its host has died.
    """

    def __init__(self, network: Network, write: Callable[[str], object]) -> None:
        self.drain, self.say, self.orders, self.answer = network.drain, network.say, network.orders, network.answer
        self._network, self._write = network, write
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING)
        self._stood_ns: dict[str, int] = {}  # target -> when it was last said where we stand
        self._heard: dict[str, set[str]] = {}  # target -> neighbours whose word about it is fresh
        self._thread = Thread(target=self._run, name="console log", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._put(None)
        self._thread.join(LAST_S)

    def show(self, message: State | LogLine | Image) -> None:
        """Publish, and say it if a person wants to know."""
        self._network.show(message)
        if isinstance(message, Image):
            return
        if isinstance(message, LogLine):
            self._put(line(message.sent_ns, message.robot, message.level, message.text))
            return
        before: set[str] = set().union(*self._heard.values())
        self._heard[message.target] = set(robot_view(message).hears)
        now: set[str] = set().union(*self._heard.values())
        for name in sorted(now ^ before):
            news = f"hears {name}" if name in now else f"hears {name} no more"
            self._put(line(message.sent_ns, message.robot, "info" if name in now else "warning", news))
        stood_ns = self._stood_ns.setdefault(message.target, message.sent_ns)
        if message.sent_ns - stood_ns >= AGAIN_NS:
            self._stood_ns[message.target] = message.sent_ns
            self._put(line(message.sent_ns, message.robot, "info", standing(message)))

    def _put(self, text: str | None) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(text)

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # nobody reads any more: `| head` has had enough
            while (text := self._lines.get()) is not None:
                self._write(text)


def line(at_ns: int, robot: str, level: str, text: str) -> str:
    """One line, time of day first, as people at the tank read it."""
    return f"{datetime.fromtimestamp(at_ns * 1e-9):%H:%M:%S} {robot} {level:7} {text}\n"


def standing(state: State) -> str:
    """What a robot knows of a target, whom it hears, and what is wrong."""
    place = "no estimate"
    if state.posterior_m is not None:
        place = " ".join(f"{1e3 * x:.1f}" for x in state.posterior_m) + " mm"
        place += f", sigma {1e3 * state.posterior_sigma_m:.1f} mm" if state.posterior_sigma_m is not None else ""
    view = robot_view(state)
    rest = dict.fromkeys([f"hears {', '.join(view.hears) or 'nobody'}", view.motors, *view.remarks])
    return f"{state.target}: {state.knows} at iteration {state.t}, {place}; {'; '.join(filter(None, rest))}"
