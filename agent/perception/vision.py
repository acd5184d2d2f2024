"""The vision worker: one thread that owns the camera, carries out sweep plans and says what each frame shows.

A Sighting flows for every frame, found or not: the kernel takes their absence for a blind camera. A camera that goes
away, or a frame that breaks what looks at it, is a reason to open the camera again, less and less often. Newer plans
replace older ones at the next frame. The output is bounded: an agent that stands still for a minute finds the newest
seconds, not the whole minute.

Beside the worker: checks of what the camera delivers, vision once more on recorded frames, and previews for operators.
"""

from __future__ import annotations

import math
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from threading import Condition, Thread
from traceback import extract_tb
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.clock.clock import CAMERA, Clock, Part, StandingClock, part_name
from agent.core.config import Fleet
from agent.core.messages import MAX_JPEG, Image
from agent.core.ranging.camera_model import RESTS, CameraFit, TimingFit
from agent.core.step_io import BlockPeaks, Sighting, SweepPlan
from agent.perception.clarity import UNSEEN, around, prepare, target_clarity
from agent.perception.depth_sweep import BlockSweep
from agent.perception.detection.detectors import Detector, load_detectors
from agent.perception.enhancement.enhance import OnDemandEnhancer, one_thread
from agent.perception.flow import LandmarkWatch
from hw.camera.camera import PATIENCE_S, Camera, CameraError, CameraGone, FocusRange, Frame, Roi

# --- checks of what a camera delivers: a frame at all, and pictures that move ---

FROZEN_NS = 2_000_000_000  # for so long the same picture: eight looks at the idle rate
FROZEN_FRAMES = 4  # and in so many frames: a machine that stood still saw few
EVERY_ROW = 16  # of the rows compared; the noise of a sensor is in each of them
MAX_FAULT = 200  # characters
KEPT = 8  # parts of the frame whose last picture is remembered; a sweep looks at one, the search at another


def check(frame: Frame, size: tuple[int, int]) -> None:
    """Raise CameraError, one line, for what is no picture of `roi`, or of no part of a full frame of `size`."""
    image, roi = frame.image, frame.roi
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        kind = f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise CameraError(f"the camera sent {kind}, not three bytes a pixel; choose another format or camera")
    height, width = image.shape[:2]
    if not height or not width or (width, height) != (roi.width, roi.height):
        raise CameraError(f"the camera sent {width}x{height} pixels for {roi.width}x{roi.height}; plug it in again")
    if roi.x < 0 or roi.y < 0 or roi.x + width > size[0] or roi.y + height > size[1]:
        raise CameraError(f"the camera sent region {tuple(roi)}, outside its {size[0]}x{size[1]}; plug it in again")


class FrozenWatch:
    """Looks whether pictures of a live camera change: two frames of a sensor never have the same noise.

    It compares a frame with the last one of the same part, and knows nothing from the first of each.
    """

    def __init__(self) -> None:
        self._prints: OrderedDict[Roi, int] = OrderedDict()
        self._newest = (-1, -1)  # time and number of the frame before
        self._moved_ns: int | None = None  # when a frame last was another than the one before
        self._repeats = 0  # frames since then that were not

    def see(self, frame: Frame, now_ns: int) -> str | None:
        """Take a frame that came at now_ns; why the pictures are taken for frozen, or None."""
        if frame.still:
            return None
        seen_print = zlib.crc32(frame.image[::EVERY_ROW].tobytes())
        before = self._prints.pop(frame.roi, None)
        self._prints[frame.roi] = seen_print
        if len(self._prints) > KEPT:
            self._prints.popitem(last=False)
        again = (frame.t_ns, frame.seq) == self._newest
        self._newest = frame.t_ns, frame.seq
        if self._moved_ns is None:
            self._moved_ns = now_ns
        elif again or seen_print == before:
            self._repeats += 1
        elif before is not None:
            self._moved_ns, self._repeats = now_ns, 0
        if self._repeats < FROZEN_FRAMES or now_ns - self._moved_ns < FROZEN_NS:
            return None
        what = "the same frame again and again" if again else "the same picture in every frame"
        return f"{what}; plug the camera in again, or give it light"


def broke_off(error: BaseException) -> str:
    """What went wrong and where, in one line."""
    where = [f"{Path(step.filename).name}:{step.lineno}" for step in extract_tb(error.__traceback__)]
    return f"{type(error).__name__} in {where[-1] if where else 'vision'}: {' '.join(str(error).split())}"[:MAX_FAULT]


# --- when a frame was exposed, and where the lens was then ---

HOMING_S = 0.12  # a lens across its whole range: three to four frames of 30 per second
ARRIVES = 5.0  # lags for its whole range
MOVES = 64  # commands that are remembered


def movable(camera: Camera) -> FocusRange | None:
    """The range of its lens; None where the focus is fixed: it cannot be set, or there is but one position."""
    limits = camera.focus_range()
    return limits if limits is not None and limits.lowest < limits.highest else None


class Move(NamedTuple):
    """The lens from one command to the next."""

    since_ns: int
    start: float  # lens position
    goal: int


class TimedCamera:
    """A camera with what its calibration knows of its timing taken out: frames have the time of their exposure, and
    wait until the lens has moved. `now_ns`: the clock of the camera's stamps."""

    def __init__(self, camera: Camera, timing: TimingFit, now_ns: Callable[[], int]) -> None:
        self._camera, self._timing, self._now_ns = camera, timing, now_ns
        self._late_ns = round(1e9 * timing.stamp_late_s)
        self._moves: deque[Move] = deque(maxlen=MOVES)
        self.size, self.close = camera.size, camera.close
        self.homing_s = max(HOMING_S, ARRIVES * timing.lens_lag_s)

    def focus_range(self) -> FocusRange | None:
        return movable(self._camera)

    def set_focus(self, lens_position: int) -> int:
        now_ns = self._now_ns()
        reported = self._camera.set_focus(lens_position)
        self._moves.append(Move(now_ns, self._at(now_ns) if self._moves else reported, reported))
        return reported

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        late_s = max(self._timing.stamp_late_s, 0.0)
        settle_s = late_s + max(settle_s, RESTS * self._timing.lens_lag_s if settle_s else 0.0)
        frame = self._camera.read(roi, settle_s=settle_s, timeout_s=timeout_s + settle_s)
        return frame._replace(t_ns=frame.t_ns - self._late_ns)

    def lens_position(self, t_ns: int) -> int | None:
        """Where the lens was in a frame of that time; None: it was never told to move."""
        return round(self._at(t_ns)) if self._moves else None

    def _at(self, t_ns: int) -> float:
        lag_ns = 1e9 * self._timing.lens_lag_s
        if not lag_ns:
            return self._moves[-1].goal  # stamps of another clock are as good
        move = next((each for each in reversed(self._moves) if each.since_ns <= t_ns), self._moves[0])
        left = math.exp(-max(t_ns - move.since_ns, 0) / lag_ns)
        return move.goal + left * (move.start - move.goal)


# --- the vision worker ---

IDLE_PERIOD_S = 0.25  # between plans: enough to notice that the target moved or the camera died
READ_TIMEOUT_S = 0.8  # settling and many frames; less than close() waits
RETRY_S = (0.2, 2.0)  # first and longest pause before a lost camera is opened again
SLACK_S = 0.025  # how long a frame may be looked at before a dive's clock waits
STANDS = "it reports one position wherever it is told to go: look at its motor and cable"
QUEUE = 256  # sightings that are not fetched yet: 8 s of frames at 30 per second


class Vision:
    """Frames in, Sightings out. Start it once, close it once; the other methods may be called from any thread.

    `open_camera` raises CameraError while there is no camera. `detectors` has one for each target. The `robot`'s clock
    waits for the thread. `on_frame(frame, sightings)` runs on it after each frame and must not block. `enhancer`: for
    frames where the fleet file asks for it; by default with the best way that is installed. `landmarks` sees whole
    frames, in sweeps too: robots that swim need them.
    """

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        fleet: Fleet,
        camera: CameraFit,
        detectors: Mapping[str, Detector],
        clock: Clock,
        robot: str = "",
        on_frame: Callable[[Frame, Sequence[Sighting]], None] | None = None,
        enhancer: OnDemandEnhancer | None = None,
        landmarks: LandmarkWatch | None = None,
        timing: TimingFit | None = None,
    ) -> None:
        self._open_camera, self._timing = open_camera, timing or TimingFit()
        self._settings = fleet.camera
        self._detectors = detectors
        self._camera = camera
        self._whole = camera.width_px, camera.height_px
        self._clock, self._robot = clock, robot
        self._part: Part | None = None  # while it waits between frames
        self._on_frame = on_frame
        self._enhancer = enhancer or OnDemandEnhancer()
        self._landmarks = landmarks
        self._changed = Condition()  # guards the next three
        self._plan: SweepPlan | None = None
        self._closing = False
        self._out: deque[Sighting] = deque(maxlen=QUEUE)
        self._views: deque[BlockPeaks] = deque(maxlen=2)
        self._thread = Thread(target=self._run, name="vision", daemon=True)
        self._rest: int | None = None
        self._last: dict[str, Sighting] = {}  # of each target, in the last frame in which it was looked for
        self._lens_position: int | None = None  # as the device reported it
        self._frozen_watch = FrozenWatch()
        self.frames = 0
        self.errors = 0  # cameras lost or not to be opened
        self.broken = 0  # frames left out because something broke off over them
        self.surveys = False  # the newest frame is of a survey's sweep
        self.dropped = 0  # sightings that were not fetched in time
        self.refused = 0  # plans for a camera whose focus cannot be set
        self.fault: str | None = None  # why there is no camera now, or no worker
        self.frozen: str | None = None  # why its pictures are not believed to be of now
        self.lens: str | None = None  # why the lens does not move, though there are pictures

    def start(self) -> None:
        if self._landmarks is not None:
            self._landmarks.prepare()
        prepare()  # a dive's clock would wait for the thread, and on a busy machine give it up
        self._thread.start()

    def plan(self, plan: SweepPlan) -> None:
        """Carry this plan out; one that is under way is given up. Raises ValueError for a plan without positions."""
        if not plan.focus:
            raise ValueError(f"sweep {plan.sweep} visits no lens position")
        with self._changed:
            self._plan = plan
            self._wake()

    def views(self) -> list[BlockPeaks]:
        """What sweeps over whole frames showed that ended since the last call."""
        with self._changed:
            out = list(self._views)
            self._views.clear()
        return out

    @property
    def faults(self) -> dict[str, str | None]:
        """What is wrong with the camera, by kind."""
        return {"no camera": self.fault, "frames frozen": self.frozen, "lens": self.lens}

    def rest(self, lens_position: int | None) -> None:
        """Where the lens shall be between sweeps, as near to it as landmarks allow; None: where they are sharpest."""
        self._rest = lens_position
        if self._landmarks is not None:
            self._landmarks.rest_at(lens_position)

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
            self._wake()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def _wake(self) -> None:
        """News for the thread; the caller holds the lock."""
        if self._part is not None:
            self._part.resume()
        self._changed.notify()

    def _run(self) -> None:
        part = Part(self._clock, part_name(self._robot, CAMERA), SLACK_S)
        try:
            self._see(part)
        except BaseException as error:
            self.fault = f"vision has ended: {broke_off(error)}; start the agent again"
            raise
        finally:
            part.leave()

    def _see(self, part: Part) -> None:
        if self._settings.enhance:
            one_thread()
        cv2.setNumThreads(1)  # two milliseconds a frame; several agents share a few cores
        pause_s = RETRY_S[0]
        while not self._closing:
            try:
                camera = TimedCamera(self._open_camera(), self._timing, self._camera_ns)
                try:
                    self._lens_position, self._frozen_watch, self.lens = None, FrozenWatch(), None
                    while not self._closing:
                        self._work(camera, part)
                        self.fault, pause_s = None, RETRY_S[0]
                finally:
                    self.frozen = None
                    camera.close()
            except CameraError as error:
                self.errors += 1
                self.fault = str(error)
            except Exception as error:  # noqa: BLE001 - a robot that is blind for good is worse than any of them
                self.broken += 1
                self.fault = broke_off(error)
            else:
                return
            self._wait(part, pause_s, until_plan=False)
            pause_s = min(2.0 * pause_s, RETRY_S[1])

    def _camera_ns(self) -> int:
        """Now, by the clock of the camera's stamps."""
        return self._clock.now_ns() - self._clock.camera_offset_ns

    def _work(self, camera: TimedCamera, part: Part) -> None:
        """One plan, or one idle frame."""
        with self._changed:
            plan, self._plan = self._plan, None
        if plan is None:
            self._rest_lens(camera)
            self._look(camera, tuple(self._detectors))
            idle_s = self._landmarks.wait_s(self._clock.now_ns()) if self._landmarks else IDLE_PERIOD_S
            self._wait(part, idle_s, until_plan=True)
        elif camera.focus_range() is None:
            self.refused += 1
        elif plan.block_px:
            self._survey(camera, plan, part)
        else:
            self._sweep(camera, plan, part)

    def _rest_lens(self, camera: TimedCamera) -> None:
        """Where it is to be between sweeps. A lens takes the nearest of its steps, or does not move at all."""
        landmarks, wanted = self._landmarks, self._rest
        if landmarks is not None:
            wanted = landmarks.due(self._lens_position)
        if wanted is None:
            return
        if camera.focus_range() is not None and wanted != self._lens_position and not self._move(camera, wanted):
            return
        if landmarks is not None:
            landmarks.rested(wanted, self._lens_position)

    def _move(self, camera: TimedCamera, lens_position: int) -> bool:
        """Whether the lens could be told. One that could not is a fault, and pictures go on: tags are seen without."""
        try:
            self._lens_position = camera.set_focus(lens_position)
        except CameraGone:
            raise
        except CameraError as error:
            self.lens = str(error)
            return False
        if self.lens != STANDS:  # which a whole sweep alone shows to be over
            self.lens = None
        return True

    def _survey(self, camera: TimedCamera, plan: SweepPlan, part: Part) -> None:
        """A sweep over whole frames, of no target."""
        view = BlockSweep(plan, self._camera)
        if not self._move(camera, plan.focus[0]):
            return
        self._wait(part, camera.homing_s, until_plan=True)
        for lens_position in plan.focus[1:]:
            if self._closing or self._plan is not None or not self._move(camera, lens_position):
                return
            self._look(camera, tuple(self._detectors), keep=view)
        peaks = view.peaks()
        with self._changed:
            self._views.append(peaks)

    def _sweep(self, camera: TimedCamera, plan: SweepPlan, part: Part) -> None:
        target = plan.target or next(iter(self._detectors))
        if not self._move(camera, plan.focus[0]):
            return
        self._wait(part, camera.homing_s, until_plan=True)
        first: Sighting | None = None
        reported = {self._lens_position}
        for index, lens_position in enumerate(plan.focus[1:], start=1):
            if self._closing or self._plan is not None or not self._move(camera, lens_position):
                return
            reported.add(self._lens_position)
            sighting = self._look(camera, (target,), plan.sweep, index, first)
            if first is None and sighting.found:
                first = sighting
        self.lens = STANDS if len(reported) == 1 < len(set(plan.focus)) else None

    def _look(
        self,
        camera: TimedCamera,
        targets: Sequence[str],
        sweep: int = 0,
        index: int = -1,
        first: Sighting | None = None,
        keep: BlockSweep | None = None,
    ) -> Sighting:
        """Read a frame, find the targets in it and say so; returns what it says of the first of them.

        A sweep looks for one target, a ball in the part around its last place. Between sweeps each frame is
        searched for all of them, so that a target that comes into view is noticed, whichever is being measured.
        """
        last = self._last.get(targets[0])
        whole = self._settings.enhance and self._enhancer.wants_whole(machine.monotonic_ns())
        searched = self._landmarks is not None and self._landmarks.wait_s(self._clock.now_ns()) <= 0.0
        part = sweep and not (whole or searched)
        roi = around(last.centre_px, last.radius_px, camera.size) if part and last and last.found else None
        frame = camera.read(roi, settle_s=self._settings.settle_s, timeout_s=READ_TIMEOUT_S)
        check(frame, camera.size)
        self.surveys = keep is not None
        lens_position = camera.lens_position(frame.t_ns)
        self.frozen = self._frozen_watch.see(frame, self._clock.now_ns())
        if keep is not None and lens_position is not None:
            keep.add(frame.image, lens_position, frame.t_ns + self._clock.camera_offset_ns)
        sightings = [self.sight(frame, target, lens_position, sweep, index, first) for target in targets]
        self._last.update(zip(targets, sightings, strict=True))
        if self._landmarks is not None and searched:
            self._landmarks.see(frame, lens_position, self._clock.camera_offset_ns, sightings)
        self.frames += 1
        with self._changed:
            for sighting in sightings:
                self.dropped += len(self._out) == QUEUE
                self._out.append(sighting)
        if self._on_frame is not None:
            self._on_frame(frame, sightings)
        return sightings[0]

    def sight(
        self, frame: Frame, target: str, lens_position: int | None, sweep: int, index: int, first: Sighting | None
    ) -> Sighting:
        """What one frame at a lens position shows of a target; `first`: of its sweep that found it. Replay calls it."""
        detector = self._detectors[target]
        find = partial(detector.find, offset_px=(frame.roi.x, frame.roi.y), lens_position=lens_position)
        enhance = self._settings.enhance and not detector.remembers
        found = self._enhancer.look(find, frame, self._whole) if enhance else find(frame.image)
        clarity, area_px = UNSEEN if found is None else target_clarity(frame, found.centre_px, found, first)
        return Sighting(
            t_ns=frame.t_ns + self._clock.camera_offset_ns,
            frame=frame.seq,
            sweep=sweep,
            index=index,
            focus=lens_position,
            target=target,
            found=found is not None,
            centre_px=found.centre_px if found else None,
            radius_px=found.radius_px if found else None,
            clarity=clarity,
            area_px=area_px,
            score=found.score if found else 0.0,
            size_px=found.size_px if found else None,
            radius_sigma_px=found.radius_sigma_px if found else None,
        )

    def measured(self, frame: Frame, seen: Sighting) -> Roi | None:
        """The part of a sweep's whole frame that the sweep alone would have read; None: no less than the frame. What
        is enhanced depends on the whole of it."""
        whole = (frame.roi.width, frame.roi.height) == self._whole
        part = bool(seen.sweep and seen.found and whole and not self._settings.enhance)
        return around(seen.centre_px, seen.radius_px, self._whole) if part else None

    def _wait(self, part: Part, seconds: float, until_plan: bool) -> None:
        """Sleep; cut short by close(), and by a plan if wanted."""
        until_ns = self._clock.now_ns() + round(seconds * 1e9)
        with self._changed:
            self._part = part
            while not self._closing and not (until_plan and self._plan is not None):
                if not part.wait_changed(self._changed, until_ns):
                    break
            self._part = None


# --- vision once more on recorded frames: the worker's own `sight`, without its camera and its thread ---

Roi4 = tuple[int, int, int, int]  # x, y, width, height in the full frame
See = Callable[[NDArray[np.uint8], Roi4, Sighting, Sighting | None], Sighting]


def rerun_vision(fleet: Fleet, camera: CameraFit) -> See:
    """A function (image, its part of the frame, the sighting of then, the sweep's first with a target) -> that of now.

    What the devices said, time, number and lens position, is taken from then; what the image says is new.
    """
    vision = Vision(_no_camera, fleet, camera, load_detectors(fleet, camera), StandingClock())

    def see(image: NDArray[np.uint8], part: Roi4, then: Sighting, first: Sighting | None) -> Sighting:
        frame = Frame(image=image, t_ns=then.t_ns, seq=then.frame, roi=Roi(*part))
        return vision.sight(frame, then.target, then.focus, then.sweep, then.index, first)

    return see


def _no_camera() -> Camera:
    raise CameraError("a recording has no camera")


# --- previews for operators, small enough to be sent; never for a measurement ---
#
# Previews are dropped, never delayed: those of frames that come too soon, and of parts of frames, are not made at
# all. With `[camera] enhance` they show what vision would look at: the enhanced frame, or the raw one where no
# colours are young enough.

KEPT_BYTES = 32 * 1024 * 1024  # of frames that were shown: 640x480, twice a second, a quarter of a minute
WIDTH_PX = 640  # at most: a panel on a screen, and what a frame of the usual cameras has
QUALITIES = (80, 60, 40, 20)  # of JPEG: with the first a frame of the twin, 640x480, is 26 kB; the last is coarse


class Preview:
    """Makes the previews of one camera, at most `hz` a second; 0: none. Used by vision's thread.

    `whole`: (width, height) of a full frame, pixels. `enhancer`: what enhances the frames; None: nothing does.
    `keep`: keep the frames that were shown for a while, for an operator may draw a box in one.
    """

    def __init__(
        self,
        robot: str,
        whole: tuple[int, int],
        hz: float,
        enhancer: OnDemandEnhancer | None = None,
        keep: bool = False,
    ) -> None:
        self._robot, self._whole, self._enhancer = robot, whole, enhancer
        self._numbers = count()
        self._keep = keep
        self._shown: deque[tuple[int, NDArray[np.uint8]]] = deque()  # number of the frame, and it
        self.set_rate(hz)

    def set_rate(self, hz: float) -> None:
        """At most so many from now on. From any thread."""
        self._period_ns = 1e9 / hz if hz else math.inf
        self._due_ns = 0.0 if hz else math.inf

    def frame(self, number: int) -> NDArray[np.uint8] | None:
        """A frame that was shown, as the camera gave it; None: it was not, or long ago. From any thread."""
        return next((image for shown, image in tuple(self._shown) if shown == number), None)

    def of(self, frame: Frame, sighting: Sighting, now_ns: int) -> Image | None:
        """The preview of a frame, of which `sighting` says time and lens position; None: not of this one.

        `now_ns`: when it is asked for, Unix time.
        """
        if now_ns < self._due_ns or (frame.roi.width, frame.roi.height) != self._whole:
            return None
        self._due_ns = now_ns + self._period_ns
        shown = frame.image if self._enhancer is None else self._enhancer.view(frame, self._whole)
        if self._keep:
            self._shown.append((frame.seq, frame.image))
            while len(self._shown) * frame.image.nbytes > KEPT_BYTES:
                self._shown.popleft()
        small, jpeg = compressed(shown)
        return Image(
            robot=self._robot,
            seq=next(self._numbers),
            sent_ns=now_ns,
            t_ns=sighting.t_ns,
            frame=frame.seq,
            width_px=small.shape[1],
            height_px=small.shape[0],
            enhanced=shown is not frame.image,
            focus=sighting.focus,
            jpeg=jpeg,
        )


def compressed(image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], bytes]:
    """The image, (height, width, 3) blue green red, at most 640 wide, and its JPEG of at most MAX_JPEG bytes.

    Quality gives way first, then size.
    """
    small = reduced(image, min(1.0, WIDTH_PX / image.shape[1]))
    while True:
        for quality in QUALITIES:
            jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            if jpeg.size <= MAX_JPEG:
                return small, jpeg.tobytes()
        small = reduced(small, 0.5)


def reduced(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    """The image `scale` times as large, which is at most 1."""
    if scale == 1.0:
        return image
    height, width = (max(1, round(scale * side)) for side in image.shape[:2])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
