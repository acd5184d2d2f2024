"""Tags and flow of a 640x480 frame, one thread's CPU time, and how far off corners are at each blur.

Pictures are drawn by the tests' own renderer: 40 tags of 8 cm from 0.3 to 0.9 m, turned by up to 70 degrees, noise of
2 % of full light.
"""

import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

from agent.core.ranging.camera_model import CameraFit
from agent.perception.flow import begin, follow
from agent.perception.tags import find_tags
from tests.perception.floor import frame, pose, texture
from tests.perception.printed import WALL, bend, corner_slopes, photograph, tag_light, turned

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1184.0, cx_px=319.5, cy_px=239.5, bend=0.392)
NOISE = 0.02
BLURS_PX = (0.0, 4.0, 8.0, 12.0)  # diameters of the disc
POSES = 40
SEED = 77  # no test's


def run() -> dict[str, dict]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return {**costs(), **errors()}
    finally:
        cv2.setNumThreads(threads)


def costs() -> dict[str, dict]:
    five = [(k, turned(8 * k, 10, 20 * k), (0.13 * (k % 3) - 0.13, 0.14 * (k // 3) - 0.07, 0.80)) for k in range(5)]
    tags, empty = photograph(lit(*five), 3.0, NOISE), photograph(lit(), 3.0, NOISE)
    if len(find_tags(tags, CAMERA)) != len(five):
        raise RuntimeError("the bench's own tags were not found")
    default = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    plane = tags[..., 1].copy()
    tags_s, empty_s = median_s(lambda: find_tags(tags, CAMERA)), median_s(lambda: find_tags(empty, CAMERA))
    default_s = median_s(lambda: default.detectMarkers(plane))
    floor = texture()
    here, there = (frame(floor, CAMERA, *pose(x, 0.0, deg), seed=3) for x, deg in ((0.0, 0.0), (0.03, 1.0)))
    key = begin(here, CAMERA, 0)
    points = key.points_px.reshape(-1, 1, 2)
    flow_s, key_s = median_s(lambda: follow(key, there, 1)), median_s(lambda: begin(here, CAMERA, 0))
    planes = here[..., 1].copy(), there[..., 1].copy()
    full_s = median_s(
        lambda: cv2.calcOpticalFlowPyrLK(*planes, points, None, winSize=(21, 21), maxLevel=4)  # as it was designed
    )
    return {
        "tags_frame_of_five_640x480": row(1e3 * tags_s, "ms", "OpenCV's detector by default", tags_s / default_s),
        "tags_frame_without_640x480": row(1e3 * empty_s, "ms", "a frame of five", empty_s / tags_s),
        "flow_frame_640x480": row(1e3 * flow_s, "ms", "full size alone, 21 px and 5 levels", flow_s / full_s),
        "flow_key_frame_640x480": row(1e3 * key_s, "ms", "a frame", key_s / flow_s),
    }


def errors() -> dict[str, dict]:
    """Of corners less their mean, rms over both axes, tags with edges alone; the same of OpenCV's corner finder."""
    rng = np.random.default_rng(SEED)
    drawn = []
    while len(drawn) < POSES:
        rotation = turned(*rng.uniform((-70, -60, -180), (70, 60, 180)))
        middle = tuple(rng.uniform((-0.15, -0.09, 0.3), (0.15, 0.09, 0.9)))
        px = bend(CAMERA, corner_slopes(rotation, middle))
        if ((px > 12) & (px < (627, 467))).all() and np.hypot(*(np.roll(px, 1, axis=0) - px).T).min() > 24:
            drawn.append((lit((0, rotation, middle)), px))
    rows = {}
    for blur_px in BLURS_PX:
        ours, theirs = [], []
        for k, (light, px) in enumerate(drawn):
            image = photograph(light, blur_px, NOISE, seed=k)
            for one in find_tags(image, CAMERA):
                if one.seen.edges:
                    ours.append(shape(one.corners_px - px))
                    theirs.append(shape(searched(image, one.corners_px) - px))
        name, error = f"tags_corners_at_blur_of_{blur_px:.0f}_px", rms(ours)
        rows[name] = row(error, "px", f"cornerSubPix, {len(ours)} of {POSES} tags", error / rms(theirs))
    return rows


def lit(*tags: tuple) -> np.ndarray:
    light = np.full((CAMERA.height_px, CAMERA.width_px), WALL)
    for tag in tags:
        tag_light(CAMERA, *tag, light)
    return light


def searched(image: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """From the best start there is."""
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    start = corners_px.astype(np.float32).reshape(4, 1, 2)
    return cv2.cornerSubPix(image[..., 1].copy(), start, (5, 5), (-1, -1), stop).reshape(4, 2)


def shape(error_px: np.ndarray) -> np.ndarray:
    return error_px - error_px.mean(axis=0)


def rms(errors_px: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.square(errors_px))))


def median_s(work: Callable[[], object], repeats: int = 31) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return statistics.median(times)


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
