"""Pictures with poses and nothing else, in nerfstudio's layout: read as written, and a surface from them."""

import json
import struct
import zlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.reconstruction import held_back
from agent.reconstruction.export import depth_unit, write_transforms
from agent.reconstruction.mesh import Mesh
from agent.reconstruction.run import Settings, looked_at, run, scale_of
from agent.reconstruction.sources import parse_length, read_transforms, transforms_views, unit_m
from agent.reconstruction.views import Camera, View
from tests.reconstruction.drawn import drawn_view, plane_depth

STRAIGHT = Camera(154.0, 55.5, 41.5, 0.0, 0.0, 112, 84)
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), *(np.zeros((0, 3), np.float32),) * 2,
               np.zeros(0, np.float32), np.zeros(0, np.uint8))  # fmt: skip
AWAY = 5e5, 4e6, -30.0
UNIT = 20.0  # of a scene that is not in metres: what is 0.5 m away is 10


def quiet(done: int, total: int, what: str = "") -> None:
    """No bar."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    places = [(0.0, -0.35, 0.42), (0.12, -0.33, 0.42), (-0.12, -0.33, 0.41), (0.02, -0.25, 0.5), (0.0, -0.42, 0.33)]
    views = [drawn_view(n, place, (0.0, 0.0, 0.0), floor, camera=STRAIGHT) for n, place in enumerate(places)]
    write_transforms([replace(v, position_m=v.position_m * UNIT) for v in views], NOTHING, tmp_path / "scene")
    return tmp_path / "scene"


def test_what_was_written_is_read(folder: Path) -> None:
    views = transforms_views(folder, quiet).views
    assert len(views) == 5
    assert views[0].camera == pytest.approx(STRAIGHT)
    np.testing.assert_allclose(views[1].position_m, np.array([0.12, -0.33, 0.42]) * UNIT)
    assert np.linalg.norm(looked_at(views)) < 0.2
    assert scale_of(views) == pytest.approx(0.7 / (UNIT * 0.546), rel=0.05)


def test_a_scene_is_learnt_alike_whatever_its_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The image model's cells are millimetres of a tank: a scene twenty times as large has no other picture."""
    monkeypatch.setattr(held_back, "ENOUGH", 6)
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    found = []
    for unit in (1.0, UNIT):
        views = [
            drawn_view(n, (0.08 * n - 0.2, -0.33 + 0.01 * (n % 3), 0.42), (0.0, 0.0, 0.0), floor, camera=STRAIGHT)
            for n in range(6)
        ]
        folder, out = tmp_path / f"scene{unit:g}", tmp_path / f"out{unit:g}"
        write_transforms([replace(v, position_m=v.position_m * unit) for v in views], NOTHING, folder)
        out.mkdir()
        settings = Settings(transforms=folder, video=False, cell_m=0.01, exports=("ply", "transforms.json", "splat"))
        found.append(run(settings, out, quiet))
    small, large = found
    assert small.figures["image"]["psnr_held_back_db"] > 15.0
    assert large.figures["image"]["psnr_held_back_db"] == pytest.approx(
        small.figures["image"]["psnr_held_back_db"], abs=0.3
    )
    assert np.array(large.figures["size_units"]) == pytest.approx(
        np.array(small.figures["size_units"]) * UNIT, rel=0.02
    )
    scales = [splat_scale(tmp_path / f"out{unit:g}" / "splat.ply") for unit in (1.0, UNIT)]
    assert scales[1] - scales[0] == pytest.approx(np.log(UNIT), abs=1e-4)


def splat_scale(path: Path) -> float:
    """The first splat's, a logarithm."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property")]
    return float(np.frombuffer(body, "<f4")[names.index("scale_0")])


@pytest.mark.parametrize("unit", [1.0, UNIT, 500.0, 0.01])
def test_depths_are_written_in_steps_of_the_scene(tmp_path: Path, unit: float) -> None:
    """All of them, to a 60,000th of the farthest; a few that are much farther are unknown, and none is wrong."""
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    view = drawn_view(0, (0.0, -0.35, 0.42), (0.0, 0.0, 0.0), floor, camera=STRAIGHT)
    depth = (view.depth_m * unit).astype(np.float32)
    depth[0, 0] = 50.0 * np.nanmax(depth)
    write_transforms([replace(view, depth_m=depth, position_m=view.position_m * unit)], NOTHING, tmp_path / "scene")
    step = json.loads((tmp_path / "scene" / "transforms.json").read_text())["depth_unit_scale_factor"]
    (path,) = (tmp_path / "scene" / "depths").iterdir()
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * step
    assert read[0, 0] == 0.0 and step == depth_unit([replace(view, depth_m=depth)])
    known = np.isfinite(depth)
    known[0, 0] = False
    assert np.abs(read - depth)[known].max() <= 0.51 * step < 1e-4 * np.nanmax(depth[1:])


def test_a_floor_from_pictures_alone(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    result = run(Settings(transforms=folder / "transforms.json", video=False, cell_m=0.01), out, quiet)
    heights = result.built.mesh.vertices_m[:, 2] / UNIT
    assert result.figures["triangles"] > 500
    assert np.median(np.abs(heights)) < 2e-3
    assert (np.abs(heights) < 0.01).mean() > 0.9
    assert "Beside photographs" in (out / "report.html").read_text()
    figures = json.loads((out / "result.json").read_text())
    assert figures["views"] == 5 and not {"area_m2", "size_m", "sigma_mm"} & figures.keys(), "nobody knows the unit"
    assert figures["size_units"] == pytest.approx(np.ptp(result.built.mesh.vertices_m, axis=0), rel=1e-3)
    assert result.figures["image"]["psnr_held_back_db"] is None or result.figures["image"]["psnr_held_back_db"] > 15
    head = (out / "surface.ply").read_bytes().partition(b"end_header")[0].decode()
    assert "comment aucamp, units and axes of the scene\n" in head and "float sigma\n" in head and "origin" not in head


def test_one_known_length_makes_metres_and_a_scene_far_from_zero_keeps_its_shape(folder: Path, tmp_path: Path) -> None:
    """UNIT times as large as it was drawn, and as far away as map coordinates: files say what they count from."""
    data = json.loads((folder / "transforms.json").read_text())
    for frame in data["frames"]:
        for k, away in enumerate(AWAY):
            frame["transform_matrix"][k][3] += away
    (folder / "transforms.json").write_text(json.dumps(data))
    views = transforms_views(folder, quiet).views
    apart_m = float(np.linalg.norm(views[0].position_m - views[3].position_m)) / UNIT
    names = [frame.file_path for frame in read_transforms(folder / "transforms.json").frames]
    length = parse_length(f"{names[0]},{Path(names[3]).stem},{apart_m}")
    assert unit_m(folder, length) == pytest.approx(1.0 / UNIT)
    (out := tmp_path / "out").mkdir()
    kinds = ("ply", "colmap", "transforms.json")
    result = run(Settings(transforms=folder, length=length, video=False, cell_m=0.01, exports=kinds), out, quiet)
    assert 0.2 < result.figures["size_m"][0] < 2.0 and "size_units" not in result.figures
    origin = result.figures["origin_m"]
    heights = result.built.mesh.vertices_m[:, 2] + origin[2] - AWAY[2] / UNIT
    assert np.median(np.abs(heights)) < 2e-3 and np.abs(result.built.mesh.vertices_m).max() < 3.0
    np.testing.assert_allclose(origin[:2], np.array(AWAY[:2]) / UNIT, atol=1.0)
    head = (out / "surface.ply").read_bytes().partition(b"end_header")[0].decode()
    assert "comment aucamp, metres, axes of the scene\ncomment origin 25000.0 199999." in head
    assert "origin" in result.notes[-1] and (out / "colmap/sparse/0/images.txt").read_text().startswith(
        "# origin 25000.0"
    )
    applied = json.loads((out / "nerfstudio" / "transforms.json").read_text())["applied_transform"]
    assert [row[3] for row in applied] == [-one for one in origin]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a,b", "write two pictures"),
        ("a,b,c", "write two pictures"),
        ("a,b,-1", "write two pictures"),
        ("a,b,1,2", "write two pictures"),
        ("a,b,1", "no picture is called a"),
        ("00000,00000,1", "at one place"),
    ],
)
def test_a_length_that_says_nothing_is_one_line(folder: Path, text: str, why: str) -> None:
    stem = Path(read_transforms(folder / "transforms.json").frames[0].file_path).stem
    with pytest.raises(ConfigError, match=why) as error:
        unit_m(folder, parse_length(text.replace("00000", stem)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bend", [0.5, -0.3])
def test_a_bent_lens_is_straightened_without_a_border(tmp_path: Path, bend: float) -> None:
    """All of what is left shows what a straight lens would have seen; of a barrel lens all pixels are."""
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    place = (0.0, -0.35, 0.42), (0.0, 0.0, 0.0), floor
    write_transforms([drawn_view(0, *place, camera=STRAIGHT._replace(bend=bend))], NOTHING, tmp_path / "scene")
    (view,) = transforms_views(tmp_path / "scene", quiet).views
    assert view.camera.bend == 0.0 and view.picture.shape[:2] == (view.camera.height, view.camera.width)
    kept = view.camera.width * view.camera.height / (STRAIGHT.width * STRAIGHT.height)
    assert kept == 1.0 if bend < 0.0 else 0.75 < kept < 0.95
    true = drawn_view(0, *place, camera=view.camera).picture
    off = np.abs(view.picture - true)
    rim = np.concatenate([off[[0, -1]].ravel(), off[:, [0, -1]].ravel()])
    assert off.mean() < 0.03 and rim.mean() < 0.03


def test_a_lens_that_leaves_no_picture_is_one_line(folder: Path) -> None:
    with pytest.raises(ConfigError, match="next to nothing of its picture is left"):
        transforms_views(changed(folder, fl_x=154.0, fl_y=154.0, cx=900.0, cy=42.0, k1=5.0), quiet)


@pytest.mark.parametrize("broken", ["{", '{"frames": [{"file_path": "a.png"}]}', '{"frames": 3}'])
def test_what_is_no_scene_is_refused(tmp_path: Path, broken: str) -> None:
    (tmp_path / "transforms.json").write_text(broken)
    with pytest.raises(ConfigError):
        transforms_views(tmp_path, quiet)


def png_of(width: int, height: int) -> bytes:
    """A PNG that claims a size, and has no pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


DAMAGE = {
    "a text for a width": (("w", "x"), "key 'w': expected `float"),
    "no width": (("w", 0), "key 'w'"),
    "a number for a name": (("frames", "file_path", 7), r"key 'frames\[1\]\.file_path'"),
    "a name elsewhere": (("frames", "file_path", "/dev/zero"), "outside of it"),
    "a name above": (("frames", "file_path", "../../x.png"), "outside of it"),
    "a folder": (("frames", "file_path", "images"), "no regular file"),
    "a text for a matrix": (("frames", "transform_matrix", "x"), r"key 'frames\[1\]\.transform_matrix'"),
    "a short matrix": (("frames", "transform_matrix", [[1.0] * 4] * 3), r"key 'frames\[1\]\.transform_matrix'"),
    "a matrix of zeros": (
        ("frames", "transform_matrix", [[0.0] * 4] * 4),
        "frame 1 .*: its transform_matrix turns",
    ),
    "a huge place": (("frames", "transform_matrix", [[1.0, 0.0, 0.0, 1e300]] * 4), "beyond"),
    "no focal length": (("frames", "fl_x", 0), r"key 'frames\[1\]\.fl_x'"),
    "no frames": (("frames", []), "key 'frames'"),
    "a focal length that is none": (("frames", "fl_x", float("nan")), r"key 'frames\[1\]\.fl_x'"),
    "a place that is none": (
        ("frames", "transform_matrix", [[1.0, 0.0, 0.0, float("nan")]] * 4),
        r"key 'frames\[1\]\.transform_matrix\[0\]\[3\]': not a finite number",
    ),
    "a mirror": (("frames", "transform_matrix", np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), "frame 1 .* mirrors"),
    "a sheared matrix": (
        ("frames", "transform_matrix", (np.eye(4) + np.eye(4, k=1) * 0.3).tolist()),
        "frame 1 .* not square to each other",
    ),
    "another picture": (("frames", "h", 240), r"has 112x84 pixels, which is no copy of 112x240 \(w and h\)"),
    "a lens of which nothing is known": (("camera_model", "EQUIRECTANGULAR"), "key 'camera_model': 'EQUIRECTANGULAR'"),
    "a lens by another program's rule": (("k4", 0.1), "frame 0 has k4, which OPENCV does not have"),
}


@pytest.mark.parametrize(("change", "why"), DAMAGE.values(), ids=DAMAGE)
def test_damage_to_a_scene_is_one_line_that_names_the_field(folder: Path, change: tuple, why: str) -> None:
    file = folder / "transforms.json"
    data = json.loads(file.read_text())
    *where, value = change
    there = data if len(where) == 1 else data["frames"][1]
    there[where[-1]] = value
    file.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match=why) as error:
        transforms_views(file, quiet)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "text", ['{"frames": ' + "[" * 5000, '{"a":' * 5000, '{"frames": [NaN]}', "[]", "7", '"x"', '{"w": 1' + "0" * 5000]
)
def test_no_scene_at_all_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(ConfigError) as error:
        transforms_views(tmp_path, quiet)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [png_of(60_000, 60_000), png_of(30_000, 30_000), png_of(64, 64), b"", b"\xff\xd8x"])
def test_a_picture_that_is_none_takes_no_memory(folder: Path, content: bytes) -> None:
    picture = next((folder / "images").iterdir())
    picture.write_bytes(content)
    with pytest.raises(ConfigError, match=f"{picture.name}: (says that it has|not an image)"):
        transforms_views(folder, quiet)


def changed(folder: Path, **entries: object) -> Path:
    """The scene with these entries, for all frames."""
    file = folder / "transforms.json"
    data = {**json.loads(file.read_text()), **entries}
    data["frames"] = [{key: said for key, said in frame.items() if key not in entries} for frame in data["frames"]]
    file.write_text(json.dumps(data))
    return file


def bent_by_a_fisheye(image: np.ndarray, k1: float) -> np.ndarray:
    """What a lens of theta (1 + k1 theta^2) makes of a straight picture of the same focal length."""
    f, cx, cy = STRAIGHT[:3]
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    x, y = (u - cx) / f, (v - cy) / f
    radius = np.maximum(np.hypot(x, y), 1e-9)
    theta = radius.copy()
    for _ in range(20):
        theta -= (theta * (1 + k1 * theta**2) - radius) / (1 + 3 * k1 * theta**2)
    grow = np.tan(theta) / radius
    return cv2.remap(image, (cx + f * x * grow).astype(np.float32), (cy + f * y * grow).astype(np.float32), 1)


def inner(view: View) -> np.ndarray:
    """Of the picture what lies about its optical axis, which a straightened one need not have in its middle."""
    x, y = round(view.camera.cx_px + 0.5), round(view.camera.cy_px + 0.5)
    return view.picture[y - 22 : y + 22, x - 36 : x + 36]


@pytest.mark.parametrize("words", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_a_fisheye_is_straightened_by_its_own_rule(folder: Path, words: dict) -> None:
    straight = transforms_views(folder, quiet).views[0]
    for path in (folder / "images").iterdir():
        cv2.imwrite(str(path), bent_by_a_fisheye(cv2.imread(str(path)), 0.5))
    apart = {}
    for name, entries in (
        ("fisheye", {**words, "k1": 0.5}),
        ("plain", {"camera_model": "OPENCV", "is_fisheye": False}),
    ):
        there = transforms_views(changed(folder, **entries), quiet).views[0]
        apart[name] = float(np.abs(inner(there) - inner(straight)).mean())
    assert apart["fisheye"] < 0.5 * apart["plain"]


def test_smaller_copies_have_the_intrinsics_of_the_large_ones(folder: Path) -> None:
    views = transforms_views(changed(folder, w=224, h=167, fl_x=308.0, fl_y=308.0, cx=112.0, cy=84.0), quiet).views
    assert views[0].camera == pytest.approx(STRAIGHT)


def test_pictures_that_are_not_there_are_counted(folder: Path) -> None:
    pictures = sorted((folder / "images").iterdir())
    pictures[1].unlink()
    posed = transforms_views(folder, quiet)
    assert [view.seq for view in posed.views] == [0, 2, 3, 4]
    assert posed.passed_over == {"pictures that are not there": 1}
    for path in pictures:
        path.unlink(missing_ok=True)
    with pytest.raises(ConfigError, match="of 5 pictures none is there, such as images"):
        transforms_views(folder, quiet)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_of_its_encoding_is_no_damage(folder: Path, encoding: str) -> None:
    file = folder / "transforms.json"
    file.write_text(file.read_text(), encoding=encoding)
    assert len(transforms_views(folder, quiet).views) == 5
