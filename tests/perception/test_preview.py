"""Previews: never too large, never too often, never of a part of a frame."""

import cv2
import numpy as np
import pytest

from agent.core.codec import decode, encode
from agent.core.messages import MAX_JPEG, Image
from agent.core.step_io import Sighting
from agent.core.topics import IMAGE
from agent.perception.enhancement.enhance import Enhancer, OnDemandEnhancer
from agent.perception.vision import KEPT_BYTES, Preview, compressed
from hw.camera.camera import Frame, Roi

WHOLE = (640, 480)
ALL = Roi(0, 0, *WHOLE)
MS = 1_000_000


def frame(image: np.ndarray | None = None, roi: Roi = ALL, t_ns: int = 0) -> Frame:
    image = np.full((roi.height, roi.width, 3), 60, np.uint8) if image is None else image
    return Frame(t_ns, 5, image, roi)


def sighting(t_ns: int = 7) -> Sighting:
    return Sighting(t_ns=t_ns, frame=5, focus=300, target="ball", found=False)


def noise(width: int, height: int) -> np.ndarray:
    """What compresses worst."""
    return np.random.default_rng(1).integers(0, 256, (height, width, 3), np.uint8)


def seen(image: Image) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(image.jpeg, np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.parametrize("size", [(640, 480), (1920, 1080), (480, 2000), (64, 64)])
def test_the_worst_picture_fits(size: tuple[int, int]) -> None:
    small, jpeg = compressed(noise(*size))
    height, width = small.shape[:2]
    assert len(jpeg) <= MAX_JPEG
    assert width <= 640
    assert abs(width / height - size[0] / size[1]) < 0.01
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == small.shape


def test_a_picture_is_no_worse_than_it_must_be() -> None:
    grain = cv2.GaussianBlur(noise(*WHOLE), (0, 0), 3.0)
    small, jpeg = compressed(grain)
    assert small is grain
    assert jpeg == cv2.imencode(".jpg", grain, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()


def test_a_preview_says_what_it_shows_and_fits_its_row() -> None:
    image = Preview("r1", WHOLE, 2.0).of(frame(noise(*WHOLE)), sighting(), 9)
    assert image is not None
    assert (image.robot, image.seq, image.sent_ns, image.t_ns, image.frame, image.focus) == ("r1", 0, 9, 7, 5, 300)
    assert seen(image).shape == (image.height_px, image.width_px, 3)
    assert not image.enhanced
    payload = encode(image)
    assert decode(payload, Image, IMAGE.limit) == image
    assert len(payload) <= 65535  # one batch of Zenoh
    room = IMAGE.limit - MAX_JPEG
    assert len(payload) - len(image.jpeg) < room / 2


@pytest.mark.parametrize("hz", [0.5, 2.0, 5.0])
def test_previews_keep_to_their_rate(hz: float) -> None:
    preview, made_ns = Preview("r1", WHOLE, hz), []
    for now_ns in range(0, 20_000 * MS, 33 * MS):
        if preview.of(frame(), sighting(), now_ns) is not None:
            made_ns.append(now_ns)
    gaps_s = np.diff(made_ns) * 1e-9
    assert gaps_s.min() >= 1 / hz
    assert gaps_s.max() <= 1 / hz + 0.034  # the next frame


def test_a_rate_of_zero_switches_them_off() -> None:
    preview = Preview("r1", WHOLE, 0.0)
    assert [preview.of(frame(), sighting(), k * 10**9) for k in range(3)] == [None] * 3


def test_a_part_of_a_frame_is_no_preview_and_does_not_use_up_the_time_of_one() -> None:
    preview = Preview("r1", WHOLE, 2.0)
    assert preview.of(frame(roi=Roi(8, 16, 240, 240)), sighting(), 0) is None
    assert preview.of(frame(), sighting(), 1) is not None


def test_previews_are_counted_without_gaps() -> None:
    preview = Preview("r1", WHOLE, 5.0)
    made = [preview.of(frame(), sighting(), k * 100 * MS) for k in range(20)]
    assert [image.seq for image in made if image is not None] == list(range(10))


def test_an_enhanced_preview_is_what_vision_looks_at() -> None:
    enhancer = OnDemandEnhancer(Enhancer("classic", lambda image: image + 90))
    image = Preview("r1", WHOLE, 2.0, enhancer).of(frame(), sighting(), 0)
    assert image is not None
    assert image.enhanced
    assert seen(image).mean() == pytest.approx(150, abs=1)


def test_without_colours_a_preview_goes_out_raw_at_once() -> None:
    """The processor is busy elsewhere: the estimate before took so long that the next one has to wait."""
    clock_s = 0.0

    def estimate(image: np.ndarray) -> None:
        nonlocal clock_s
        clock_s += 2.0

    enhancer = OnDemandEnhancer(Enhancer("fast", lambda image: image, estimate), lambda: clock_s)
    preview = Preview("r1", WHOLE, 2.0, enhancer)
    for k in range(4):  # of eight seconds of rest after the estimate two have passed
        clock_s += 0.5
        image = preview.of(frame(t_ns=k * 10**9), sighting(), k * 10**9)
        assert image is not None and not image.enhanced
        assert seen(image).mean() == pytest.approx(60, abs=1)
    assert clock_s == 4.0


def test_frames_that_were_shown_are_kept_for_a_while_where_somebody_may_draw_in_them() -> None:
    many = 3 * KEPT_BYTES // frame().image.nbytes
    for keep in (False, True):
        preview = Preview("r1", WHOLE, 2.0, keep=keep)
        images = [np.full((480, 640, 3), i % 256, np.uint8) for i in range(many)]
        for i, image in enumerate(images):
            assert preview.of(Frame(0, i, image, ALL), sighting(), 500 * MS * i) is not None
        assert (preview.frame(many - 1) is images[-1]) is keep and preview.frame(0) is None
        kept = sum(preview.frame(i) is not None for i in range(many))
        assert kept == (KEPT_BYTES // images[0].nbytes if keep else 0)


def test_the_rate_can_be_changed_on_the_way() -> None:
    preview = Preview("r1", WHOLE, 2.0)
    assert preview.of(frame(), sighting(), 0) is not None
    preview.set_rate(0.0)
    assert preview.of(frame(), sighting(), 10_000 * MS) is None
    preview.set_rate(5.0)
    shown = [preview.of(frame(), sighting(), 10_000 * MS + 50 * MS * i) is not None for i in range(40)]
    assert sum(shown) == 10
