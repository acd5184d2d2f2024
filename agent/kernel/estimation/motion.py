"""Does the target rest or move? Each robot asks its own samples, and tells the others what it found.

At rest the normalised innovations squared of own samples against the mean of the own samples before them follow chi^2
with 3 degrees of freedom each. The own mean is the yardstick, not the agreed place: a robot that is wrong is
wrong in both, and raises no alarm. Moving turns to rest when the track has stayed in one place for half a minute.
"""

from __future__ import annotations

from collections import deque

from agent.kernel.messages import Vector

BATCH = 5  # samples whose sum is judged; two batches in a row must agree
MOVED = 37.70  # chi^2, 15 degrees of freedom, 0.999
NORMAL = 25.00  # chi^2, 15 degrees of freedom, 0.95
RESTED_NS = 30_000_000_000  # this long in one place is rest
REST_SPEED_M_S = 0.002  # mean speed over that time below which the target counts as resting


class Motion:
    """Evidence for and against motion, of one robot in one epoch."""

    def __init__(self) -> None:
        self._batch: list[float] = []
        self._alarms = 0
        self._normal = False  # the last full batch was as innocent as it should be
        self._path: deque[tuple[int, Vector]] = deque()

    def sample(self, nis: float) -> None:
        """Take note of the innovation of one own sample."""
        self._batch.append(nis)
        if len(self._batch) == BATCH:
            total = sum(self._batch)
            self._alarms = self._alarms + 1 if total > MOVED else 0
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
