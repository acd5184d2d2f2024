"""How like the thing other things get here: what a place has to surpass to be taken for it when it was lost.

A likeness of 0.7 is proof of a buoy in open water, and none of a fish in a tank where others and the gravel reach it
time and again. So the limit is the scene's own, as in a radar that keeps its rate of false alarms constant: places that
were like the thing and were not it, because it was seen elsewhere or could not have got there, are samples of what
chance offers. One of them that is still at its place does not count, however like the thing: it is known what that is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from agent.perception.tracking.look_alikes import LookAlike, Seen, matched
from agent.perception.tracking.motion import Motion

EVERY = 15  # frames from one survey to the next: half a second
CLUTTER_KEPT = 8  # surveys that are remembered: 4 s
FADED = 0.1  # by so much less like the thing one that is still there may be


class Surveys:
    """What was like the thing and was not it, in the newest of the frames in which the whole picture was searched."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, list[Seen]]] = deque(maxlen=CLUTTER_KEPT)

    def due(self, frame: int) -> bool:
        return not self._kept or frame - self._kept[-1][0] >= EVERY

    def add(self, frame: int, places: Sequence[Seen]) -> None:
        self._kept.append((frame, [*places]))

    @property
    def empty(self) -> bool:
        """Whether none of them found anything like it."""
        return not any(places for _, places in self._kept)

    def clear(self) -> None:
        self._kept.clear()

    def surpass(self, frame: int, places: Sequence[Seen]) -> float:
        """The most like the thing that any of them was that is at none of these places now; 0 where all are."""
        return max((unaccounted(then, places, frame - at) for at, then in self._kept), default=0.0)


def unaccounted(survey: Sequence[Seen], places: Sequence[Seen], frames: int) -> float:
    """The same for one survey, of so many frames ago."""
    others = [LookAlike(Motion(place.box, unseen=frames), place.like) for place in survey]
    found = matched(others, places)
    here = {k for k, n in found.items() if places[n].like >= others[k].like - FADED}
    return max((other.like for k, other in enumerate(others) if k not in here), default=0.0)
