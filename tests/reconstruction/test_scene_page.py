"""The scene to be turned by hand, in a real browser, from a file."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.reconstruction.mesh import Mesh
from agent.reconstruction.report import MODULES, VIEWER, coarser, seen_first, write_scene
from tests.network.looking.page_process import Tab, browser
from tests.waiting import until

SIDE = 20
CELL_M = 0.05
MIDDLE = (0.475, 0.475, 0.0)


def sheet(side: int = SIDE, concluded_from: int = 15) -> Mesh:
    """A red square, seen from above; rows from `concluded_from` on were seen by nobody and are blue."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    vertices = np.stack([x.ravel() * CELL_M, y.ravel() * CELL_M, 0.01 * np.sin(x.ravel())], axis=1)
    number = np.arange(side * side).reshape(side, side)
    a, b, c, d = (one.ravel() for one in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    concluded = y.ravel() >= concluded_from
    colours = np.where(concluded[:, None], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]).astype(np.float32)
    normals = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (side * side, 1))
    sigma = np.where(concluded, 0.05, 0.002).astype(np.float32)
    return Mesh(vertices, faces, normals, colours, sigma, np.where(concluded, 0, 3).astype(np.uint8))


def test_what_was_concluded_comes_last() -> None:
    mesh = sheet()
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    found, vertices, faces = seen_first(mesh._replace(faces=mesh.faces[order]))
    assert vertices == 15 * SIDE and faces == 2 * 14 * (SIDE - 1)
    assert (found.views[:vertices] == 3).all() and (found.views[vertices:] == 0).all()
    assert (found.views[found.faces[:faces]] == 3).all()
    assert (found.views[found.faces[faces:]] == 0).any(axis=1).all()
    corners = {tuple(sorted(map(tuple, mesh.vertices_m[face].tolist()))) for face in mesh.faces}
    assert {tuple(sorted(map(tuple, found.vertices_m[face].tolist()))) for face in found.faces} == corners


def test_a_large_surface_is_made_coarser_and_stays_where_it_is() -> None:
    mesh = sheet(60, concluded_from=60)
    found, cell_m = coarser(mesh, CELL_M, 1500)
    assert 300 < len(found.faces) <= 1500 and cell_m > CELL_M
    for end in (np.min, np.max):
        assert end(found.vertices_m, axis=0) == pytest.approx(end(mesh.vertices_m, axis=0), abs=cell_m)
    a, b, c = (found.vertices_m[found.faces[:, k]] for k in range(3))
    up = np.cross(b - a, c - a)[:, 2]
    assert (up > 0).all(), "turned as they were"
    assert up.sum() / 2 == pytest.approx((59 * CELL_M) ** 2, rel=0.1)
    assert found.views.max() == 3 and np.allclose(found.colours, (1, 0, 0)) and np.allclose(found.sigma_m, 0.002)
    same, cell_m = coarser(mesh, CELL_M, len(mesh.faces))
    assert same is mesh and cell_m == CELL_M


def test_the_eye_begins_where_the_cameras_were(tmp_path: Path) -> None:
    cameras = np.array([(3.0, 0.4, 1.0), (3.0, 0.55, 1.0)])
    write_scene(sheet(), CELL_M, cameras, ("", ""), "", tmp_path / "scene.html")
    about = re.search(r'id="about">(.*?)</script>', (tmp_path / "scene.html").read_text())[1]
    off = np.subtract(json.loads(about)["eye"], MIDDLE)
    toward = cameras.mean(axis=0) - MIDDLE
    assert off @ toward > 0.999 * np.linalg.norm(off) * np.linalg.norm(toward)


def test_the_library_is_small_and_has_its_licence() -> None:
    assert sum(len((VIEWER / name).read_bytes()) for name in MODULES.values()) <= 1_300_000
    assert "MIT" in (VIEWER / "LICENSE").read_text()


@pytest.fixture(scope="module")
def chromium():
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def address(tmp_path_factory) -> str:
    path: Path = tmp_path_factory.mktemp("scene") / "scene.html"
    write_scene(sheet(), CELL_M, np.array([MIDDLE]), ("dark is sure", "dark is few"), "722 triangles", path)
    return path.as_uri()


@pytest.fixture
def tab(chromium, address):
    found = Tab(chromium, address, viewport={"width": 800, "height": 600}, has_touch=True)
    found.page.wait_for_selector("#scene[data-drawn]")
    yield found
    found.page.close()
    assert not [url for url in found.outside if not url.startswith("data:")], "it asks nobody"
    assert not found.complaints


def drawn(tab: Tab) -> int:
    return int(tab.page.get_attribute("#scene", "data-drawn"))


def eye(tab: Tab) -> np.ndarray:
    return np.array(tab.page.get_attribute("#scene", "data-eye").split(), float)


def shown(tab: Tab) -> dict[str, float]:
    """Shares of the canvas that are clearly red, and blue."""
    data = np.frombuffer(tab.page.locator("#scene").screenshot(), np.uint8)
    blue, green, red = (cv2.imdecode(data, cv2.IMREAD_COLOR)[..., k].astype(int) for k in range(3))
    return {"red": float(np.mean(red - blue - green > 100)), "blue": float(np.mean(blue - red - green > 100))}


def test_surface_colours_and_what_was_concluded(tab) -> None:
    everything = 2 * (SIDE - 1) ** 2
    assert drawn(tab) == everything
    before = shown(tab)
    assert before["red"] > 0.1 and before["blue"] > 0.01
    tab.page.uncheck("#concluded")
    assert drawn(tab) == 2 * 14 * (SIDE - 1)
    after = shown(tab)
    assert after["blue"] == 0.0 and after["red"] > 0.9 * before["red"]
    tab.page.select_option("#kind", "points")
    assert drawn(tab) == 15 * SIDE and shown(tab)["red"] > 0.05
    tab.page.check("#concluded")
    assert drawn(tab) == SIDE * SIDE
    tab.page.select_option("#colours", label="standard deviation")
    assert tab.page.inner_text("#legend") == "dark is sure" and shown(tab)["red"] == 0.0


def test_it_is_turned_by_mouse_keys_and_fingers(tab) -> None:
    start = eye(tab)
    far = float(np.linalg.norm(start))
    at = tab.page.locator("#scene").bounding_box()
    x, y = at["x"] + at["width"] / 2, at["y"] + at["height"] / 2
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 100, y, steps=4)
    tab.page.mouse.up()
    by_mouse = eye(tab)
    assert np.linalg.norm(by_mouse - start) > 0.1 * far and by_mouse[2] == pytest.approx(start[2], rel=0.01)
    tab.page.keyboard.press("0")
    assert eye(tab) == pytest.approx(start)
    for _ in range(3):
        tab.page.keyboard.press("ArrowUp")
    assert eye(tab)[2] > 1.05 * start[2], "higher"
    tab.page.keyboard.press("0")
    tab.page.keyboard.press("+")
    assert np.linalg.norm(eye(tab) - MIDDLE) == pytest.approx(0.9 * np.linalg.norm(start - MIDDLE), rel=0.01)
    tab.page.keyboard.press("Shift+ArrowRight")
    moved = eye(tab)
    tab.page.mouse.wheel(0, 400)
    until(lambda: np.linalg.norm(eye(tab) - moved) > 0.01)
    tab.page.click("#back")
    assert eye(tab) == pytest.approx(start)
    session = tab.page.context.new_cdp_session(tab.page)
    for kind, dx in (("touchStart", 0), ("touchMove", 40), ("touchMove", 90), ("touchEnd", None)):
        places = [] if dx is None else [{"x": x + dx, "y": y}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})
    until(lambda: np.linalg.norm(eye(tab) - start) > 0.1 * far)


def test_it_fits_a_phone(chromium, address) -> None:
    tab = Tab(chromium, address, viewport={"width": 390, "height": 844}, color_scheme="dark")
    tab.page.wait_for_selector("#scene[data-drawn]")
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert tab.page.locator("#scene").bounding_box()["height"] > 400
    assert shown(tab)["red"] > 0.05
    tab.page.close()
