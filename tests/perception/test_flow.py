"""Points of a key frame on a textured floor, followed while the camera moves in a known way."""

import time

import msgspec
import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Flow, Sighting
from agent.perception.flow import MOST, NEAR_M, OLDEST_NS, OPENS_S, QUEUE, REST_M, LandmarkWatch, begin, flow, follow
from agent.perception.tags import to_pixels
from hw.camera.camera import Frame, Roi
from tests.known_lens import PLAIN
from tests.perception.floor import frame, meet, pose, seen_from, texture
from tests.perception.floor import frame as floor_frame
from tests.perception.printed import WALL, photograph, tag_light, turned
from tests.perception.scripted_camera import EMPTY, ScriptedCamera

CAMERA = CameraFit(width_px=320, height_px=240, f_px=500.0, cx_px=159.5, cy_px=119.5, bend=0.39)
# A tenth of a second apart: 0.15 m/s ahead, some to the side, turning by 10 degrees a second.
PATH = [pose(0.015 * k, 0.004 * k, 1.0 * k) for k in range(6)]
STEP_NS = 100_000_000


@pytest.fixture(scope="module")
def frames():
    floor = texture(1000)
    return [frame(floor, CAMERA, *at, seed=k) for k, at in enumerate(PATH)]


@pytest.fixture(scope="module")
def tracks(frames):
    """What is tracked in each frame."""
    out = [begin(frames[0], CAMERA, 0)]
    for k, image in enumerate(frames[1:], start=1):
        out.append(follow(out[-1], image, k * STEP_NS))
    return out


def errors_px(said, k):
    """(n,) distance from where the floor's points are, of the pairs that are said."""
    pairs = np.array(said.pairs)
    return CAMERA.f_px * np.hypot(*(pairs[:, 2:] - seen_from(meet(pairs[:, :2], *PATH[0]), *PATH[k])).T)


def test_points_are_where_the_floor_is(tracks):
    for k in (1, 3, 5):
        said = flow(tracks[k], CAMERA)
        error = errors_px(said, k)
        assert len(error) == MOST
        assert np.median(error) < 0.05 + 0.06 * k  # patches are seen from elsewhere, and change their shape
        assert error.max() < 2.0


def test_no_points_are_on_what_was_found(frames):
    box = (300.0, 200.0), (160.0, 120.0)
    everywhere, around = begin(frames[0], CAMERA, 0), begin(frames[0], CAMERA, 0, [box])

    def inside(tracked):
        return (np.abs(tracked.key.points_px - box[0]) < np.array(box[1]) / 2 - 1.0).all(axis=1)

    assert inside(everywhere).any() and not inside(around).any() and len(around.key.points_px) > 50


def test_a_new_key_frame_is_due_when_the_old_one_goes_out_of_sight(tracks):
    assert not tracks[1].due
    lost = tracks[1]._replace(left=np.arange(len(tracks[1].left)) < 0.5 * len(tracks[1].left))
    assert lost.due
    assert tracks[1]._replace(t_ns=4_100_000_000).due


def test_what_is_said_is_what_was_seen(tracks):
    said = flow(tracks[2], CAMERA)
    assert (said.t_ns, said.since_ns) == (2 * STEP_NS, 0)
    assert msgspec.json.decode(msgspec.json.encode(said), type=Flow) == said
    assert not flow(tracks[2]._replace(left=np.zeros(len(tracks[2].left), bool)), CAMERA).pairs


def test_a_frame_without_texture_has_no_points():
    grey = np.full((240, 320, 3), 90, np.uint8)
    empty = begin(grey, CAMERA, 0)
    assert empty.due and not flow(empty, CAMERA).pairs
    assert follow(empty, grey, 1).due


def test_points_that_go_away_are_lost_and_not_invented(frames, tracks):
    other = np.ascontiguousarray(frames[0][::-1, ::-1])  # another place
    assert follow(tracks[0], other, STEP_NS).left.mean() < 0.3


# --- watch ---
# What a vision worker's frames say of landmarks: how often, by whose clock, and at which lens position.

OFFSET_NS = 10**18  # from the camera's clock to the agent's
SECOND = 1_000_000_000
BLANK = np.full((240, 320, 3), 90, np.uint8)


@pytest.fixture(scope="module")
def floor():
    return floor_frame(texture(600), CAMERA, *pose(0.0, 0.0, 0.0), seed=0)


@pytest.fixture
def watch():
    return LandmarkWatch(CAMERA, PLAIN, hz=10.0)


def see(watch, image, t_s, lens=None):
    """t_s: by the camera's clock."""
    t_ns = round(t_s * SECOND)
    roi = Roi(0, 0, CAMERA.width_px, CAMERA.height_px)
    watch.see(Frame(t_ns, round(10 * t_s), image, roi), watch.rest if lens is None else lens, OFFSET_NS)


def test_frames_are_due_at_the_rate_that_was_asked_for(watch) -> None:
    assert watch.wait_s(OFFSET_NS) == 0.0
    see(watch, BLANK, 5.0)
    now_ns = OFFSET_NS + 5 * SECOND
    assert watch.wait_s(now_ns) == pytest.approx(0.1 - OPENS_S)
    assert watch.wait_s(now_ns + 40_000_000) == pytest.approx(0.06 - OPENS_S)
    assert watch.wait_s(now_ns + 100_000_000) == watch.wait_s(now_ns + 9 * SECOND) == 0.0


def test_what_was_seen_is_fetched_once_and_in_order(watch) -> None:
    light = np.full((240, 320), WALL)
    tag_light(CAMERA, 3, turned(0, 0, 0), (0.0, 0.0, 0.6), light)
    see(watch, photograph(light), 1.0)
    see(watch, BLANK, 1.1, lens=500)
    tags, flows = watch.drain()
    assert [(each.t_ns - OFFSET_NS, each.frame, each.focus) for each in tags] == [
        (SECOND, 10, watch.rest),
        (1_100_000_000, 11, 500),
    ]
    assert [[tag.id for tag in each.tags] for each in tags] == [[3], []]  # a frame that shows none is said as well
    assert flows == () and watch.drain() == ((), ())


def test_of_what_nobody_fetches_the_newest_is_kept(watch) -> None:
    tiny = np.full((48, 64, 3), 90, np.uint8)
    for k in range(QUEUE + 3):
        see(watch, tiny, 0.1 * k, lens=500)
    assert [each.frame for each in watch.drain()[0]] == list(range(3, QUEUE + 3))


def test_a_key_frame_is_of_a_lens_at_rest_and_outlives_a_sweep(watch, floor) -> None:
    assert watch.rest == round(lens_position(PLAIN, REST_M))
    sweep = watch.rest + 200
    see(watch, floor, 0.9, sweep)  # none begins there
    for t_s, image, lens in (
        (1.0, floor, watch.rest),
        (1.1, floor, sweep),
        (1.2, BLANK, sweep),
        (1.3, floor, watch.rest),
    ):
        see(watch, image, t_s, lens)
    told = [(flow.since_ns - OFFSET_NS, flow.t_ns - OFFSET_NS, len(flow.pairs)) for flow in watch.drain()[1]]
    assert [each[:2] for each in told] == [(SECOND, 1_100_000_000), (SECOND, 1_300_000_000)]
    assert all(pairs > 20 for *_, pairs in told)  # what the blur hid for a while is found again


def test_where_sweep_follows_sweep_a_key_frame_begins_near_rest(watch, floor) -> None:
    """The kernel has forgotten where it was at one that is older than its memory of a few seconds."""
    near, far = watch.rest + 60, watch.rest + 200
    late_s = 1.1 + OLDEST_NS / SECOND
    for t_s, lens in ((1.0, watch.rest), (1.5, near), (late_s, far), (late_s + 0.2, near), (late_s + 0.4, far)):
        see(watch, floor, t_s, lens)
    told = [(flow.since_ns - OFFSET_NS) / SECOND for flow in watch.drain()[1]]
    assert told == [1.0, 1.0, 1.0, pytest.approx(late_s + 0.2)]


def test_defocused_only_fitted_corners_count(watch) -> None:
    small, large = np.full((240, 320), WALL), np.full((240, 320), WALL)
    tag_light(CAMERA, 3, turned(0, 0, 0), (0.0, 0.0, 2.1), small)  # 19 px: no edges are fitted
    tag_light(CAMERA, 3, turned(0, 0, 0), (0.0, 0.0, 0.6), large)
    for t_s, light, lens in ((1.0, small, watch.rest), (1.1, small, 500), (1.2, large, 500)):
        see(watch, photograph(light), t_s, lens)
    assert [[tag.edges for tag in each.tags] for each in watch.drain()[0]] == [[False], [], [True]]


def test_a_key_frame_is_followed_until_another_is_due(watch, floor) -> None:
    late_s = 1.2 + OLDEST_NS / SECOND
    for t_s in (1.0, 1.1, late_s, late_s + 0.1):
        see(watch, floor, t_s)
    told = [(flow.since_ns - OFFSET_NS) / SECOND for flow in watch.drain()[1]]
    assert told == [1.0, 1.0, pytest.approx(late_s)]
    see(watch, BLANK, late_s + 0.2)  # all its points are lost: nothing to say, and no key frame either
    see(watch, floor, late_s + 0.3)
    see(watch, floor, late_s + 0.4)
    told = [(flow.since_ns - OFFSET_NS) / SECOND for flow in watch.drain()[1]]
    assert told == [pytest.approx(late_s + 0.3)]


def test_a_key_frame_begins_when_the_gimbal_has_been_still_for_a_while(watch, floor) -> None:
    turned = np.roll(floor, 40, axis=1)
    for t_s, image in ((1.0, floor), (1.1, turned), (1.2, turned), (1.3, turned), (1.4, turned), (1.5, turned)):
        see(watch, image, t_s)
    told = [round((flow.since_ns - OFFSET_NS) / SECOND, 2) for flow in watch.drain()[1]]
    assert told == [1.0, 1.0, 1.0, 1.3, 1.3]  # the kernel does not know where the camera points until then


def test_points_keep_away_from_targets(watch, floor) -> None:
    roi, ball = Roi(0, 0, 320, 240), (160.0, 120.0)
    found = Sighting(t_ns=0, frame=0, target="ball", found=True, centre_px=ball, radius_px=50.0)
    lost = Sighting(t_ns=0, frame=0, target="fish", found=False)
    for k in range(2):
        watch.see(Frame(k * SECOND // 10, k, floor, roi), watch.rest, OFFSET_NS, [found, lost])
    (_, (flow,)) = watch.drain()
    then = to_pixels(CAMERA, np.array(flow.pairs)[:, :2])
    assert (np.abs(then - ball) > 55.0).any(axis=1).all()


def test_a_lens_that_does_not_move_is_always_at_rest(watch, floor) -> None:
    watch.rest = None
    see(watch, floor, 1.0)
    see(watch, floor, 1.1)
    (tags, _), (flow,) = watch.drain()
    assert tags.focus is None and len(flow.pairs) > 20


# --- in a worker ---------------------------------------------------------------------------------------------------


class Coarse(ScriptedCamera):
    """Its lens takes every tenth position."""

    def set_focus(self, position):
        return super().set_focus(position // 10 * 10)


@pytest.mark.parametrize("camera", [Coarse, ScriptedCamera])
def test_the_worker_brings_the_lens_to_rest_once(worker, camera) -> None:
    here = camera(focusable=camera is Coarse, images=lambda _: EMPTY)
    watch = LandmarkWatch(CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5), PLAIN, 20.0)
    rest = watch.sharp // 10 * 10 if camera is Coarse else None
    assert watch.sharp % 10 != 0
    out = worker(here, landmarks=watch)
    until = time.monotonic() + 60.0
    seen = []
    while len(seen) < 3 and time.monotonic() < until:
        seen += watch.drain()[0]
        time.sleep(0.002)
    out.close()
    assert out.fault is None and [each.focus for each in seen[:3]] == [rest] * 3 and watch.rest == rest
    assert [call for call in here.calls if call[0] == "focus"] == ([("focus", rest)] if camera is Coarse else [])


def test_the_worker_moves_the_lens_towards_a_target_as_far_as_landmarks_allow(worker) -> None:
    here = ScriptedCamera(images=lambda _: EMPTY)
    watch = LandmarkWatch(CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5), PLAIN, 50.0)
    out, until, told = worker(here, landmarks=watch), time.monotonic() + 60.0, []
    nearest = round(lens_position(PLAIN, NEAR_M))
    for wanted, expected in ((watch.sharp + 7, watch.sharp + 7), (2000, nearest), (None, watch.sharp)):
        out.rest(wanted)
        while time.monotonic() < until and (not told or told[-1] != expected):
            told += [each.focus for each in watch.drain()[0]]
            time.sleep(0.002)
        assert told[-1] == watch.rest == expected
        stays = []
        while time.monotonic() < until and len(stays) < 4:
            stays += [each.focus for each in watch.drain()[0]]
            time.sleep(0.002)
        assert stays[:4] == [expected] * 4, "it does not go to and fro between the target's and the landmarks'"
    out.close()


def test_away_from_where_landmarks_are_sharp_only_fitted_corners_count(watch) -> None:
    small = np.full((240, 320), WALL)
    tag_light(CAMERA, 3, turned(0, 0, 0), (0.0, 0.0, 2.1), small)
    watch.rest_at(watch.sharp + 20)
    assert watch.due(watch.rest) == watch.sharp + 20
    watch.rested(watch.sharp + 20, watch.sharp + 20)
    assert watch.due(watch.rest) is None
    see(watch, photograph(small), 1.0)
    assert [each.tags for each in watch.drain()[0]] == [()]
