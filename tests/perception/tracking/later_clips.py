"""More clips of loss_clips.py's kinds: other fish, other pieces that hide them, other buoys.

ANEW was made after surveys and meetings had been settled; AGAIN_LIKE of follow.py was chosen with it in view. KEPT_BACK
was made after that, run once, and nothing was changed for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.perception.tracking.loss_clips import WATER, Clip, backwards, drifting, flickering, hidden, meeting, real

Drift = tuple[str, str, int, tuple[float, float]]  # folder, picture, number of the ball, direction
Met = tuple[str, str, int, str]

ANEW: Sequence[Drift] = (
    ("balls", "usc_b_0005.jpg", 0, (1, 0)), ("balls", "usc_a_0008.jpg", 0, (-1, 0.3)),
    ("balls", "usc_b_0011.jpg", 0, (0, 1)), ("balls_composite", "comp_018.jpg", 0, (1, 0)),
    ("balls_composite", "comp_036.jpg", 0, (-1, 0.2)), ("balls_composite", "comp_045.jpg", 0, (0, 1)),
    ("balls_composite", "comp_056.jpg", 0, (-1, 0)),
)  # fmt: skip
ANEW_MEETINGS: Sequence[Met] = (
    ("balls", "usc_b_0005.jpg", 0, "passes behind"), ("balls_composite", "comp_036.jpg", 0, "turns round at"),
)  # fmt: skip
KEPT_BACK: Sequence[Drift] = (
    ("balls", "usc_b_0003.jpg", 0, (-1, 0.1)), ("balls", "usc_a_0010.jpg", 0, (1, 0.2)),
    ("balls_composite", "comp_021.jpg", 0, (0.1, -1)), ("balls_composite", "comp_033.jpg", 0, (1, 0)),
    ("balls_composite", "comp_051.jpg", 0, (-1, -0.2)),
)  # fmt: skip
KEPT_BACK_MEETINGS: Sequence[Met] = (
    ("balls", "usc_b_0003.jpg", 0, "passes before"), ("balls_composite", "comp_051.jpg", 0, "passes behind"),
)  # fmt: skip


def anew(data: Path) -> Iterator[Clip]:
    """One at a time, as tuned() does."""
    turns, rim, tetra = _fish(data)
    yield hidden(turns, (420, 180), 45)
    yield hidden(rim, (300, 120), 40)
    yield hidden(rim, (520, 40), 20)
    yield hidden(tetra, (300, 250), 15)
    yield hidden(backwards(turns), (420, 180), 40)
    yield from _balls(data, ANEW, ANEW_MEETINGS, 100)


def kept_back(data: Path) -> Iterator[Clip]:
    """One at a time, as tuned() does."""
    turns, rim, tetra = _fish(data)
    yield hidden(turns, (150, 70), 10)
    yield hidden(rim, (420, 200), 5)
    yield hidden(tetra, (400, 60), 5)
    yield hidden(backwards(rim), (200, 90), 15)
    yield hidden(backwards(tetra), (480, 62), 5)
    yield from _balls(data, KEPT_BACK, KEPT_BACK_MEETINGS, 300)


def _fish(data: Path) -> tuple[Clip, Clip, Clip]:
    names = ("goldfish_turns", 30.0), ("goldfish_rim", 30.0), ("tetra_leaves", 25.0)
    turns, rim, tetra = (real(name, data, rate_hz) for name, rate_hz in names)
    return turns, rim, tetra


def _balls(data: Path, drifts: Sequence[Drift], meetings: Sequence[Met], seed: int) -> Iterator[Clip]:
    for k, (kind, file, ball, direction) in enumerate(drifts):
        clip = drifting(data / WATER / kind, file, ball, direction, seed + k)
        yield flickering(clip) if k % 2 else clip
    for k, (kind, file, ball, how) in enumerate(meetings):
        yield meeting(data / WATER / kind, file, ball, how, seed + 50 + k)
