"""Boxes and turned ellipsoids in a scene: where a ray meets them, against a search along it in float64."""

import numpy as np
import pytest

from hw.twin.optics.lens import draw_lens
from hw.twin.optics.raycast import SOLID_ID, Eye, Moment, make_view, ray, trace, turned
from hw.twin.scene import Solid

BOX_M = (1.5, 1.2, 0.5)
LENS = draw_lens("binned_640", np.random.default_rng(1))
START = np.array([0.2, 0.6, 0.25])
TURN = (35.0, 20.0, -15.0)


def look(target):
    forward = np.asarray(target, float) - START
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Eye(START, np.column_stack([right, np.cross(forward, right), forward]))


def traced(solid):
    view = make_view(Moment(look(solid.position_m), (solid,)), LENS.image_m(1.0), LENS, 1.333, BOX_M)
    depth, identity = np.empty((480, 640), np.float32), np.empty((480, 640), np.uint8)
    trace(view, 0, 0, depth, identity)
    return view, depth, identity


def inside(solid, points):
    own = (points - solid.position_m) @ turned(solid.turn_deg) / solid.radii_m
    return np.abs(own).max(axis=-1) <= 1.0 if solid.kind == "box" else (own**2).sum(axis=-1) <= 1.0


@pytest.mark.parametrize("kind", ["box", "stone"])
@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), TURN])
def test_a_ray_stops_where_a_search_along_it_says(kind, turn_deg):
    solid = Solid(kind=kind, position_m=(0.75, 0.6, 0.22), radii_m=(0.12, 0.06, 0.08), turn_deg=turn_deg)
    view, depth, identity = traced(solid)
    eye, steps = look(solid.position_m), np.arange(0.2, 0.95, 5e-4)
    hits = 0
    for i in range(20, 640, 40):
        for j in range(20, 480, 40):
            mx, my, a, b = (float(v) for v in ray.py_func(view.optics, i, j))
            points = np.column_stack([a + steps * mx, b + steps * my, steps]) @ np.asarray(eye.rotation).T + START
            within = inside(solid, points)
            if within.any():
                first = steps[within.argmax()]
                # A corner that is cut by less than a step may be missed by the search, never by more.
                assert identity[j, i] == SOLID_ID and -1e-4 < first - depth[j, i] < 6e-4
                hits += 1
            elif identity[j, i] == SOLID_ID:
                there = np.array([a + depth[j, i] * mx, b + depth[j, i] * my, depth[j, i]])
                own = (np.asarray(eye.rotation) @ there + START - solid.position_m) @ turned(turn_deg) / solid.radii_m
                assert np.abs(own).max() < 1.01 if kind == "box" else np.linalg.norm(own) < 1.01
    assert hits > 12


def test_nothing_of_a_box_is_cut_off_by_its_bounds():
    solid = Solid(kind="box", position_m=(0.75, 0.6, 0.22), radii_m=(0.12, 0.06, 0.08), turn_deg=TURN)
    view, _, identity = traced(solid)
    wide = view._replace(bounds=np.array([[-1000, -1000, 2000, 2000]]))
    depth, everywhere = np.empty((480, 640), np.float32), np.empty((480, 640), np.uint8)
    trace(wide, 0, 0, depth, everywhere)
    assert (identity == everywhere).all() and (identity == SOLID_ID).sum() > 5000
