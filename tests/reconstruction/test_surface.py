"""Surfaces of planes and balls in closed form: where they are, which way they look, what contradicts them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.process.command import Failed
from agent.reconstruction.fusion import fuse
from agent.reconstruction.mesh import coloured, mesh_of
from agent.reconstruction.views import View, stacked
from tests.reconstruction.drawn import ball_depth, drawn_view, plane_depth, texture

CELL_M = 5e-3
NORMAL = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
PLANE = partial(plane_depth, normal=NORMAL, offset=0.013)
PLACES = [(0.05, -0.45, 0.5), (0.3, -0.3, 0.5), (-0.35, -0.2, 0.45), (0.1, 0.3, 0.55)]


def plane_views() -> list[View]:
    return [drawn_view(n, place, (0.0, 0.0, 0.0), PLANE) for n, place in enumerate(PLACES)]


def test_a_plane_is_where_it_is_and_faces_the_water() -> None:
    mesh = mesh_of(fuse(stacked(plane_views()), CELL_M))
    off = mesh.vertices_m @ NORMAL - 0.013
    assert len(off) > 2000
    assert np.abs(off).mean() < CELL_M / 10
    assert (mesh.normals @ NORMAL > 0.98).mean() > 0.97
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    assert ((np.cross(b - a, c - a) @ NORMAL) > 0).mean() > 0.99  # counter-clockwise from the water


def test_a_ball_has_its_radius() -> None:
    centre = np.array([0.0, 0.0, 0.1])
    views = [drawn_view(n, p, centre, partial(ball_depth, centre=centre, radius=0.07)) for n, p in enumerate(PLACES)]
    mesh = mesh_of(fuse(stacked(views), CELL_M))
    off = np.linalg.norm(mesh.vertices_m - centre, axis=1) - 0.07
    assert np.median(np.abs(off)) < CELL_M / 10
    assert np.quantile(np.abs(off), 0.9) < CELL_M / 2  # of its rim sight lines graze


def test_views_count_by_their_certainty() -> None:
    """A view that is 6 mm off with three times the sigma moves the plane by its share of the weight, or less."""
    views = plane_views()[:2]
    off = replace(views[1], depth_m=views[1].depth_m + 4e-3, sigma_m=3 * views[1].sigma_m)
    single = mesh_of(fuse(stacked([views[0], views[1]]), CELL_M))
    both = mesh_of(fuse(stacked([views[0], off]), CELL_M))
    shift = np.median(both.vertices_m @ NORMAL) - np.median(single.vertices_m @ NORMAL)
    w = [1e-4 / (s * s + 1e-6) for s in (2e-3, 6e-3)]
    assert abs(shift) < 1.2 * 4e-3 * w[1] / sum(w)


def test_what_only_one_view_claims_is_carved_away_by_three_that_look_through_it() -> None:
    views = plane_views()
    depth = views[0].depth_m.copy()
    depth[40:70, 60:100] -= 0.1  # something 10 cm before the plane
    mesh = mesh_of(fuse(stacked([replace(views[0], depth_m=depth), *views[1:]]), CELL_M))
    assert (mesh.vertices_m @ NORMAL - 0.013 > 0.03).mean() < 0.01
    alone = mesh_of(fuse(stacked([replace(views[0], depth_m=depth)]), CELL_M))
    assert (alone.vertices_m @ NORMAL - 0.013 > 0.03).mean() > 0.02


def test_colours_are_those_that_were_seen() -> None:
    stack = stacked(plane_views())
    mesh = coloured(mesh_of(fuse(stack, CELL_M)), stack)
    assert np.abs(mesh.colours - texture(mesh.vertices_m)).mean() < 0.03


def test_nothing_known_is_said_to_be_nothing() -> None:
    view = plane_views()[0]
    with pytest.raises(Failed, match="nothing was sharp enough"):
        fuse(stacked([replace(view, depth_m=np.full_like(view.depth_m, np.nan))]), CELL_M)
    with pytest.raises(Failed, match="no keyframe"):
        stacked([])
