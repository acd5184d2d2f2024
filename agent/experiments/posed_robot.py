"""A robot of the twin put where one likes: its camera behind its own servos, on the bench first, then in the water.

Time is virtual. The lens, its motor and the servos are those of one robot throughout, so a calibration made on the
bench is as wrong in the water as it would be. It offers what every camera offers (hw.camera.Camera).
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Fleet, WaterKind
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration
from agent.tools.bench_calibration import BACKLASH_US, calibrate
from hw.camera.camera import PATIENCE_S, FocusRange, Frame, Roi, deliverable
from hw.twin.bench import Bench
from hw.twin.landmarks import PaintedTag
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.scene import Scene, Solid, generator, load_scene

Array = NDArray[np.float64]

DIVE_NS = 10_000_000_000_000  # hours after the bench: the coil is warm


class PosedRobot:
    """Robot `name` of a fleet in the fleet's own world, with this sensor; `submerge` takes it off the bench."""

    def __init__(self, fleet: Fleet, name: str, sensor: str) -> None:
        self._fleet, self._name = fleet, name
        self._scene = msgspec.structs.replace(load_scene(fleet.twin.scene), camera=sensor)
        seed = fleet.twin.seed
        self._lens = draw_lens(self._scene.camera, generator(seed, name, "lens"))
        self._vcm = Vcm(self._lens, generator(seed, name, "vcm"))
        self.size = (self._lens.width, self._lens.height)
        empty = msgspec.structs.replace(self._scene, solid=())
        self._bench = self._with(empty, 0)

    def calibrate(self) -> Calibration:
        """The bench's whole procedure. Raises CalibrationRefused."""
        return calibrate(self._fleet, self._name, self, self._bench.place, lambda done, total: None)

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
