"""The calibration bench: one robot clamped under water in front of a chessboard that can be moved.

Lens, lens motor and servos are those that the robot dives with. Time is virtual: servos have settled when a request
is answered, and a frame costs no more than its rendering.
"""

from __future__ import annotations

import json
import math
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Fleet
from hw.camera.camera import FocusRange, Frame, Roi
from hw.twin.camera_device import EXPOSURE_NS, FrameClock, look
from hw.twin.dive import RobotPose
from hw.twin.optics.raycast import Chessboard
from hw.twin.physics.body import BODY, draw_servos, motor_deg_after, shaft_deg_after
from hw.twin.physics.tank import STEP_S

if TYPE_CHECKING:
    from hw.twin.optics.lens import Lens, Vcm
    from hw.twin.optics.painter import Painter

PIVOT_X_M = 0.12  # leaves 1.38 m of the 1.5 m tank in front of the camera
CHESSBOARD_SIZE_M = (0.30, 0.20)
# Chessboard axes (right, up, towards the viewer) as columns in the body frame (forward, left, up) that it faces.
BODY_CHESSBOARD = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

MOST_WAIT_S = 60.0  # at once
SETTLED_S = 1.2  # the longest way, 180 deg at full slew, and fifteen lags


class Bench:
    """The clamped robot's camera, a FrameSource, and what stands in front of it. Calls may come from two threads."""

    def __init__(self, fleet: Fleet, robot: str, lens: Lens, vcm: Vcm, painter: Painter, start_ns: int) -> None:
        self.size = (lens.width, lens.height)
        self.focus_range = FocusRange(lens.lowest, lens.highest, 1)
        self._vcm, self._painter = vcm, painter
        self._mounting = fleet.body
        self._servos = np.zeros((), BODY)
        draw_servos(self._servos, fleet.twin.seed, robot, fleet.body)
        self._motor_deg = self._servos["servo_zero_deg"][:2].tolist()
        self._shaft_deg = list(self._motor_deg)
        pivot_m = np.array((PIVOT_X_M, fleet.tank.size_m[1] / 2, fleet.tank.surface_m / 2))
        self._body_m = pivot_m - np.array(fleet.body.camera_m)
        self._rotation = np.eye(3)  # level, ahead is world x
        self._pivot_m = pivot_m
        self._chessboard: Chessboard | None = None
        self._clock = FrameClock(start_ns)
        self._now_ns = self._focused_ns = start_ns
        self._late_ns = round(fleet.twin.stamp_late_ms * 1e6)
        self._lock = threading.Lock()

    def place(self, board_m: tuple[float, float, float] | None, servo_us: tuple[float, float]) -> None:
        """Put the chessboard there (None: away) and let the servos settle. Raises ValueError for a place behind.

        board_m: its centre from the gimbal's pivot, body frame. It stands upright, facing the robot.
        """
        if board_m is not None and not (board_m[0] > 0 and all(map(math.isfinite, board_m))):
            raise ValueError(f"board_m {list(board_m)} is not in front of the camera; give x > 0")
        if not all(map(math.isfinite, servo_us)):
            raise ValueError("servo_us is not finite")
        with self._lock:
            self._chessboard = None
            if board_m is not None:
                self._chessboard = Chessboard(self._pivot_m + np.array(board_m), BODY_CHESSBOARD, CHESSBOARD_SIZE_M)
            for k in range(2):
                self._turn(k, (round(servo_us[k]) - self._mounting.servo_centre_us) / self._mounting.servo_us_per_deg)
            self._now_ns += round(SETTLED_S * 1e9)

    def wait(self, seconds: float) -> int:
        """Let so many seconds pass; returns the bench's time, ns. Raises ValueError for none that can be waited."""
        if not 0 <= seconds <= MOST_WAIT_S:
            raise ValueError(f"wait_s {seconds} is not between 0 and {MOST_WAIT_S:g}")
        with self._lock:
            self._now_ns += round(seconds * 1e9)
            return self._now_ns

    def stand(self, body_m: tuple[float, float, float], rotation: NDArray[np.float64]) -> None:
        """Take the robot off its clamp: centre and turn (body to world) of its body. The chessboard stays there."""
        with self._lock:
            self._body_m, self._rotation = np.array(body_m), rotation

    def _turn(self, k: int, nominal_deg: float) -> None:
        gain, zero, low, high = (
            float(self._servos[f"servo_{name}"][k]) for name in ("gain", "zero_deg", "low_deg", "high_deg")
        )
        for _ in range(round(SETTLED_S / STEP_S)):
            self._motor_deg[k] = motor_deg_after(self._motor_deg[k], nominal_deg, gain, zero, low, high, STEP_S)
            self._shaft_deg[k] = shaft_deg_after(self._shaft_deg[k], self._motor_deg[k])

    def set_focus(self, lens_position: int) -> int:
        with self._lock:
            self._focused_ns = self._now_ns
            return int(self._vcm.command(lens_position, self._now_ns))

    def read(self, roi: Roi | None, settle_s: float) -> Frame:
        with self._lock:
            stamped_ns = max(self._now_ns, self._focused_ns + round(settle_s * 1e9))
            seq = self._clock.next(stamped_ns - self._late_ns)
            middle_ns = self._clock.opens_ns(seq) + EXPOSURE_NS // 2
            self._now_ns = middle_ns + max(EXPOSURE_NS // 2, self._late_ns)
            pose = RobotPose(self._body_m, self._rotation, self._shaft_deg[0], self._shaft_deg[1])
            eye, elevation_rad = look(pose, self._mounting.camera_m)
            distance_m = self._vcm.image_distance_m(middle_ns, elevation_rad)
            image = self._painter.frame(eye, distance_m, chessboard=self._chessboard, roi=roi, tick=seq)
            return Frame(middle_ns + self._late_ns, seq, image, roi or Roi(0, 0, *self.size))


# --- socket: JSON, one object a line ---
#
# {"board_m": [x, y, z] or null, "servo_us": [pan, tilt]} and {"wait_s": seconds} are answered by {"now_ns": time of the
# bench} or {"error": "..."}; Bench.place and Bench.wait say what they mean.

MAX_LINE = 1024  # bytes of a request
POLL_S = 0.2


class Request(msgspec.Struct, forbid_unknown_fields=True):
    board_m: tuple[float, float, float] | None = None
    servo_us: tuple[float, float] | None = None  # None: board and servos stay
    wait_s: float = 0.0


def serve(bench: Bench, path: Path, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Answer one client after the other until stopped; blocks. Calls ready() once a client can connect."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen(1)
        listener.settimeout(POLL_S)
        ready()
        while not stop.is_set():
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                continue
            with connection:
                _converse(bench, connection, stop)


def _converse(bench: Bench, connection: socket.socket, stop: threading.Event) -> None:
    connection.settimeout(POLL_S)
    pending = b""
    while not stop.is_set():
        try:
            chunk = connection.recv(MAX_LINE)
            if not chunk:
                return
            *lines, pending = (pending + chunk).split(b"\n")
            for line in lines:
                connection.sendall(json.dumps(_answer(bench, line)).encode() + b"\n")
        except TimeoutError:
            continue
        except OSError:
            return
        if len(pending) > MAX_LINE:
            return


def _answer(bench: Bench, line: bytes) -> dict[str, Any]:
    try:
        request = msgspec.json.decode(line, type=Request)
        if request.servo_us is not None:
            bench.place(request.board_m, request.servo_us)
        return {"now_ns": bench.wait(request.wait_s)}
    except (msgspec.DecodeError, ValueError) as error:
        return {"error": str(error)}


class BenchClient:
    """Moves chessboard and servos by the socket; `with BenchClient(folder / "r1.bench") as bench: bench.place(...)`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connection: socket.socket | None = None

    def __enter__(self) -> BenchClient:
        self._connection = socket.socket(socket.AF_UNIX)
        self._connection.settimeout(10.0)
        try:
            self._connection.connect(str(self._path))
        except OSError:
            self._connection.close()
            raise ConnectionError(f"{self._path}: no bench here; start the twin with --bench") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._connection is not None:
            self._connection.close()

    def place(self, board_m: tuple[float, float, float] | None, servo_us: tuple[float, float]) -> None:
        """Returns when everything is at rest. Raises ValueError if refused, ConnectionError if the bench is gone."""
        board = None if board_m is None else [float(v) for v in board_m]
        self._ask({"board_m": board, "servo_us": [float(v) for v in servo_us]})

    def wait(self, seconds: float) -> int:
        """Let so much of the bench's time pass; returns it, ns. Raises as `place`."""
        return int(self._ask({"wait_s": seconds})["now_ns"])

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            answer: dict[str, Any] = json.loads(self._exchange(json.dumps(request).encode() + b"\n"))
        except (OSError, json.JSONDecodeError):
            raise ConnectionError(f"{self._path}: the bench has ended; start it again") from None
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def _exchange(self, line: bytes) -> bytes:
        """Send a line; returns the line that answers it, short if the bench hangs up."""
        if self._connection is None:
            raise RuntimeError("use the client in a with statement")
        self._connection.sendall(line)
        reply = b""
        while not reply.endswith(b"\n"):
            chunk = self._connection.recv(MAX_LINE)
            if not chunk:
                break
            reply += chunk
        return reply
