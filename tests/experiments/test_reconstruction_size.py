"""Growing surveys: what is drawn is what a sweep would say; a small one goes all the way in a process of its own."""

import math

import numpy as np

from agent.experiments.reconstruction.score import distances_to
from hw.twin.scene import Solid
from tests.bench.bench_size import (
    FARTHEST_M,
    MOST,
    RIM_M,
    SIZE_M,
    BasinCamera,
    basin,
    drawn_views,
    keep,
    measured,
    stops,
    summary,
)


def test_a_survey_goes_through_all_of_the_basin_in_turns() -> None:
    for seed in (1, 2):
        found = stops(seed)
        assert len(found) == MOST and stops(seed, 50) == found[:50]
        x, y, z = np.array([one.position_m for one in found]).T
        assert x[:70].max() < 2.0 < 8.0 < x[-70:].min()  # together, from one end to the other
        assert np.ptp(y) > SIZE_M[1] - 1.2 and z.min() > 0.6
        solids = basin(seed).solid
        assert len(solids) == 48 and max(s.position_m[2] + s.radii_m[2] for s in solids) < 0.5
        assert min(min(s.position_m[:2]) for s in solids) >= RIM_M
        for n, one in enumerate(solids):
            assert all(math.dist(one.position_m[:2], other.position_m[:2]) > 0.1 for other in solids[:n])


def test_drawn_depths_err_as_they_say_and_are_silent_where_a_sweep_is() -> None:
    camera = BasinCamera(basin(1), 1, "r1")
    truth = np.full((240, 320), 0.9)
    truth[:, 200:] = 1.2  # an edge
    truth[:60] = FARTHEST_M + 0.1
    found = camera.focus(truth)
    z = (found.depth_m - truth)[70:, :180] / found.sigma_m[70:, :180]
    z = z[np.isfinite(z)]
    assert len(z) > 5000 and 0.3 < np.std(z) < 1.2 and abs(np.mean(z)) < 0.3  # between blocks it is a mean of them
    assert np.isnan(found.depth_m[:50]).all() and np.isnan(found.depth_m[:, 198:204]).all()


def test_boxes_are_as_far_as_geometry_says() -> None:
    box = Solid(kind="box", position_m=(2.0, 2.0, 0.1), radii_m=(0.3, 0.1, 0.1), turn_deg=(90.0, 0.0, 0.0))
    points = np.array([[2.0, 2.3, 0.1], [2.15, 2.0, 0.1], [2.1 + 0.03, 2.3 + 0.04, 0.1], [2.0, 2.0, 0.23]])
    off, of_solid = distances_to(points, np.array([10.0, 6.0, 1.3]), (box,))
    np.testing.assert_allclose(off, [0.0, 0.05, 0.05, 0.03], atol=1e-9)
    assert of_solid.all()


def test_a_small_survey_from_pictures_to_a_row(tmp_path) -> None:
    views = list(drawn_views(1, 3))
    assert [view.key for view in views] == [("r1", "", 0), ("r2", "", 0), ("r3", "", 0)]
    keep(views, tmp_path)
    row = measured(tmp_path, 3, 1)
    assert row["keyframes"] == 3 and row["median_mm"] < 5.0 and row["refined_mm"] > 0.0
    assert 100.0 < row["peak_mb"] < 2000.0
    assert min(row[key] for key in ("refine_s", "focus_s", "surface_s", "image_s")) > 0.0


def test_time_is_told_by_pairs_and_by_keyframes() -> None:
    one = {"refine_s": 9.0, "focus_s": 2.0, "image_s": 20.0, "median_mm": 0.7, "refined_mm": 1.3}
    rows = [
        {**one, "keyframes": n, "compared": pairs, "surface_s": 0.1 * pairs, "peak_mb": 6.0 * n}
        for n, pairs in ((125, 500), (250, 1125), (500, 2350))
    ]
    told = summary({"survey": rows})
    assert round(told["power_pairs"], 6) == 1.0 and told["power_keyframes"] > 1.05
    assert (told["peak_mb"], told["surface_s"]) == (3000.0, 235.0) and "scene_focus_s" not in told
    slower = [{**row, "surface_s": row["surface_s"] * row["keyframes"]} for row in rows]
    assert summary({"survey": slower})["power_pairs"] > 1.8
    assert summary({"survey": rows[:1]})["power_pairs"] is None
    assert summary({"scene": rows[:1]})["scene_surface_s"] == 50.0
