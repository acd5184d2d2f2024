"""Our fusion of depths beside Open3D's, of the same maps: two surfaces within a fraction of a cell of each other."""

import numpy as np
import pytest

from agent.reconstruction.fusion import TRUNCATION_M, fuse
from agent.reconstruction.mesh import mesh_of
from agent.reconstruction.views import Camera, View, stacked
from tests.reconstruction.drawn import ball_depth, drawn_view, plane_depth

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
