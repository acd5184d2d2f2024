"""Points of a key frame on a textured floor, followed while the camera moves in a known way."""

import msgspec
import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Flow
from agent.perception.flow import MOST, begin, flow, follow
from tests.perception.landmarks.floor import frame, meet, pose, seen_from, texture

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
