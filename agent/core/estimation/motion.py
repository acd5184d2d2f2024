"""Does the target rest or move? Each robot asks its own samples, and tells the others what it found.

At rest the normalised innovations squared of own samples against the mean of the own samples before them follow chi^2
with 3 degrees of freedom each. The own mean is the yardstick, not the agreed place: a robot that is wrong is
wrong in both, and raises no alarm. Moving turns to rest when the track has stayed in one place for half a minute.

Samples that scatter by more than they say make this sum large as well; in murky water they do so for as long as a dive
lasts. So the sum of a batch is taken apart, with d the innovations, S their covariances and m the mean of the batch,

    sum d' S^-1 d  =  m' (sum S^-1) m  +  sum (d - m)' S^-1 (d - m)        m = (sum S^-1)^-1 sum S^-1 d

What moves shows in the first part, whatever samples scatter by: of five that do nothing else it has a fifth.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.core.estimation.track import summed
from agent.core.matrix import apply, invert, quadratic
from agent.core.messages import Symmetric, Vector
from agent.core.savepoint import Revertible

BATCH = 5  # samples whose sum is judged; two batches in a row must agree
MOVED = 37.70  # chi^2, 15 degrees of freedom, 0.999
# Of that sum, in the mean of the batch. Scatter along one axis, however large, has more in one batch of 26, and twice
# in a row in one of 700; a target that goes off at one speed has 0.8 in the first batch, and soon nearly all.
SHIFT = 0.7
NORMAL = 25.00  # chi^2, 15 degrees of freedom, 0.95
RESTED_NS = 30_000_000_000  # this long in one place is rest
REST_SPEED_M_S = 0.002  # mean speed over that time below which the target counts as resting


class Innovation(NamedTuple):
    """An own sample against what the own samples before it said."""

    step_m: Vector
    covariance_m2: Symmetric  # of that, if nothing changed
    nis: float  # that step, normalised and squared


class Motion(Revertible):
    """Evidence for and against motion, of one robot in one epoch."""

    def __init__(self) -> None:
        self._batch: list[Innovation] = []
        self._alarms = 0
        self._normal = False  # the last full batch was as innocent as it should be
        self._path: deque[tuple[int, Vector]] = deque()

    def sample(self, innovation: Innovation) -> None:
        """Take note of one own sample."""
        self._batch.append(innovation)
        if len(self._batch) == BATCH:
            total = sum(each.nis for each in self._batch)
            moved = total > MOVED and _of_mean(self._batch) > SHIFT * total
            self._alarms = self._alarms + 1 if moved else 0
            self._normal = total < NORMAL
            self._batch = []

    def place(self, now_ns: int, x_m: Vector) -> None:
        """Take note of where the track is."""
        self._path.append((now_ns, x_m))
        while len(self._path) > 1 and now_ns - self._path[1][0] >= RESTED_NS:
            self._path.popleft()

    @property
    def moves(self) -> bool:
        return self._alarms >= 2

    def rests(self, now_ns: int) -> bool:
        """Whether the track went nowhere for half a minute, and own samples agree with it."""
        if not self._normal or not self._path or now_ns - self._path[0][0] < RESTED_NS:
            return False
        here, reach = self._path[-1][1], REST_SPEED_M_S * RESTED_NS * 1e-9
        return all(sum((a - b) ** 2 for a, b in zip(x, here, strict=True)) < reach * reach for _, x in self._path)


def _of_mean(batch: list[Innovation]) -> float:
    """The part of the sum that the mean of the batch has."""
    known = [(invert(each.covariance_m2), each.step_m) for each in batch]
    information, vector = summed([(precision, apply(precision, step_m)) for precision, step_m in known])
    return quadratic(invert(information), vector)
