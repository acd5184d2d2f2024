"""Whether lost is said on real pictures: clips of fish, and clips made of them and of real buoys.

Limits of the trackers were chosen in view of the clips called seen; those kept back have other fish and other cameras,
and nothing was chosen on them.
"""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path

import msgspec

from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value
from agent.perception.tracking.appearance import overlap
from agent.perception.tracking.follow import FOLLOWED, Followed, Follower, load_box_tracker, model_files
from agent.tools.track import score
from tests.bench.timing import one_thread
from tests.perception.tracking.later_clips import anew, kept_back
from tests.perception.tracking.loss_clips import Clip, held_out, tuned
from tests.places import DATA, shared

TRACKERS = {"filter": "filter", "nano": "NanoTrack"}
CLIPS = {"seen": lambda data: chain(tuned(data), held_out(data), anew(data)), "kept-back": kept_back}
ELSEWHERE_IOU = 0.1  # below it a box is on something else
AGAIN_IOU = 0.3  # from it on a box is on the thing that came back


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    clips: int | None = None  # the first ones alone


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each clip. Raises ConfigError where the clips are absent."""
    tracker, part = case.split("-", 1)
    shared("real_water", "clips")
    files = model_files(shared("models", "nanotrack_v2")) if tracker == "nano" else None
    with one_thread():
        return [row_of(clip, follow(clip, files)) for clip in islice(CLIPS[part](DATA), settings.clips)]


def follow(clip: Clip, files: tuple[Path, ...] | None) -> list[Followed]:
    follower, drawn = Follower(load_box_tracker(files)), clip.truth[0].box
    assert drawn is not None
    follower.start(clip.images[0], drawn)
    return [Followed(drawn, 1.0, "followed"), *(follower.look(image) for image in clip.images[1:])]


def row_of(clip: Clip, said: list[Followed]) -> Row:
    """Numbers of frames; and how often it came back, and was then found again."""
    scored, again = score(clip.truth, dict(enumerate(said)), clip.rate_hz), returns(clip, said)
    return {
        "absent": scored.absent,
        "absent_lost": scored.absent_said_lost,
        "present": scored.frames - scored.absent,
        "present_lost": scored.present_said_lost,
        "on_target": scored.on_target,
        "on_another": misled(clip, said),
        "returns": len(again),
        "again": sum(again),
    }


def returns(clip: Clip, said: list[Followed]) -> list[bool]:
    """For each time it came back: whether it was followed where it is before it went again."""
    found, gone, waits = list[bool](), False, False
    for (_, box, counted), now in zip(clip.truth, said, strict=True):
        if box is None:
            found += [False] if waits else []
            gone, waits = True, False
        elif gone and counted:
            gone, waits = False, True
        if box is not None and waits and now.state in FOLLOWED and overlap(now.box, box) > AGAIN_IOU:
            found.append(True)
            waits = False
    return found + ([False] if waits else [])


def misled(clip: Clip, said: list[Followed]) -> int:
    """Frames in which it is there and something else is said to be it."""
    return sum(
        box is not None and counted and now.state in FOLLOWED and bool(overlap(now.box, box) < ELSEWHERE_IOU)
        for (_, box, counted), now in zip(clip.truth, said, strict=True)
    )


def summary(rows: Rows) -> dict[str, Value]:
    """Shares of frames are those of these clips: frames of one clip are too alike to tell of others."""
    figures: dict[str, Value] = {}
    for case, clips in rows.items():
        total = {key: sum(clip[key] for clip in clips) for key in clips[0]}
        for key, of in OF.items():
            if total[of]:
                figures[f"{case}_{key}"] = 100.0 * total[key] / total[of]
        if total["returns"]:
            figures[f"{case}_again"] = Share(total["again"], total["returns"])
    return figures


OF = {"absent_lost": "absent", "present_lost": "present", "on_another": "present", "on_target": "present"}

CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"clips": 2},
    cases=tuple(f"{tracker}-{part}" for tracker in TRACKERS for part in CLIPS),
    measured_on="real pictures",
    figures=tuple(
        Figure(f"{tracker}-{part}_{key}", f"{words}, clips {part.replace('-', ' ')}: {what}", "%")
        for tracker, words in TRACKERS.items()
        for part in CLIPS
        for key, what in (
            ("absent_lost", "away, and called lost or ambiguous"),
            ("present_lost", "there, and called lost or ambiguous"),
            ("on_another", "there, and another thing is said to be it"),
            ("on_target", "there, and followed with half the overlap or more"),
            ("again", "came back, and is found again"),
        )
    ),
    exact=True,
    explanation="""A box is drawn round a fish or a buoy in the first picture of a clip, and followed; the thing leaves
        the picture, or is hidden, and comes back. Frames are counted against where it is, from half a second after it
        went. The clips called seen are those that limits of the trackers were chosen on; the others are kept back.""",
)
