"""What the vision worker looks at when `[camera] enhance = true`: the frame, then the frame enhanced, none late for it.

A target is looked for in the frame as it came, and where that shows none in the enhanced frame as well
(docs/experiments.md, Detection, has the figures).

An estimate of the colours costs tens of milliseconds, its use on a frame one or two. So a whole frame gives a new
estimate when one is due, and all others use the newest: the frames and parts of frames of a focus sweep are treated
alike, whatever their blur. When no estimate is young enough, because the processor is busy elsewhere, a frame is shown
raw and counted. The classic way has no such halves and treats each frame by itself.

Previews come from here as well: their estimates serve vision, and vision's serve them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from agent.clock import machine
from agent.perception.enhancement import fast_enhance
from agent.perception.enhancement.enhance import Enhancer, default
from agent.perception.enhancement.fast_enhance import Colours
from agent.perception.enhancement.grey_world import Image
from hw.camera.camera import Frame

DUE_NS = 200_000_000  # between estimates: each idle frame (0.25 s apart) has its own, a sweep of a second a few
OLD_NS = 3_000_000_000  # older colours belong to another view: the longest sweep, and no more
SHARE = 0.25  # of one core that estimates may take; three agents share two cores with twin and firmware

T = TypeVar("T")


def raw_else_enhanced(find: Callable[[Image], T | None], image: Image, enhanced: Callable[[], Image]) -> T | None:
    """What `find` sees in the frame as it came, else in the enhanced one."""
    found = find(image)
    return found if found is not None else find(enhanced())


class OnDemandEnhancer:
    """One camera's frames, enhanced; one thread uses it at a time. `way`: the machine's best if none is given."""

    def __init__(self, way: Enhancer | None = None, clock: Callable[[], float] = machine.stopwatch_s) -> None:
        self._way = way
        self._clock = clock  # seconds
        self._colours: Colours | None = None
        self._estimated_ns = 0  # time of the frame that gave them
        self._last: tuple[Frame, Image] | None = None
        self._raw_sufficed = True  # for the last frame that was looked at
        self._rest_s = 0.0  # no estimate before this time of `clock`
        self.frames = 0
        self.raw = 0  # of them, shown as they came

    def wants_whole(self, t_ns: int) -> bool:
        """Whether a frame taken about now should be read whole: it will be enhanced, and the colours are aging."""
        estimates = self._way is not None and self._way.estimate is not None
        return estimates and not self._raw_sufficed and self._age_ns(t_ns) > OLD_NS // 2

    def look(self, find: Callable[[Image], T | None], frame: Frame, whole: tuple[int, int]) -> T | None:
        """What `find` sees in the frame, or in the part of one; `whole`: (width, height) of the camera."""
        self._raw_sufficed = True

        def enhanced() -> Image:
            self._raw_sufficed = False
            return self.view(frame, whole)

        return raw_else_enhanced(find, frame.image, enhanced)

    def view(self, frame: Frame, whole: tuple[int, int]) -> Image:
        """The frame, or the part of one, enhanced if that can be had in time; `whole`: (width, height) of the camera.

        The same frame again, for another target, costs nothing.
        """
        if self._last is None or frame is not self._last[0]:
            self.frames += 1
            self._last = frame, self._enhanced(frame, whole)
        return self._last[1]

    def _enhanced(self, frame: Frame, whole: tuple[int, int]) -> Image:
        way = self._way = self._way or default()
        if way.estimate is None:
            return way.apply(frame.image)
        if (frame.roi.width, frame.roi.height) == whole and self._due(frame.t_ns):
            start_s = self._clock()
            self._colours, self._estimated_ns = way.estimate(frame.image), frame.t_ns
            took_s = self._clock() - start_s
            self._rest_s = start_s + took_s / SHARE
        if self._colours is None or self._colours.size != whole or self._age_ns(frame.t_ns) > OLD_NS:
            self.raw += 1
            return frame.image
        return fast_enhance.apply_colours(self._colours, frame.image, (frame.roi.x, frame.roi.y))

    def _due(self, t_ns: int) -> bool:
        return self._age_ns(t_ns) >= DUE_NS and self._clock() >= self._rest_s

    def _age_ns(self, t_ns: int) -> int:
        """Age of the colours; a camera that starts again counts from anew."""
        return OLD_NS + 1 if self._colours is None or t_ns < self._estimated_ns else t_ns - self._estimated_ns
