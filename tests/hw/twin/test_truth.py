"""Paths and separation: what really happened, for who judges."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from agent.robot.fleet_reader import load_fleet
from hw.twin.camera_device import EXPOSURE_NS, DiveCamera, FrameClock
from hw.twin.dive import Dive
from hw.twin.optics.lens import draw_lens
from hw.twin.physics.body import euler_rad, quaternion
from hw.twin.physics.tank import STATE
from hw.twin.scene import Occlude, Scene, Solid, TagLost, load_scene
from hw.twin.truth import HEAD, Stage, Watch, movable, true_tags
from tests.hw.twin.stand_ins import boardless_dive
from tests.hw.twin.test_camera_device import Notebook

SIZE_M = (3.0, 2.0, 0.8)


def states(*places_m):
    made = np.zeros(len(places_m), STATE)
    made["position_m"] = places_m
    made["quaternion"] = quaternion(0.0, 0.1, 0.5)
    return made


def test_the_closest_that_two_came_is_kept_with_who_and_when():
    watch = Watch(["a", "b", "c"], SIZE_M)
    for k, x_m in enumerate((1.0, 0.9, 0.85, 0.9)):
        watch.see(states((0.4, 1.0, 0.2), (x_m, 1.0, 0.2), (2.5, 1.5, 0.2)), k * 10)
    kept = watch.separation
    assert kept.least_m == pytest.approx(0.45) and kept.between == ("a", "b") and kept.at_ns == 20
    assert (kept.ring_overlaps, kept.hull_contacts, kept.wall_contacts) == (0, 0, 0)


def test_overlaps_and_contacts_are_counted_when_they_begin():
    watch = Watch(["a", "b"], SIZE_M)
    for x_m in (1.0, 0.70, 0.65, 0.64, 0.80, 0.70, 1.0):  # rings of 0.17 m, hulls of 0.14 m, at 0.40 m
        watch.see(states((0.40, 1.0, 0.2), (x_m, 1.0, 0.2)), 0)
    assert watch.separation.ring_overlaps == 2 and watch.separation.hull_contacts == 1
    for x_m in (0.139, 0.138, 0.15, 0.139):
        watch.see(states((x_m, 1.0, 0.2), (2.0, 1.87, 0.2)), 0)
    assert watch.separation.wall_contacts == 3  # twice at x = 0, and once at y = 2


def test_one_above_the_other_overlaps_and_does_not_touch():
    watch = Watch(["a", "b"], SIZE_M)
    watch.see(states((1.0, 1.0, 0.15), (1.1, 1.0, 0.45)), 0)
    assert (watch.separation.ring_overlaps, watch.separation.hull_contacts) == (1, 0)


def test_one_alone_is_apart_from_nobody(tmp_path):
    watch = Watch(["a"], SIZE_M, tmp_path)
    watch.see(states((1.0, 1.0, 0.2)), 0)
    watch.close()
    assert json.loads((tmp_path / "separation.json").read_text())["least_m"] is None


def test_paths_are_rows_of_twenty_a_second(tmp_path):
    made = boardless_dive(scene=Scene(name="swim", moored=False))
    made.states["held"] = 0
    made.watch = Watch(made.robots, SIZE_M, tmp_path)
    made.push("r1", (0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    for _ in range(100):
        made.move()
    made.watch.close()
    made.watch.close()
    lines = (tmp_path / "paths.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert lines[0] == HEAD
    assert len(rows) == 40 and [row["robot"] for row in rows[:2]] == ["r1", "r2"]
    assert [int(row["t_ns"]) for row in rows[:3]] == [50_000_000, 50_000_000, 100_000_000]
    last = made.states[0]
    assert [float(rows[-2][key]) for key in ("x_m", "y_m", "z_m")] == pytest.approx(last["position_m"], abs=1e-5)
    angles_deg = np.degrees(euler_rad(last["quaternion"]))
    assert [float(rows[-2][key]) for key in ("roll_deg", "pitch_deg", "yaw_deg")] == pytest.approx(angles_deg, abs=1e-5)
    assert float(rows[-2]["pan_deg"]) == pytest.approx(last["shaft_deg"][0], abs=1e-5)
    kept = json.loads((tmp_path / "separation.json").read_text())
    closest_m = min(float(b["x_m"]) - float(a["x_m"]) for a, b in zip(rows[::2], rows[1::2], strict=True))
    assert kept["between"] == ["r1", "r2"] and kept["least_m"] == pytest.approx(closest_m, abs=2e-4)


# --- stage ---
# Stones that move and tags that get lost: at each time of an exposure what was there then.

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
    events = (TagLost(at_s=0.50, id=12), Occlude(at_s=0.50, solid=1, to_m=(1.0, 1.0, 0.1), over_s=1.0))
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
