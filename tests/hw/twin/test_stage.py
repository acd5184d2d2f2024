"""Stones that move and tags that get lost: at each time of an exposure what was there then."""

from pathlib import Path

import numpy as np
import pytest

from agent.robot.fleet_reader import load_fleet
from hw.twin.camera_device import EXPOSURE_NS, DiveCamera, FrameClock
from hw.twin.dive import Dive
from hw.twin.optics.lens import draw_lens
from hw.twin.scene import Occlude, Scene, Solid, TagLost, load_scene
from hw.twin.truth import Stage, movable, true_tags
from tests.hw.twin.devices.test_camera_device import Notebook

FLEET = load_fleet(Path(__file__).parent / "swim.toml")
BALL, STONE, _ = load_scene("swim").solid
TAGS = true_tags(FLEET.landmarks, 0)


def test_a_stone_goes_straight_and_stays_where_it_comes_to():
    stage = Stage((BALL, STONE), ())
    assert stage.solids(10**18) == (BALL, STONE)
    start_m, end_m = np.array(STONE.position_m), np.array((1.0, 1.0, 0.1))
    stage.move(1, tuple(end_m), 1_000_000_000, over_s=4.0)
    for t_s, share in ((0.5, 0.0), (1.0, 0.0), (2.0, 0.25), (5.0, 1.0), (60.0, 1.0)):
        ball, stone = stage.solids(round(t_s * 1e9))
        assert ball == BALL
        np.testing.assert_allclose(stone.position_m, start_m + share * (end_m - start_m))
    stage.move(1, tuple(start_m), 3_000_000_000, over_s=1.0)  # called back half way
    np.testing.assert_allclose(stage.solids(2_999_999_999)[1].position_m, (start_m + end_m) / 2, atol=1e-6)
    np.testing.assert_allclose(stage.solids(3_500_000_000)[1].position_m, start_m + (end_m - start_m) / 4)


def test_a_lost_tag_is_there_until_then():
    stage = Stage((), TAGS)
    assert stage.tags(0) is stage.tags(10**18)
    stage.lose_tag(12, 5_000_000_000)
    assert [tag.id for tag in stage.tags(4_999_999_999)] == [tag.id for tag in TAGS]
    assert 12 not in [tag.id for tag in stage.tags(5_000_000_000)]
    assert len(stage.tags(5_000_000_000)) == len(TAGS) - 1


def test_targets_stay_where_the_truth_says():
    scene = load_scene("flat_stone")
    assert movable(FLEET, scene) == [0]
    named = Solid(kind="stone", name="ball", position_m=(0, 0, 0), radii_m=(0.1, 0.1, 0.1))  # the fleet's target
    assert movable(FLEET, Scene(name="s", solid=(named, STONE, BALL))) == [1]


def test_cameras_see_the_stage_at_their_own_times():
    events = (
        TagLost(at_s=0.50, id=12),
        Occlude(at_s=0.50, solid=1, to_m=(1.0, 1.0, 0.1), over_s=1.0),
    )
    scene = Scene(name="swim", moored=False, solid=(BALL, STONE), event=events)
    dive = Dive(FLEET, list(FLEET.robot), 0, scene=scene)
    notebook, seen = Notebook(), []
    lens = draw_lens(scene.camera, np.random.default_rng(0))
    for blurs in (False, True):
        camera = DiveCamera(
            0,
            dive.history,
            lens,
            notebook,
            notebook,
            (0.1, 0.0, 0.0),
            dive.stage,
            FrameClock(0),
            lambda: 0,
            blurs=blurs,
        )
        seen.append(camera)
    for _ in range(100):
        dive.tick(0.0)
    seen[0]._frame(1, 400_000_000, None)
    before = notebook.moments[-1]
    assert notebook.during is None
    seen[1]._frame(2, 900_000_000, None)
    after = notebook.moments[-1]
    assert {12} == {tag.id for tag in before.tags} - {tag.id for tag in after.tags}
    assert before.solids == (BALL, STONE)
    np.testing.assert_allclose(
        after.solids[1].position_m, np.array(STONE.position_m) * 0.6 + 0.4 * np.array((1.0, 1.0, 0.1))
    )
    first, last = notebook.during(-0.5), notebook.during(0.5)
    way_m = np.array(last.solids[1].position_m) - np.array(first.solids[1].position_m)
    np.testing.assert_allclose(way_m, (np.array((1.0, 1.0, 0.1)) - STONE.position_m) * EXPOSURE_NS * 1e-9)
    assert len(after.hulls) == 2
    assert pytest.approx(last.eye.position_m) == first.eye.position_m
