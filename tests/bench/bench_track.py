"""What following a box costs and how well it holds, one thread: NanoTrack and the filter, checked, on a drawn clip."""

import statistics
import time
from pathlib import Path

import cv2

from agent.perception.tracking.appearance import Box, remember, search
from agent.perception.tracking.follow import Follower, load_box_tracker, model_files
from tests.perception.tracking.swimming import clip, overlap
from tests.places import DATA

MODELS = DATA / "models" / "nanotrack_v2"
FRAMES, GONE = 120, range(80, 90)


def run() -> dict[str, dict]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        filter_s, filter_iou, held = follow(None)
        nano_s, nano_iou, nano_held = follow(model_files(MODELS)) if MODELS.is_dir() else (None, None, None)
        search_s = search_whole()
    finally:
        cv2.setNumThreads(threads)
    rows = {
        "track_filter_480x360": row(1.0 / filter_s, "1/s", "NanoTrack", nano_s and nano_s / filter_s),
        "track_filter_overlap": row(filter_iou, "IoU", "NanoTrack", nano_iou and filter_iou / nano_iou),
        "track_filter_held_without_target": row(held, "frames", "frames without it", held / len(GONE)),
        "track_search_640x480": row(1e3 * search_s, "ms", "30 ms", search_s / 0.030),
    }
    if nano_s is not None:
        rows["track_nano_480x360"] = row(1.0 / nano_s, "1/s", "the filter", filter_s / nano_s)
        rows["track_nano_held_without_target"] = row(nano_held, "frames", "frames without it", nano_held / len(GONE))
    return rows


def follow(files: tuple[Path, Path] | None) -> tuple[float, float, int]:
    """Median seconds a frame, mean overlap while it is followed, frames in which it claims what is not there."""
    follower, times, overlaps, held = Follower(load_box_tracker(files)), [], [], 0
    for k, (image, box) in enumerate(clip(FRAMES, GONE)):
        if k == 0:
            follower.start(image, Box(*box))
            continue
        start = time.process_time()
        now = follower.look(image)
        times.append(time.process_time() - start)
        if box is None:
            held += not now.lost
        elif not now.lost:
            overlaps.append(overlap(now.box, box))
    return statistics.median(times), statistics.mean(overlaps), held


def search_whole() -> float:
    """Median seconds of one search of a whole picture, with a first and a newest picture to compare with."""
    image, box = next(clip(1))
    image = cv2.resize(image, (640, 480))
    drawn = Box(*(4.0 / 3.0 * side for side in box))
    looks = remember(image, drawn)._replace(newest=remember(image, drawn.moved(5.0, 5.0)).first)
    times = []
    for _ in range(20):
        start = time.process_time()
        search(looks, image, drawn)
        times.append(time.process_time() - start)
    return statistics.median(times)


def row(value: float, unit: str, against: str, ratio: float | None) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
