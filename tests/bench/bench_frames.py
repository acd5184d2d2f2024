"""What the parts of perception take of a frame of 640x480, on one thread."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from agent.core.config import Link
from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.focus import fit_peak, fit_peaks
from agent.core.step_io import Sighting
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.perception.clarity import around, block_peaks, disc_clarity, grid, tenengrad_grid
from agent.perception.detection.detect import find_ball
from agent.perception.enhancement import enhance
from agent.perception.flow import begin, follow
from agent.perception.tags import find_tags
from agent.perception.tracking.appearance import Box, remember, search
from agent.perception.tracking.follow import Follower, load_box_tracker, model_files
from agent.perception.vision import Preview
from agent.process.command import Failed
from hw.camera.camera import Frame, Roi
from hw.compiled import compiled
from tests.bench.timing import QUICK, REPETITIONS, Settings, Told, median_figures, medians_ms, one_thread
from tests.perception import floor
from tests.perception.printed import WALL, photograph, tag_light, turned
from tests.perception.tracking.swimming import clip
from tests.places import DATA, ROOT

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5, bend=0.392)
WHOLE = Roi(0, 0, 640, 480)
PREVIEW_HZ = Link().preview_hz
NANOTRACK = DATA / "models" / "nanotrack_v2"


# --- a ball, and how sharp it is ---


def detection(times: int) -> Row:
    frame = ball()
    found = find_ball(frame.image, CAMERA)
    if found is None:
        raise Failed("the ball of this claim's own picture was not found")
    roi = around(found.centre_px, found.radius_px, (640, 480)) or WHOLE
    part = frame._replace(image=frame.image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width].copy(), roi=roi)
    lens = np.linspace(0, 1023, 30)
    curves = 1000 / (1 + ((lens - np.linspace(200, 800, 108)[:, None]) / 120) ** 2) + 50
    x, one = lens.tolist(), curves[40].tolist()
    ways = {
        "sum": lambda: frame.image.sum(),
        "whole": lambda: see(frame),
        "region": lambda: see(part) or see(frame),
        "peak": lambda: fit_peak(x, one),
        "peaks": lambda: fit_peaks(lens, curves),
    }
    row = medians_ms(ways, times)
    rates = {"whole_hz": 1e3 / row["whole"], "region_hz": 1e3 / row["region"]}
    return {**row, **rates, "peak_of_many": row["peaks"] / len(curves)}


def see(frame: Frame) -> object:
    """A frame to what a sighting says of it."""
    found = find_ball(frame.image, CAMERA, (frame.roi.x, frame.roi.y))
    return found and disc_clarity(frame, found.centre_px, found.radius_px)


def ball() -> Frame:
    """A mottled red disc of 178 px on grey, 0.46 m away; cost depends on its size, not on its beauty."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:480, :640]
    red = ((u - 330) ** 2 + (v - 235) ** 2 < 178**2)[..., None]
    grain = cv2.GaussianBlur(rng.normal(0, 1, (480, 640)), (0, 0), 1.5)[..., None]
    light = np.where(red, np.array([60, 60, 160]) + 80 * grain, 120 + 40 * grain) + rng.normal(0, 2, (480, 640, 3))
    return Frame(0, 0, np.clip(light, 0, 255).astype(np.uint8), WHOLE)


# --- a focus sweep ---


def sweep(times: int) -> Row:
    """30 colour frames to the depths of 9 x 12 blocks, against one pass over their bytes and two known ways."""
    rng, image = np.random.default_rng(1), ball().image
    stack = np.stack([np.clip(image + rng.integers(-8, 9, image.shape), 0, 255).astype(np.uint8) for _ in range(30)])
    lens, rows, cols = np.linspace(0, 1023, len(stack)), grid(480, 50), grid(640, 50)

    def clarity() -> np.ndarray:
        return np.array([tenengrad_grid(frame, rows, cols) for frame in stack])

    def depths(fit: Callable[..., object]) -> object:
        return fit(lens, clarity().reshape(len(stack), -1).T)

    ways = {
        "pass": lambda: pass_over(stack.reshape(-1)),
        "clarity": clarity,
        "depths": lambda: depths(block_peaks),
        "by_kernel": lambda: depths(fit_peaks),
        "sobel": lambda: [sobel_integral(frame) for frame in stack],
    }
    row = medians_ms(ways, times)
    tenth = medians_ms({"per_pixel": lambda: [per_pixel(frame) for frame in stack[:3]]}, 3)
    return {**row, "per_pixel": 10.0 * tenth["per_pixel"], "frames_hz": 1e3 * len(stack) / row["depths"]}


@compiled()
def pass_over(data: np.ndarray) -> np.uint64:
    """Sum of all bytes: the least that can be done with each of them, a tenth of the time of numpy's own sum."""
    total = np.uint64(0)
    for k in range(data.size):
        total += data[k]
    return total


def sobel_integral(image: np.ndarray) -> np.ndarray:
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


# --- tags and flow ---


def tags(times: int) -> Row:
    """Of a frame with five tags and one without any; flow of a floor, against OpenCV's at full size alone."""
    light = np.full((480, 640), WALL)
    empty = photograph(light, 3.0, 0.02)
    for k in range(5):
        middle_m = (0.13 * (k % 3) - 0.13, 0.14 * (k // 3) - 0.07, 0.80)
        tag_light(CAMERA, k, turned(8 * k, 10, 20 * k), middle_m, light)
    five = photograph(light, 3.0, 0.02)
    if len(find_tags(five, CAMERA)) != 5:
        raise Failed("the tags of this claim's own picture were not found")
    texture = floor.texture()
    here, there = (
        floor.frame(texture, CAMERA, *floor.pose(x, 0.0, deg), seed=3) for x, deg in ((0.0, 0.0), (0.03, 1.0))
    )
    key = begin(here, CAMERA, 0)
    points, planes, five_grey = (
        key.points_px.reshape(-1, 1, 2),
        [here[..., 1].copy(), there[..., 1].copy()],
        five[..., 1].copy(),
    )
    by_default = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    ways = {
        "five": lambda: find_tags(five, CAMERA),
        "none": lambda: find_tags(empty, CAMERA),
        "opencv": lambda: by_default.detectMarkers(five_grey),
        "flow": lambda: follow(key, there, 1),
        "key": lambda: begin(here, CAMERA, 0),
        "full_flow": lambda: cv2.calcOpticalFlowPyrLK(*planes, points, None, winSize=(21, 21), maxLevel=4),
    }
    return medians_ms(ways, times)


# --- enhancement ---


def enhancement(times: int) -> Row:
    """By weights that are drawn: they do not matter to what it takes."""
    frame = textured()
    ways = enhancers()
    colours = ways["fast"].estimate(frame)
    works = {way: partial(enhancer.apply, frame) for way, enhancer in ways.items()}
    works["known_colours"] = lambda: enhance.apply_colours(colours, frame)
    works["classic"] = lambda: enhance.classic(frame)
    return medians_ms(works, times)


def enhancers() -> dict[str, enhance.Enhancer]:
    """Raises Failed without torch."""
    try:
        import torch

        from agent.perception.enhancement.lu2net import LU2Net
    except ImportError:
        raise Failed("the network needs torch: pip install 'aucamp[enhance]'") from None
    torch.manual_seed(0)
    net = LU2Net().eval().to(memory_format=torch.channels_last)
    return {way: enhance.network_enhancer(net, way) for way in ("plain", "folded", "fast")}


def memory(times: int) -> Row:
    """MB that each way takes on top of a process with torch."""
    peaks = {way: peak_mb(way) for way in ("nothing", *enhancers())}
    return {way: peak - peaks["nothing"] for way, peak in peaks.items()}


def peak_mb(way: str) -> float:
    """Largest resident size of a process that enhances three frames in one way."""
    code = f"from tests.bench.bench_frames import print_peak; print_peak({way!r})"
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, cwd=ROOT)
    return float(ran.stdout)


def print_peak(way: str) -> None:
    ways = enhancers()
    for _ in range(3):
        if way in ways:
            ways[way].apply(textured())
    status = Path("/proc/self/status").read_text(encoding="ascii")  # ru_maxrss would hold the parent's as well
    peak_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    print(peak_kb / 1024)


def textured() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.clip(cv2.GaussianBlur(rng.normal(110, 300, (480, 640, 3)), (0, 0), 3.0), 0, 255).astype(np.uint8)


# --- previews ---


def preview(times: int) -> Row:
    """Raw and enhanced. Each enhanced one has an estimate of the colours of its own, as where vision needs none."""
    frame, now_ns = ball(), 0
    seen = Sighting(t_ns=0, frame=0, target="ball", found=False)
    # On a core that is never busy elsewhere.
    enhancer = enhance.OnDemandEnhancer(enhance.default(), clock=lambda: now_ns * 1e-9)
    raw = Preview("r1", (640, 480), PREVIEW_HZ)
    enhanced = Preview("r1", (640, 480), PREVIEW_HZ, enhancer)

    def made(preview: Preview) -> None:
        nonlocal now_ns
        now_ns += max(round(1e9 / PREVIEW_HZ), enhance.DUE_NS)  # the next preview and the next estimate are due
        assert preview.of(frame._replace(t_ns=now_ns), seen, now_ns) is not None

    ways = {
        "find": lambda: find_ball(frame.image, CAMERA),
        "raw": lambda: made(raw),
        "enhanced": lambda: made(enhanced),
    }
    row = medians_ms(ways, times)
    assert enhancer.raw == 0
    return {**row, **{f"{way}_core": 0.1 * PREVIEW_HZ * row[way] for way in ("raw", "enhanced")}}


# --- a thing in a box ---


def track(times: int) -> Row:
    """In clips of 480x360 by each tracker, and one search of a whole picture for what was lost."""
    image, box = next(clip(1))
    image, drawn = cv2.resize(image, (640, 480)), Box(*(4.0 / 3.0 * side for side in box))
    looks = remember(image, drawn)._replace(newest=remember(image, drawn.moved(5.0, 5.0)).first)
    ways = {"search": lambda: search(looks, image, drawn), "filter": followed(None, times)}
    if NANOTRACK.is_dir():
        ways["nanotrack"] = followed(model_files(NANOTRACK), times)
    row = medians_ms(ways, times)
    return {**row, **{f"{way}_hz": 1e3 / row[way] for way in ways if way != "search"}}


def followed(files: tuple[Path, Path] | None, times: int) -> Callable[[], object]:
    """Looks at the next frame of a clip each time."""
    pictures = [image for image, _ in clip(times + 2)]
    follower, (_, box) = Follower(load_box_tracker(files)), next(clip(1))
    follower.start(pictures[0], Box(*box))
    rest = iter(pictures[1:])
    return lambda: follower.look(next(rest))


# --- the claim ---

CASES: dict[str, Callable[[int], Row]] = {
    "detection": detection,
    "sweep": sweep,
    "tags": tags,
    "enhancement": enhancement,
    "memory": memory,
    "preview": preview,
    "track": track,
}

FIGURES = {
    "detection_ms": Told("detection", "whole"),
    "detection": Told("detection", "whole", "sum"),
    "whole_hz": Told("detection", "whole_hz"),
    "region_hz": Told("detection", "region_hz"),
    "peak": Told("detection", "peak", "peak_of_many"),
    "sweep": Told("sweep", "depths", "pass"),
    "sweep_clarity": Told("sweep", "clarity", "pass"),
    "sweep_kernel": Told("sweep", "by_kernel", "pass"),
    "sweep_sobel": Told("sweep", "sobel", "clarity"),
    "sweep_per_pixel": Told("sweep", "per_pixel", "clarity"),
    "sweep_hz": Told("sweep", "frames_hz"),
    "tags_ms": Told("tags", "five"),
    "tags": Told("tags", "five", "opencv"),
    "no_tags": Told("tags", "none", "five"),
    "flow_ms": Told("tags", "flow"),
    "flow": Told("tags", "flow", "full_flow"),
    "flow_key": Told("tags", "key", "flow"),
    "plain_ms": Told("enhancement", "plain"),
    "folded": Told("enhancement", "folded", "plain"),
    "fast": Told("enhancement", "fast", "plain"),
    "fast_ms": Told("enhancement", "fast"),
    "known_colours": Told("enhancement", "known_colours", "fast"),
    "classic": Told("enhancement", "classic", "fast"),
    "plain_mb": Told("memory", "plain"),
    "folded_memory": Told("memory", "folded", "plain"),
    "fast_memory": Told("memory", "fast", "plain"),
    "preview": Told("preview", "raw", "find"),
    "preview_enhanced": Told("preview", "enhanced", "raw"),
    "preview_core": Told("preview", "raw_core"),
    "enhanced_core": Told("preview", "enhanced_core"),
    "search_ms": Told("track", "search"),
    "filter_hz": Told("track", "filter_hz"),
    "nanotrack_hz": Told("track", "nanotrack_hz"),
    "nanotrack": Told("track", "nanotrack", "filter"),
}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where what a case needs is not installed."""
    with one_thread():
        return [CASES[case](settings.times)]


def summary(rows: Rows) -> dict[str, Value]:
    return median_figures(rows, FIGURES)


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick=QUICK,
    cases=tuple(CASES),
    measured_on="this machine",
    figures=(
        Figure("detection_ms", "a ball found in a whole frame, and its clarity", "ms"),
        Figure("detection", "the same, against numpy's sum over the frame", "times"),
        Figure("whole_hz", "whole frames that one core sees", "1/s"),
        Figure("region_hz", "regions of a frame that one core sees", "1/s"),
        Figure("peak", "a focus peak alone, against one of 108 fitted at once", "times"),
        Figure("sweep", "30 frames to depths, against one pass over their bytes", "times"),
        Figure("sweep_clarity", "their clarity alone, against that pass", "times"),
        Figure("sweep_kernel", "depths by the kernel's peak fit, against that pass", "times"),
        Figure("sweep_sobel", "OpenCV's gradients and integral, against our clarity", "times"),
        Figure("sweep_per_pixel", "energy around each pixel, against our clarity", "times"),
        Figure("sweep_hz", "frames of a sweep that one core turns to depths", "1/s"),
        Figure("tags_ms", "five tags found in a frame", "ms"),
        Figure("tags", "the same, against OpenCV's detector as it comes", "times"),
        Figure("no_tags", "a frame without tags, against one with five", "times"),
        Figure("flow_ms", "points followed to the next frame", "ms"),
        Figure("flow", "the same, against OpenCV's at full size, 21 px and 5 levels", "times"),
        Figure("flow_key", "new points chosen in a frame, against following them", "times"),
        Figure("plain_ms", "enhanced by the network as it is trained", "ms"),
        Figure("folded", "folded, against plain", "times"),
        Figure("fast", "fast, against plain", "times"),
        Figure("fast_ms", "enhanced fast", "ms"),
        Figure("known_colours", "with colours estimated before, against fast", "times"),
        Figure("classic", "without a network, against fast", "times"),
        Figure("plain_mb", "memory of plain, on top of torch", "MB"),
        Figure("folded_memory", "memory of folded, against plain", "times"),
        Figure("fast_memory", "memory of fast, against plain", "times"),
        Figure("preview", "a raw preview, against detection in the frame", "times"),
        Figure("preview_enhanced", "an enhanced preview, against a raw one", "times"),
        Figure("preview_core", "two raw previews a second", "% of a core"),
        Figure("enhanced_core", "two enhanced previews a second", "% of a core"),
        Figure("search_ms", "one search of a whole picture for a lost thing", "ms"),
        Figure("filter_hz", "frames of 480x360 in which the filter follows a box", "1/s"),
        Figure("nanotrack_hz", "the same by NanoTrack", "1/s"),
        Figure("nanotrack", "NanoTrack, against the filter", "times"),
    ),
    seeds=REPETITIONS,
    alone=True,
    explanation="""Processor time of one thread; all ways of a case are taken in turn. A ratio holds on other machines
        too, as far as their memory and compilers are alike. NanoTrack's figures are there where its weights are.""",
)
