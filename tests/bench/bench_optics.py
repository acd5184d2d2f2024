"""The twin's camera: CPU time of a frame, and what blur and a region of interest change about it."""

import statistics
import time

import cv2
import numpy as np

from agent.core.config import Tank
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.scene import generator, load_scene

REPEATS = 15
PART = (170, 90, 300, 300)


def run() -> dict[str, dict]:
    scene = load_scene("tank")
    lens = draw_lens(scene.camera, generator(0, "r1", "lens"))
    painter = Painter(scene, Tank(), 1.333, lens, 0, "r1")
    painter.prepare()
    eye = Eye((0.38, 0.31, 0.10), _level(yaw_rad=0.585))
    sharp, far = lens.image_m(1 / 0.29), lens.at_position_m(lens.lowest)
    plain = np.random.default_rng(0).random((480, 640, 3), dtype=np.float32)
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9)).astype(np.float32)
    cv2.setNumThreads(1)
    one_filter = _cpu_s(lambda: cv2.filter2D(plain, -1, disk))
    full = _cpu_s(lambda: painter.frame(eye, sharp))
    blurred = _cpu_s(lambda: painter.frame(eye, far))
    part = _cpu_s(lambda: painter.frame(eye, sharp, roi=PART))
    return {
        "twin_frame_640x480": _rate(full, "one cv2.filter2D, disk of 9 px", one_filter),
        "twin_frame_640x480_far_out_of_focus": _rate(blurred, "in focus", full),
        "twin_frame_300x300_part": _rate(part, "640x480", full),
    }


def _level(yaw_rad: float) -> np.ndarray:
    """Camera to world for a level camera: columns right, down, forward."""
    sin, cos = np.sin(yaw_rad), np.cos(yaw_rad)
    return np.column_stack([(sin, -cos, 0), (0, 0, -1), (cos, sin, 0)])


def _cpu_s(work) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def _rate(seconds: float, against: str, other_s: float) -> dict:
    return {"value": 1 / seconds, "unit": "frames/CPU s", "against": against, "ratio": other_s / seconds}
