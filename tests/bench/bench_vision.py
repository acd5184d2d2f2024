"""What perception and the peak fit cost: one thread, medians of its CPU time, so that other programs do not count.

One pass over the bytes is a compiled sum of all of them, read from memory once: a tenth of the time of numpy's own sum.
"""

import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.focus import fit_peak, fit_peaks
from agent.perception.clarity import around, block_peaks, disc_clarity, grid, tenengrad_grid
from agent.perception.detection.detect import find_ball
from hw.camera.camera import Frame, Roi
from hw.compiled import compiled

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
    lens_positions = np.linspace(0, 1023, 30)
    curves = 1000 / (1 + ((lens_positions - np.linspace(200, 800, 108)[:, None]) / 120) ** 2) + 50
    one, x = curves[40].tolist(), lens_positions.tolist()

    read_s = median_s(lambda: frame.image.sum())
    roi = around(found.centre_px, found.radius_px, (640, 480)) or frame.roi
    part = frame._replace(image=frame.image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width].copy(), roi=roi)
    part_s = median_s(lambda: see(part) or see(frame))
    full_s = median_s(lambda: see(frame))
    find_s = median_s(lambda: find_ball(frame.image, CAMERA))
    one_s = median_s(lambda: fit_peak(x, one))
    short_s = median_s(lambda: fit_peak(x[12:19], one[12:19], width=120.0))
    many_s = median_s(lambda: fit_peaks(lens_positions, curves))
    return {
        "vision_detect_and_clarity_640x480": row(full_s * 1e3, "ms", "numpy sum over the frame", full_s / read_s),
        "vision_frames_per_second_full": row(1.0 / full_s, "1/s", "30 frames per second", 1.0 / full_s / 30.0),
        "vision_frames_per_second_region": row(1.0 / part_s, "1/s", "30 frames per second", 1.0 / part_s / 30.0),
        "vision_detection_of_a_full_frame": row(find_s * 1e3, "ms", "the whole vision path", find_s / full_s),
        **sweep_rows(frame.image),
        "ranging_fit_peak_30": row(one_s * 1e6, "us", "108 curves at once, each", one_s / (many_s / 108)),
        "ranging_fit_peak_7": row(short_s * 1e6, "us", "30 positions, free width", short_s / one_s),
    }


def see(frame: Frame) -> object:
    """A frame to what a sighting says of it."""
    ball = find_ball(frame.image, CAMERA, (frame.roi.x, frame.roi.y))
    return ball and disc_clarity(frame, ball.centre_px, ball.radius_px)


def sweep_rows(image: np.ndarray) -> dict[str, dict]:
    """30 colour frames to the depths of 9 x 12 blocks, against one pass over their bytes and two known ways."""
    rng = np.random.default_rng(1)
    stack = np.stack([np.clip(image + rng.integers(-8, 9, image.shape), 0, 255).astype(np.uint8) for _ in range(30)])
    lens_positions = np.linspace(0, 1023, len(stack))
    rows, cols = grid(480, 50), grid(640, 50)

    def clarity() -> np.ndarray:
        return np.array([tenengrad_grid(frame, rows, cols) for frame in stack])

    def depths(fit: Callable[..., object] = block_peaks) -> object:
        return fit(lens_positions, clarity().reshape(len(stack), -1).T)

    # In one loop, so that what else the machine does falls on all of them alike.
    works = (
        lambda: pass_over(stack.reshape(-1)),
        clarity,
        depths,
        lambda: depths(fit_peaks),
        lambda: [opencv(frame) for frame in stack],
    )
    pass_s, clarity_s, depths_s, kernel_s, opencv_s = medians_s(works)
    pixel_s = median_s(lambda: [per_pixel(frame) for frame in stack[:3]], repeats=3) * len(stack) / 3
    per_robot = 1.0 / (depths_s / len(stack))
    return {
        "sweep_30x640x480_to_depths": row(depths_s * 1e3, "ms", "one pass over the bytes", depths_s / pass_s),
        "sweep_30x640x480_to_depths_by_kernel": row(kernel_s * 1e3, "ms", "one pass over the bytes", kernel_s / pass_s),
        "sweep_30x640x480_to_clarity": row(clarity_s * 1e3, "ms", "one pass over the bytes", clarity_s / pass_s),
        "sweep_against_cv2_sobel_integral": row(opencv_s * 1e3, "ms", "this clarity kernel", opencv_s / clarity_s),
        "sweep_against_per_pixel_energy": row(pixel_s * 1e3, "ms", "this clarity kernel", pixel_s / clarity_s),
        "sweep_frames_per_second_one_core": row(per_robot, "1/s", "30 frames per second", per_robot / 30.0),
    }


@compiled()
def pass_over(data: np.ndarray) -> np.uint64:
    """Sum of all bytes: the least that can be done with each of them."""
    total = np.uint64(0)
    for k in range(data.size):
        total += data[k]
    return total


def opencv(image: np.ndarray) -> np.ndarray:
    """The usual way: two float gradients, the integral of their squares, differences at the corners of blocks."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    gx, gy = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    total = cv2.integral(gx * gx + gy * gy)[0:451:50, 0:601:50]
    return np.diff(np.diff(total, axis=0), axis=1)


def per_pixel(image: np.ndarray) -> np.ndarray:
    """What programs for focus stacking do: energy of the Laplacian around every pixel, over a Gaussian window."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    edges = cv2.Laplacian(cv2.GaussianBlur(grey, (5, 5), 0), cv2.CV_64F, ksize=5)
    return cv2.GaussianBlur(edges * edges, (0, 0), 8.0)


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
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return statistics.median(times)


def medians_s(works: tuple[Callable[[], object], ...], repeats: int = 25) -> list[float]:
    """Medians of several works, done in turn."""
    times: list[list[float]] = [[] for _ in works]
    for work in works:
        work()
    for _ in range(repeats):
        for work, taken in zip(works, times, strict=True):
            start = time.thread_time()
            work()
            taken.append(time.thread_time() - start)
    return [statistics.median(taken) for taken in times]


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
