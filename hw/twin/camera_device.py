"""One robot's camera in the water: when a frame is exposed, from which pose, and with the lens at which distance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agent.core.messages import Vector
from hw.camera.camera import FocusRange, Frame, Roi
from hw.twin.creatures import swimming
from hw.twin.dive import History, RobotPose
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment
from hw.twin.physics.body import GIMBAL_CAMERA, gimbal
from hw.twin.scene import Creature
from hw.twin.truth import Stage

if TYPE_CHECKING:
    from hw.twin.optics.image_formation import Exposure
    from hw.twin.optics.lens import Lens, Vcm
    from hw.twin.optics.painter import Outline, Painter

Witness = Callable[[int, int, "list[Outline]"], None]  # middle of the exposure, number of the frame, what it shows

FRAME_NS = 1_000_000_000 // 30
EXPOSURE_NS = 10_000_000  # where the exposure does not follow the light
DELIVERY_NS = FRAME_NS  # from the opening of the shutter: exposed, read out and sent while the next one is exposed
LATER_NS = 25_000_000  # what a machine that is slow to render may add, before time waits for it


class FrameClock(NamedTuple):
    """A sensor that runs freely at 30 frames a second: frame k is exposed from start_ns + k FRAME_NS on."""

    start_ns: int

    def next(self, t_ns: int) -> int:
        """The number of the first frame whose exposure begins at t_ns or later."""
        return max(0, -(-(t_ns - self.start_ns) // FRAME_NS))

    def opens_ns(self, seq: int) -> int:
        return self.start_ns + seq * FRAME_NS


@contextmanager
def unhurried(delivered_ns: int, latest_ns: int) -> Iterator[None]:
    """A frame is there as soon as it is rendered: for benches and tests that have their own time."""
    yield


def look(pose: RobotPose, camera_m: Vector) -> tuple[Eye, float]:
    """The camera of a robot in this pose, and how far it looks up (rad), which is how gravity pulls at its lens.

    The optical centre is the gimbal's pivot, camera_m in the body frame.
    """
    position_m = pose.position_m + np.sum(pose.rotation * np.asarray(camera_m), axis=1)
    rotation = pose.rotation @ gimbal(pose.pan_deg, pose.tilt_deg) @ GIMBAL_CAMERA
    return Eye(position_m, rotation), math.asin(min(max(float(rotation[2, 2]), -1.0), 1.0))


def burning(pose: RobotPose, lamp_m: Vector) -> LampBeam:
    """The lamp of a robot in this pose, on a gimbal whose pivot is at lamp_m in the body frame."""
    position_m = pose.position_m + np.sum(pose.rotation * np.asarray(lamp_m), axis=1)
    rotation = pose.rotation @ gimbal(pose.lamp_pan_deg, pose.lamp_tilt_deg) @ GIMBAL_CAMERA
    return LampBeam(position_m, rotation[:, 2], pose.lamp)


class DiveCamera:
    """The camera of robot number `me`, a FrameSource. Frames are rendered on demand, and only those asked for.

    A frame shows the middle of its exposure; one that `blurs` shows all of it, as far as anything moves.
    """

    def __init__(
        self,
        me: int,
        history: History,
        lens: Lens,
        vcm: Vcm,
        painter: Painter,
        camera_m: Vector,
        stage: Stage,
        clock: FrameClock,
        now_ns: Callable[[], int],
        rendering: Callable[[int, int], AbstractContextManager[None]] = unhurried,
        blurs: bool = False,
        creatures: Sequence[Creature] = (),
        seed: int = 0,
        witness: Witness | None = None,
        lamp_m: Vector | None = None,
        late_ns: int = 0,
    ) -> None:
        """`now_ns`: the dive's clock. `rendering(delivered_ns, latest_ns)` is around the making of a frame: it ends
        when it is delivered_ns, and it may keep time from going beyond latest_ns before that. `creatures` as the
        history has them; `witness` gets what each frame shows of them. lamp_m: where on each robot's body its lamp
        is; None: there are none, or the water is such that they do not show. late_ns: by which frames are stamped
        after the middle of their exposure, for which it is delivered no sooner."""
        self.size = (lens.width, lens.height)
        self.focus_range = FocusRange(lens.lowest, lens.highest, 1)
        self._me, self._history, self._camera_m, self._lamp_m = me, history, camera_m, lamp_m
        self._vcm, self._painter, self._clock = vcm, painter, clock
        self._now_ns, self._rendering = now_ns, rendering
        self._stage, self._blurs = stage, blurs
        self._creatures, self._seed, self._witness = tuple(creatures), seed, witness
        self._focused_ns, self._late_ns = 0, late_ns

    def set_focus(self, lens_position: int) -> int:
        self._focused_ns = self._now_ns()
        return int(self._vcm.command(lens_position, self._focused_ns))

    def read(self, roi: Roi | None, settle_s: float) -> Frame:
        stamped_ns = max(self._now_ns(), self._focused_ns + round(settle_s * 1e9))
        seq = self._clock.next(stamped_ns - self._late_ns)
        opens_ns = self._clock.opens_ns(seq)
        delivered_ns = opens_ns + max(DELIVERY_NS, EXPOSURE_NS + self._late_ns)
        with self._rendering(delivered_ns, delivered_ns + LATER_NS):
            exposure, open_ns = None, EXPOSURE_NS
            if self._lamp_m is not None:  # as long as the light asks for when the shutter opens
                self._history.wait(opens_ns)
                moment, elevation_rad = self._moment(opens_ns)
                exposure = self._painter.metered(moment, self._vcm.image_distance_m(opens_ns, elevation_rad))
                open_ns = exposure.open_ns or EXPOSURE_NS
            self._history.wait(opens_ns + open_ns)
            return self._frame(seq, opens_ns + open_ns // 2, roi, exposure, open_ns)

    def _frame(
        self, seq: int, middle_ns: int, roi: Roi | None, exposure: Exposure | None = None, open_ns: int = EXPOSURE_NS
    ) -> Frame:
        middle, elevation_rad = self._moment(middle_ns)
        distance_m = self._vcm.image_distance_m(middle_ns, elevation_rad)

        def during(share: float) -> Moment:
            return self._moment(middle_ns + round(share * open_ns))[0]

        metered = () if exposure is None else (exposure,)
        image = self._painter.expose(middle, distance_m, roi, seq, during if self._blurs else None, *metered)
        if self._witness is not None and middle.creatures:
            self._witness(middle_ns, seq, self._painter.outlines(middle, distance_m))
        return Frame(middle_ns + self._late_ns, seq, image, roi or Roi(0, 0, *self.size))

    def _moment(self, t_ns: int) -> tuple[Moment, float]:
        """What there is to see at t_ns, and how far the camera looks up (rad)."""
        poses = self._history.at(t_ns)
        eye, elevation_rad = look(poses[self._me], self._camera_m)
        hulls = tuple(Hull(p.position_m, p.rotation) for i, p in enumerate(poses) if i != self._me)
        moment = Moment(eye, self._stage.solids(t_ns), hulls, self._stage.tags(t_ns))
        if self._creatures:
            attitudes = zip(self._creatures, self._history.creatures_at(t_ns), strict=True)
            moment = moment._replace(creatures=tuple(swimming(who, how, self._seed) for who, how in attitudes))
        if self._lamp_m is not None:
            lamps = tuple(burning(pose, self._lamp_m) for pose in poses if pose.lamp > 0.0)
            moment = moment._replace(lamps=lamps, own_hull=Hull(poses[self._me].position_m, poses[self._me].rotation))
        return moment, elevation_rad
