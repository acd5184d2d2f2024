"""Painted tags: the right squares, the right way up, where they truly are; read by OpenCV, which has its own table."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from agent.core.config import Landmarks, Tag, Tank
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics.image_formation import apparent_m
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, Moment
from hw.twin.optics.shade import draw_water, transmission_and_veil
from hw.twin.optics.tags import family
from hw.twin.scene import Scene, SceneWater, generator
from hw.twin.truth import surveyed_tag, true_tags

N = 1.333
LENS = draw_lens("imx519_640", generator(0, "r1", "lens"))._replace(port_gap_m=0.0, k1=0.0, k2=0.0)
FLEET = load_fleet(Path(__file__).parents[1] / "swim.toml")
EXACT = msgspec.structs.replace(FLEET.landmarks, sigma_m=0.0, sigma_deg=0.0)
FAMILY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
# Tag 0 as it is published: https://github.com/AprilRobotics/apriltag-imgs, tag36h11/tag36_11_00000.png, 1 is white.
PUBLISHED = """
1111111111
1000000001
1011010101
1001110101
1001100001
1010100001
1001011001
1000010001
1000000001
1111111111
"""


@pytest.fixture(scope="module")
def painter():
    painter = Painter(Scene(name="bare"), FLEET.tank, N, LENS, 0, "r1")
    painter.prepare()
    return painter


def look(position_m, target):
    forward = np.asarray(target, float) - position_m
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Eye(np.asarray(position_m, float), np.column_stack([right, np.cross(forward, right), forward]))


def sharp_at(distance_m):
    return LENS.image_m(1 / apparent_m(distance_m, N, 0.0))


def corners_m(tag):
    """(4, 3) of the black edge, clockwise as seen, from the upper left of the upright tag."""
    h = tag.size_m / 2
    return tag.position_m + np.array([(-h, h, 0), (h, h, 0), (h, -h, 0), (-h, -h, 0)]) @ tag.rotation.T


def pixels(points_m, eye, v):
    """Where a pinhole behind flat glass, with Snell's law, has points (n, 3)."""
    x, y, z = ((points_m - eye.position_m) @ eye.rotation).T
    in_water = np.arctan2(np.hypot(x, y), z)
    in_air = np.tan(np.arcsin(N * np.sin(in_water))) * v / LENS.pixel_m
    aside = np.arctan2(y, x)
    return np.column_stack([in_air * np.cos(aside), in_air * np.sin(aside)]) + LENS.centre_px


def read(image):
    """Corners (4, 2) px of each tag by its id, from the upper left of the upright tag."""
    found, ids, _ = cv2.aruco.ArucoDetector(FAMILY).detectMarkers(image)
    # OpenCV 5 turned its table by half a turn (opencv pull request 28823).
    turned = not np.array_equal(
        cv2.aruco.Dictionary.getBitsFromByteList(FAMILY.bytesList[:1], 6)[0], family()[0, 2, 2:8]
    )
    return (
        {} if ids is None else {int(i): np.roll(c[0], 2 * turned, 0) for i, c in zip(ids.ravel(), found, strict=True)}
    )


def test_the_table_is_the_published_family():
    expected = np.array([[int(digit) for digit in row] for row in PUBLISHED.split()])
    assert np.array_equal(family()[0], expected)
    codes = family()[:, 2:8, 2:8].reshape(587, 36).astype(int)
    # The family's promise: any two of them, whichever way round, differ in 11 squares at least.
    turns = [np.rot90(family()[:, 2:8, 2:8], k, (1, 2)).reshape(587, 36).astype(int) for k in range(4)]
    same = [codes @ turn.T + (1 - codes) @ (1 - turn).T for turn in turns]
    np.fill_diagonal(same[0], 0)
    assert 36 - max(agreed.max() for agreed in same) == 11


@pytest.mark.parametrize("tag", EXACT.tag, ids=lambda tag: f"{tag.id}_{tag.face}")
def test_a_tag_is_read_where_it_is_put_and_upright(painter, tag):
    painted = surveyed_tag(tag, EXACT.size_m)
    eye = look(painted.position_m + painted.rotation @ (0.15, 0.10, 0.55), painted.position_m)
    v = sharp_at(0.58)
    roi = (200, 120, 240, 240)
    found = read(painter.expose(Moment(eye, tags=(painted,)), v, roi))
    assert list(found) == [tag.id]
    assert abs(found[tag.id] + roi[:2] - pixels(corners_m(painted), eye, v)).max() < 1.5


def test_all_tags_lie_on_their_faces_printed_side_to_the_water():
    size_m = (*FLEET.tank.size_m[:2], FLEET.tank.surface_m)
    for tag in EXACT.tag:
        painted = surveyed_tag(tag, EXACT.size_m)
        assert np.linalg.det(painted.rotation) == pytest.approx(1)
        inwards = painted.position_m + 0.01 * painted.rotation[:, 2]
        assert np.all(inwards >= 0) and np.all(inwards <= size_m)
        np.testing.assert_allclose(
            corners_m(painted) @ painted.rotation[:, 2], painted.position_m @ painted.rotation[:, 2]
        )
    floor = surveyed_tag(Tag(id=0, face="floor", position_m=(1.0, 1.0, 0.0)), 0.08)
    np.testing.assert_allclose(corners_m(floor)[0], (0.96, 1.04, 0.0))
    anticlockwise = surveyed_tag(Tag(id=0, face="floor", position_m=(1.0, 1.0, 0.0), turn_deg=90.0), 0.08)
    np.testing.assert_allclose(corners_m(anticlockwise)[0], (0.96, 0.96, 0.0), atol=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 3.0, 45.0])
def test_edges_stand_where_geometry_has_them(painter, turn_deg):
    """Along normals of an edge: where a step would have to be for the light that there is on the way across it."""
    painted = surveyed_tag(Tag(id=3, face="x1", position_m=(3.0, 1.0, 0.25), turn_deg=turn_deg), 0.08)
    eye, v = look(np.array([2.55, 1.0, 0.25]), painted.position_m), sharp_at(0.45)
    light = (painter.expose(Moment(eye, tags=(painted,)), v)[..., 1] / 255.0) ** 2.2
    upper_left, _, _, lower_left = corners_m(painted)
    on_edge = pixels(upper_left + np.linspace(0.15, 0.7, 200)[:, None] * (lower_left - upper_left), eye, v)
    along = np.gradient(on_edge, axis=0)  # the port bends straight edges
    inwards = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    steps = np.arange(-8, 8.01, 0.25)
    x, y = (on_edge[:, None] + steps[:, None] * inwards[:, None]).astype(np.float32).transpose(2, 0, 1)
    across = cv2.remap(light.astype(np.float32), x, y, cv2.INTER_LINEAR).mean(0)
    white, black = across[steps < -4].mean(), across[steps > 4].mean()
    near = abs(steps) <= 4
    assert abs(np.mean((across[near] - black) / (white - black)) - 0.5) * 8.25 < 1 / 16  # px: one sample in sixteen


def test_what_stands_before_a_tag_hides_it_and_tags_do_not_shine_through_walls(painter):
    painted = surveyed_tag(EXACT.tag[0], EXACT.size_m)
    eye, v = look(np.array([0.5, 1.0, 0.2]), painted.position_m), sharp_at(0.5)
    hull = Hull(np.array([0.25, 1.0, 0.2]), np.eye(3))
    roi = (200, 120, 240, 240)
    assert list(read(painter.expose(Moment(eye, tags=(painted,)), v, roi))) == [0]
    hidden = painter.expose(Moment(eye, hulls=(hull,), tags=(painted,)), v, roi)
    assert np.array_equal(hidden, painter.expose(Moment(eye, hulls=(hull,)), v, roi))
    away = look(np.array([0.5, 1.0, 0.2]), [1.0, 1.0, 0.2])
    assert np.array_equal(painter.expose(Moment(away, tags=(painted,)), v, roi), painter.expose(Moment(away), v, roi))


def test_the_survey_errs_by_what_it_says_and_each_tag_for_itself():
    said = Landmarks(
        size_m=0.08,
        sigma_m=0.002,
        sigma_deg=0.5,
        tag=tuple(Tag(id=i, face="y0", position_m=(1.0, 0.0, 0.2), turn_deg=10.0) for i in range(400)),
    )
    true = true_tags(said, 7)
    exact = surveyed_tag(said.tag[0], 0.08)
    off_m = np.array([tag.position_m for tag in true]) - exact.position_m
    np.testing.assert_allclose(off_m.std(0), 0.002, rtol=0.12)
    turns = np.array([exact.rotation.T @ tag.rotation for tag in true])
    angles_deg = np.degrees([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]])
    np.testing.assert_allclose(angles_deg.std(1), 0.5, rtol=0.12)
    scale = np.array([tag.size_m for tag in true]) / 0.08 - 1
    assert abs(scale).max() <= 0.001 and scale.std() > 0.0004
    fewer = true_tags(msgspec.structs.replace(said, tag=said.tag[3:5]), 7)
    assert np.array_equal(fewer[0].position_m, true[3].position_m)
    assert np.array_equal(fewer[1].rotation, true[4].rotation)
    assert not np.array_equal(true_tags(said, 8)[3].position_m, true[3].position_m)
    assert true_tags(None, 7) == ()


def test_a_tag_is_dimmed_and_veiled_as_the_wall_that_it_is_on():
    """In turbid water a tag's contrast falls with range as the water's own figures say."""
    scene = Scene(name="murky", water=SceneWater(preset="turbid"))
    painter = Painter(scene, Tank(), N, LENS, 0, "r1")
    painter.prepare()
    painted = surveyed_tag(Tag(id=5, face="x1", position_m=(1.5, 0.6, 0.25)), 0.08)
    contrast = []
    for distance_m in (0.4, 1.0):
        eye, v = look(np.array([1.5 - distance_m, 0.6, 0.25]), painted.position_m), sharp_at(distance_m)
        light = (painter.expose(Moment(eye, tags=(painted,)), v)[..., 1] / 255.0) ** 2.2
        levels = []
        for squares_up in (3.5, 4.5):  # in the black border, in the white margin
            ((x, y),) = pixels(painted.position_m + [[0.0, squares_up * 0.01, 0.0]] @ painted.rotation.T, eye, v)
            levels.append(light[round(y) - 3 : round(y) + 4, round(x) - 5 : round(x) + 6].mean())
        contrast.append(levels[1] - levels[0])
    near, far = transmission_and_veil(draw_water(scene.water, generator(0, "water")), np.array([0.4, 1.0]))[0][:, 1]
    assert contrast[1] / contrast[0] == pytest.approx(far / near, rel=0.08)
