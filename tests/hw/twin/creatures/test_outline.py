"""What a frame shows of a creature, and what the truth says that it shows."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from agent.robot.fleet_reader import load_fleet
from hw.twin.creatures import Attitude, swimming
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Moment
from hw.twin.physics.body import GIMBAL_CAMERA, gimbal
from hw.twin.scene import Creature, Scene, Solid

FLEET = load_fleet(Path(__file__).parent.parent / "swim.toml")
FISH, TWO = Creature(name="fish"), Creature(name="two", colour="silver")
LENS = draw_lens("imx519_640", np.random.default_rng(1))
EYE = Eye(np.array((0.6, 0.8, 0.2)), gimbal(0, 0) @ GIMBAL_CAMERA)
V = LENS.at_rest_m
AT = Attitude(1.15, 0.8, 0.22, math.pi / 2, 0.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def painter():
    painter = Painter(Scene(name="bare", creature=(FISH, TWO)), FLEET.tank, 1.333, LENS, 0, "r1")
    painter.prepare()
    return painter


def moment(*attitudes, solids=()):
    creatures = zip((FISH, TWO), attitudes, strict=False)
    return Moment(EYE, solids, creatures=tuple(swimming(who, how, 0) for who, how in creatures))


def changed(painter, what, without):
    """Rows and columns of the pixels that differ by more than noise can."""
    seen, bare = (painter.expose(each, V).astype(int) for each in (what, without))
    return np.nonzero(np.abs(seen - bare).max(2) > 40)


def test_what_it_covers_is_the_box_of_the_truth(painter):
    (shown,) = painter.outlines(moment(AT), V)
    rows, columns = changed(painter, moment(AT), moment())
    x0, y0, x1, y1 = shown.box
    assert shown.visible == shown.pixels > 5000
    assert len(rows) > 0.6 * shown.visible
    blur = 6  # px, of the lens at rest at this range
    assert x0 - blur <= columns.min() < x0 + blur and x1 - blur <= columns.max() < x1 + blur
    assert y0 - blur <= rows.min() < y0 + blur and y1 - blur <= rows.max() < y1 + blur


def test_its_length_is_seen_at_the_pinhole_scale(painter):
    straight = AT._replace(width=0.0)
    (shown,) = painter.outlines(moment(straight), V)
    focal_px = 1.333 * V / LENS.pixel_m
    assert shown.box[2] - shown.box[0] == pytest.approx(focal_px * 0.15 / 0.55, rel=0.03)


def test_behind_a_stone_nothing_shows_and_the_truth_says_so(painter):
    stone = Solid(kind="stone", position_m=(0.95, 0.8, 0.2), radii_m=(0.05, 0.16, 0.12))
    (hidden,) = painter.outlines(moment(AT, solids=(stone,)), V)
    assert hidden.visible == 0 and hidden.pixels > 5000
    with_it, without = (painter.expose(moment(*at, solids=(stone,)), V, tick=3) for at in ((AT,), ()))
    assert with_it.tobytes() == without.tobytes()
    half = msgspec.structs.replace(stone, position_m=(0.95, 0.96, 0.2))
    (shown,) = painter.outlines(moment(AT, solids=(half,)), V)
    assert 0.2 < shown.visible / shown.pixels < 0.8


def test_one_in_front_of_the_other_hides_it_and_who_is_out_of_the_frame_is_not_told(painter):
    first, second = painter.outlines(moment(AT, AT._replace(x_m=1.3)), V)
    assert (first.name, second.name) == ("fish", "two")
    assert second.visible < 0.2 * second.pixels
    assert not painter.outlines(moment(AT._replace(x_m=0.2)), V)


def test_a_passing_one_is_smeared_and_what_rests_is_not(painter):
    def passing(share):
        return moment(AT._replace(y_m=0.8 + 0.004 * share))

    still, moving = (painter.expose(moment(AT), V, None, 0, during) for during in (None, passing))
    (shown,) = painter.outlines(moment(AT), V)
    x0, y0, x1, y1 = shown.box
    differs = np.abs(still.astype(int) - moving).max(2) > 12  # the noise of both is the same
    assert differs[y0:y1, x0:x1].sum() > 500
    assert not differs[:, : x0 - 30].any() and not differs[:, x1 + 30 :].any()
