"""One sweep of the focus: in which order, on which grid, and where its blocks are sharpest."""

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.depth_peaks import measure_growth
from agent.perception.depth_sweep import check_frames, clarity_of, measure, steadied, sweep
from hw.camera.camera import CameraError, FocusRange, Frame, Roi
from hw.camera.files import open_stack
from tests.tools.planes import FOCUS, Breathing, Lens, blurred, quiet, two_planes


def test_the_picture_is_sharp_everywhere(planes):
    sharp = sweep(open_stack(planes), 40, quiet).sharp
    for lens_position in (0.20, 0.40):  # each photograph is sharp on one side only
        photograph = two_planes(lens_position, 0.21, 0.388, 10.0)
        assert cv2.Laplacian(sharp, cv2.CV_64F).var() > 1.2 * cv2.Laplacian(photograph, cv2.CV_64F).var()


def test_a_camera_is_swept_upwards_and_its_own_report_counts(tmp_path):
    lens = Lens()
    taken = sweep(lens, 40, quiet)
    home, *visited = lens.visited
    assert home == 0 and visited == sorted(visited) and len(visited) == 30 and visited[-1] == 1022
    result = measure(taken, 40, FOCUS)
    step = 1023 / 29
    blocks = result.blocks
    assert np.abs(blocks.lens_position[:3, :3] - 400.4).max() < 0.1 * step
    assert np.abs(blocks.lens_position[:3, 3:] - 640.7).max() < 0.1 * step
    assert blocks.range_m[:3, :2] == pytest.approx(0.05 + 200.0 / 700.4, rel=0.01)
    assert result.range_on_parts()[:8, 8:11] == pytest.approx(0.05 + 200.0 / 700.4, rel=0.02)
    assert np.isnan(blocks.range_m[3]).all()


def test_the_grid_grows_with_the_picture():
    lens, images, lens_positions = Breathing(), [], np.linspace(1.0, 1022.0, 30).round()
    for lens_position in lens_positions:
        lens.lens_position = lens_position
        images.append(lens.read().image)
    assert measure_growth(images) == pytest.approx(0.05, abs=0.004)
    spread = [
        np.std(measure(clarity_of(images, lens_positions, 50, g), 50, None).blocks.lens_position) for g in (0.05, 0)
    ]
    assert spread[0] < 0.7 * spread[1]
    with pytest.raises(ConfigError, match=r"growth 0\.5"):
        sweep(lens, 50, quiet, 0.5)
    with pytest.raises(ConfigError, match=r"--block 400: the picture is 300x300; choose 8 to 300"):
        sweep(lens, 400, quiet)
    lens.size = (1, 1)
    with pytest.raises(ConfigError, match=r"the picture is 1x1, too small: give pictures of 8 px or more"):
        sweep(lens, 8, quiet)


def test_growth_goes_by_lens_positions_not_by_frames():
    lens, images = Breathing(), []
    lens_positions = 1023.0 * np.linspace(0.0, 1.0, 24) ** 2.5
    for lens_position in lens_positions:
        lens.lens_position = lens_position
        images.append(lens.read().image)
    assert measure_growth(images, lens_positions) == pytest.approx(0.05, abs=0.004)


def test_light_that_creeps_moves_no_peak():
    texture = SCENE[:160, :200, 0].astype(float)
    steady = [blurred(texture, 14.3, k, 0.15) for k in range(30)]
    steady_map, crept_map = (
        measure(
            clarity_of([np.clip(each, 0, 255).astype(np.uint8) for each in images], np.arange(30.0), 40, 0.0), 40, None
        )
        for images in (steady, [0.75 * 1.01**k * image for k, image in enumerate(steady)])
    )
    assert steady_map.light == 1.0 and crept_map.light == pytest.approx(1.01**29, rel=0.02)
    apart = crept_map.blocks.lens_position - steady_map.blocks.lens_position
    assert np.abs(apart).max() < 0.05, "1.1 where it is left in"


def test_a_scene_without_texture_has_no_growth():
    assert measure_growth([np.full((200, 200), 90, np.uint8)] * 8) is None


# --- frames that cannot be believed ---

NAMES = [f"p{k:02}" for k in range(20)]
SCENE = cv2.GaussianBlur(np.random.default_rng(8).integers(0, 256, (400, 500, 3)).astype(np.uint8), (0, 0), 1.0)


def slope(moved=lambda k: (0, 0), gain=lambda k: 1.0):
    """Twenty frames 240 x 320 of a plane that is sharp at 5 on its left and at 14 on its right, in the first frame."""
    columns, frames = np.arange(500.0), []
    for k in range(20):
        layers = [cv2.GaussianBlur(SCENE, (0, 0), 0.4 + 0.25 * abs(k - at)) for at in range(4, 20)]
        at = np.clip(5.0 + 9.0 * (columns - 80.0) / 319.0, 4.0, 19.0)
        low = np.minimum(at.astype(int), 18) - 4
        share = (at - 4 - low)[None, :, None]
        stack = np.stack(layers)
        x = np.arange(500)
        picture = (1 - share) * stack[low, :, x].swapaxes(0, 1) + share * stack[low + 1, :, x].swapaxes(0, 1)
        dx, dy = moved(k)
        part = picture[80 - dy : 320 - dy, 80 - dx : 400 - dx]
        frames.append(np.clip(gain(k) * part, 0, 255).round().astype(np.uint8))
    return frames


def off(taken, block=20):
    """How far the peaks are from the truth, in the first frame's pixels; lens positions."""
    blocks = measure(taken, block, None).blocks
    columns = taken.corner_px[0] + (np.arange(blocks.lens_position.shape[1]) + 0.5) * block
    return (blocks.lens_position - (5.0 + 9.0 * columns / 319.0))[blocks.accepted]


class Frames(Lens):
    """A camera of 20 lens positions that shows what it is given."""

    size = (320, 240)

    def __init__(self, frames):
        super().__init__()
        self.frames = frames

    def focus_range(self):
        return FocusRange(0, 19, 1)

    def set_focus(self, position):
        self.lens_position = position
        return position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        return Frame(0, 0, self.frames[self.lens_position], Roi(0, 0, *self.size))


@pytest.fixture(scope="module")
def still():
    return slope()


def test_a_sweep_that_is_sound_is_taken_as_it_is(still):
    check_frames(still, NAMES)
    assert steadied(still, 0.0).moved_px == 0.0
    taken = sweep(Frames(still), 20, quiet)
    assert taken.moved_px == 0.0 and np.abs(off(taken)).max() < 0.5


def test_frames_that_are_the_same_are_named(still):
    hung = [*still[:8], *[still[7]] * 5, *still[13:]]
    with pytest.raises(CameraError, match="p08 to p12 are the same picture as p07: the camera hung"):
        check_frames(hung, NAMES)
    with pytest.raises(CameraError, match="p04 is the same picture as p03: the camera hung"):
        check_frames([*still[:4], still[3], *still[5:]], NAMES)
    with pytest.raises(CameraError, match="p03 and p17 are the same picture; take one of them out"):
        check_frames([*still[:17], still[3], *still[18:]], NAMES)
    check_frames([np.full((40, 40, 3), 90, np.uint8)] * 20, NAMES)


@pytest.mark.parametrize("frames", [(9,), range(9, 20)])
def test_brightness_that_jumps_is_named(still, frames):
    dark = [(0.45 * one).astype(np.uint8) if k in frames else one for k, one in enumerate(still)]
    with pytest.raises(CameraError, match=r"brightness jumps at p09, to 0\.4\d times that of p08; set exposure"):
        check_frames(dark, NAMES)
    drifting = [(0.95**k * one).astype(np.uint8) for k, one in enumerate(still)]
    check_frames(drifting, NAMES)


@pytest.mark.parametrize(
    "moved", [lambda k: (3 * k, 2 * k), lambda k: (-k, k), lambda k: (-((7 * k) % 11), (5 * k) % 9)]
)
def test_a_picture_that_moves_is_brought_back_by_whole_pixels(moved):
    frames = slope(moved)
    taken = sweep(Frames(frames), 20, quiet)
    way = np.array([moved(k) for k in range(20)])
    assert taken.moved_px == pytest.approx(np.hypot(*np.ptp(way, axis=0)), abs=1.5)
    assert np.abs(off(taken)).max() < 0.6


def test_growth_about_a_side_is_no_movement():
    """All texture is on the right, so that growing shifts it."""
    lens, images = Breathing(), []
    for lens_position in np.linspace(1.0, 1022.0, 30).round():
        lens.lens_position = lens_position
        image = lens.read().image
        image[:, :180] = 128
        images.append(image)
    assert steadied(images, 0.05).moved_px == 0.0


def test_another_picture_in_between_is_no_sweep(still):
    with pytest.raises(CameraError, match="the picture moved by 60 px from one frame to the next; fix the camera"):
        steadied([*still[:10], *(np.roll(one, 60, axis=1) for one in still[10:])], 0.0)
