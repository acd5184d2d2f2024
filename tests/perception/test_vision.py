"""The worker against a scripted camera: plans, order, regions, loss and return, closing."""

from __future__ import annotations

import math
import time

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.messages import MAX_JPEG, Image
from agent.core.ranging.camera_model import TimingFit
from agent.core.ranging.focus import Peak, fit_peak
from agent.core.step_io import Sighting, SweepPlan
from agent.core.topics import IMAGE
from agent.perception import vision
from agent.perception.enhancement.enhance import Enhancer, OnDemandEnhancer
from agent.perception.vision import (
    FROZEN_FRAMES,
    FROZEN_NS,
    KEPT_BYTES,
    QUEUE,
    FrozenWatch,
    Preview,
    TimedCamera,
    check,
    compressed,
)
from hw.camera.camera import CameraError, Frame, Roi
from hw.camera.files import StackCamera
from tests.known_lens import CAMERA
from tests.perception.painted import sharp_position
from tests.perception.scripted_camera import CENTRE_M, EMPTY, ScriptedCamera
from tests.replay.small_box import FLEET, START_NS
from tests.replay.small_box import seen as sighted
from tests.sightings import collect


def test_between_plans_every_frame_is_a_sighting(worker, images):
    camera = ScriptedCamera(images=images)
    seen = collect(worker(camera), lambda s: len(s) >= 3)
    assert [s.frame for s in seen[:3]] == [1, 2, 3]
    offset_ns = seen[0].t_ns - 1_000_000  # from the stamps of a camera to the time of day
    assert [s.t_ns - offset_ns for s in seen[:3]] == [1_000_000, 2_000_000, 3_000_000]
    assert offset_ns == pytest.approx(time.time_ns() - time.monotonic_ns(), abs=1e9)
    assert all(s.found and s.sweep == 0 and s.index == -1 and s.focus is None for s in seen)
    assert not [call for call in camera.calls if call[0] == "focus"]


def test_a_frame_without_the_ball_is_a_sighting_too(worker):
    seen = collect(worker(ScriptedCamera(images=lambda _: EMPTY)), lambda s: len(s) >= 2)
    assert all(not s.found and s.centre_px is None and s.clarity is None for s in seen)


def test_a_plan_is_carried_out_in_order_and_gives_the_peak(worker, images):
    camera = ScriptedCamera(images=images)
    lens_positions = tuple(range(60, 600, 30))
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.plan(SweepPlan(sweep=7, focus=(0, *lens_positions)))
    seen = [s for s in collect(out, lambda s: any(x.index == len(lens_positions) for x in s)) if s.sweep == 7]
    assert [s.focus for s in seen] == list(lens_positions)
    assert [s.index for s in seen] == list(range(1, len(lens_positions) + 1))
    peak = fit_peak([s.focus for s in seen], [s.clarity for s in seen])
    assert isinstance(peak, Peak)
    assert peak.lens_position == pytest.approx(sharp_position(CENTRE_M[2] - 0.07), abs=6)
    assert len({s.area_px for s in seen}) == 1 or np.ptp([s.area_px for s in seen]) < 0.01 * seen[0].area_px
    reads = [call for call in camera.calls if call[0] == "read" and call[1] is not None]
    assert all(call[2] == 0.03 and call[1].width < 400 for call in reads) and len(reads) >= len(lens_positions)


def test_a_newer_plan_replaces_the_one_under_way(worker, images):
    out = worker(ScriptedCamera(images=images))
    out.plan(SweepPlan(sweep=1, focus=tuple(range(100, 600))))
    collect(out, lambda s: any(x.sweep == 1 for x in s))
    out.plan(SweepPlan(sweep=2, focus=(200, 210, 220)))
    seen = collect(out, lambda s: any(x.sweep == 2 and x.index == 2 for x in s))
    later = [s.sweep for s in seen]
    assert 1 not in later[later.index(2) :]
    with pytest.raises(ValueError, match="no lens position"):
        out.plan(SweepPlan(sweep=3, focus=()))


def test_a_lost_camera_is_opened_again(worker, images):
    first, second = ScriptedCamera(images=images), ScriptedCamera(images=images)
    out = worker(first, CameraError("still away"), second)
    collect(out, lambda s: len(s) >= 1)
    first.gone = True
    while not second.seq:
        time.sleep(0.002)
    out.drain()  # of the first camera
    seen = collect(out, lambda s: len(s) >= 1)
    assert seen and first.closed and out.errors == 2
    collect(out, lambda s: len(s) >= 1)
    assert out.fault is None


def test_no_camera_at_all_is_a_fault_with_its_reason(worker):
    out = worker()
    while out.errors < 3:
        time.sleep(0.002)
    assert "plug it in" in out.fault
    assert out.drain() == []


def test_a_camera_without_focus_refuses_plans_and_goes_on(worker, images):
    out = worker(ScriptedCamera(focusable=False, images=images))
    out.plan(SweepPlan(sweep=1, focus=(0, 100)))
    seen = collect(out, lambda s: len(s) >= 3)
    assert out.refused == 1 and all(s.sweep == 0 for s in seen)


def test_a_lens_that_cannot_be_told_is_a_fault_and_pictures_go_on(worker, images):
    """A robot finds its way by tags, which it sees without a sweep."""
    camera = ScriptedCamera(images=images)
    moves, camera.set_focus = camera.set_focus, broken
    out = worker(camera)
    out.plan(SweepPlan(sweep=1, focus=(0, 100, 200)))
    seen = collect(out, lambda s: len(s) >= 3)
    assert all(s.sweep == 0 for s in seen) and out.errors == 0
    assert out.faults == {"no camera": None, "frames frozen": None, "lens": "focus_absolute fails: Input/output error"}
    camera.set_focus = moves
    out.plan(SweepPlan(sweep=2, focus=(0, 100, 200)))
    collect(out, lambda s: any(x.sweep == 2 and x.index == 2 for x in s))
    assert out.lens is None


def broken(position):
    raise CameraError("focus_absolute fails: Input/output error")


def test_a_lens_that_reports_one_position_is_a_fault_until_it_moves(worker, images):
    camera = ScriptedCamera(images=images)
    moves, camera.set_focus = camera.set_focus, lambda position: 3
    out = worker(camera)
    sweep(out, 1)
    assert "one position wherever it is told to go" in out.faults["lens"]
    camera.set_focus = moves
    sweep(out, 2)
    assert out.lens is None


def sweep(out, number):
    """To its end: the frame after it is of none."""
    out.plan(SweepPlan(sweep=number, focus=(0, 100, 200)))
    collect(out, lambda s: [x.sweep for x in s[-2:]] == [number, 0])


def test_what_nobody_fetches_is_bounded_and_counted(worker):
    out = worker(ScriptedCamera(images=lambda _: EMPTY))
    vision.IDLE_PERIOD_S = 0.0  # as fast as it goes; the fixture puts it back
    while out.dropped < 5:
        time.sleep(0.005)
    seen = out.drain()
    assert len(seen) <= QUEUE and seen[0].frame > 1


def test_every_frame_is_offered_to_the_recording(worker, images):
    frames = []
    out = worker(
        ScriptedCamera(images=images), on_frame=lambda frame, sightings: frames.append((frame.seq, sightings[0].frame))
    )
    collect(out, lambda s: len(s) >= 3)
    assert frames[:3] == [(1, 1), (2, 2), (3, 3)]


def test_closing_does_not_wait_for_the_next_frame(worker, images, monkeypatch):
    monkeypatch.setattr(vision, "IDLE_PERIOD_S", 60.0)
    camera = ScriptedCamera(images=images)
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.close()
    assert camera.closed


# --- frame checks ---
# Frames that are none, and pictures that stand still.

SIZE = (64, 48)
WHOLE, PART = Roi(0, 0, *SIZE), Roi(8, 8, 32, 32)
MS = 1_000_000
SCENE = np.random.default_rng(3).integers(0, 256, (48, 64, 3), np.uint8)


def noisy(seed: int) -> np.ndarray:
    """The same scene, one grey level of noise in every other pixel."""
    return SCENE ^ np.random.default_rng(seed).integers(0, 2, SCENE.shape, np.uint8)


def frame(number: int, image: np.ndarray = SCENE, roi: Roi = WHOLE, still: bool = False) -> Frame:
    return Frame(number * MS, number, image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width], roi, still)


@pytest.mark.parametrize(
    ("image", "roi", "why"),
    [
        (np.zeros((0, 0, 3), np.uint8), Roi(0, 0, 0, 0), "0x0 pixels"),
        (np.zeros((48, 0, 3), np.uint8), WHOLE, "0x48 pixels for 64x48"),
        (np.zeros((47, 64, 3), np.uint8), WHOLE, "64x47 pixels for 64x48"),
        (np.zeros((48, 64), np.uint8), WHOLE, r"uint8 of shape \(48, 64\), not three bytes"),
        (np.zeros((48, 64, 4), np.uint8), WHOLE, "not three bytes"),
        (np.zeros((48, 64, 3), np.float32), WHOLE, "float32"),
        (np.zeros((48, 64, 3), np.uint8), Roi(1, 0, 64, 48), "outside its 64x48"),
        (np.zeros((8, 8, 3), np.uint8), Roi(-8, 0, 8, 8), "outside its 64x48"),
        (None, WHOLE, "NoneType"),
    ],
)
def test_what_is_no_frame_is_refused_in_one_line(image, roi, why):
    with pytest.raises(CameraError, match=why) as refused:
        check(Frame(1, 1, image, roi), SIZE)
    assert "\n" not in str(refused.value)


def test_a_frame_and_a_part_of_one_are_accepted():
    check(frame(1), SIZE)
    check(frame(2, roi=PART), SIZE)


def told(frames: list[Frame], every_ns: int = 250 * MS) -> list[str | None]:
    watch = FrozenWatch()
    return [watch.see(one, i * every_ns) for i, one in enumerate(frames)]


def test_the_same_picture_for_two_seconds_is_frozen_and_over_when_it_moves():
    frames = [frame(i, noisy(4 if 4 <= i <= 30 else i)) for i in range(40)]  # the same from 4 to 30, numbered on
    why = told(frames)
    first = 4 + FROZEN_NS // (250 * MS)
    assert why[:first] == [None] * first
    assert all(text is not None and "same picture" in text for text in why[first:31])
    assert why[31:] == [None] * 9


def test_a_sweep_of_the_lens_over_a_frozen_picture_is_frozen_too():
    """Between frames of the whole come those of a part, and the part may wander."""
    rois = [WHOLE, *[PART] * 6, WHOLE, *[PART] * 6, WHOLE, *[Roi(16, 8, 32, 32)] * 6] * 3
    why = told([frame(i, roi=roi) for i, roi in enumerate(rois)], every_ns=100 * MS)
    assert why[-1] is not None


def test_the_same_frame_again_is_frozen_whatever_is_in_it():
    why = told([Frame(7, 7, noisy(i), WHOLE) for i in range(12)])
    assert why[-1] is not None and "same frame" in why[-1]


def test_a_sensor_that_looks_at_a_still_scene_is_not_frozen():
    assert set(told([frame(i, noisy(i)) for i in range(60)])) == {None}


def test_a_machine_that_stood_still_is_no_frozen_camera():
    assert told([frame(i) for i in range(FROZEN_FRAMES)], every_ns=10 * FROZEN_NS) == [None] * FROZEN_FRAMES


def test_photographs_may_repeat():
    camera = StackCamera([], SCENE, None)
    assert set(told([camera.read() for _ in range(60)])) == {None}


# --- preview ---
# Previews: never too large, never too often, never of a part of a frame.

PREVIEW_WHOLE = (640, 480)
ALL = Roi(0, 0, *PREVIEW_WHOLE)


def preview_frame(image: np.ndarray | None = None, roi: Roi = ALL, t_ns: int = 0) -> Frame:
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
    grain = cv2.GaussianBlur(noise(*PREVIEW_WHOLE), (0, 0), 3.0)
    small, jpeg = compressed(grain)
    assert small is grain
    assert jpeg == cv2.imencode(".jpg", grain, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()


def test_a_preview_says_what_it_shows_and_fits_its_row() -> None:
    image = Preview("r1", PREVIEW_WHOLE, 2.0).of(preview_frame(noise(*PREVIEW_WHOLE)), sighting(), 9)
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
    preview, made_ns = Preview("r1", PREVIEW_WHOLE, hz), []
    for now_ns in range(0, 20_000 * MS, 33 * MS):
        if preview.of(preview_frame(), sighting(), now_ns) is not None:
            made_ns.append(now_ns)
    gaps_s = np.diff(made_ns) * 1e-9
    assert gaps_s.min() >= 1 / hz
    assert gaps_s.max() <= 1 / hz + 0.034  # the next frame


def test_a_rate_of_zero_switches_them_off() -> None:
    preview = Preview("r1", PREVIEW_WHOLE, 0.0)
    assert [preview.of(preview_frame(), sighting(), k * 10**9) for k in range(3)] == [None] * 3


def test_a_part_of_a_frame_is_no_preview_and_does_not_use_up_the_time_of_one() -> None:
    preview = Preview("r1", PREVIEW_WHOLE, 2.0)
    assert preview.of(preview_frame(roi=Roi(8, 16, 240, 240)), sighting(), 0) is None
    assert preview.of(preview_frame(), sighting(), 1) is not None


def test_previews_are_counted_without_gaps() -> None:
    preview = Preview("r1", PREVIEW_WHOLE, 5.0)
    made = [preview.of(preview_frame(), sighting(), k * 100 * MS) for k in range(20)]
    assert [image.seq for image in made if image is not None] == list(range(10))


def test_an_enhanced_preview_is_what_vision_looks_at() -> None:
    enhancer = OnDemandEnhancer(Enhancer("classic", lambda image: image + 90))
    image = Preview("r1", PREVIEW_WHOLE, 2.0, enhancer).of(preview_frame(), sighting(), 0)
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
    preview = Preview("r1", PREVIEW_WHOLE, 2.0, enhancer)
    for k in range(4):  # of eight seconds of rest after the estimate two have passed
        clock_s += 0.5
        image = preview.of(preview_frame(t_ns=k * 10**9), sighting(), k * 10**9)
        assert image is not None and not image.enhanced
        assert seen(image).mean() == pytest.approx(60, abs=1)
    assert clock_s == 4.0


def test_frames_that_were_shown_are_kept_for_a_while_where_somebody_may_draw_in_them() -> None:
    many = 3 * KEPT_BYTES // preview_frame().image.nbytes
    for keep in (False, True):
        preview = Preview("r1", PREVIEW_WHOLE, 2.0, keep=keep)
        images = [np.full((480, 640, 3), i % 256, np.uint8) for i in range(many)]
        for i, image in enumerate(images):
            assert preview.of(Frame(0, i, image, ALL), sighting(), 500 * MS * i) is not None
        assert (preview.frame(many - 1) is images[-1]) is keep and preview.frame(0) is None
        kept = sum(preview.frame(i) is not None for i in range(many))
        assert kept == (KEPT_BYTES // images[0].nbytes if keep else 0)


def test_the_rate_can_be_changed_on_the_way() -> None:
    preview = Preview("r1", PREVIEW_WHOLE, 2.0)
    assert preview.of(preview_frame(), sighting(), 0) is not None
    preview.set_rate(0.0)
    assert preview.of(preview_frame(), sighting(), 10_000 * MS) is None
    preview.set_rate(5.0)
    shown = [preview.of(preview_frame(), sighting(), 10_000 * MS + 50 * MS * i) is not None for i in range(40)]
    assert sum(shown) == 10


def test_what_the_calibration_knows_of_timing_is_taken_out_of_frames() -> None:
    now_ns, camera = [0], ScriptedCamera()
    asked: list[float] = []

    def read(roi=None, settle_s=0.0, timeout_s=1.0):
        asked.append(settle_s)
        return Frame(now_ns[0] + round(1e9 * settle_s), 1, np.zeros((480, 640, 3), np.uint8), Roi(0, 0, 640, 480))

    camera.read = read
    timed = TimedCamera(camera, TimingFit(stamp_late_s=0.12, lens_lag_s=0.1), lambda: now_ns[0])
    assert timed.lens_position(0) is None and timed.homing_s == pytest.approx(0.5)
    timed.set_focus(100)
    now_ns[0] = 10 * 10**9
    timed.set_focus(200)
    frame = timed.read(settle_s=0.05)
    assert asked == [pytest.approx(0.32)]  # late stamps, and two lags of the lens
    assert frame.t_ns == 10_200_000_000
    assert timed.lens_position(frame.t_ns) == round(200 - 100 * math.exp(-2))
    assert timed.lens_position(10 * 10**9 - 1) == 100  # exposed before the lens was told
    as_it_is = TimedCamera(camera, TimingFit(), lambda: now_ns[0])
    as_it_is.set_focus(300)
    frame = as_it_is.read(settle_s=0.05)
    assert asked[-1] == 0.05 and frame.t_ns == 10_050_000_000 and as_it_is.lens_position(0) == 300


def test_of_a_whole_frame_that_is_swept_the_part_about_the_ball_is_what_was_measured() -> None:
    eyes, enhancing = (
        vision.Vision(ScriptedCamera, fleet, CAMERA, {}, vision.StandingClock())
        for fleet in (replace(FLEET, camera=replace(FLEET.camera, enhance=each)) for each in (False, True))
    )
    image = np.zeros((480, 640, 3), np.uint8)
    whole, part = Frame(0, 0, image, Roi(0, 0, 640, 480)), Frame(0, 0, image[:100, :100], Roi(200, 200, 100, 100))
    swept = replace(sighted(START_NS, 1), centre_px=(320.0, 240.0), radius_px=40.0)
    roi = eyes.measured(whole, swept)
    assert roi is not None and roi.x <= 320 - 40 and roi.x + roi.width >= 320 + 40 and roi.width < 200
    assert eyes.measured(part, swept) is None
    assert eyes.measured(whole, replace(swept, sweep=0)) is None
    assert eyes.measured(whole, replace(swept, found=False, centre_px=None, radius_px=None)) is None
    assert enhancing.measured(whole, swept) is None, "what is enhanced depends on the whole frame"
