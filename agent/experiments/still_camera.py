"""A camera of the twin held still under water, and sweeps of its lens over views of the tank, with their truth.

Frames are rendered directly, in virtual time, with nothing but lens and picture. The camera offers what every camera
offers (hw.camera.Camera), so the code that measures on it is the code that dives.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.focus import Array
from agent.perception.clarity import grid
from agent.perception.depth_peaks import measure_growth
from agent.perception.depth_sweep import HOME_SETTLE_S, SETTLE_S, SWEEP_STEPS
from agent.process.command import Failed, shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.camera.camera import PATIENCE_S, FocusRange, Frame, Image, Roi, Stamp, deliverable
from hw.twin.optics.lens import Lens, Vcm, draw_lens, with_field
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Floats
from hw.twin.scene import Scene, generator, load_scene

FRAME_NS = 1_000_000_000 // 30
START_NS = 1_000_000_000


class TankView(msgspec.Struct, frozen=True):
    """Where a camera stands and looks: world frame, yaw from x to y, tilt positive up."""

    position_m: Vector
    yaw_deg: float
    tilt_deg: float = 0.0


class StillCamera:
    """The camera that robot `robot` has in world `seed`; set `view`, then use it as a camera.

    It stands in the tank's scene, or in another one if `scene` is given.
    """

    def __init__(
        self,
        sensor: str,
        seed: int,
        robot: str = "r1",
        scene: Scene | None = None,
        sensor_tilt_deg: float = 0.0,
        field_um: float = 0.0,
    ) -> None:
        fleet = load_fleet(shipped_fleet())
        scene = msgspec.structs.replace(scene or load_scene("tank"), camera=sensor)
        lens = draw_lens(sensor, generator(seed, robot, "lens"))
        self.lens = with_field(lens, sensor_tilt_deg, field_um, generator(seed, robot, "sensor"))
        self.size = (self.lens.width, self.lens.height)
        self.stamp: Stamp = "exposure-start"
        self.view = TankView((0.1, 0.6, 0.25), 0.0)
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
        image = self._painter.frame(self._eye(), image_m, roi=part, tick=self._seq)
        return Frame(self._now_ns, self._seq, image, part)

    def close(self) -> None:
        """Nothing is held open."""

    def seen(self) -> CameraFit:
        """Its picture in water, from the data sheet of its lens and port: what ranges off the axis need."""
        lens = self.lens
        return CameraFit(
            width_px=lens.width,
            height_px=lens.height,
            f_px=WATER_INDEX * lens.at_rest_m / lens.pixel_m,
            cx_px=lens.centre_px[0],
            cy_px=lens.centre_px[1],
            bend=0.5 * (WATER_INDEX**2 - 1.0),
            ahead_m=(1.0 - WATER_INDEX) * lens.port_gap_m,
            breathing=lens.per_position_m / lens.at_rest_m,
        )

    def truth_m(self, lens_position: float) -> Floats:
        """z-depth (height, width) of every pixel with the lens at rest at `lens_position`, metres."""
        return self._painter.depth(self._eye(), self.lens.at_position_m(lens_position))

    def _eye(self) -> Eye:
        return Eye(self.view.position_m, rotation_of_view(self.view.yaw_deg, self.view.tilt_deg))


def rotation_of_view(yaw_deg: float, tilt_deg: float) -> Array:
    """(3, 3) camera (right, down, ahead) to world."""
    yaw, tilt = math.radians(yaw_deg), math.radians(tilt_deg)
    ahead = np.array([math.cos(yaw) * math.cos(tilt), math.sin(yaw) * math.cos(tilt), math.sin(tilt)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    return np.stack([right, np.cross(ahead, right), ahead], axis=1)


# --- sweeps ---
# Lens positions are equally spaced over the whole range, always from the lowest up: one direction, one hysteresis.

BLOCK_PX = 50  # the paper's
GROWTH_M = 0.5  # distance of the wall on which focus breathing is measured
QUALITY = 0.998  # of a block's peak: leaves out most blocks astride an edge in depth, and few others
WATER_INDEX = 1.333

VIEWS = (
    TankView((0.30, 0.25, 0.12), 34.0, -8.0),  # the ball half a metre away, the corner behind it
    TankView((0.62, 0.28, 0.10), 62.0, -4.0),  # the ball close
    TankView((0.20, 0.85, 0.25), 8.0, -18.0),  # the stone, and the floor from near to far
    TankView((0.75, 0.85, 0.20), 20.0, -10.0),  # the wall, at an angle
)


class SweptView(NamedTuple):
    """One sweep over one view, and the truth for its blocks."""

    view: TankView
    lens_positions: Array  # (n,)
    images: list[Image]
    growth: float  # of the picture over the sweep, relative
    truth_m: Array  # (rows, cols) harmonic mean of a block's z-depths: blocks are sharp at their mean vergence
    pixels_m: NDArray[np.float32]  # (height, width) z-depth of every pixel


def sweep_view(camera: StillCamera, view: TankView, growth: float) -> SweptView:
    """Sweep once; `growth` as measured on the wall."""
    camera.view = view
    images, rho = sweep(camera), lens_positions(camera)
    largest = rho[-1] if growth >= 0 else rho[0]  # blocks are squares in the largest picture
    pixels = camera.truth_m(float(largest))
    rows, cols = (len(grid(size, BLOCK_PX)) - 1 for size in pixels.shape)
    truth_m = truth_on(pixels, rows, cols, BLOCK_PX)
    return SweptView(view, np.array(rho, float), images, growth, truth_m, pixels.astype(np.float32))


def truth_on(pixels_m: NDArray[Any], rows: int, cols: int, side_px: float) -> Array:
    """Harmonic mean (rows, cols) of the z-depths in squares of `side_px`, whose edges are rounded to whole pixels."""
    down, across = (np.rint(np.arange(count + 1) * side_px).astype(int) for count in (rows, cols))
    sums = np.add.reduceat(
        np.add.reduceat(1.0 / pixels_m[: down[-1], : across[-1]].astype(float), down[:-1]), across[:-1], 1
    )
    truth_m: Array = np.outer(np.diff(down), np.diff(across)) / sums
    return truth_m


def sweep(camera: StillCamera, roi: Roi | None = None) -> list[Image]:
    """The pictures of one sweep."""
    camera.set_focus(camera.focus_range().lowest)
    camera.read(roi, settle_s=HOME_SETTLE_S)
    images = []
    for lens_position in lens_positions(camera):
        camera.set_focus(lens_position)
        images.append(camera.read(roi, settle_s=SETTLE_S).image)
    return images


def lens_positions(camera: StillCamera) -> list[int]:
    """Those of every sweep."""
    limits = camera.focus_range()
    return [round(p) for p in np.linspace(limits.lowest, limits.highest, SWEEP_STEPS)]


def breathing(camera: StillCamera) -> float:
    """Growth of the picture over a sweep, on the wall. Raises Failed where it cannot be measured."""
    camera.view = facing_wall(GROWTH_M)
    growth = measure_growth(sweep(camera))
    if growth is None:
        raise Failed("the wall's pictures cannot be registered, so focus breathing is unknown")
    return growth


def facing_wall(u_m: float, tilt_deg: float = 0.0) -> TankView:
    """A view of the wall at the far end of the tank's x axis, `u_m` from it."""
    return TankView((1.5 - u_m, 0.6, 0.25), 0.0, tilt_deg)


def mm_per_position(lens: Lens, lens_position: Array) -> Array:
    """|d range / d rho|, mm per lens position: vergence 1/f - 1/v, range = index / vergence under water."""
    v_m = lens.at_position_m(0.0) + lens.per_position_m * lens_position
    vergence = 1.0 / lens.focal_m - 1.0 / v_m
    return np.asarray(1e3 * WATER_INDEX / vergence**2 / v_m**2 * abs(lens.per_position_m), np.float64)
