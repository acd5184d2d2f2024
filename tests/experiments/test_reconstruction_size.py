"""Growing surveys: what is drawn is what a sweep would say; a small one goes all the way in a process of its own."""

import math

import numpy as np

from agent.experiments.reconstruction.score import distances_to
from agent.experiments.reconstruction.size import (
    COUNTS,
    FARTHEST_M,
    MOST,
    RIM_M,
    ROBOTS,
    SIZE_M,
    BasinCamera,
    basin,
    drawn_views,
    keep,
    kept,
    missed_size,
    size,
    size_parts,
    stops,
    verdict,
)
from hw.twin.scene import Solid


def test_a_survey_goes_through_all_of_the_basin_in_turns() -> None:
    for seed in (1, 2):
        found = stops(seed)
        assert len(found) == MOST and stops(seed, 50) == found[:50]
        assert [one.robot for one in found[:7]] == list(ROBOTS)
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


def test_a_small_survey_from_pictures_to_a_row() -> None:
    done: list[None] = []
    (row,) = size(1, lambda: done.append(None), counts=(3,))
    assert len(done) == size_parts((3,)) == 4
    assert (row["seed"], row["keyframes"], row["robots"]) == (1, 3, 3)
    assert row["triangles"] > 1000 and row["median_mm"] < 5.0
    assert 50.0 < row["refine_mb"] <= row["surface_mb"] <= row["peak_mb"] < 2000.0 and row["seconds"] > 0.0
    assert row["believed_mm"] > 1.0 and row["refine_seconds"] > 0.0 and row["place_mm"] > 0.0
    assert row["image_seconds"] > 0.0 and row["image_db"] > 15.0


def test_views_are_kept_as_they_are(tmp_path) -> None:
    views = list(drawn_views(2, 2, lambda: None))
    keep(views, tmp_path)
    for one, other in zip(views, kept(tmp_path, 2), strict=True):
        assert one.key == other.key and one.camera == other.camera
        for name in ("rotation", "position_m", "pose_covariance", "picture", "depth_m", "sigma_m"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_what_grows_faster_than_it_may_is_said() -> None:
    rows = [
        {
            "keyframes": n,
            "compared": c,
            "seconds": 0.1 * n * c,
            "peak_mb": 3000,
            "matches": 50 * n**2,
            "refine_seconds": n * n,
            "image_seconds": n,
        }
        for n, c in zip(COUNTS, (4.0, 4.5, 4.7), strict=True)
    ]
    told = verdict(rows)
    assert (told["power_pairs"], told["peak_mb"]) == (1.0, 3000) and told["power_keyframes"] > 1.05
    assert (told["power_refine"], told["power_matches"], told["power_image"]) == (2.0, 1.0, 1.0)
    assert missed_size(rows) == missed_size([]) == [] and verdict([]) == {}
    slower = [{**row, "seconds": row["seconds"] * row["keyframes"]} for row in rows]
    assert missed_size([*slower[:2], {**slower[2], "peak_mb": 4100}]) == [
        "500 keyframes: 4100 MB",
        "time grows as pairs of pictures^1.90",
    ]
