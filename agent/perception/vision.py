"""The vision worker: one thread that owns the camera, carries out sweep plans and says what each frame shows.

A Sighting flows for every frame, found or not: the kernel takes their absence for a blind camera. A camera that goes
away is opened again, less and less often. Newer plans replace older ones at the next frame. The output is bounded:
an agent that stands still for a minute finds the newest seconds, not the whole minute.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from threading import Condition, Thread

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.config import Fleet
from agent.messages import Sighting, SweepPlan
from agent.perception.clarity import luminance, tenengrad_disc
from agent.perception.clear_view import ClearView
from agent.perception.detect import Ball, find_ball
from agent.perception.enhance import Enhancer, one_thread
from agent.ranging.calibration import CameraFit, at_lens
from agent.ranging.camera_model import INNER_DISC
from hw.camera import Camera, CameraError, Frame, Roi

IDLE_PERIOD_S = 0.25  # between plans: enough to notice that the target moved or the camera died
HOMING_S = 0.12  # a lens across its whole range: three to four frames of 30 per second
READ_TIMEOUT_S = 0.8  # settling and many frames; less than close() waits
RETRY_S = (0.2, 2.0)  # first and longest pause before a lost camera is opened again
QUEUE = 256  # sightings nobody has fetched: 8 s of frames at 30 per second
ROI_MARGIN = 1.15  # of the ball's radius, and
ROI_BORDER_PX = 24  # the blur at the end of a tracking sweep


class Vision:
    """Frames in, Sightings out. Start it once, close it once; the other methods may be called from any thread.

    `open_camera` raises CameraError while there is no camera. `epoch_offset_ns` is added to the monotonic time of a
    frame. `on_frame(frame, sightings)` runs on this thread after each frame; it must not block. `way`: how frames are
    enhanced where the fleet file asks for it; by default the best that is installed.
    """

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        fleet: Fleet,
        camera: CameraFit,
        epoch_offset_ns: int,
        on_frame: Callable[[Frame, Sequence[Sighting]], None] | None = None,
        way: Enhancer | None = None,
    ) -> None:
        self._open_camera = open_camera
        self._settings = fleet.camera
        self._targets = fleet.target
        self._fit = camera
        self._epoch_offset_ns = epoch_offset_ns
        self._on_frame = on_frame
        self.clear = ClearView(way)  # for `[camera] enhance`; counts what it showed raw
        self._changed = Condition()  # guards the next three
        self._plan: SweepPlan | None = None
        self._closing = False
        self._out: deque[Sighting] = deque(maxlen=QUEUE)
        self._thread = Thread(target=self._run, name="vision", daemon=True)
        self._balls: dict[str, Ball | None] = {}  # in the last frame in which each was looked for
        self._focus: int | None = None  # as the device reported it
        self.frames = 0
        self.errors = 0  # cameras lost or not to be opened
        self.dropped = 0  # sightings that nobody fetched in time
        self.refused = 0  # plans for a camera whose focus cannot be set
        self.fault: str | None = None  # why there is no camera now

    def start(self) -> None:
        self._thread.start()

    def plan(self, plan: SweepPlan) -> None:
        """Carry this plan out; one that is under way is given up. Raises ValueError for a plan without positions."""
        if not plan.focus:
            raise ValueError(f"sweep {plan.sweep} visits no lens position")
        with self._changed:
            self._plan = plan
            self._changed.notify()

    def drain(self) -> list[Sighting]:
        """All Sightings since the last call, oldest first."""
        with self._changed:
            out = list(self._out)
            self._out.clear()
        return out

    def close(self) -> None:
        """Stop and join; waits at most a second for a frame that is under way."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def _run(self) -> None:
        if self._settings.enhance:
            one_thread()
        cv2.setNumThreads(1)  # two milliseconds a frame; several agents share a few cores
        pause_s = RETRY_S[0]
        while not self._closing:
            try:
                camera = self._open_camera()
                try:
                    self._focus = None
                    while not self._closing:
                        self._work(camera)
                        self.fault, pause_s = None, RETRY_S[0]
                finally:
                    camera.close()
            except CameraError as error:
                self.errors += 1
                self.fault = str(error)
                self._wait(pause_s, until_plan=False)
                pause_s = min(2.0 * pause_s, RETRY_S[1])

    def _work(self, camera: Camera) -> None:
        """One plan, or one idle frame."""
        with self._changed:
            plan, self._plan = self._plan, None
        if plan is None:
            self._look(camera, tuple(self._targets))
            self._wait(IDLE_PERIOD_S, until_plan=True)
        elif camera.focus_range() is None:
            self.refused += 1
        else:
            self._sweep(camera, plan)

    def _sweep(self, camera: Camera, plan: SweepPlan) -> None:
        target = plan.target or next(iter(self._targets))
        self._focus = camera.set_focus(plan.focus[0])
        self._wait(HOMING_S, until_plan=True)
        radius_px: float | None = None  # of this sweep's first ball: areas stay comparable while the blur changes
        for index, position in enumerate(plan.focus[1:], start=1):
            if self._closing or self._plan is not None:
                return
            self._focus = camera.set_focus(position)
            ball = self._look(camera, (target,), plan.sweep, index, radius_px)
            if radius_px is None and ball is not None:
                radius_px = ball.radius_px

    def _look(
        self,
        camera: Camera,
        targets: Sequence[str],
        sweep: int = 0,
        index: int = -1,
        radius_px: float | None = None,
    ) -> Ball | None:
        """Read a frame, find the targets in it and say so; returns the first target's ball.

        A sweep looks for one target, in the part around its last ball. Between sweeps each frame is searched for all
        of them: who comes into view is noticed, whoever is being measured.
        """
        last = self._balls.get(targets[0])
        enhance = self._settings.enhance
        part = sweep and last and not (enhance and self.clear.wants_whole(time.monotonic_ns()))
        roi = around(last, camera.size) if last and part else None
        frame = camera.read(roi, settle_s=self._settings.settle_s, timeout_s=READ_TIMEOUT_S)
        sightings = []
        for target in targets:
            self._balls[target], sighting = self.sight(frame, target, self._focus, sweep, index, radius_px)
            sightings.append(sighting)
        self.frames += 1
        with self._changed:
            for sighting in sightings:
                self.dropped += len(self._out) == QUEUE
                self._out.append(sighting)
        if self._on_frame is not None:
            self._on_frame(frame, sightings)
        return self._balls[targets[0]]

    def sight(
        self, frame: Frame, target: str, focus: int | None, sweep: int, index: int, radius_px: float | None
    ) -> tuple[Ball | None, Sighting]:
        """What one frame taken at lens position `focus` shows of a target; `radius_px`: of the sweep's first ball.

        Replay calls it as well.
        """
        whole = self._fit.width_px, self._fit.height_px
        camera, origin_px, colour = at_lens(self._fit, focus), (frame.roi.x, frame.roi.y), self._targets[target].colour
        find = partial(find_ball, camera=camera, origin_px=origin_px, colour=colour)
        ball = self.clear.look(find, frame, whole) if self._settings.enhance else find(frame.image)
        clarity, area_px = (None, None) if ball is None else disc_clarity(frame, ball, radius_px or ball.radius_px)
        return ball, Sighting(
            t_ns=frame.t_ns + self._epoch_offset_ns,
            frame=frame.seq,
            sweep=sweep,
            index=index,
            focus=focus,
            target=target,
            found=ball is not None,
            centre_px=ball.centre_px if ball else None,
            radius_px=ball.radius_px if ball else None,
            clarity=clarity,
            area_px=area_px,
            score=ball.score if ball else 0.0,
        )

    def _wait(self, seconds: float, until_plan: bool) -> None:
        """Sleep; cut short by close(), and by a plan if wanted."""
        deadline = time.monotonic() + seconds
        with self._changed:
            while not self._closing and not (until_plan and self._plan is not None):
                left = deadline - time.monotonic()
                if left <= 0.0:
                    return
                self._changed.wait(left)


def around(ball: Ball, size: tuple[int, int]) -> Roi | None:
    """The part of a frame that holds the ball, its outline's blur and a little motion; None: the whole frame."""
    half = ROI_MARGIN * ball.radius_px + ROI_BORDER_PX
    left, top = (max(0, int(c - half)) for c in ball.centre_px)
    right, bottom = (min(s, int(c + half) + 1) for c, s in zip(ball.centre_px, size, strict=True))
    if left + 16 > right or top + 16 > bottom or (right - left, bottom - top) == size:
        return None
    return Roi(left, top, right - left, bottom - top)


def disc_clarity(frame: Frame, ball: Ball, radius_px: float) -> tuple[float | None, float | None]:
    """Clarity on the raw luminance of the inner disc, and its area; (None, None) where the frame shows none of it."""
    x, y, radius = ball.centre_px[0] - frame.roi.x, ball.centre_px[1] - frame.roi.y, INNER_DISC * radius_px
    left, top = max(0, int(x - radius) - 2), max(0, int(y - radius) - 2)
    part: NDArray[np.uint8] = frame.image[top : int(y + radius) + 4, left : int(x + radius) + 4]
    if min(part.shape[:2]) < 3:
        return None, None
    clarity, area_px = tenengrad_disc(luminance(part), (x - left, y - top), radius)
    return (clarity, area_px) if area_px else (None, None)
