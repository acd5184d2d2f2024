"""What previews take of a core: two a second of frames of 640x480, as the camera gave them and enhanced, one thread.

CPU time of the thread, so that other programs do not count. Enhanced, each has an estimate of the colours of its own,
as it has where vision needs none.
"""

import cv2

from agent.core.config import Link
from agent.core.step_io import Sighting
from agent.perception.detection.detect import find_ball
from agent.perception.enhancement.enhance import DUE_NS, SHARE, OnDemandEnhancer, default, one_thread
from agent.perception.vision import Preview
from hw.camera.camera import Frame
from tests.bench.bench_vision import CAMERA, ball, medians_s, row

WHOLE = (640, 480)
HZ = Link().preview_hz


def run() -> dict[str, dict]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    one_thread()
    try:
        return measure()
    finally:
        cv2.setNumThreads(threads)


def measure() -> dict[str, dict]:
    frame, at = ball(), Clock()
    seen = Sighting(t_ns=0, frame=0, target="ball", found=False)
    raw = Preview("r1", WHOLE, HZ)
    enhancer = OnDemandEnhancer(default(), clock=lambda: at.now_ns * 1e-9)  # a core that is never busy elsewhere
    enhanced = Preview("r1", WHOLE, HZ, enhancer)

    def made(preview: Preview) -> None:
        image = preview.of(at.next(frame), seen, at.now_ns)
        assert image is not None

    find_s, raw_s, enhanced_s = medians_s(
        (lambda: find_ball(frame.image, CAMERA), lambda: made(raw), lambda: made(enhanced))
    )
    assert enhancer.raw == 0
    return {
        "preview_640x480": row(1e3 * raw_s, "ms", "detection in the same frame", raw_s / find_s),
        "preview_640x480_enhanced": row(1e3 * enhanced_s, "ms", "the raw preview", enhanced_s / raw_s),
        "preview_share_of_a_core": row(1e2 * HZ * raw_s, "%", "the share estimates may take", HZ * raw_s / SHARE),
        "preview_share_of_a_core_enhanced": row(
            1e2 * HZ * enhanced_s, "%", "the share estimates may take", HZ * enhanced_s / SHARE
        ),
    }


class Clock:
    """Each frame comes when the next preview and the next estimate are due."""

    def __init__(self) -> None:
        self.now_ns = 0

    def next(self, frame: Frame) -> Frame:
        self.now_ns += max(round(1e9 / HZ), DUE_NS)
        return frame._replace(t_ns=self.now_ns)
