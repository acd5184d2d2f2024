"""The reconstruction experiment's world and its scores, on scenes in closed form instead of minutes of rendering."""

import io
import math
from functools import partial

import numpy as np
import pytest
from rich.console import Console

from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.reconstruction.coverage import WideBodies, missed_coverage, swimming_fleet, swum
from agent.experiments.reconstruction.reconstruction import Settings, missed, run, swimmers_table, table
from agent.experiments.reconstruction.render import (
    CLEAR_M,
    MOORED,
    NEW,
    OWN,
    SHARED,
    TRUTH_STEP,
    Rendered,
    camera_of,
    held_back_known,
    held_back_new,
    noisy,
    scene_of_seed,
    trained,
)
from agent.experiments.reconstruction.score import distances, into_truth, missed_pictures, nearest_m, score, seen_twice
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
    scene = scene_of_seed(0, "tap")
    empty = type(scene)(**{**{name: getattr(scene, name) for name in scene.__struct_fields__}, "solid": ()})
    return Rendered(0, "tap", empty, views[:4], views[4:], views[4:], [view.depth_m for view in views[:4]])


def test_nothing_lies_in_anothers_way() -> None:
    for seed in range(1, 8):
        scene = scene_of_seed(seed, "coastal")
        assert scene.water.preset == "coastal"
        assert [solid.kind for solid in scene.solid].count("ball") == 1
        for solid in scene.solid:
            stations = [*((x, y) for x, y, _ in MOORED.values()), *((x, y) for x, y, *_ in NEW)]
            assert min(math.dist(solid.position_m[:2], one) for one in stations) > CLEAR_M
    assert scene_of_seed(3, "tap").solid == scene_of_seed(3, "coastal").solid != scene_of_seed(4, "tap").solid
    assert (len(trained()), len(held_back_known()), len(held_back_new())) == (45, 5, 5)


def test_the_camera_model_fits_the_twins_port() -> None:
    fit = camera_of(draw_lens("crop_1280", generator(5, "r2", "lens")), 1023.0)
    assert fit.noise_px < 0.4  # the best that five numbers can do, of 1280 px
    assert 0.3 < fit.bend < 0.5


def test_scores_of_a_floor_that_is_off_by_three_millimetres(floor: Rendered) -> None:
    truth = seen_twice(floor)
    assert np.abs(truth[:, 2]).max() < 2e-3  # pictures of views are TRUTH_STEP times smaller: here they are not
    x, y = np.meshgrid(np.arange(0.45, 1.0, 0.003), np.arange(0.35, 0.9, 0.003))
    points = np.stack([x, y, np.full_like(x, 0.003)], axis=-1).reshape(-1, 3)
    told = score(points, floor, truth)
    assert told.median_mm == pytest.approx(3.0)
    assert told.precision_5mm == pytest.approx(100.0)
    assert math.isnan(told.objects_mean_mm)  # there is none
    assert TRUTH_STEP == 4


def test_distances_to_solids_are_those_of_geometry() -> None:
    tank = scene_of_seed(0, "tap")
    world = Rendered(0, "tap", tank, [], [], [], [])
    ball, stone = tank.solid[0], tank.solid[1]
    above = np.add(ball.position_m, (0.0, 0.0, 0.07 + 0.004))
    beside = np.add(stone.position_m, (stone.radii_m[0] + 0.002, 0.0, 0.0))
    off, of_solid = distances(np.array([above, beside, [0.001, 0.6, 0.3]]), world)
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


def test_it_all_from_views_to_table(floor: Rendered) -> None:
    asked = Settings(
        seeds=1, waters=("tap",), poses=("exact", "noisy"), only="scenes"
    )  # refined ones have tests of their own
    result = run(asked, lambda done, total: None, world=lambda *asked: floor)
    exact, off = result.cases
    assert exact["median_mm"] < 0.5
    assert exact["complete_10mm"] > 85.0
    assert exact["median_mm"] < off["median_mm"]
    assert exact["psnr_in"] > 15.0
    assert exact["image"] == "surfels" and exact["place_mm"] < 1e-6 < off["place_mm"]
    assert {"water", "poses", "median_mm", "complete_10mm", "f5", "psnr_in", "psnr_new", "seconds"} <= set(exact)
    assert table(result)


def test_a_survey_that_saves_too_little_or_ends_unlike_is_said() -> None:
    equal = {"shared": True, "loss30": True}
    told = {"coverage": {"shared": 70.0, "alone": 100.0, "loss30": 79.0}, "coverage_equal": equal}
    assert missed_coverage(told) == []
    told = {"coverage": {**told["coverage"], "loss30": 85.0}, "coverage_equal": {"shared": False, "loss30": True}}
    assert missed_coverage(told) == ["shared: maps differ", "loss30: 0.85 times the keyframes of robots alone"]
    assert missed_coverage({"coverage": {}, "coverage_equal": {}}) == []


def test_pictures_and_poses_that_miss_their_bars_are_said() -> None:
    one = {"seed": 2, "water": "tap", "poses": "exact", "image": "surfels", "psnr_in": 31.0, "psnr_new": 28.0, "f5": 77}
    assert missed_pictures([one, {**one, "poses": "refined", "psnr_in": 30.1, "f5": 73}]) == []
    assert missed_pictures([{**one, "psnr_new": 26.0}]) == ["seed 2, tap: new stations 26.0 dB"]
    worse = {**one, "poses": "refined", "psnr_in": 29.9, "f5": 71}
    assert missed_pictures([one, worse]) == [
        "seed 2, tap: refined poses lose 1.1 dB at known stations",
        "seed 2, tap: refined poses lose 6.0 points of F",
    ]


def test_a_bar_that_is_missed_is_said() -> None:
    focus = {"median_mm": 2.6, "complete_10mm": 90.0}
    one = {"seed": 1, "water": "tap", "poses": "exact", "focus": focus, "sweep": {"objects_mean_mm": 0.7}, "f5": 90.0}
    assert missed([one, {**one, "poses": "noisy"}]) == ["seed 1, tap: median by focus 2.60 mm"]


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
    assert all(made >= 1 for made in row["keyframes"])
    assert row["things"] >= row["empty"] >= 0
    console = Console(width=120, file=io.StringIO())
    console.print(swimmers_table([row]))
    assert f"{100 * second:.1f} %" in console.file.getvalue()
