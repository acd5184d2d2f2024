"""Whether lost is said on real pictures: three clips of fish, and clips made of them and of real buoys.

Reads ../shared/data; where that is absent there are no rows. Limits were chosen on the part "tuned"; "held out" has
other fish and other cameras, and was looked at while FOUND_LIKE and SURE_COLOUR of follow.py, MAX_STEP of
distractors.py and
the limits of distractors.py and distractors.py were settled, and frame by frame while distractors.py was written.
"anew" and
"kept_back" were made afterwards (later_clips.py says what was chosen on the first of them).

`python -m tests.bench.pictures.bench_track_loss gamma_0.7 half_rate --only filter` runs the same clips as another
camera would have given them (disturbed.py names all of them; as_is is none), and prints the table.
"""

import argparse
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from rich.console import Console

from agent.perception.tracking.appearance import overlap
from agent.perception.tracking.follow import FOLLOWED, Followed, Follower, load_box_tracker, model_files
from agent.tools.track import Score, score
from tests.bench.__main__ import WIDE, table
from tests.perception.tracking.disturbed import DISTURBANCES
from tests.perception.tracking.later_clips import anew, kept_back
from tests.perception.tracking.loss_clips import WATER, Clip, held_out, tuned
from tests.places import DATA

MODELS = DATA / "models" / "nanotrack_v2"
ELSEWHERE_IOU = 0.1  # below it a box is on something else
PARTS = {"tuned": tuned, "held_out": held_out, "anew": anew, "kept_back": kept_back}
TRACKERS = {"filter": None, "nano": model_files(MODELS)}


def run(disturbance: str = "as_is", only: Sequence[str] = tuple(TRACKERS)) -> dict[str, dict]:
    if not (DATA / WATER).is_dir():
        return {}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        found: dict[str, dict] = {}
        for part, clips in PARTS.items():
            name = part if disturbance == "as_is" else f"{part}_{disturbance}"
            found |= rows(name, map(DISTURBANCES.get(disturbance, lambda clip: clip), clips(DATA)), only)
        return found
    finally:
        cv2.setNumThreads(threads)


def rows(part: str, clips: Iterable[Clip], only: Sequence[str]) -> dict[str, dict]:
    """What `only` these of the trackers say, a few rows each."""
    trackers = {name: TRACKERS[name] for name in only if name == "filter" or MODELS.is_dir()}
    found: dict[str, list[Score]] = {name: [] for name in trackers}
    waits: dict[str, list[float]] = {name: [] for name in trackers}
    elsewhere = dict.fromkeys(trackers, 0)
    for clip in clips:
        for name, files in trackers.items():
            said = follow(clip, files)
            found[name].append(score(clip.truth, said, clip.rate_hz))
            waits[name] += returns(clip, said)
            elsewhere[name] += misled(clip, said)
    shown = {}
    for name, scores in found.items():
        absent = sum(one.absent for one in scores)
        present = sum(one.frames for one in scores) - absent
        said, wrong = sum(one.absent_said_lost for one in scores), sum(one.present_said_lost for one in scores)
        on = sum(one.on_target for one in scores)
        shown[f"loss_{part}_{name}_absent_said_lost"] = row(said, "frames", "frames without it", said / absent)
        shown[f"loss_{part}_{name}_present_said_lost"] = row(wrong, "frames", "frames with it", wrong / present)
        other = elsewhere[name]
        shown[f"loss_{part}_{name}_on_another"] = row(other, "frames", "frames with it", other / present)
        shown[f"loss_{part}_{name}_on_target"] = row(on, "frames", "frames with it", on / present)
        again = [wait for wait in waits[name] if np.isfinite(wait)]
        share = len(again) / len(waits[name])
        for kind, of in (("median", 50), ("p95", 95)):
            frames = float(np.percentile(again, of)) if again else float("nan")
            shown[f"loss_{part}_{name}_found_again_{kind}"] = row(frames, "frames", "times it came back", share)
    return shown


def follow(clip: Clip, files: tuple | None) -> list[Followed]:
    follower, drawn = Follower(load_box_tracker(files)), clip.truth[0].box
    assert drawn is not None
    follower.start(clip.images[0], drawn)
    return [Followed(drawn, 1.0, "followed"), *(follower.look(image) for image in clip.images[1:])]


def returns(clip: Clip, said: list[Followed]) -> list[float]:
    """For each time it came back: frames until it was followed where it is; infinite where it never was."""
    waits, gone, since = list[float](), False, None
    for k, (_, box, counted) in enumerate(clip.truth):
        if box is None:
            waits += [np.inf] if since is not None else []
            gone, since = True, None
        elif gone and counted:
            gone, since = False, k
        if box is not None and since is not None and said[k].state in FOLLOWED and overlap(said[k].box, box) > 0.3:
            waits.append(k - since)
            since = None
    return waits + ([np.inf] if since is not None else [])


def misled(clip: Clip, said: list[Followed]) -> int:
    """Frames in which it is there and something else is said to be it."""
    return sum(
        box is not None and counted and now.state in FOLLOWED and bool(overlap(now.box, box) < ELSEWHERE_IOU)
        for (_, box, counted), now in zip(clip.truth, said, strict=True)
    )


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("disturbances", nargs="+", choices=["as_is", *DISTURBANCES])
    parser.add_argument("--only", choices=list(TRACKERS), action="append", help="tracker; again for another")
    asked = parser.parse_args()
    for disturbance in asked.disturbances:
        Console(width=WIDE).print(table(run(disturbance, asked.only or tuple(TRACKERS))))
