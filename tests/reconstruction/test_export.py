"""Files for other programs, read back by those programs: same places, same pixels, same colours."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from agent.reconstruction.export import encoded, export, from_z, quaternion
from agent.reconstruction.fusion import fuse
from agent.reconstruction.mesh import Mesh, coloured, mesh_of
from agent.reconstruction.views import View, rotation_of, see, stacked
from tests.reconstruction.drawn import drawn_view, plane_depth

PLACES = [(0.05, -0.45, 0.5), (0.3, -0.3, 0.5), (-0.35, -0.2, 0.45)]


@pytest.fixture(scope="module")
def scene() -> tuple[list[View], Mesh]:
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    views = [drawn_view(n, place, (0.0, 0.0, 0.0), floor) for n, place in enumerate(PLACES)]
    stack = stacked(views)
    return views, coloured(mesh_of(fuse(stack, 0.01)), stack)


def test_colmap_sees_the_same_pixels(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pip install 'aucamp[validate]'")
    views, mesh = scene
    folder = export("colmap", views, mesh, 0.01, tmp_path)
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    assert len(model.images) == len(views)
    assert len(model.points3D) == len(mesh.vertices_m)
    for n, view in enumerate(views, start=1):
        pixels, _ = see(view, mesh.vertices_m)
        image = model.images[n]
        assert (folder / "images" / image.name).exists()
        for m in range(0, len(pixels), 997):
            there = image.project_point(mesh.vertices_m[m])
            if np.isfinite(pixels[m]).all() and np.abs(pixels[m]).max() < 300:
                assert np.abs(np.asarray(there) - 0.5 - pixels[m]).max() < 0.01


def test_nerfstudio_sees_the_same_pixels(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    views, mesh = scene
    folder = export("transforms.json", views, mesh, 0.01, tmp_path)
    read = json.loads((folder / "transforms.json").read_text())
    for frame, view in zip(read["frames"], views, strict=True):
        assert (folder / frame["file_path"]).exists()
        there = np.linalg.inv(np.array(frame["transform_matrix"]))
        x, y, z = (there[:3, :3] @ mesh.vertices_m.T + there[:3, 3:]) * [[1], [-1], [-1]]  # OpenGL's axes
        x, y = x / z, y / z
        bend = 1 + frame["k1"] * (x * x + y * y)
        u, v = frame["fl_x"] * x * bend + frame["cx"] - 0.5, frame["fl_y"] * y * bend + frame["cy"] - 0.5
        pixels, _ = see(view, mesh.vertices_m)
        inside = np.isfinite(pixels).all(axis=1)
        np.testing.assert_allclose(np.stack([u, v], axis=1)[inside], pixels[inside], atol=1e-6)


def test_ply_and_glb_are_read_by_trimesh(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="pip install 'aucamp[reconstruct]'")
    views, mesh = scene
    ply = trimesh.load(export("ply", views, mesh, 0.01, tmp_path), process=False)
    np.testing.assert_allclose(ply.vertices, mesh.vertices_m, atol=1e-6)
    np.testing.assert_array_equal(ply.faces, mesh.faces)
    np.testing.assert_array_equal(ply.visual.vertex_colors[:, :3], encoded(mesh.colours))
    glb = trimesh.load(export("glb", views, mesh, 0.01, tmp_path), process=False, force="mesh")
    np.testing.assert_allclose(np.asarray(glb.vertices)[:, [0, 2, 1]] * (1, -1, 1), mesh.vertices_m, atol=1e-6)


def test_open3d_reads_the_surface(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", reason="aucamp[validate], libusb, libGL", exc_type=ImportError)
    views, mesh = scene
    read = open3d.io.read_triangle_mesh(str(export("ply", views, mesh, 0.01, tmp_path)))
    assert len(read.triangles) == len(mesh.faces)
    assert read.has_vertex_colors()


def test_foxgloves_own_messages_by_the_descriptors_in_the_file(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    views, mesh = scene
    with export("mcap", views, mesh, 0.01, tmp_path).open("rb") as file:
        read = {
            channel.topic: (schema.name, message)
            for schema, channel, _, message in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        }
    kind, cloud = read["/scene/points"]
    assert (kind, cloud.frame_id) == ("foxglove.PointCloud", "world")
    numpy_of = {7: "<f4", 1: "u1"}  # foxglove.PackedElementField.NumericType
    names, types, offsets = zip(*((one.name, numpy_of[one.type], one.offset) for one in cloud.fields), strict=True)
    layout = {"names": names, "formats": types, "offsets": offsets, "itemsize": cloud.point_stride}
    points = np.frombuffer(cloud.data, np.dtype(layout))
    np.testing.assert_array_equal(np.stack([points[k] for k in "xyz"], axis=1), mesh.vertices_m.astype(np.float32))
    colours = np.stack([points[k] for k in ("red", "green", "blue")], axis=1)
    np.testing.assert_array_equal(colours, encoded(mesh.colours))
    np.testing.assert_array_equal(points["sigma_m"], mesh.sigma_m)
    np.testing.assert_array_equal(points["views"], mesh.views)
    kind, cameras = read["/scene/cameras"]
    assert (kind, len(cameras.poses)) == ("foxglove.PosesInFrame", len(views))
    for view, pose in zip(views, cameras.poses, strict=True):
        q, p = pose.orientation, pose.position
        ahead = (2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2))
        np.testing.assert_allclose(ahead, view.rotation[:, 2], atol=1e-9)
        np.testing.assert_allclose((p.x, p.y, p.z), view.position_m)


def test_rerun_takes_the_mcap_and_the_meshes(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="pip install 'aucamp[validate]'")
    pytest.importorskip("trimesh", reason="pip install 'aucamp[reconstruct]'")
    views, mesh = scene
    tool, env = str(Path(sys.executable).with_name("rerun")), {**os.environ, "HOME": str(tmp_path)}

    def told(*command: str | Path) -> str:
        return subprocess.run([tool, *command], check=True, capture_output=True, text=True, env=env).stdout

    for kind in ("ply", "glb"):
        recording = rerun.RecordingStream("scene")
        recording.save(tmp_path / f"{kind}.rrd")
        recording.log_file_from_path(export(kind, views, mesh, 0.01, tmp_path))
        recording.disconnect()
        assert "Asset3D:blob" in told("rrd", "print", "-v", tmp_path / f"{kind}.rrd")
    file = export("mcap", views, mesh, 0.01, tmp_path)
    told("mcap", "check", file)
    told("mcap", "convert", file, "-o", tmp_path / "mcap.rrd")
    shown = told("rrd", "print", "-v", tmp_path / "mcap.rrd")
    for what in ("points@Points3D:positions", "points@Points3D:colors", "cameras@InstancePoses3D:quaternions"):
        assert f"/scene/{what}" in shown


def test_splats_lie_on_the_surface(scene: tuple[list[View], Mesh], tmp_path: Path) -> None:
    views, mesh = scene
    data = export("splat", views, mesh, 0.01, tmp_path).read_bytes()
    head, body = data.split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property")]
    splats = np.frombuffer(body, [(name, "<f4") for name in names])
    np.testing.assert_allclose(np.stack([splats[k] for k in "xyz"], axis=1), mesh.vertices_m, atol=1e-6)
    w, x, y, z = (splats[f"rot_{k}"] for k in range(4))
    turned = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)  # of the z axis
    np.testing.assert_allclose(turned, mesh.normals, atol=1e-5)


def test_quaternions() -> None:
    for w in ((0.3, -1.0, 0.2), (0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)):
        q0, q1, q2, q3 = quaternion(rotation_of(np.array(w)))
        back = np.array([[1 - 2 * (q2**2 + q3**2), 2 * (q1 * q2 - q0 * q3), 2 * (q1 * q3 + q0 * q2)],
                         [2 * (q1 * q2 + q0 * q3), 1 - 2 * (q1**2 + q3**2), 2 * (q2 * q3 - q0 * q1)],
                         [2 * (q1 * q3 - q0 * q2), 2 * (q2 * q3 + q0 * q1), 1 - 2 * (q1**2 + q2**2)]])  # fmt: skip
        np.testing.assert_allclose(back, rotation_of(np.array(w)), atol=1e-9)
    assert from_z(np.array([[0.0, 0.0, -1.0]])).tolist() == [[0.0, 1.0, 0.0, 0.0]]
