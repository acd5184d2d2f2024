"""From blocks to pixels: a plane stays one, what does not hang together is left out, sigma is the calibration's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.core.ranging.camera_model import CameraFit, FocusFit
from agent.core.ranging.camera_model import pixel as kernel_pixel
from agent.core.ranging.focus import range_variance
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction.fusion import TRUNCATION_M, fuse
from agent.reconstruction.mesh import mesh_of
from agent.reconstruction.views import (
    FLOOR_M,
    Camera,
    View,
    composite,
    diagonal_prior,
    focus_map,
    linear,
    moved,
    pixel_grid,
    pixel_of,
    project,
    range_sigma_m,
    ray_slopes,
    rotation_of,
    see,
    shrunk,
    shrunk_frame,
    slopes_of,
    stacked,
    surface_points,
    to_camera,
    to_world,
    unproject,
)
from tests.reconstruction.drawn import ball_depth, drawn_view, plane_depth

FOCUS = FocusFit(u_inf_m=0.001, b_m=130.0, rho0=90.0, covariance=(0.0,) * 6, noise=0.7, width=250.0, lowest=190,
                 highest=700, r2=1.0, rmse_m=0.0, held_out_rmse_m=0.0)  # fmt: skip
BLOCK, TIMES = 50, 4
F_PX, LONG_PX = 600.0, 2400.0  # of a block of 50 px in 0.5 m: 42 and 10 mm, of which squares are shared


def grid(range_m: np.ndarray) -> DepthMap:
    """Blocks at these ranges, all accepted but those that are NaN."""
    rho = FOCUS.rho0 + FOCUS.b_m / (range_m - FOCUS.u_inf_m)
    reason = np.where(np.isnan(range_m), Reason.POOR_FIT, Reason.ACCEPTED).astype(np.uint8)
    ones = np.ones_like(range_m)
    blocks = GridPeaks(rho, 2.0 * ones, 250.0 * ones, ones, reason, range_m)
    return DepthMap(BLOCK, blocks, None, np.zeros((1, 1, 3), np.uint8), 0.0)


def test_a_plane_between_blocks_is_a_plane() -> None:
    """1/z of a plane is linear in the pixel; the middle of block n is pixel 50 n + 24.5."""
    u, v = np.meshgrid(50 * np.arange(8) + 24.5, 50 * np.arange(6) + 24.5)
    found = focus_map(grid(1.0 / (2.0 + 4e-4 * u - 3e-4 * v)), FOCUS, F_PX, TIMES, (100, 75))
    small_u, small_v = np.meshgrid(4 * np.arange(100) + 1.5, 4 * np.arange(75) + 1.5)
    known = np.isfinite(found.depth_m)
    assert known.mean() > 0.7  # half a block at the rim has no four around it
    truth = 1.0 / (2.0 + 4e-4 * small_u - 3e-4 * small_v)
    np.testing.assert_allclose(found.depth_m[known], truth[known], rtol=1e-6)


def test_three_blocks_tell_what_lies_between_them() -> None:
    """The middle of block (2, 3) is small pixel (43.25, 30.75) of (u, v), 12.5 of them are a block."""
    u, v = np.meshgrid(50 * np.arange(8) + 24.5, 50 * np.arange(6) + 24.5)
    ranges = 1.0 / (2.0 + 4e-4 * u - 3e-4 * v)
    ranges[2, 3] = np.nan
    found = focus_map(grid(ranges), FOCUS, F_PX, TIMES, (100, 75))
    u, v = np.meshgrid(np.arange(100), np.arange(75))
    away = np.abs(u - 43.25) / 12.5 + np.abs(v - 30.75) / 12.5  # 1 at the four blocks beside it
    asked = (u > 6) & (u < 93) & (v > 6) & (v < 68) & (np.abs(away - 1.0) > 1e-9)
    np.testing.assert_array_equal(np.isfinite(found.depth_m)[asked], (away > 1.0)[asked])
    truth = 1.0 / (2.0 + 4e-4 * (4 * u + 1.5) - 3e-4 * (4 * v + 1.5))
    known = np.isfinite(found.depth_m)
    np.testing.assert_allclose(found.depth_m[known], truth[known], rtol=1e-6)


def test_across_a_step_nothing_is_guessed() -> None:
    ranges = np.full((6, 8), 0.5)
    ranges[:, 4:] = 0.7
    ranges[2, 1] = np.nan
    found = focus_map(grid(ranges), FOCUS, F_PX, TIMES, (100, 75))
    between = slice(int((50 * 3 + 24.5) / 4) + 2, int((50 * 4 + 24.5) / 4) - 1)
    assert np.isnan(found.depth_m[:, between]).all()
    assert np.isnan(found.depth_m[27:35, 15:22]).all()  # what is nearer to the unknown block than to all others
    assert set(np.unique(found.depth_m[np.isfinite(found.depth_m)]).round(4)) == {np.float32(0.5), np.float32(0.7)}


def test_sigma_is_the_calibrations() -> None:
    found = grid(np.array([[0.3, 0.6], [0.9, 1.2]]))
    told = range_sigma_m(found.blocks, FOCUS)
    for row, col in np.ndindex(2, 2):
        rho = float(found.blocks.lens_position[row, col])
        assert told[row, col] ** 2 == pytest.approx(range_variance(FOCUS, rho, 2.0)[0])
    flat = focus_map(grid(np.full((6, 8), 0.5)), FOCUS, F_PX, TIMES, (100, 75))
    s = np.sqrt(range_variance(FOCUS, float(grid(np.full((1, 1), 0.5)).blocks.lens_position[0, 0]), 2.0)[0])
    np.testing.assert_allclose(flat.sigma_m[np.isfinite(flat.sigma_m)], np.hypot(s, FLOOR_M), rtol=1e-5)


def test_blocks_of_a_plane_share_what_they_know_and_a_ball_and_an_edge_stay_what_they_are() -> None:
    u, v = np.meshgrid(50 * np.arange(20) + 24.5, 50 * np.arange(16) + 24.5)
    plane = 1.0 / (2.0 + 4e-4 * u - 3e-4 * v)
    aside_m = np.hypot(u - 500.0, v - 400.0) * 0.5 / LONG_PX
    ball = 0.57 - np.sqrt(np.maximum(0.07**2 - aside_m**2, 0.0))
    edge = np.where(u < 500.0, plane, plane + 0.1)
    rng, size = np.random.default_rng(7), (250, 200)

    for ranges, most in ((plane, 0.5), (ball, 1.1), (edge, 0.7)):
        noisy = grid(ranges + range_sigma_m(grid(ranges).blocks, FOCUS) * rng.standard_normal(ranges.shape))
        alone, shared = (focus_map(noisy, FOCUS, f_px, TIMES, size) for f_px in (F_PX, LONG_PX))
        exact = focus_map(grid(ranges), FOCUS, F_PX, TIMES, size).depth_m
        known = np.isfinite(alone.depth_m) & np.isfinite(shared.depth_m) & np.isfinite(exact)
        alone_m, shared_m = (np.sqrt(np.mean((found.depth_m - exact)[known] ** 2)) for found in (alone, shared))
        assert shared_m < most * alone_m
        assert np.sqrt(np.mean(((shared.depth_m - exact) / shared.sigma_m)[known] ** 2)) < 1.3


def test_each_part_comes_from_its_sharpest_frame_on_the_largest_ones_scale() -> None:
    rng = np.random.default_rng(2)
    scene = np.kron(rng.integers(40, 220, (12, 16, 3)), np.ones((20, 20, 1))).astype(np.uint8)  # 320 x 240
    dark = np.zeros_like(scene)
    left, right = scene.copy(), scene.copy()
    left[:, 160:], right[:, :160] = dark[:, 160:], dark[:, :160]
    clarity = np.zeros((2, 4, 8))
    clarity[0, :, :4], clarity[1, :, 4:] = 1.0, 1.0
    picture = composite([left, right], np.ones(2), (159.5, 119.5), clarity, 40.0, 4, 2.2)
    truth = linear(scene, 2.2).reshape(60, 4, 80, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(picture[:, :34], truth[:, :34], atol=1e-6)
    np.testing.assert_allclose(picture[:, 46:], truth[:, 46:], atol=1e-6)


def test_a_smaller_frame_is_brought_to_the_largest_ones_scale() -> None:
    """A disc of radius 60 about the axis, 57 in a frame 0.95 times as large."""
    v, u = np.mgrid[:240, :320]
    discs = [np.where(np.hypot(u - 150.0, v - 110.0) < r, 200, 20).astype(np.uint8) for r in (60.0, 57.0)]
    frames = [np.repeat(one[..., None], 3, axis=2) for one in discs]
    same = [shrunk_frame(f, s, (150.0, 110.0), 4, 2.2) for f, s in zip(frames, (1.0, 0.95), strict=True)]
    wrong = shrunk_frame(frames[1], 1.0, (150.0, 110.0), 4, 2.2)
    apart = [float(np.abs(same[0] - other).mean()) for other in (same[1], wrong)]
    assert apart[0] < 0.15 * apart[1]


# --- fusion oracle ---
# Our fusion of depths beside Open3D's, of the same maps: two surfaces within a fraction of a cell of each other.

CELL_M, CENTRE, RADIUS_M = 5e-3, np.array([0.0, 0.0, 0.06]), 0.07
SIDE_M, NEAR_M = 1.0, 0.2  # of their grid; of what is compared, around the ball
PINHOLE = Camera(220.0, 79.5, 59.5, 0.0, 0.0, 160, 120)  # Open3D knows no bend
PLACES = [(0.05, -0.45, 0.5), (0.3, -0.3, 0.5), (-0.35, -0.2, 0.45), (0.1, 0.3, 0.55), (-0.2, 0.35, 0.4)]


def ball_on_floor(camera: Camera, rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    ball = ball_depth(camera, rotation, position, CENTRE, RADIUS_M)
    return np.fmin(ball, plane_depth(camera, rotation, position, np.array([0.0, 0.0, 1.0]), 0.0))


def noisy_views() -> list[View]:
    """Each with depths 2 mm off at random: what is compared is how that is averaged, too."""
    rng = np.random.default_rng(11)

    def depth(camera: Camera, rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
        truth = ball_on_floor(camera, rotation, position)
        return truth + rng.normal(0.0, 2e-3, truth.shape)

    return [drawn_view(n, place, tuple(CENTRE), depth, camera=PINHOLE) for n, place in enumerate(PLACES)]


def test_open3d_fuses_the_same_depths_to_the_same_surface() -> None:
    open3d = pytest.importorskip("open3d", reason="aucamp[validate], libusb, libGL", exc_type=ImportError)
    views = noisy_views()
    volume = open3d.pipelines.integration.UniformTSDFVolume(
        length=SIDE_M,
        resolution=round(SIDE_M / CELL_M),
        sdf_trunc=TRUNCATION_M,
        color_type=open3d.pipelines.integration.TSDFVolumeColorType.RGB8,
        origin=-0.5 * np.full(3, SIDE_M),
    )
    c = PINHOLE
    lens = open3d.camera.PinholeCameraIntrinsic(c.width, c.height, c.f_px, c.f_px, c.cx_px, c.cy_px)
    for view in views:
        to_camera = np.eye(4)
        to_camera[:3, :3], to_camera[:3, 3] = view.rotation.T, -view.rotation.T @ view.position_m
        black = open3d.geometry.Image(np.zeros((c.height, c.width, 3), np.uint8))
        depth = open3d.geometry.Image(np.ascontiguousarray(view.depth_m))
        both = open3d.geometry.RGBDImage.create_from_color_and_depth(
            black, depth, depth_scale=1.0, depth_trunc=2.0, convert_rgb_to_intensity=False
        )
        volume.integrate(both, lens, to_camera)
    theirs = np.asarray(volume.extract_triangle_mesh().vertices)
    ours = mesh_of(fuse(stacked(views), CELL_M)).vertices_m
    ours, theirs = (points[np.linalg.norm(points - CENTRE, axis=1) < NEAR_M] for points in (ours, theirs))
    one, other = (open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)) for points in (ours, theirs))
    there, back = (np.asarray(a.compute_point_cloud_distance(b)) for a, b in ((one, other), (other, one)))
    assert np.quantile(there, 0.95) < CELL_M and np.quantile(back, 0.95) < CELL_M  # from vertex to vertex
    off = [np.minimum(abs(np.linalg.norm(p - CENTRE, axis=1) - RADIUS_M), abs(p[:, 2])).mean() for p in (ours, theirs)]
    assert off[0] <= off[1] < CELL_M / 5  # from the truth: 0.26 and 0.63 mm


# --- view ---
# Pixels, depths and places of a view agree with each other and with the kernel's camera.

CAMERAS = st.builds(
    Camera,
    f_px=st.floats(150.0, 4000.0),
    cx_px=st.floats(100.0, 220.0),
    cy_px=st.floats(80.0, 160.0),
    bend=st.floats(-0.3, 0.6),
    ahead_m=st.floats(-0.01, 0.05),
    width=st.just(320),
    height=st.just(240),
)
TURNS = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
VIEW_PLACES = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


def view_of(camera: Camera, rotation: np.ndarray, position: np.ndarray, depth: np.ndarray) -> View:
    picture = np.zeros((camera.height, camera.width, 3), np.float32)
    return View("r1", "a", 1, camera, rotation, position, diagonal_prior(0.01, 0.001), picture, depth, depth)


@given(CAMERAS, st.floats(0.1, 3.0))
def test_every_pixel_comes_back_from_its_place(camera: Camera, depth_m: float) -> None:
    pixels = pixel_grid(camera)[::24, ::32]
    if camera.bend < 0.0:  # a picture does not reach beyond its own fold
        off_axis = np.linalg.norm(pixels - (camera.cx_px, camera.cy_px), axis=-1)
        pixels = pixels[off_axis < 0.3 * camera.f_px]
    points = unproject(camera, pixels, np.full(pixels.shape[:-1], depth_m))
    np.testing.assert_allclose(project(camera, points), pixels, atol=1e-9, rtol=0)


@given(CAMERAS, TURNS, VIEW_PLACES)
def test_the_world_and_back(camera: Camera, turn: np.ndarray, place: np.ndarray) -> None:
    view = view_of(camera, rotation_of(turn), place, np.full((240, 320), np.nan, np.float32))
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3))
    np.testing.assert_allclose(to_world(view, to_camera(view, points)), points, atol=1e-12)
    seen, depth = see(view, points)
    np.testing.assert_allclose(depth, ((points - place) @ view.rotation)[:, 2], atol=1e-12)
    assert np.isnan(seen).any(axis=-1)[depth <= camera.ahead_m].all()


@given(CAMERAS, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.2, 2.0))
def test_kernels_kernel_and_pictures_have_one_camera(camera: Camera, x: float, y: float, z: float) -> None:
    fit = CameraFit(width_px=320, height_px=240, f_px=camera.f_px, cx_px=camera.cx_px, cy_px=camera.cy_px,
                    bend=camera.bend, ahead_m=camera.ahead_m)  # fmt: skip
    point = (x * z, y * z, z)
    told = kernel_pixel(fit, point)
    u, v, before = pixel_of.py_func(camera, *point)
    assert before and told is not None
    np.testing.assert_allclose((u, v), told, rtol=1e-12)
    np.testing.assert_allclose(project(camera, np.array(point)), told, rtol=1e-12)
    slopes = ray_slopes(camera, np.array(told))
    np.testing.assert_allclose(slopes_of.py_func(camera, u, v), slopes, atol=1e-9)
    np.testing.assert_allclose(slopes, np.array(point[:2]) / (z - camera.ahead_m), atol=1e-9)


def test_a_smaller_picture_sees_the_same_ray() -> None:
    camera = Camera(857.0, 640.0, 350.0, 0.39, 0.01, 1280, 720)
    small = shrunk(camera, 4)
    assert (small.width, small.height) == (320, 180)
    corner = np.array([10.0, 20.0])  # a pixel of the small one covers 40..43, 80..83 of the large one
    np.testing.assert_allclose(ray_slopes(small, corner), ray_slopes(camera, np.array([41.5, 81.5])), atol=1e-12)


def test_a_correction_is_along_the_cameras_axes() -> None:
    rotation = rotation_of(np.array([0.3, -1.2, 0.4]))
    depth = np.full((4, 4), 0.5, np.float32)
    view = view_of(Camera(100.0, 1.5, 1.5, 0.0, 0.0, 4, 4), rotation, np.zeros(3), depth)
    there = moved(view, np.array([0.0, math.pi / 2, 0.0]), np.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(there.position_m, rotation @ (0.0, 0.0, 2.0), atol=1e-12)
    np.testing.assert_allclose(there.rotation[:, 2], rotation[:, 0], atol=1e-12)  # z turns to x about y
    middle = surface_points(there).mean(axis=(0, 1))
    np.testing.assert_allclose(middle, there.position_m + 0.5 * rotation[:, 0], atol=1e-6)


@pytest.mark.parametrize("w", [(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.5, -0.2, 3.0)])
def test_rotations_are_rotations(w: tuple[float, float, float]) -> None:
    rotation = rotation_of(np.array(w))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
