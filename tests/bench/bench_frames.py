"""What the parts of perception take of a frame of 640x480, on one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from agent.core.config import Link
from agent.core.step_io import Sighting
from agent.experiments.claim import Figure, Row
from agent.perception.clarity import around, block_peaks, disc_clarity, grid, tenengrad_grid
from agent.perception.detection.detect import find_ball
from agent.perception.enhancement import enhance
from agent.perception.flow import begin, follow
from agent.perception.tags import find_tags
from agent.perception.tracking.appearance import Box, remember, search
from agent.perception.tracking.follow import Follower, load_box_tracker
from agent.perception.vision import Preview
from agent.process.command import Failed
from hw.camera.camera import Frame, Roi
from hw.compiled import compiled
from tests.bench.timing import Settings, claim_of_costs, medians_ms, one_thread
from tests.perception import floor
from tests.perception.painted import CAMERA, ball_frame
from tests.perception.printed import WALL, photograph, tag_light, turned
from tests.perception.tracking.swimming import clip

WHOLE = Roi(0, 0, 640, 480)
PREVIEW_HZ = Link().preview_hz


def ball() -> Frame:
    """Of 7 cm, 0.46 m away: a disc of 178 px."""
    return Frame(0, 0, ball_frame((0.0, 0.0, 0.46)), WHOLE)


def detection(times: int) -> Row:
    """A frame to what a sighting says of it."""
    frame = ball()
    found = find_ball(frame.image, CAMERA)
    if found is None:
        raise Failed("the ball of this claim's own picture was not found")
    roi = around(found.centre_px, found.radius_px, (640, 480)) or WHOLE
    part = frame._replace(image=frame.image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width].copy(), roi=roi)

    def see(frame: Frame) -> None:
        found = find_ball(frame.image, CAMERA, (frame.roi.x, frame.roi.y))
        assert found is not None
        disc_clarity(frame, found.centre_px, found.radius_px)

    row = medians_ms(
        {"sum": lambda: frame.image.sum(), "whole": lambda: see(frame), "region": lambda: see(part)}, times
    )
    return {**row, "whole_hz": 1e3 / row["whole"], "region_hz": 1e3 / row["region"]}


# --- a focus sweep ---


def sweep(times: int) -> Row:
    """30 colour frames to the depths of 9 x 12 blocks, against one pass over their bytes, and the usual way."""
    rng, image = np.random.default_rng(1), ball().image
    stack = np.stack([np.clip(image + rng.integers(-8, 9, image.shape), 0, 255).astype(np.uint8) for _ in range(30)])
    lens, rows, cols = np.linspace(0, 1023, len(stack)), grid(480, 50), grid(640, 50)

    def clarity() -> np.ndarray:
        return np.array([tenengrad_grid(frame, rows, cols) for frame in stack])

    ways = {
        "pass": lambda: pass_over(stack.reshape(-1)),
        "clarity": clarity,
        "depths": lambda: block_peaks(lens, clarity().reshape(len(stack), -1).T),
        "sobel": lambda: [sobel_integral(frame) for frame in stack],
    }
    row = medians_ms(ways, times)
    return {**row, "frames_hz": 1e3 * len(stack) / row["depths"]}


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


def landmarks(times: int) -> Row:
    """Of a frame with five tags, and the flow of a floor; beside them OpenCV's detector, and its flow at full size."""
    light = np.full((480, 640), WALL)
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
    points, greys = key.points_px.reshape(-1, 1, 2), [image[..., 1].copy() for image in (here, there, five)]
    as_it_comes = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    ways = {
        "tags": lambda: find_tags(five, CAMERA),
        "opencv_tags": lambda: as_it_comes.detectMarkers(greys[2]),
        "flow": lambda: follow(key, there, 1),
        "full_flow": lambda: cv2.calcOpticalFlowPyrLK(*greys[:2], points, None, winSize=(21, 21), maxLevel=4),
    }
    return medians_ms(ways, times)


def enhancement(times: int) -> Row:
    """By weights that are drawn: they do not matter to what it takes. Raises Failed without torch."""
    try:
        import torch

        from agent.perception.enhancement.lu2net import LU2Net
    except ImportError:
        raise Failed("the network needs torch: pip install 'aucamp[enhance]'") from None
    torch.manual_seed(0)
    net, frame = LU2Net().eval().to(memory_format=torch.channels_last), ball().image
    ways = {way: enhance.network_enhancer(net, way) for way in ("plain", "folded", "fast")}
    colours = ways["fast"].estimate(frame)
    works = {way: partial(enhancer.apply, frame) for way, enhancer in ways.items()}
    works["known_colours"] = lambda: enhance.apply_colours(colours, frame)
    works["classic"] = lambda: enhance.classic(frame)
    return medians_ms(works, times)


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

    row = medians_ms({"raw": lambda: made(raw), "enhanced": lambda: made(enhanced)}, times)
    assert enhancer.raw == 0
    return {**row, **{f"{way}_core": 0.1 * PREVIEW_HZ * ms for way, ms in row.items()}}


def track(times: int) -> Row:
    """By the filter, in a clip of 480x360; and one search of a whole picture for what was lost."""
    pictures, (image, box) = [picture for picture, _ in clip(times + 2)], next(clip(1))
    follower = Follower(load_box_tracker(None))
    follower.start(image, Box(*box))
    rest = iter(pictures[1:])
    image, drawn = cv2.resize(image, (640, 480)), Box(*(4.0 / 3.0 * side for side in box))
    looks = remember(image, drawn)._replace(newest=remember(image, drawn.moved(5.0, 5.0)).first)
    row = medians_ms(
        {"search": lambda: search(looks, image, drawn), "filter": lambda: follower.look(next(rest))}, times
    )
    return {**row, "filter_hz": 1e3 / row["filter"]}


# --- the claim ---

PARTS: tuple[Callable[[int], Row], ...] = (detection, sweep, landmarks, enhancement, preview, track)
CASES = {part.__name__: part for part in PARTS}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where what a case needs is not installed."""
    with one_thread():
        return [CASES[case](settings.times)]


CLAIM = claim_of_costs(
    run=run,
    cases=CASES,
    figures=(
        Figure("detection.whole", "a ball found in a whole frame, and its clarity", "ms"),
        Figure("detection.whole/sum", "the same, against numpy's sum over the frame", "times"),
        Figure("detection.whole_hz", "whole frames that one core sees", "1/s", least=30.0),
        Figure("detection.region_hz", "regions of a frame that one core sees", "1/s", least=30.0),
        Figure("sweep.depths/pass", "30 frames to depths, against one pass over their bytes", "times", most=4.0),
        Figure("sweep.clarity/pass", "their clarity alone, against that pass", "times"),
        Figure("sweep.sobel/clarity", "OpenCV's gradients and integral, against our clarity", "times"),
        Figure("sweep.frames_hz", "frames of a sweep that one core turns to depths", "1/s", least=30.0),
        Figure("landmarks.tags", "five tags found in a frame", "ms"),
        Figure("landmarks.tags/opencv_tags", "the same, against OpenCV's detector as it comes", "times"),
        Figure("landmarks.flow", "points followed to the next frame", "ms"),
        Figure("landmarks.flow/full_flow", "the same, against OpenCV's at full size, 21 px, 5 levels", "times"),
        Figure("enhancement.plain", "a frame enhanced by the network as it is trained", "ms"),
        Figure("enhancement.folded/plain", "folded, against plain", "times"),
        Figure("enhancement.fast/plain", "fast, against plain", "times"),
        Figure("enhancement.fast", "a frame enhanced fast", "ms", most=33.0),
        Figure("enhancement.known_colours/fast", "by colours estimated before, against fast", "times"),
        Figure("enhancement.classic/fast", "without a network, against fast", "times"),
        Figure("preview.raw_core", "two raw previews a second", "% of a core", most=100.0 * enhance.SHARE),
        Figure("preview.enhanced_core", "two enhanced previews a second", "% of a core", most=100.0 * enhance.SHARE),
        Figure("track.search", "one search of a whole picture for a lost thing", "ms", most=30.0),
        Figure("track.filter_hz", "frames of 480x360 in which the filter follows a box", "1/s"),
    ),
    explanation="""Processor time of one thread; all ways of a case are taken in turn. A ratio holds on other machines
        too, as far as their memory and compilers are alike.""",
)
