"""What is passed over because a view cannot see it: never anything that it does see."""

from functools import partial

import numpy as np
import pytest

from agent.reconstruction import fusion
from agent.reconstruction import mesh as colours
from agent.reconstruction.bricks import balls_of, cone, cones, meets, touched
from agent.reconstruction.mesh import mesh_of, pieces_of, rendered
from agent.reconstruction.views import Camera, View, pixel_grid, project, rotation_of, stacked, unproject
from tests.reconstruction.drawn import CAMERA, drawn_view, plane_depth

FLOOR = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)


@pytest.fixture(scope="module")
def views() -> list[View]:
    """Six of a floor: three that look at one part of it, three that look at another."""
    places = [(x + dx, y, 0.4) for x in (0.0, 1.5) for dx, y in ((0.0, -0.3), (0.2, -0.2), (-0.2, -0.25))]
    return [drawn_view(n, p, (0.0 if n < 3 else 1.5, 0.0, 0.0), FLOOR) for n, p in enumerate(places)]


@pytest.mark.parametrize("bend", [0.39, 0.0, -0.2, -0.9])
def test_no_pixel_lies_outside_the_cone(bend: float) -> None:
    camera, rng = CAMERA._replace(bend=bend), np.random.default_rng(3)
    rotation, position = rotation_of(rng.normal(size=3)), rng.normal(size=3)
    depth = rng.uniform(0.05, 1.5, (camera.height, camera.width))
    points = unproject(camera, pixel_grid(camera), depth)
    seen = np.isfinite(project(camera, points)).all(axis=-1).ravel()  # at -0.9 the corners lie beyond the fold
    assert seen.all() == (bend > -0.9) and seen.mean() > 0.8
    around = np.column_stack([points.reshape(-1, 3) @ rotation.T + position, np.zeros(seen.size)])
    assert touched(around, cone(camera, rotation, position, 1.5))[seen].all()
    assert not touched(around, cone(camera, rotation, position, 1.0))[depth.ravel() > 1.0].any()


def test_what_is_beside_behind_or_beyond_is_passed_over() -> None:
    camera = Camera(200.0, 79.5, 59.5, 0.0, 0.0, 160, 120)  # half of its diagonal is seen under 27 degrees
    one = cone(camera, np.eye(3), np.zeros(3), 1.0)
    places = [(0.0, 0.0, 0.5), (0.4, 0.0, 0.5), (0.0, 0.0, -0.2), (0.0, 0.0, 1.2), (0.4, 0.0, 0.5)]
    radii = [0.0, 0.05, 0.1, 0.1, 0.2]
    found = touched(np.column_stack([np.array(places), radii]), one)
    assert found.tolist() == [True, False, False, False, True]
    assert meets(one[None], np.array(places[0]), 0.0).tolist() == [True]


def test_balls_hold_their_points() -> None:
    points = np.random.default_rng(1).normal(size=(150, 3))
    around = balls_of(points, 64)
    assert len(around) == 3
    off = np.linalg.norm(points - np.repeat(around[:, :3], 64, axis=0)[:150], axis=1)
    assert (off <= np.repeat(around[:, 3], 64)[:150] + 1e-12).all()


def test_a_surface_is_the_same_without_it(views: list[View], monkeypatch: pytest.MonkeyPatch) -> None:
    stack = stacked(views)
    assert not all(meets(cones(stack, 0.012), np.zeros(3), 0.2)) and any(meets(cones(stack, 0.012), np.zeros(3), 0.2))
    mesh = colours.coloured(mesh_of(fusion.fuse(stack, 0.01)), stack)
    picture = rendered(mesh, mesh.colours, views[0].camera, views[0].rotation, views[0].position_m)
    for room in (fusion, colours):
        monkeypatch.setattr(room, "cones", lambda stack, band_m: _everything(len(stack.cameras)))
    whole = colours.coloured(mesh_of(fusion.fuse(stack, 0.01)), stack)
    for a, b in zip(mesh, whole, strict=True):
        np.testing.assert_array_equal(a, b)
    around = pieces_of(mesh)
    around[:, 3] = 100.0
    all_of_it = rendered(mesh, mesh.colours, views[0].camera, views[0].rotation, views[0].position_m, around)
    np.testing.assert_array_equal(picture.depth_m, all_of_it.depth_m)
    np.testing.assert_array_equal(picture.picture, all_of_it.picture)


def _everything(count: int) -> np.ndarray:
    """Cones that are half of space, and face all of the scene."""
    return np.tile([0.0, 0.0, 100.0, 0.0, 0.0, -1.0, 1.0, 0.0, np.inf], (count, 1))
