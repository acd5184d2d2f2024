"""What following a box costs and how well it holds: NanoTrack with its checks, beside OpenCV's MIL, on one clip."""

import statistics
import time
from pathlib import Path

import cv2

from agent.perception.tracking.box import Box
from agent.perception.tracking.box_trackers import load_box_tracker
from agent.perception.tracking.follow import Follower
from tests.perception.tracking.swimming import clip, overlap
from tests.places import DATA

MODELS = DATA / "models" / "nanotrack_v2"
FRAMES, GONE = 120, range(80, 90)


def run() -> dict[str, dict]:
    files = (MODELS / "nanotrack_backbone_sim.onnx", MODELS / "nanotrack_head_sim.onnx")
    if not files[0].exists():
        return {}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        nano_s, nano_iou, held = follow(files)
        mil_s, mil_iou, _ = follow((None, None))
    finally:
        cv2.setNumThreads(threads)
    return {
        "track_nano_480x360": row(1.0 / nano_s, "1/s", "MIL", mil_s / nano_s),
        "track_nano_overlap": row(nano_iou, "IoU", "MIL", nano_iou / mil_iou),
        "track_nano_held_without_target": row(held, "frames", "frames without it", held / len(GONE)),
    }


def follow(files: tuple[Path | None, Path | None]) -> tuple[float, float, int]:
    """Median seconds a frame, mean overlap while it is followed, frames in which it claims what is not there."""
    follower, times, overlaps, held = Follower(load_box_tracker(*files)), [], [], 0
    for k, (image, box) in enumerate(clip(FRAMES, GONE)):
        if k == 0:
            follower.start(image, Box(*box))
            continue
        start = time.perf_counter()
        now = follower.look(image)
        times.append(time.perf_counter() - start)
        if box is None:
            held += not now.lost
        elif not now.lost:
            overlaps.append(overlap(now.box, box))
    return statistics.median(times), statistics.mean(overlaps), held


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
