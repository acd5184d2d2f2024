"""Pixels, depths and places of a view agree with each other and with the kernel's camera."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.camera_model import pixel as kernel_pixel
from agent.reconstruction.views import (
    Camera,
    View,
    diagonal_prior,
    moved,
    pixel_grid,
    pixel_of,
    project,
    ray_slopes,
    rotation_of,
    see,
    shrunk,
    slopes_of,
    surface_points,
    to_camera,
    to_world,
    unproject,
)

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
PLACES = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


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


@given(CAMERAS, TURNS, PLACES)
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
