"""What scenes and surveys are judged by: their worlds and scores, on scenes in closed form instead of minutes of
rendering."""

import math
from functools import partial

import msgspec
import numpy as np
import pytest

from agent.experiments.claim import Quantile, Share
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.reconstruction import coverage, scenes, survey
from agent.experiments.reconstruction.render import (
    BOX_M,
    CLEAR_M,
    MOORED,
    NEW,
    OWN,
    SHARED,
    Rendered,
    camera_of,
    held_back,
    noisy,
    scene_of_seed,
    trained,
)
from agent.experiments.reconstruction.scenes import distances_to, into_truth, nearest_m, score, seen_twice
from agent.experiments.reconstruction.survey import WideBodies, swimming_fleet, swum
from agent.reconstruction.views import Camera
from hw.twin.optics.lens import draw_lens
from hw.twin.scene import generator
from tests.reconstruction.drawn import drawn_view, plane_depth

SMALL = Camera(220.0, 79.5, 59.5, 0.39, 0.0, 160, 120)


@pytest.fixture(scope="module")
def floor() -> Rendered:
    """Five views of the tank's floor, each with its truth; nothing lies on it."""
    depth_of = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    places = [(0.6, 0.5, 0.4), (0.75, 0.45, 0.42), (0.85, 0.6, 0.4), (0.7, 0.75, 0.45), (0.62, 0.62, 0.43)]
    views = [drawn_view(n, place, (0.72, 0.61, 0.0), depth_of, camera=SMALL) for n, place in enumerate(places)]
    empty = msgspec.structs.replace(scene_of_seed(0, "tap"), solid=())
    return Rendered(empty, views[:4], views[:4], views[4:], views[4:])


def test_nothing_lies_in_anothers_way() -> None:
    for seed in range(1, 8):
        scene = scene_of_seed(seed, "coastal")
        assert scene.water.preset == "coastal"
        assert [solid.kind for solid in scene.solid].count("ball") == 1
        for solid in scene.solid:
            stations = [place[:2] for place in (*MOORED.values(), *NEW.values())]
            assert min(math.dist(solid.position_m[:2], one) for one in stations) > CLEAR_M
    assert scene_of_seed(3, "tap").solid == scene_of_seed(3, "coastal").solid != scene_of_seed(4, "tap").solid
    views = [view for robot in MOORED for view in (*trained(robot), *held_back(robot))]
    assert len(views) == len(set(views)) == 55


def test_the_camera_model_fits_the_twins_port() -> None:
    fit = camera_of(draw_lens("crop_1280", generator(5, "r2", "lens")), 1023.0)
    assert fit.noise_px < 0.4  # the best that five numbers can do, of 1280 px
    assert 0.3 < fit.bend < 0.5


def test_scores_of_a_floor_that_is_off_by_three_millimetres(floor: Rendered) -> None:
    truth = seen_twice(floor)
    assert len(truth) > 1000 and np.abs(truth[:, 2]).max() < 2e-3
    x, y = np.meshgrid(np.arange(0.3, 1.2, 0.003), np.arange(0.2, 1.0, 0.003))
    points = np.stack([x, y, np.full_like(x, 0.003)], axis=-1).reshape(-1, 3)
    told = score(points, floor, truth)
    assert told.median_mm == pytest.approx(3.0)
    assert told.f5 > 90.0 and told.complete_10mm > 90.0
    assert told.objects_mm is None  # there is none
    higher = score(points + np.array([0.0, 0.0, 0.003]), floor, truth)
    assert higher.f5 == 0.0 and higher.complete_10mm > 90.0


def test_distances_to_solids_are_those_of_geometry() -> None:
    solids = scene_of_seed(0, "tap").solid
    above = np.add(solids[0].position_m, (0.0, 0.0, 0.07 + 0.004))
    beside = np.add(solids[1].position_m, (solids[1].radii_m[0] + 0.002, 0.0, 0.0))
    off, of_solid = distances_to(np.array([above, beside, [0.001, 0.6, 0.3]]), BOX_M, solids)
    np.testing.assert_allclose(off, [0.004, 0.002, 0.001], atol=1e-6)
    assert of_solid.tolist() == [True, True, False]


def test_nearest_is_what_brute_force_finds() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 0.1, (60, 3)), rng.uniform(0, 0.1, (80, 3))
    brute = np.minimum(np.linalg.norm(a[:, None] - b[None], axis=-1).min(axis=1), 0.01)
    np.testing.assert_allclose(nearest_m(a, b, 0.01), brute)


def test_robots_share_their_error_and_a_common_one_is_nobodys(floor: Rendered) -> None:
    off = noisy(floor.trained, 3)
    again = noisy(floor.trained, 3)
    shifts = np.array([b.position_m - a.position_m for a, b in zip(floor.trained, off, strict=True)])
    assert 0.0 < np.abs(shifts).max() < 6 * SHARED[0] + 6 * SHARED[1] * 0.3
    assert np.ptp(shifts, axis=0).max() < 8 * OWN[0] + 6 * SHARED[1] * 0.3
    assert all((a.position_m == b.position_m).all() for a, b in zip(off, again, strict=True))
    believed = [view.position_m for view in off]
    back = into_truth(np.array(believed), off, floor)
    true = np.array([view.position_m for view in floor.trained])
    assert np.linalg.norm(back - true) < np.linalg.norm(np.array(believed) - true)


def test_views_that_are_off_make_a_worse_scene(floor: Rendered) -> None:
    truth = seen_twice(floor)
    exact, off = (scenes.judged_scene(floor, truth, poses, 0) for poses in ("exact", "noisy"))
    assert exact["median_mm"] < 0.5 and exact["focus_complete_10mm"] > 85.0
    assert exact["median_mm"] < off["median_mm"]
    assert exact["known_db"] > 15.0
    assert 0.0 <= exact["concluded_share"] < 20.0 and exact["whole_complete_10mm"] >= exact["focus_complete_10mm"] - 5.0
    assert exact["off_mm"] < 1e-6 < off["off_mm"]


def test_a_tank_is_as_good_as_in_its_worse_water_and_refined_poses_lose() -> None:
    one = {
        "focus_median_mm": 2.0,
        "focus_complete_10mm": 90.0,
        "sweep_objects_mm": 0.6,
        "median_mm": 0.3,
        "f5": 89.0,
        "concluded_share": 4.0,
        "concluded_median_mm": 3.0,
        "concluded_within": 90.0,
        "whole_complete_10mm": 95.0,
        "known_db": 31.0,
        "new_db": 28.0,
        "off_mm": 0.0,
    }
    tap = [{**one, "poses": "exact"}, {**one, "poses": "refined", "f5": 88.0, "new_db": 28.5}] * 2
    murky = {**one, "known_db": 29.0, "focus_median_mm": 2.6, "concluded_median_mm": None}
    coastal = [{**murky, "poses": "exact"}, {**murky, "poses": "refined", "f5": 86.0}] * 2
    found = scenes.summary({"tap": tap, "coastal": coastal})
    assert found["focus_median_mm"] == Quantile([2.6, 2.6], 80.0)
    assert found["known_db"] == Quantile([29.0, 29.0], 20.0)
    assert found["lost_f5"] == Quantile([3.0, 3.0], 80.0) and found["lost_new_db"] == Quantile([0.0, 0.0], 80.0)
    assert found["concluded_median_mm"] == 3.0, "where nothing was concluded there is nothing to be wrong"
    assert found["refined_f5"] == 87.0 and "noisy_f5" not in found
    told = scenes.summary({"tap": [{**one, "poses": "exact", "sweep_objects_mm": None}]})
    assert told["sweep_objects_mm"] == Quantile([math.inf], 80.0) and "lost_f5" not in told


def test_a_run_of_moored_robots_that_is_too_long_counts_as_the_longest() -> None:
    alone = [{"keyframes": 200}, {"keyframes": None}]
    shared = [{"keyframes": 150, "equal": True}, {"keyframes": 165, "equal": False}]
    found = coverage.summary({"shared": shared, "alone": alone})
    assert found["alone_keyframes"] == 225.0 and found["shared_ratio"] == 0.7
    assert found["shared_equal"] == Share(1, 2)
    assert "shared_ratio" not in coverage.summary({"shared": shared})


def test_what_swimmers_that_survey_say_is_believed() -> None:
    fleet = swimming_fleet(9)
    swimmers, heard = Swimmers(fleet, WideBodies(fleet)), set()
    for _ in range(40):
        swimmers.step()
        heard |= {each.topic for inputs in swimmers.inputs.values() for each in inputs.heard}
    assert {"near", "claim"} <= heard
    assert [agent.inbox.refused for agent in swimmers.agents.values()] == [{}] * 3
    claims = [agent.capabilities["survey"].exchange.cache for agent in swimmers.agents.values()]
    assert all(sender.newest for cache in claims for sender in cache.senders.values())


def test_swimmers_begin_to_know_the_floor_and_wrong_blocks_are_among_what_they_see() -> None:
    row = swum(9, seconds=14.0, every_s=7.0)
    first, second = row["known"]
    assert 0.0 < first < second < 0.3
    assert row["keyframes"] >= 3
    assert row["things"] >= row["empty"] >= 0
    found = survey.summary({"all": [row, {**row, "things": 0, "empty": 0}]})
    assert found["known_2"] == pytest.approx(100.0 * second)
    assert found["empty"] == (100.0 * row["empty"] / row["things"] if row["things"] else None)
