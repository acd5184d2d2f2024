"""Whether lost is said on real pictures: three clips of fish, and clips made of them and of real buoys.

Reads ../shared/data; where that is absent there are no rows. Limits were chosen on the part "tuned"; "held out" has
other fish and other cameras, and was looked at while FOUND_LIKE and SURE_COLOUR of follow.py, MAX_STEP of motion.py and
the limits of meeting.py and look_alikes.py were settled.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from agent.perception.tracking.box import overlap
from agent.perception.tracking.box_trackers import load_box_tracker, model_files
from agent.perception.tracking.follow import FOLLOWED, Followed, Follower
from agent.pictures.track_truth import Score, score
from tests.perception.tracking.loss_clips import WATER, Clip, held_out, tuned
from tests.places import DATA

MODELS = DATA / "models" / "nanotrack_v2"
TRACKERS = {"filter": (None, None), "nano": model_files(MODELS)}


def run() -> dict[str, dict]:
    if not (DATA / WATER).is_dir():
        return {}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        parts = {"tuned": tuned, "held_out": held_out}
        return {name: row for part, clips in parts.items() for name, row in rows(part, clips(DATA)).items()}
    finally:
        cv2.setNumThreads(threads)


def rows(part: str, clips: Iterable[Clip]) -> dict[str, dict]:
    """Three rows for each tracker."""
    trackers = {name: files for name, files in TRACKERS.items() if name == "filter" or MODELS.is_dir()}
    found: dict[str, list[Score]] = {name: [] for name in trackers}
    waits: dict[str, list[float]] = {name: [] for name in trackers}
    for clip in clips:
        for name, files in trackers.items():
            said = follow(clip, files)
            found[name].append(score(clip.truth, said, clip.rate_hz))
            waits[name] += returns(clip, said)
    table = {}
    for name, scores in found.items():
        absent = sum(one.absent for one in scores)
        present = sum(one.frames for one in scores) - absent
        said, wrong = sum(one.absent_said_lost for one in scores), sum(one.present_said_lost for one in scores)
        on = sum(one.on_target for one in scores)
        table[f"loss_{part}_{name}_absent_said_lost"] = row(said, "frames", "frames without it", said / absent)
        table[f"loss_{part}_{name}_present_said_lost"] = row(wrong, "frames", "frames with it", wrong / present)
        table[f"loss_{part}_{name}_on_target"] = row(on, "frames", "frames with it", on / present)
        again = [wait for wait in waits[name] if np.isfinite(wait)]
        share = len(again) / len(waits[name])
        for kind, of in (("median", 50), ("p95", 95)):
            frames = float(np.percentile(again, of)) if again else float("nan")
            table[f"loss_{part}_{name}_found_again_{kind}"] = row(frames, "frames", "times it came back", share)
    return table


def follow(clip: Clip, files: tuple) -> list[Followed]:
    follower, drawn = Follower(load_box_tracker(*files)), clip.truth[0].box
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


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
