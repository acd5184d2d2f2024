"""What a view is expected to show, as spots: where, how they face, and what they count."""

import math

import pytest

from agent.capabilities.survey.candidates import SPOTS_ACROSS, SPOTS_DOWN, Station, Where, frame_scene, view_of
from agent.capabilities.survey.coverage_map import FARTHEST_M, grid_of
from agent.capabilities.survey.survey import lens_of
from agent.core.config import Body, Pose
from agent.experiments.reconstruction.survey import WIDE, swimming_fleet

FLEET = swimming_fleet(1)
GRID = grid_of(FLEET)


def scene(tilt_deg: float, cells=None, stops=frozenset(), x_m=1.0):
    lens, rows = lens_of(WIDE, None)
    pose = Pose(x_m=x_m, y_m=1.0, yaw_deg=0.0)
    where = Where(pose, 0.3, FLEET.tank.surface_m, Body(), lens, rows, 100, None)
    view = view_of(Station((x_m, 1.0), 0.0, 0.0, tilt_deg), where)
    return frame_scene(view, GRID, cells or {}, stops)


def test_of_a_view_of_the_floor_all_spots_lie_on_it_face_up_and_count() -> None:
    found = scene(-45.0)
    assert len(found.spots) == SPOTS_ACROSS * SPOTS_DOWN
    assert all(abs(spot.at_m[2]) < 1e-6 and spot.normal == (0.0, 0.0, 1.0) for spot in found.spots)
    near = [spot for spot in found.spots if math.dist(spot.at_m, found.camera_m) < FARTHEST_M]
    assert sum(spot.blocks for spot in near) == pytest.approx(475 * len(near) / (SPOTS_ACROSS * SPOTS_DOWN), rel=0.02)
    assert found.aim_m[2] == pytest.approx(0.0, abs=1e-6) and found.axis[2] < 0.0


def test_walls_face_inwards_and_nothing_is_expected_of_what_is_far() -> None:
    near = [spot for spot in scene(0.0, x_m=2.2).spots if spot.at_m[2] > 1e-3]
    assert near and all(spot.normal == (-1.0, 0.0, 0.0) and spot.blocks > 0.0 for spot in near)
    far = scene(0.0)  # two metres before it
    assert not far.spots
    ahead = [p + a for p, a in zip(far.camera_m, far.axis, strict=True)]
    assert far.aim_m == pytest.approx(ahead)


def test_cells_that_are_known_well_enough_count_nothing_and_lamps_aim_at_the_others() -> None:
    fresh = scene(-45.0)
    known = {GRID.number(*spot.at_m): GRID.goal for spot in fresh.spots if spot.at_m[1] > 1.0}
    found = scene(-45.0, known)
    assert {spot.blocks > 0.0 for spot in found.spots if spot.at_m[1] > 1.0} == {False}
    assert found.aim_m[1] < fresh.aim_m[1]


def test_a_thing_stops_the_ray_and_is_taken_to_face_the_camera() -> None:
    fresh = scene(-45.0)
    spot = fresh.spots[len(fresh.spots) // 2]
    half = tuple(0.5 * (a + b) for a, b in zip(spot.at_m, fresh.camera_m, strict=True))
    number = GRID.number(*half)
    found = scene(-45.0, stops=frozenset({number}))
    nearer = [s for s, f in zip(found.spots, fresh.spots, strict=True) if s.at_m != f.at_m]
    assert nearer
    for one in nearer:
        towards = [c - a for c, a in zip(found.camera_m, one.at_m, strict=True)]
        assert sum(n * t for n, t in zip(one.normal, towards, strict=True)) == pytest.approx(math.hypot(*towards))
