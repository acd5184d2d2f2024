"""What perception and the peak fit cost: one thread, medians; the ratio is to the least that any method must do."""

import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

from agent.perception.clarity import luminance, tenengrad_blocks
from agent.perception.detect import find_ball
from agent.perception.vision import disc_clarity
from agent.ranging.calibration import CameraFit
from agent.ranging.focus import fit_peak, fit_peaks
from hw.camera import Frame, Roi

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)


def run() -> dict[str, dict]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return measure()
    finally:
        cv2.setNumThreads(threads)


def measure() -> dict[str, dict]:
    frame = ball()
    found = find_ball(frame.image, CAMERA)
    if found is None:
        raise RuntimeError("the bench's own ball was not found")
    positions = np.linspace(0, 1023, 30)
    curves = 1000 / (1 + ((positions - np.linspace(200, 800, 108)[:, None]) / 120) ** 2) + 50
    one, x = curves[40].tolist(), positions.tolist()
    grey = luminance(frame.image)

    read_s = median_s(lambda: frame.image.sum())
    detect_s = median_s(lambda: disc_clarity(frame, find_ball(frame.image, CAMERA) or found, found.radius_px))
    grey_s = median_s(lambda: grey.sum())
    blocks_s = median_s(lambda: tenengrad_blocks(grey))
    one_s = median_s(lambda: fit_peak(x, one))
    short_s = median_s(lambda: fit_peak(x[12:19], one[12:19], width=120.0))
    many_s = median_s(lambda: fit_peaks(positions, curves))
    return {
        "vision_detect_and_clarity_640x480": row(detect_s * 1e3, "ms", "numpy sum over the frame", detect_s / read_s),
        "vision_tenengrad_blocks_640x480": row(blocks_s * 1e3, "ms", "numpy sum over the grey", blocks_s / grey_s),
        "ranging_fit_peak_30": row(one_s * 1e6, "us", "108 curves at once, each", one_s / (many_s / 108)),
        "ranging_fit_peak_7": row(short_s * 1e6, "us", "30 positions, free width", short_s / one_s),
    }


def ball() -> Frame:
    """A mottled red disc of 178 px on grey, 0.46 m away; cost depends on its size, not on its beauty."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:480, :640]
    red = ((u - 330) ** 2 + (v - 235) ** 2 < 178**2)[..., None]
    grain = cv2.GaussianBlur(rng.normal(0, 1, (480, 640)), (0, 0), 1.5)[..., None]
    light = np.where(red, np.array([60, 60, 160]) + 80 * grain, 120 + 40 * grain) + rng.normal(0, 2, (480, 640, 3))
    return Frame(0, 0, np.clip(light, 0, 255).astype(np.uint8), Roi(0, 0, 640, 480))


def median_s(work: Callable[[], object], repeats: int = 25) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
