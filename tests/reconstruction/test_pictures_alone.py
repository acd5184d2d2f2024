"""Pictures with poses and nothing else, in nerfstudio's layout: read as written, and a surface from them."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.reconstruction.export import write_transforms
from agent.reconstruction.mesh import Mesh
from agent.reconstruction.run import Settings, looked_at, run, scale_of
from agent.reconstruction.sources import transforms_views
from agent.reconstruction.views import Camera, View
from tests.reconstruction.drawn import drawn_view, plane_depth

STRAIGHT = Camera(154.0, 55.5, 41.5, 0.0, 0.0, 112, 84)
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), *(np.zeros((0, 3), np.float32),) * 2,
               np.zeros(0, np.float32), np.zeros(0, np.uint8))  # fmt: skip
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
    views = transforms_views(folder, quiet)
    assert len(views) == 5
    assert views[0].camera == pytest.approx(STRAIGHT)
    np.testing.assert_allclose(views[1].position_m, np.array([0.12, -0.33, 0.42]) * UNIT)
    assert np.linalg.norm(looked_at(views)) < 0.2
    assert scale_of(views) == pytest.approx(0.7 / (UNIT * 0.546), rel=0.05)


def test_a_floor_from_pictures_alone(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    result = run(Settings(transforms=folder / "transforms.json", video=False, cell_m=0.01), out, quiet)
    heights = result.built.mesh.vertices_m[:, 2] / UNIT
    assert result.figures["triangles"] > 500
    assert np.median(np.abs(heights)) < 2e-3
    assert (np.abs(heights) < 0.01).mean() > 0.9
    assert "Beside photographs" in (out / "report.html").read_text()
    assert json.loads((out / "result.json").read_text())["views"] == 5
    assert (out / "surface.ply").exists()


def test_a_bent_lens_is_straightened(folder: Path) -> None:
    file = folder / "transforms.json"
    data = json.loads(file.read_text())
    for frame in data["frames"]:
        frame["k1"] = 0.2
    file.write_text(json.dumps(data))
    views: list[View] = transforms_views(file, quiet)
    assert views[0].camera.bend == 0.0


@pytest.mark.parametrize("broken", ["{", '{"frames": [{"file_path": "a.png"}]}', '{"frames": 3}'])
def test_what_is_no_scene_is_refused(tmp_path: Path, broken: str) -> None:
    (tmp_path / "transforms.json").write_text(broken)
    with pytest.raises(ConfigError):
        transforms_views(tmp_path, quiet)
