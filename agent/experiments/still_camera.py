"""A camera of the twin held still under water: rendered directly, in virtual time, with nothing but lens and picture.

It offers what every camera offers (hw.camera.Camera), so what is measured on it is the code that dives.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from agent.core.messages import Vector
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.camera.camera import PATIENCE_S, FocusRange, Frame, Roi, deliverable
from hw.twin.bench import CHESSBOARD_SIZE_M
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Floats
from hw.twin.optics.view import Chessboard, Eye
from hw.twin.scene import Scene, generator, load_scene

FRAME_NS = 1_000_000_000 // 30
START_NS = 1_000_000_000


class TankView(msgspec.Struct, frozen=True):
    """Where a camera stands and looks: world frame, yaw from x to y, tilt positive up."""

    position_m: Vector
    yaw_deg: float
    tilt_deg: float = 0.0


class StillCamera:
    """The camera that robot `robot` has in world `seed`; set `view` and `board_m`, then use it as a camera.

    It stands in the tank's scene, or in another one if `scene` is given.
    """

    def __init__(self, sensor: str, seed: int, robot: str = "r1", scene: Scene | None = None) -> None:
        fleet = load_fleet(shipped_fleet())
        scene = msgspec.structs.replace(scene or load_scene("tank"), camera=sensor)
        self.lens = draw_lens(sensor, generator(seed, robot, "lens"))
        self.size = (self.lens.width, self.lens.height)
        self.solids = scene.solid
        self.view = TankView((0.1, 0.6, 0.25), 0.0)
        self.board_m: float | None = None  # z-depth of a board square to the camera, in the middle of its view
        self._vcm = Vcm(self.lens, generator(seed, robot, "vcm"))
        self._painter = Painter(scene, fleet.tank, fleet.water.refractive_index, self.lens, seed, robot)
        self._now_ns, self._seq = START_NS, 0

    def prepare(self) -> None:
        """Make textures and let the kernels compile: seconds on a fresh machine."""
        self._painter.prepare()

    def focus_range(self) -> FocusRange:
        return FocusRange(self.lens.lowest, self.lens.highest, 1)

    def set_focus(self, lens_position: int) -> int:
        return self._vcm.command(lens_position, self._now_ns)

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        part = deliverable(roi, self.size)
        self._now_ns += round(settle_s * 1e9) + FRAME_NS
        self._seq += 1
        image_m = self._vcm.image_distance_m(self._now_ns, math.radians(self.view.tilt_deg))
        image = self._painter.frame(self._eye(), image_m, chessboard=self._board(), roi=part, tick=self._seq)
        return Frame(self._now_ns, self._seq, image, part)

    def close(self) -> None:
        """Nothing is held open."""

    def truth_m(self, lens_position: float) -> Floats:
        """z-depth (height, width) of every pixel with the lens at rest at `lens_position`, metres."""
        return self._painter.depth(self._eye(), self.lens.at_position_m(lens_position), chessboard=self._board())

    def _eye(self) -> Eye:
        ahead, right, down = self._axes()
        return Eye(self.view.position_m, np.stack([right, down, ahead], axis=1))

    def _board(self) -> Chessboard | None:
        if self.board_m is None:
            return None
        ahead, right, down = self._axes()
        place = np.array(self.view.position_m) + self.board_m * ahead
        return Chessboard(place, np.stack([right, -down, -ahead], axis=1), CHESSBOARD_SIZE_M)

    def _axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ahead, right and down of the camera, unit vectors of the world."""
        yaw, tilt = math.radians(self.view.yaw_deg), math.radians(self.view.tilt_deg)
        ahead = np.array([math.cos(yaw) * math.cos(tilt), math.sin(yaw) * math.cos(tilt), math.sin(tilt)])
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        return ahead, right, np.cross(ahead, right)
