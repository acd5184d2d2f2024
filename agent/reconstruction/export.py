"""What `aucamp reconstruct --export` can be, and which files it gives."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import write_whole
from agent.process.command import Failed
from agent.reconstruction.mesh import Mesh
from agent.reconstruction.views import Floats, View
from hw.camera.files import write_picture
from replay.files.channels import PROTOBUF, Entry
from replay.files.frames import schema
from replay.files.mcap_file import Part
from replay.viewers.foxglove import Turn, world_cloud, world_poses

# --- what the numbers in a file mean ---


class Space(NamedTuple):
    """Of a scene: in which unit and axes its lengths are, and what they are counted from."""

    said: str = "metres, z up"
    sigma: str = "sigma_m"  # name of a standard deviation
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # where that is in the scene as it was given

    @property
    def away(self) -> str:
        """Where the origin is, in words; nothing where it is that of the scene itself."""
        return f"origin {_text(list(self.origin))}" if any(self.origin) else ""


WORLD = Space()  # of a dive


# --- light as bytes, for pictures and vertex colours ---

GAMMA = 2.2  # near enough to sRGB that no viewer shows the difference


def encoded(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear 0 to 1 -> 255 light ** (1 / 2.2), clipped."""
    return np.asarray(np.rint(255.0 * np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA)), np.uint8)


# --- a view as other programs model cameras ---
#
# Their rays meet in the camera's centre, and the first pixel's corner is (0, 0). Our rays meet `ahead_m` before the
# pivot, so that is where their centre goes; our first pixel's middle is (0, 0), so theirs is half a pixel on. The bend
# is their first radial coefficient: u = f x (1 + k1 r^2) + cx, exactly.


class Pinhole(NamedTuple):
    f_px: float
    cx_px: float
    cy_px: float
    k1: float
    width: int
    height: int
    rotation: Floats  # (3, 3) camera (right, down, ahead) to world
    centre_m: Floats  # (3,)


def pinhole(view: View) -> Pinhole:
    """The same view, in their convention."""
    camera = view.camera
    centre = view.position_m + camera.ahead_m * view.rotation[:, 2]
    f, cx, cy = camera.f_px, camera.cx_px + 0.5, camera.cy_px + 0.5
    return Pinhole(f, cx, cy, camera.bend, camera.width, camera.height, view.rotation, centre)


def quaternion(rotation: Floats) -> Floats:
    """(w, x, y, z) of a rotation (3, 3), w >= 0."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3.0)  # reads the lower triangle: Bar-Itzhack 2000
    x, y, z, w = vectors[:, -1]
    return np.array([w, x, y, z]) * (1.0 if w >= 0.0 else -1.0)


def names(views: list[View]) -> list[str]:
    """A file name for each view, without an ending."""
    return [f"{view.robot}_{view.seq:05d}_{n:04d}" for n, view in enumerate(views)]


# --- COLMAP: a sparse model in its text form, images/ and sparse/0/ with three files ---

MOST_POINTS = 100_000  # of the surface, which is enough for any program to start from


def write_colmap(views: list[View], mesh: Mesh, folder: Path, space: Space = WORLD) -> None:
    """The folder is made; camera n belongs to image n, for each robot has its own lens at its own position.

    Points are of what was seen.
    """
    sparse, images = folder / "sparse" / "0", folder / "images"
    for one in (sparse, images):
        one.mkdir(parents=True)
    cameras, poses = [], []
    for n, (view, name) in enumerate(zip(views, names(views), strict=True), start=1):
        write_picture(images / f"{name}.png", encoded(view.picture)[..., ::-1])
        p = pinhole(view)
        cameras.append(f"{n} SIMPLE_RADIAL {p.width} {p.height} {_text([p.f_px, p.cx_px, p.cy_px, p.k1])}")
        to_camera = p.rotation.T
        pose = [*quaternion(to_camera).tolist(), *(-to_camera @ p.centre_m).tolist()]
        poses.append(f"{n} {_text(pose)} {n} {name}.png\n")  # the line of its points is empty
    seen = np.flatnonzero(mesh.views > 0)
    step = max(1, -(-len(seen) // MOST_POINTS))
    colours = encoded(mesh.colours)
    points = [
        f"{n} {_text(mesh.vertices_m[m].tolist())} {' '.join(str(c) for c in colours[m])} 0"
        for n, m in enumerate(seen[::step].tolist(), start=1)
    ]
    for file, lines in (("cameras.txt", cameras), ("images.txt", poses), ("points3D.txt", points)):
        head = [f"# {space.away}"] if space.away else []
        write_whole(sparse / file, "".join(f"{line}\n" for line in (*head, *lines)))


def _text(numbers: list[float]) -> str:
    return " ".join(np.format_float_positional(number, trim="0") for number in numbers)


# --- GLB, which browsers and office programs show ---


def write_glb(mesh: Mesh, path: Path) -> None:
    """Y up as glTF wants it; alpha is half where nobody saw the surface, which viewers show as any other.

    Raises Failed where trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError:
        raise Failed("GLB needs trimesh: pip install 'aucamp[reconstruct]', or choose another --export") from None
    y_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    body = trimesh.Trimesh(
        vertices=mesh.vertices_m @ y_up.T,
        faces=mesh.faces,
        vertex_normals=mesh.normals @ y_up.T,
        vertex_colors=np.column_stack([encoded(mesh.colours), np.where(mesh.views > 0, 255, 128).astype(np.uint8)]),
        process=False,
    )
    glb: Any = body.export(file_type="glb")  # bytes, of all that it can be
    write_whole(path, glb)


# --- MCAP of Foxglove's own messages, for Foxglove and Rerun: a cloud of points, and the cameras ---

POINTS, CAMERAS = "/scene/points", "/scene/cameras"
T_NS = 0  # a scene stands still: it has no time


def write_mcap(views: list[View], mesh: Mesh, path: Path, space: Space = WORLD) -> None:
    """A point has `sigma_m` and `views` beside its colour; a camera looks along z, y down.

    Raises ConfigError where the file cannot be written, or is there.
    """
    beside = {space.sigma: mesh.sigma_m.astype("<f4"), "views": mesh.views.astype("u1")}
    cloud = world_cloud(mesh.vertices_m.astype(np.float32), encoded(mesh.colours), beside, T_NS)
    poses = world_poses([_vector(view) for view in views], [_turn(view) for view in views], T_NS)
    file = Part(path)
    file.start({"kind": "scene", "lengths": space.said, **({"away": space.away} if space.away else {})}, {})
    for number, (channel, message) in enumerate(((POINTS, cloud), (CAMERAS, poses))):
        file.add(
            Entry(
                channel=channel,
                log_time_ns=T_NS,
                publish_time_ns=T_NS,
                sequence=number,
                data=message.SerializeToString(),
                encoding=PROTOBUF,
                metadata={},
                schema=schema(message.__class__),
            )
        )
    file.finish("aucamp.end", {"kind": "scene"})


def _vector(view: View) -> Any:
    return tuple(view.position_m.tolist())


def _turn(view: View) -> Turn:
    w, x, y, z = quaternion(view.rotation).tolist()
    return x, y, z, w


# --- PLY (binary, little endian), which every viewer of meshes reads; with sigma_m and views a vertex ---

FORMATS = {"f4": "float", "u1": "uchar"}


def write_ply(mesh: Mesh, path: Path, space: Space = WORLD) -> None:
    """Triangles; a comment says what lengths mean."""
    vertices = np.empty(
        len(mesh.vertices_m),
        [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
        + [(name, "u1") for name in ("red", "green", "blue")]
        + [(space.sigma, "<f4"), ("views", "u1")],
    )
    for n, axis in enumerate("xyz"):
        vertices[axis], vertices[f"n{axis}"] = mesh.vertices_m[:, n], mesh.normals[:, n]
    for n, colour in enumerate(("red", "green", "blue")):
        vertices[colour] = encoded(mesh.colours)[:, n]
    vertices[space.sigma], vertices["views"] = mesh.sigma_m, mesh.views
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, mesh.faces
    ending = [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    write_elements(path, vertices, ending, faces, space)


def write_elements(
    path: Path, vertices: NDArray[np.void], ending: list[str], rest: NDArray[np.void] | None, space: Space
) -> None:
    """A PLY file whose vertices have the fields of a structured array, floats and bytes."""
    names = vertices.dtype.names or ()
    properties = [f"property {FORMATS[vertices.dtype[name].str[1:]]} {name}" for name in names]
    head = ["ply", "format binary_little_endian 1.0", f"comment aucamp, {space.said}"]
    head += [f"comment {space.away}"] if space.away else []
    head += [f"element vertex {len(vertices)}", *properties, *ending, "end_header"]
    parts = ["\n".join(head).encode() + b"\n", vertices.tobytes(), b"" if rest is None else rest.tobytes()]
    write_whole(path, b"".join(parts))


# --- PLY of 3D Gaussian splatting: a flat, opaque Gaussian at each vertex, turned as the surface is ---

ACROSS, THICK = 0.55, 0.1  # standard deviations along and across the surface, cells
OPACITY, CONCLUDED_OPACITY = 0.97, 0.8
BAND0 = 0.28209479177387814  # the constant spherical harmonic: colour = 0.5 + BAND0 f_dc


def write_splat(mesh: Mesh, cell_m: float, path: Path, space: Space = WORLD) -> None:
    """Degree 0: one colour from all sides. Quaternions are (w, x, y, z), scales logarithms of lengths."""
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    splats = np.zeros(len(mesh.vertices_m), [(name, "<f4") for name in names])
    turn = from_z(mesh.normals.astype(float))
    for n, axis in enumerate("xyz"):
        splats[axis], splats[f"n{axis}"] = mesh.vertices_m[:, n], mesh.normals[:, n]
        splats[f"f_dc_{n}"] = (encoded(mesh.colours)[:, n] / 255.0 - 0.5) / BAND0
        splats[f"scale_{n}"] = np.log(cell_m * (ACROSS if n < 2 else THICK))
    for n in range(4):
        splats[f"rot_{n}"] = turn[:, n]
    opacity = np.where(mesh.views > 0, OPACITY, CONCLUDED_OPACITY)
    splats["opacity"] = np.log(opacity / (1.0 - opacity))
    write_elements(path, splats, [], None, space)


def from_z(normals: NDArray[np.float64]) -> Floats:
    """Quaternions (n, 4) that turn z onto unit vectors (n, 3)."""
    turn = np.stack([1.0 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    turn[turn[:, 0] < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True))


# --- nerfstudio's transforms.json, with pictures, depths and the surface's points beside it ---

MOST_DEPTH = 65535  # of a picture of 16 bits, in which 0 is unknown
NEARLY_ALL = 99.9  # percent of the depths that have to fit: a few far ones are no reason for coarse steps
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # theirs look along -z, y up


def write_transforms(views: list[View], mesh: Mesh, folder: Path, space: Space = WORLD) -> None:
    """The folder is made. Depths are in steps of depth_unit_scale_factor, in the scene's unit; what is too far is 0."""
    for name in ("images", "depths"):
        (folder / name).mkdir(parents=True)
    frames, unit = [], depth_unit(views)
    for view, name in zip(views, names(views), strict=True):
        write_picture(folder / "images" / f"{name}.png", encoded(view.picture)[..., ::-1])
        steps = np.rint(np.nan_to_num((view.depth_m - view.camera.ahead_m) / unit))
        depths = np.where((steps > 0) & (steps <= MOST_DEPTH), steps, 0)
        write_picture(folder / "depths" / f"{name}.png", depths.astype(np.uint16))
        frames.append({"file_path": f"images/{name}.png", "depth_file_path": f"depths/{name}.png", **frame(view)})
    write_ply(mesh, folder / "points.ply", space)
    top: dict[str, Any] = {"camera_model": "OPENCV", "depth_unit_scale_factor": unit, "ply_file_path": "points.ply"}
    if space.away:  # nerfstudio's word for what was done to the poses as they were given
        top["applied_transform"] = np.column_stack([np.eye(3), np.negative(space.origin)]).tolist()
    write_whole(folder / "transforms.json", json.dumps({**top, "frames": frames}, indent=1) + "\n")


def depth_unit(views: list[View]) -> float:
    """The step of depth pictures: 1, 2 or 5 of a power of ten, the least with which nearly all depths fit."""
    known = np.concatenate([view.depth_m[np.isfinite(view.depth_m)] - view.camera.ahead_m for view in views])
    known = known[known > 0.0]
    if not known.size:
        return 1e-4
    least = float(np.percentile(known, NEARLY_ALL)) / MOST_DEPTH
    power = 10.0 ** math.floor(math.log10(least))
    return float(f"{next(times for times in (1, 2, 5, 10) if times * power >= least) * power:.0e}")


def frame(view: View) -> dict[str, Any]:
    """Camera and pose of one view, each with its own intrinsics."""
    p = pinhole(view)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = p.rotation, p.centre_m
    lens = {"fl_x": p.f_px, "fl_y": p.f_px, "cx": p.cx_px, "cy": p.cy_px, "w": p.width, "h": p.height}
    return {**lens, "k1": p.k1, "k2": 0.0, "p1": 0.0, "p2": 0.0, "transform_matrix": (pose @ TO_OPENGL).tolist()}


# --- kinds of export ---

Kind = Literal["ply", "glb", "colmap", "transforms.json", "splat", "mcap"]


def export(kind: Kind, views: list[View], mesh: Mesh, cell_m: float, folder: Path, space: Space = WORLD) -> Path:
    """Write into the folder, which is there; what was written. Raises Failed where a package is missing."""
    match kind:
        case "ply":
            write_ply(mesh, path := folder / "surface.ply", space)
        case "glb":
            write_glb(mesh, path := folder / "surface.glb")
        case "splat":
            write_splat(mesh, cell_m, path := folder / "splat.ply", space)
        case "mcap":
            write_mcap(views, mesh, path := folder / "scene.mcap", space)
        case "colmap":
            write_colmap(views, mesh, path := folder / "colmap", space)
        case "transforms.json":
            write_transforms(views, mesh, path := folder / "nerfstudio", space)
    return path
