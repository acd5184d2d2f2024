"""What nobody saw and is concluded from what lies around it: where it is, how sure, and where it is left alone."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agent.reconstruction.export import write_colmap, write_glb, write_splat
from agent.reconstruction.fusion import Built, conclude, fuse, surface_of, with_concluded
from agent.reconstruction.mesh import Mesh, mesh_of, rendered, seen_faces
from agent.reconstruction.run import Made, area_m2, figures_of
from agent.reconstruction.views import View, stacked, surface_points
from tests.reconstruction.drawn import drawn_view, plane_depth

CELL_M = 5e-3
NORMAL = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
PLANE = partial(plane_depth, normal=NORMAL, offset=0.013)
PLACES = [(0.05, -0.45, 0.5), (0.2, -0.4, 0.5), (-0.15, -0.38, 0.45), (0.1, -0.3, 0.55)]
PLAIN_M = 0.07  # radius of a patch without texture, in the middle


def views_with_a_plain_patch() -> list[View]:
    """Nobody knows how far the patch is, and it looks the same all over."""
    found = []
    for n, place in enumerate(PLACES):
        view = drawn_view(n, place, (0.0, 0.0, 0.0), PLANE)
        plain = np.linalg.norm(surface_points(view) - 0.013 * NORMAL, axis=-1) < PLAIN_M
        picture = np.where(plain[..., None], np.float32(0.4), view.picture)
        depth, sigma = (np.where(plain, np.float32(np.nan), values) for values in (view.depth_m, view.sigma_m))
        found.append(replace(view, picture=picture, depth_m=depth, sigma_m=sigma))
    return found


def expected(views: list[View], mesh: Mesh) -> np.ndarray:
    return np.stack([rendered(mesh, mesh.colours, v.camera, v.rotation, v.position_m).depth_m for v in views])


@pytest.fixture(scope="module")
def seen_and_all() -> tuple[Mesh, Mesh]:
    views = views_with_a_plain_patch()
    return mesh_of(fuse(stacked(views, 0), CELL_M)), surface_of(views, CELL_M)


def in_the_patch(mesh: Mesh, radius_m: float = PLAIN_M - 2 * CELL_M) -> np.ndarray:
    return np.linalg.norm(mesh.vertices_m - 0.013 * NORMAL, axis=1) < radius_m


def test_a_plain_patch_of_a_plane_is_closed_where_the_plane_is(seen_and_all) -> None:
    seen, mesh = seen_and_all
    assert not in_the_patch(seen).any()
    patch = in_the_patch(mesh)
    assert patch.sum() > 400
    off = np.abs(mesh.vertices_m[patch] @ NORMAL - 0.013)
    assert np.median(off) < CELL_M / 2 and off.max() < 2 * CELL_M
    assert (off < 2.0 * mesh.sigma_m[patch]).mean() > 0.9
    assert (mesh.normals[patch] @ NORMAL > 0.9).mean() > 0.95
    assert np.abs(mesh.colours[patch] - 0.4).max() < 0.05


def test_it_is_told_from_what_was_seen_and_is_less_sure(seen_and_all) -> None:
    mesh = seen_and_all[1]
    patch, concluded = in_the_patch(mesh), mesh.views == 0
    assert concluded[patch].all()
    assert np.median(mesh.sigma_m[patch]) > 2.0 * np.median(mesh.sigma_m[~concluded])
    middle = in_the_patch(mesh, PLAIN_M / 3)
    assert np.median(mesh.sigma_m[middle]) > np.median(mesh.sigma_m[patch & ~middle]), "less sure the farther"


def test_what_was_seen_stays_to_the_bit(seen_and_all) -> None:
    seen, mesh = seen_and_all
    known = mesh.views > 0
    assert known.sum() == len(seen.vertices_m)

    def rows(one: Mesh, which: np.ndarray) -> list:
        return sorted(np.column_stack([one.vertices_m, one.normals, one.sigma_m, one.views])[which].tolist())

    assert rows(mesh, known) == rows(seen, np.ones(len(seen.vertices_m), bool))
    corners = {tuple(sorted(map(tuple, seen.vertices_m[face].tolist()))) for face in seen.faces}
    assert {tuple(sorted(map(tuple, mesh.vertices_m[face].tolist()))) for face in seen_faces(mesh)} >= corners


def test_exports_tell_it_from_what_was_seen(seen_and_all, tmp_path: Path) -> None:
    mesh = seen_and_all[1]
    write_splat(mesh, CELL_M, tmp_path / "splat.ply")
    _, _, body = (tmp_path / "splat.ply").read_bytes().partition(b"end_header\n")
    fields = np.frombuffer(body, "<f4").reshape(len(mesh.vertices_m), 17)
    opacity = 1.0 / (1.0 + np.exp(-fields[:, 9]))
    assert (opacity[mesh.views == 0] < 0.85).all() and (opacity[mesh.views > 0] > 0.95).all()
    write_colmap([], mesh, tmp_path / "colmap")
    points = np.loadtxt(tmp_path / "colmap" / "sparse" / "0" / "points3D.txt")[:, 1:4]
    assert len(points) == (mesh.views > 0).sum()
    assert not in_the_patch(mesh._replace(vertices_m=points)).any()


def test_a_glb_tells_it_too(seen_and_all, tmp_path: Path) -> None:
    mesh = seen_and_all[1]
    trimesh = pytest.importorskip("trimesh", reason="pip install 'aucamp[reconstruct]'")
    write_glb(mesh, tmp_path / "surface.glb")
    alpha = next(iter(trimesh.load(tmp_path / "surface.glb").geometry.values())).visual.vertex_colors[:, 3]
    assert sorted(alpha.tolist()) == sorted(np.where(mesh.views > 0, 255, 128).tolist())


def test_its_share_of_the_area_is_counted_and_sigma_is_of_what_was_seen(seen_and_all) -> None:
    seen, mesh = seen_and_all
    built = Built(views_with_a_plain_patch(), mesh, 0.5)
    told = figures_of(built.views, mesh, Made(built, [], {}, []))
    without = area_m2(seen)
    patch_m2 = np.pi * PLAIN_M**2
    assert told["concluded"] * told["area_m2"] == pytest.approx(patch_m2, rel=0.3)
    assert told["area_m2"] - without == pytest.approx(patch_m2, rel=0.3)
    assert told["sigma_mm"]["p50"] == pytest.approx(1e3 * np.median(seen.sigma_m), rel=0.01)


def test_depth_breaks_where_the_picture_does() -> None:
    """A hole across the edge of something nearer: each side has the depth of its own colour."""
    views = []
    for n, place in enumerate(PLACES):
        view = drawn_view(n, place, (0.0, 0.0, 0.0), PLANE)
        right = np.arange(view.camera.width)[None] >= 80
        depth = np.where(right, view.depth_m - 0.1, view.depth_m).astype(np.float32)
        picture = np.where(right[..., None], np.float32(0.1), np.float32(0.6)) * np.ones((*depth.shape, 3), np.float32)
        hole = np.zeros(depth.shape, bool)
        hole[50:70, 70:90] = True
        views.append(replace(view, picture=picture, depth_m=np.where(hole, np.nan, depth).astype(np.float32)))
    true = [
        np.where(np.arange(160)[None] >= 80, v - 0.1, v)
        for v in (PLANE(w.camera, w.rotation, w.position_m) for w in views)
    ]
    # Each view by itself: four times the same one, so that all bear witness.
    same = [replace(views[0], seq=n, position_m=views[0].position_m + np.array([0.03 * n, 0.0, 0.0])) for n in range(3)]
    found = conclude(same, np.full((3, 120, 160), np.nan, np.float32))
    rows, cols = np.nonzero(np.isfinite(found.depth_m[0]))
    inner = (np.abs(cols - 79.5) > 2) & (rows >= 50) & (rows < 70)
    assert inner.sum() > 100
    assert np.abs(found.depth_m[0] - true[0])[rows[inner], cols[inner]].max() < 0.02


def test_nothing_is_concluded_where_others_look_through() -> None:
    """Half of the views see, in the patch, a floor 20 cm below: the plane has a hole there."""
    views = views_with_a_plain_patch()
    below = partial(plane_depth, normal=NORMAL, offset=0.013 - 0.2)
    through = []
    for view in views[2:]:
        deep = below(view.camera, view.rotation, view.position_m).astype(np.float32)
        hole = np.isnan(view.depth_m)
        through.append(
            replace(view, depth_m=np.where(hole, deep, view.depth_m), sigma_m=np.full_like(view.sigma_m, 2e-3))
        )
    mesh = surface_of([*views[:2], *through], CELL_M)
    middle = in_the_patch(mesh, PLAIN_M / 2)
    assert middle.sum() < 20


def test_no_other_view_no_conclusion() -> None:
    view = views_with_a_plain_patch()[0]
    seen = fuse(stacked([view], 0), CELL_M)
    found = conclude([view], expected([view], mesh_of(seen)))
    assert np.isnan(found.depth_m).all()
    assert (with_concluded([view], seen, found).views > 0).all()


def test_where_nothing_is_known_nothing_is_concluded() -> None:
    views = views_with_a_plain_patch()
    blind = replace(
        views[0], depth_m=np.full_like(views[0].depth_m, np.nan), sigma_m=np.full_like(views[0].depth_m, np.nan)
    )
    nothing = np.full((2, 120, 160), np.nan, np.float32)
    assert np.isnan(conclude([blind, replace(blind, seq=1)], nothing).depth_m).all()
