"""Measurements of a ball by one robot of the twin, each with the error that it has and the error that it states.

The robot has a lens, servos and a calibration of its own, and looks at its ball from many places. Every measurement
goes the whole way: frames, detection, a full sweep, its peak, then the place with its 3x3 covariance. The same frames
are evaluated with both cues, with focus alone and with size alone.

What a robot does not know is drawn from the twin's own figures: the survey, what is left of it by the mooring's sway,
drift and noise of the pressure sensors, and the tolerance of the ball.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, NoReturn, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.clock.clock import StandingClock
from agent.core.attitude import Attitude, zeros
from agent.core.config import CAREFUL, Cues, Fleet, Pose, Target, WaterKind
from agent.core.estimation.track import outer
from agent.core.linear_algebra import full, plus, times, trace
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, TimingFit, camera_pose, gimbal_deg, look_at, servos_us
from agent.core.ranging.fix import NoRange, distance, locate
from agent.core.ranging.sweep import Measurement, Sweep
from agent.core.step_io import SetPoint, Sighting, Telemetry
from agent.experiments.claim import Row
from agent.perception.clarity import around
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import HOMING_S, TimedCamera, Vision
from agent.process.command import shipped_fleet, temporary_folder
from agent.robot.fleet_reader import load_fleet
from agent.tools.bench_calibration import BACKLASH_US, calibrate, focus_rows
from agent.tools.focus_calibration import FocusRow
from hw.camera.camera import PATIENCE_S, CameraError, FocusRange, Frame, Roi, Stamp, deliverable
from hw.stm32.protocol import HostProtocol
from hw.twin.board import Board, interpreter
from hw.twin.calibration_bench import Bench
from hw.twin.dive import Dive
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.physics.body import SURVEY_DEG, SURVEY_M
from hw.twin.physics.sensors import DRIFT_M_S, NOISE_M, drifted_s, seems
from hw.twin.scene import Scene, Solid, generator, in_daylight, scene_of
from hw.twin.truth import PaintedTag

# --- a robot of the twin at any pose: on the bench first, then in the water ---
# Time is virtual. The lens, its motor and the servos are those of one robot throughout, so a calibration made on the
# bench is as wrong in the water as it would be. It offers what every camera offers (hw.camera.Camera).

Array = NDArray[np.float64]

DIVE_NS = 10_000_000_000_000  # hours after the bench: the coil is warm


class PosedRobot:
    """Robot `name` of a fleet in the fleet's own world, with this sensor; `submerge` takes it off the bench.

    The bench has daylight and nothing but its board, whatever the scene.
    """

    def __init__(self, fleet: Fleet, name: str, sensor: str) -> None:
        self._fleet, self._name = fleet, name
        self._scene = msgspec.structs.replace(scene_of(fleet), camera=sensor)
        seed = fleet.twin.seed
        self._lens = draw_lens(self._scene.camera, generator(seed, name, "lens"))
        self._vcm = Vcm(self._lens, generator(seed, name, "vcm"))
        self.size = (self._lens.width, self._lens.height)
        self.stamp: Stamp = "exposure-start"
        self._bench = self._with(in_daylight(msgspec.structs.replace(self._scene, solid=(), creature=())), 0)

    def calibrate(self) -> Calibration:
        """The bench's whole procedure. Raises CalibrationRefused."""
        return calibrate(self._fleet, self._name, self, self._bench.place, lambda done, total: None)

    def focus_rows(self) -> list[FocusRow]:
        """Its first part: the sharpest lens position at each distance."""
        camera = TimedCamera(self, TimingFit(), lambda: 0)
        return focus_rows(self._fleet, camera, self.focus_range(), self._bench.place, lambda done, total: None)[0]

    def submerge(self, water: WaterKind, solids: tuple[Solid, ...], tags: Sequence[PaintedTag] = ()) -> None:
        """Hours later, in this kind of water, before these solids and tags alone."""
        kind = msgspec.structs.replace(self._scene.water, preset=water)
        self._bench = self._with(msgspec.structs.replace(self._scene, water=kind, solid=solids), DIVE_NS, tags)

    def stand(self, position_m: Vector, rotation: Array, servos_us: tuple[int, int]) -> None:
        """The body's centre and turn (body to world), and the pulses of pan and tilt, reached from shorter ones."""
        self._bench.stand(position_m, rotation)
        self._bench.place(None, (servos_us[0] - BACKLASH_US, servos_us[1] - BACKLASH_US))
        self._bench.place(None, servos_us)

    def focus_range(self) -> FocusRange:
        return self._bench.focus_range

    def set_focus(self, lens_position: int) -> int:
        return self._bench.set_focus(lens_position)

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        return self._bench.read(deliverable(roi, self.size), settle_s)

    def close(self) -> None:
        """Nothing is held open."""

    def _with(self, scene: Scene, start_ns: int, tags: Sequence[PaintedTag] = ()) -> Bench:
        fleet = self._fleet
        index, seed = fleet.water.refractive_index, fleet.twin.seed
        painter = Painter(scene, fleet.tank, index, self._lens, seed, self._name, tags)
        painter.prepare()
        bench = Bench(fleet, self._name, self._lens, self._vcm, painter, start_ns)
        bench.place(None, (fleet.body.servo_centre_us, fleet.body.servo_centre_us))
        return bench


def rotation_of(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """Body to world, Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (np.cos(np.radians(a)), np.sin(np.radians(a))) for a in (roll_deg, pitch_deg, yaw_deg)
    )
    rz = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    ry = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    rx = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(rz @ ry @ rx)


# --- depth, roll and pitch as four drifting pressure sensors measure them ---

DIVE_S = 120.0  # sensors have drifted for up to so long
INTERPOLATED = 1.9  # readings that one makes which lies between two frames of telemetry: the level errs by 0.08 degrees


def level_of(depth_m: float, roll_deg: float, pitch_deg: float, rng: np.random.Generator) -> tuple[Attitude, float]:
    """Attitude as it is measured at some time of a dive, from what it is; and that time, s."""
    rate_m_s, on_s = rng.normal(0.0, DRIFT_M_S, 4), float(rng.uniform(0.0, DIVE_S))
    error_m = rate_m_s * drifted_s(on_s) + rng.normal(0.0, NOISE_M / math.sqrt(INTERPOLATED), 4)
    # z rises to the left with roll, and falls ahead with pitch: a sensor that reads too deep stands too low.
    deeper_m, ahead, left = seems(error_m)
    return Attitude(depth_m + deeper_m, roll_deg - math.degrees(left), pitch_deg + math.degrees(ahead)), on_s


# --- measurements of a ball ---

ROBOT = "r1"
RANGE_M = (0.25, 1.20)  # camera to ball
WATERS: tuple[WaterKind, ...] = ("tap", "pool", "coastal")
SWAY_M, SWAY_DEG = 0.001, 0.1  # of a moored robot
HOVER_DEG = 0.3  # roll and pitch
AIM_DEG = 2.0  # a ball nearer to the middle than this is not followed
CLEAR_M = 0.10  # from a wall to the middle of a robot
CORNER_M = (0.20, 0.40)  # from two walls to the ball
HEIGHT_M = (0.09, 0.30)  # of the camera
PAN_DEG = 60.0


class Placement(NamedTuple):
    """One place of a robot: truth, and what the robot believes."""

    distance_m: float  # camera to ball
    position_m: Vector
    roll_pitch_yaw_deg: Vector
    pose: Pose  # surveyed
    level: Attitude  # as measured
    on_s: float  # how long its control module had been on


def ball_measurements(seed: int, count: int, sensor: str, known: Calibration | None = None) -> Iterator[Row]:
    """One robot, calibrated on its bench unless its calibration is `known`, then at `count` places around its ball.

    Yields a row for each place: what `errors` says of each of the cues. Raises CalibrationRefused.
    """
    rng = np.random.Generator(np.random.PCG64([seed, 4]))
    fleet = load_fleet(shipped_fleet())
    fleet = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, seed=seed))
    name, target = next(iter(fleet.target.items()))
    robot = PosedRobot(fleet, ROBOT, sensor)
    known = known or robot.calibrate()
    assert target.radius_m is not None  # a ball
    radius_m = target.radius_m + float(rng.normal(0.0, target.radius_sigma_m))
    near = [float(rng.uniform(*CORNER_M)) for _ in range(2)]  # a corner: the rest of the tank is as far as can be
    x, y = (n if rng.random() < 0.5 else side - n for n, side in zip(near, fleet.tank.size_m[:2], strict=True))
    ball_m = (x, y, radius_m)
    robot.submerge(WATERS[seed % len(WATERS)], (Solid(kind="ball", position_m=ball_m, radii_m=(radius_m,) * 3),))
    vision = Vision(_no_camera, fleet, known.camera, load_detectors(fleet, known.camera), StandingClock())
    for _ in range(count):
        placement = draw_placement(fleet, ball_m, float(rng.uniform(*RANGE_M)), rng)
        eye = place_robot(robot, fleet, known, placement, ball_m, rng)
        found = sweep_ball(robot, vision, fleet, name, known)
        row: Row = {"distance_m": placement.distance_m}
        for cue in get_args(Cues):
            row[cue] = errors(found, eye, known, target, cue, ball_m, placement)
        yield row


def draw_placement(fleet: Fleet, ball_m: Vector, distance_m: float, rng: np.random.Generator) -> Placement:
    """A place in the tank from which the ball is in reach of the gimbal."""
    width, depth, _ = fleet.tank.size_m
    while True:
        height_m = float(rng.uniform(*HEIGHT_M))
        flat = math.sqrt(max(distance_m**2 - (height_m - ball_m[2]) ** 2, 0.0))
        azimuth, pan_deg = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(-PAN_DEG, PAN_DEG))
        yaw_deg = math.degrees(azimuth) + pan_deg
        roll_deg, pitch_deg = (float(a) for a in rng.normal(0.0, HOVER_DEG, 2))
        camera = np.array(ball_m) - (flat * math.cos(azimuth), flat * math.sin(azimuth), 0.0)
        camera[2] = height_m
        x, y, z = (float(v) for v in camera - rotation_of(roll_deg, pitch_deg, yaw_deg) @ fleet.body.camera_m)
        if CLEAR_M <= x <= width - CLEAR_M and CLEAR_M <= y <= depth - CLEAR_M:
            break
    off_m, off_deg = math.hypot(SURVEY_M, SWAY_M), math.hypot(SURVEY_DEG, SWAY_DEG)
    pose = Pose(
        x_m=x + float(rng.normal(0.0, off_m)),
        y_m=y + float(rng.normal(0.0, off_m)),
        yaw_deg=yaw_deg + float(rng.normal(0.0, off_deg)),
    )
    level, on_s = level_of(fleet.tank.surface_m - z, roll_deg, pitch_deg, rng)
    return Placement(distance_m, (x, y, z), (roll_deg, pitch_deg, yaw_deg), pose, level, on_s)


def place_robot(
    robot: PosedRobot, fleet: Fleet, known: Calibration, placement: Placement, ball_m: Vector, rng: np.random.Generator
) -> Eye:
    """Put the robot there, its gimbal about towards the ball; where it believes its camera to be."""
    body, surface_m = fleet.body, fleet.tank.surface_m
    pan, tilt = look_at(ball_m, placement.pose, body, *placement.level, surface_m)
    off = rng.uniform(-AIM_DEG, AIM_DEG, 2)
    us = servos_us(known.camera, body, pan + float(off[0]), tilt + float(off[1]))
    robot.stand(placement.position_m, rotation_of(*placement.roll_pitch_yaw_deg), us)
    return camera_pose(placement.pose, body, *placement.level, *gimbal_deg(known.camera, body, us), surface_m)


def sweep_ball(
    robot: PosedRobot, vision: Vision, fleet: Fleet, target: str, known: Calibration
) -> Measurement | NoRange:
    """One full sweep as the vision worker does it, and what the sweep's state machine makes of it."""
    state = Sweep(known.swept, fleet.camera.sweep_steps)
    plan = state.start(0)
    middle = robot.set_focus(round(0.5 * (known.swept.lowest + known.swept.highest)))
    seen = vision.sight(robot.read(settle_s=HOMING_S), target, middle, 0, -1, None)
    robot.set_focus(plan.focus[0])
    robot.read(settle_s=HOMING_S)
    first: Sighting | None = None
    for index, wanted in enumerate(plan.focus[1:], start=1):
        lens_position = robot.set_focus(wanted)
        frame = robot.read(around(seen.centre_px, seen.radius_px, robot.size), settle_s=fleet.camera.settle_s)
        seen = vision.sight(frame, target, lens_position, plan.sweep, index, first)
        state.frame(seen)
        if first is None and seen.found:
            first = seen
    result = state.finish(10**12)
    return result if isinstance(result, Measurement) else NoRange(result.reason if result else "unfinished")


def errors(
    found: Measurement | NoRange,
    eye: Eye,
    known: Calibration,
    ball: Target,
    cue: Cues,
    truth_m: Vector,
    placement: Placement,
) -> Row:
    """The error of one measurement in millimetres, and in standard deviations; or why there is none.

    "range": of the camera's own distance to the ball, without what the robot does not know of its place.
    """
    if isinstance(found, NoRange):
        return {"refused": found.reason}
    measured = found.outline, found.lens_position, found.sigma, ball, cue
    fix = locate(known, eye, *measured, zeros=zeros(CAREFUL, placement.on_s))
    reach = distance(known, *measured, eye.tilt_rad)
    if isinstance(fix, NoRange) or isinstance(reach, NoRange):
        return {"refused": fix.reason if isinstance(fix, NoRange) else ""}
    e = np.array(fix.position_m) - truth_m
    stretch = (1.0 - fix.focus_share) * ball.radius_sigma_m / (ball.radius_m or 1.0)  # of a range by size
    covariance = plus(fix.covariance_m2, times(stretch * stretch, outer(fix.lever_m)))
    return {
        "nees": float(e @ np.linalg.solve(full(covariance), e)),
        "error_mm": 1e3 * float(np.linalg.norm(e)),
        "sigma_mm": 1e3 * math.sqrt(trace(covariance)),
        "range_mm": 1e3 * (reach.distance_m + known.camera.ahead_m - placement.distance_m),
        "range_sigma_mm": 1e3 * math.sqrt(reach.variance_m2),
        "focus_share": fix.focus_share,
    }


def _no_camera() -> NoReturn:
    raise CameraError("frames are handed over")


# --- the host's half of a tether ---

SET_POINT_TICKS = 5  # 20 Hz


class Host:
    """The ground computer's half of one tether, and its wire, in the virtual time of a dive that goes in lock-step.

    It speaks the driver's own protocol (hw.stm32.protocol) with a board of the twin, and is called once a tick. Bytes
    are there at once: a pty's are when the machine has time for them, and a dive would depend on that.
    """

    def __init__(self) -> None:
        self.protocol = HostProtocol(1)
        self.protocol.connected()
        self.protocol.arm()
        self.heard: list[Telemetry] = []
        self._to_board = self._to_host = b""

    def exchange(self, wanted: SetPoint, dive: Dive) -> None:
        """Take what the board said, say what is due; the set-point in every SET_POINT_TICKS-th tick."""
        now_ns, protocol = dive.now_ns, self.protocol
        data, self._to_host = self._to_host, b""
        protocol.receive(data, now_ns)
        self.heard += protocol.telemetry
        protocol.telemetry.clear()
        self._to_board += protocol.due(now_ns)
        if dive.ticks % SET_POINT_TICKS == 0:
            self._to_board += protocol.set_point(wanted, now_ns)

    def last_said(self) -> str:
        """The board's last line of text."""
        return self.protocol.lines[-1].text if self.protocol.lines else "nothing heard"

    # The wire, as the board has it.

    def plug(self) -> None:
        """It is never out."""

    def unplug(self) -> None:
        """Nor pulled."""

    def receive(self) -> bytes:
        data, self._to_board = self._to_board, b""
        return data

    def unread(self) -> int:
        return len(self._to_host)

    def send(self, data: bytes) -> None:
        self._to_host += data


@contextlib.contextmanager
def hosts_of(dive: Dive, settings: Mapping[str, str] | None = None) -> Iterator[dict[str, Host]]:
    """Boot a board for each robot of a dive; settings: of its flash."""
    hosts = {name: Host() for name in dive.robots}
    with temporary_folder() as folder, contextlib.ExitStack() as stack:
        for (name, host), tare_pa in zip(hosts.items(), dive.tare_pa, strict=True):
            board = Board(name, folder, tare_pa, interpreter=interpreter(), settings=settings, cable=host)
            stack.callback(board.close)
            dive.boards.append(board)
            board.start()
        yield hosts
