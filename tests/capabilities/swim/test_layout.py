"""Corners of tags on every face, as somebody sees them who looks at it; and tables [landmarks] that cannot be."""

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.landmarks import corners, markers, survey_jacobian
from agent.core.config import Body, ConfigError, Landmarks, Pose, Tag, Tank, common, dump
from agent.core.ranging.camera_model import camera_pose, to_camera
from agent.robot.fleet_reader import broken_landmark_rules, load_fleet
from tests.places import ROOT

TANK = Tank(size_m=(1.5, 1.2, 0.8), surface_m=0.5)
MIDDLES = {
    "x0": (0.0, 0.6, 0.25),
    "x1": (1.5, 0.6, 0.25),
    "y0": (0.7, 0.0, 0.25),
    "y1": (0.7, 1.2, 0.25),
    "floor": (0.7, 0.6, 0.0),
}
# From the middle of the tank, (yaw, tilt): which way a camera looks to have the face before it, its up side up.
LOOKS = {"x0": (180.0, 0.0), "x1": (0.0, 0.0), "y0": (-90.0, 0.0), "y1": (90.0, 0.0), "floor": (90.0, -90.0)}


def seen(face, turn_deg):
    """The corners (4, 2) in a picture, x right and y down, of a camera that looks straight at the face."""
    yaw_deg, tilt_deg = LOOKS[face]
    middle = MIDDLES[face]
    at = [0.75 if face[0] != "y" else middle[0], 0.6 if face[0] != "x" else middle[1]]
    if face == "floor":
        at = middle[:2]
    pose, body = Pose(x_m=at[0], y_m=at[1], yaw_deg=yaw_deg), Body(camera_m=(0.0, 0.0, 0.0))
    eye = camera_pose(pose, body, 0.25, 0.0, 0.0, 0.0, tilt_deg, TANK.surface_m)
    tag = Tag(id=3, face=face, position_m=middle, turn_deg=turn_deg)
    points = np.array([to_camera(eye, corner) for corner in corners(tag, 0.08)])
    assert np.all(points[:, 2] > 0.2)
    return points[:, :2] / points[:, 2:]


@pytest.mark.parametrize("face", LOOKS)
def test_an_upright_tag_is_upright_before_the_camera(face) -> None:
    x, y = seen(face, 0.0).T
    side = x[1] - x[0]
    assert side > 0.0
    np.testing.assert_allclose(x / side, [-0.5, 0.5, 0.5, -0.5], atol=1e-12)
    np.testing.assert_allclose(y / side, [-0.5, -0.5, 0.5, 0.5], atol=1e-12)


@pytest.mark.parametrize("face", LOOKS)
def test_it_turns_anticlockwise_as_it_is_seen(face) -> None:
    upright = seen(face, 0.0)
    np.testing.assert_allclose(seen(face, 90.0), upright[[3, 0, 1, 2]], atol=1e-12)  # upper left is now lower left
    a = np.radians(20.0)
    anticlockwise = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])  # y points down
    np.testing.assert_allclose(seen(face, 20.0), upright @ anticlockwise.T, atol=1e-12)


def test_errors_of_the_survey_move_the_corners() -> None:
    tag = Tag(id=3, face="x1", position_m=MIDDLES["x1"], turn_deg=30.0)
    for corner in corners(tag, 0.08):
        J = np.array(survey_jacobian(tag.position_m, corner))
        arm = np.subtract(corner, tag.position_m)
        np.testing.assert_array_equal(J[:, :3], np.eye(3))
        for k, axis in enumerate(np.eye(3)):
            np.testing.assert_allclose(J[:, 3 + k], np.cross(axis, arm), atol=1e-15)


def test_markers_come_in_the_order_of_their_ids() -> None:
    tags = [Tag(id=n, face=face, position_m=MIDDLES[face]) for n, face in zip((9, 4, 7), MIDDLES, strict=False)]
    assert list(markers(Landmarks(size_m=0.08, tag=tuple(tags)))) == [4, 7, 9]


def broken(*tags, size_m=0.08):
    return list(broken_landmark_rules(Landmarks(size_m=size_m, tag=tags), TANK))


def on(face, position_m, number=1, turn_deg=0.0):
    return Tag(id=number, face=face, position_m=position_m, turn_deg=turn_deg)


def test_a_sound_table_breaks_no_rule() -> None:
    tags = [on(face, middle, number) for number, (face, middle) in enumerate(MIDDLES.items())]
    assert broken(*tags, on("floor", (0.79, 0.6, 0.0), 8), on("y0", (0.04, 0.015, 0.04), 9)) == []


@pytest.mark.parametrize(
    ("tags", "key", "words"),
    [
        ((), "landmarks.tag", "there is none"),
        ((on("x0", MIDDLES["x0"]), on("x1", MIDDLES["x1"])), "landmarks.tag[1].id", "already tag[0]"),
        ((on("x1", MIDDLES["x0"]),), "landmarks.tag[0].position_m", "x is 0 m, and x1 lies at x = 1.5"),
        ((on("floor", (0.5, 0.5, 0.1)),), "landmarks.tag[0].position_m", "z is 0.1 m, and floor lies at z = 0"),
        ((on("y0", (0.5, 0.0, 0.47)),), "landmarks.tag[0].position_m", "above the surface, at 0.5 m"),
        ((on("y0", (0.5, 0.0, 0.45), turn_deg=45.0),), "landmarks.tag[0].position_m", "above the surface"),
        ((on("y0", (0.5, 0.0, 0.03)),), "landmarks.tag[0].position_m", "over the edge of y0, z from -0.01"),
        ((on("y1", (1.47, 1.2, 0.3)),), "landmarks.tag[0].position_m", "over the edge of y1, x from 1.43 to 1.51"),
        ((on("floor", (0.5, 1.17, 0.0)),), "landmarks.tag[0].position_m", "over the edge of floor, y"),
        ((on("floor", (0.5, 0.5, 0.0)), on("floor", (0.589, 0.5, 0.0), 2)), "landmarks.tag[1].position_m", "0.01 m of"),
        (
            (on("floor", (0.5, 0.5, 0.0)), on("floor", (0.6, 0.5, 0.0), 2, turn_deg=45.0)),
            "landmarks.tag[1].position_m",
            "tag 2 and tag 1 overlap on floor",
        ),
    ],
)
def test_a_mistake_is_named(tags, key, words) -> None:
    (where, remedy), *more = broken(*tags)
    assert where == key and words in remedy and not more


def test_squares_that_face_each_other_by_their_corners_may_be_nearer() -> None:
    """Two squares turned by 45 degrees, one above the other to the side: their boxes overlap, they do not."""
    assert broken(on("floor", (0.5, 0.5, 0.0), 1, 45.0), on("floor", (0.57, 0.57, 0.0), 2, 45.0)) == []


def test_the_map_is_something_that_all_must_share() -> None:
    fleet = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
    tags = on("x0", MIDDLES["x0"], 1), on("x1", MIDDLES["x1"], 2)
    maps = [None, *(Landmarks(size_m=0.08, tag=t) for t in (tags, tags[::-1], tags[:1]))]
    bare, one, turned, fewer = (common(replace(fleet, landmarks=each)) for each in maps)
    assert bare == common(fleet) and one == turned and len({bare, one, fewer}) == 3


TABLE = """
[landmarks]
size_m = 0.08
tag = [
  { id = 12, face = "y0", position_m = [0.125, 0.0, 0.15] },
  { id = 13, face = "floor", position_m = [0.40, 0.30, 0.0], turn_deg = 90.0 },
]
"""


def test_a_fleet_file_may_have_landmarks(tmp_path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text((ROOT / "agent" / "fleets" / "tank.toml").read_text() + TABLE)
    fleet = load_fleet(path)
    assert [tag.face for tag in fleet.landmarks.tag] == ["y0", "floor"] and fleet.landmarks.sigma_deg == 0.1
    path.write_text(dump(fleet))
    assert load_fleet(path) == fleet
    path.write_text(path.read_text().replace("id = 13", "id = 12"))
    with pytest.raises(ConfigError, match=r"fleet.toml: key 'landmarks.tag\[1\].id': tag 12 is already tag\[0\]"):
        load_fleet(path)
