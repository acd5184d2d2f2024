"""Where a robot turns its camera to find itself."""

import json
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from agent.capabilities.swim.landmark_look import SEARCH_DEG, WAIT_NS, LandmarkLook, Sure
from agent.capabilities.swim.landmarks import axes, corners, facing, markers, survey_jacobian
from agent.core.attitude import Attitude
from agent.core.config import Body, ConfigError, Landmarks, Pose, Tag, Tank, dump
from agent.core.ranging.camera_model import camera_pose, to_camera
from agent.core.trust import common
from agent.robot.fleet_reader import broken_landmark_rules, load_fleet
from tests.places import ROOT

SURFACE_M, LEVEL = 0.5, Attitude(0.3, 0.0, 0.0)  # 0.2 m above the floor
HERE = Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0)
BODY = Body(camera_m=(0.0, 0.0, 0.0), pan_limit_deg=(-80.0, 80.0))
MS, KNOWN = 1_000_000, Sure(0.0, 0.0)


def on_wall(number, y_m, face="x1", x_m=2.5):
    return Tag(id=number, face=face, position_m=(x_m, y_m, 0.2))


def glance(*tags, body=BODY):
    return LandmarkLook(markers(Landmarks(size_m=0.08, tag=tags)).values(), body, SURFACE_M, half_deg=(18.0, 14.0))


def ways(of, count, pose=HERE, sure=KNOWN):
    """What it looks at, one after the other, with a gimbal that takes as long to turn as it is waited for."""
    found, now_ns = [of.direction_deg(pose, sure, LEVEL, True, 0)], 0
    while len(found) < count:
        for steady in (False, True, True):
            now_ns += WAIT_NS
            way = of.direction_deg(pose, sure, LEVEL, steady, now_ns)
        found.append(way)
    return found


TWO = on_wall(1, 1.9), on_wall(2, 2.1)  # 31 and 36 degrees to the left
ALONE = on_wall(0, 0.5)  # nearer, to the right
LEFT, RIGHT = pytest.approx((30.96, 0.0), abs=0.01), pytest.approx((-18.43, 0.0), abs=0.01)


def test_where_most_landmarks_are_first_and_after_the_wait_where_others_are() -> None:
    of = glance(*TWO, ALONE)
    assert ways(of, 4) == [LEFT, RIGHT, LEFT, RIGHT]  # the other of the two was seen beside the first


def test_of_two_the_one_that_murky_water_leaves_first() -> None:
    near, far = on_wall(5, 0.5), on_wall(4, 1.9)
    assert ways(glance(far, near), 2) == [RIGHT, LEFT]


def test_beside_a_target_the_picture_shows_landmarks_as_far_as_there_is_room() -> None:
    """A tag straight ahead is 1.5 m off and 3 degrees wide; the picture reaches 14 degrees up and down."""
    of, level = glance(on_wall(1, 1.0), on_wall(2, 1.15)), LEVEL

    def aside(tilt_deg: float, most_deg: float) -> float:
        return of.tilt_aside_deg((0.0, tilt_deg), most_deg, 0.0, HERE, level)

    assert aside(5.0, 6.0) == 0.0, "they are in the picture as it is"
    below = aside(15.0, 6.0)
    assert -6.0 < below < -3.0 and 15.0 + below + 1.53 < 14.0, "so much lower that both are whole"
    assert aside(15.0, 2.0) == 0.0, "not where the target would leave the picture"
    assert aside(25.0, 6.0) == 0.0, "nor where it would not help"
    assert aside(15.0, 0.0) == 0.0
    assert glance(on_wall(1, 3.0)).tilt_aside_deg((0.0, 15.0), 6.0, 0.0, HERE, level) == 0.0, "it is beside the picture"


def test_who_hardly_knows_its_yaw_looks_to_where_it_can_hardly_miss() -> None:
    """One landmark straight ahead and near, or four in a row from 20 to 40 degrees to the left."""
    row = [on_wall(k, 1.0 + 1.5 * tan) for k, tan in enumerate((0.38, 0.52, 0.67, 0.83))]
    of = glance(on_wall(9, 1.0, x_m=1.45), *row)
    (sure,), (unsure,) = ways(of, 1), ways(glance(on_wall(9, 1.0, x_m=1.45), *row), 1, sure=Sure(0.1, 12.0))
    assert sure == pytest.approx((0.0, 0.0)) and 25.0 < unsure[0] < 40.0


def test_the_wait_counts_from_when_the_gimbal_rests_and_the_way_stays_the_same() -> None:
    of, moved = glance(*TWO, ALONE), replace(HERE, x_m=1.05, yaw_deg=2.0)
    assert of.direction_deg(HERE, KNOWN, LEVEL, False, 0) == LEFT
    assert of.direction_deg(moved, KNOWN, LEVEL, False, 5000 * MS) == LEFT
    assert of.direction_deg(moved, KNOWN, LEVEL, True, 5100 * MS) == LEFT  # at rest from now on
    assert of.direction_deg(moved, KNOWN, LEVEL, True, 5100 * MS + WAIT_NS - 1) == LEFT
    assert of.direction_deg(HERE, KNOWN, LEVEL, True, 5100 * MS + WAIT_NS) == RIGHT
    of.reset()
    assert of.direction_deg(HERE, KNOWN, LEVEL, True, 9000 * MS) == LEFT


def test_a_look_whose_frames_show_none_is_over_at_once_and_one_that_showed_some_lasts() -> None:
    """Who is lost with its thrusters off drifts while it looks where nothing is."""
    for shown, then in (((False, False), RIGHT), ((False, True, False), LEFT)):
        of = glance(*TWO, ALONE)
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 0) == LEFT
        of.add_frame(shows=shown[0])
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 100 * MS) == LEFT  # one frame may be a blurred one
        for shows in shown[1:]:
            of.add_frame(shows)
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 200 * MS) == then
        of.add_frame(shows=False)  # the first one of the next look says nothing of it yet
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 300 * MS) == then


UNREACHABLE = {
    "behind": on_wall(9, 1.0, "x0", 0.0),
    "beyond the gimbal's pan": Tag(id=9, face="y1", position_m=(0.9, 2.0, 0.2)),
    "beyond its tilt": Tag(id=9, face="floor", position_m=(1.05, 1.05, 0.0)),
    "too far": on_wall(9, 1.0, x_m=3.1),
    "too near to be in the picture as a whole": on_wall(9, 1.0, x_m=1.2),
    "at a glance": Tag(id=9, face="y1", position_m=(2.2, 1.3, 0.2)),
    "from behind": on_wall(9, 1.0, "x0", 2.0),
}


@pytest.mark.parametrize("why", UNREACHABLE)
def test_what_cannot_be_seen_is_not_looked_at(why) -> None:
    assert set(ways(glance(*TWO, UNREACHABLE[why]), 4)) == set(ways(glance(*TWO), 4))
    assert ways(glance(UNREACHABLE[why]), 3) == list(SEARCH_DEG[:3])  # then all around


def test_who_knows_nothing_looks_all_around_over_and_over() -> None:
    of = glance(*TWO)
    assert ways(of, len(SEARCH_DEG) + 1, pose=None) == [*SEARCH_DEG, SEARCH_DEG[0]]
    pans = sorted({pan for pan, _ in SEARCH_DEG})
    assert all(b - a <= 30.0 for a, b in pairwise(pans))  # a picture is 38 degrees wide
    lowest, highest = Body().pan_limit_deg
    assert pans[0] - 5.0 <= lowest and pans[-1] + 5.0 >= highest


def test_who_finds_out_where_it_is_begins_with_the_best_way() -> None:
    of = glance(*TWO, ALONE)
    *_, last = ways(of, 3, pose=None)
    assert ways(of, 2) == [last, LEFT]  # once it has looked there for long enough


def test_a_landmark_faces_the_water() -> None:
    (marker,) = markers(Landmarks(size_m=0.08, tag=(on_wall(1, 1.0),))).values()
    assert facing(marker, (1.5, 1.0, 0.2)) == pytest.approx(1.0)
    assert facing(marker, (1.5, 2.0, 0.2)) == pytest.approx(0.5**0.5)
    assert facing(marker, (3.5, 1.0, 0.2)) == pytest.approx(-1.0)
    (floor,) = markers(Landmarks(size_m=0.08, tag=(Tag(id=1, face="floor", position_m=(1.0, 1.0, 0.0)),))).values()
    assert facing(floor, (1.0, 1.0, 0.4)) == pytest.approx(1.0)


# --- layout ---
# Corners of tags on every face, as somebody sees them who looks at it; and tables [landmarks] that cannot be.

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


# --- layout files ---
# Tags from other files: written as the other programs do, read as our own; what cannot be used is one line.

LAYOUT_FILES_TANK = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
WIDTH, DEPTH, _ = LAYOUT_FILES_TANK.tank.size_m
TAGS = (
    Tag(id=3, face="x0", position_m=(0.0, 0.6, 0.25), turn_deg=30.0),
    Tag(id=4, face="x1", position_m=(WIDTH, 0.6, 0.25), turn_deg=0.0),
    Tag(id=5, face="y0", position_m=(0.7, 0.01, 0.25), turn_deg=-90.0),
    Tag(id=6, face="y1", position_m=(0.7, DEPTH, 0.25), turn_deg=120.0),
    Tag(id=17, face="floor", position_m=(0.7, 0.6, 0.0), turn_deg=45.0),
)


def turn(tag, order):
    """Quaternion (x, y, z, w) of a frame whose axes are those of the tag named: right, up and out."""
    right, up = map(np.array, axes(tag))
    named = {"r": right, "u": up, "o": np.cross(right, up)}
    return [float(value) for value in Rotation.from_matrix(np.column_stack([named[one] for one in order])).as_quat()]


def ros(tags, size=0.08):
    """tags.yaml of apriltag_ros: a tag's frame has x right, y up, z out of it."""
    lines = ["standalone_tags:", "  [", f"    {{id: 99, size: {size}}},", "  ]", "tag_bundles:", "  [", "    {"]
    lines += ["      name: 'tank',", "      layout:", "        ["]
    for tag in tags:
        (x, y, z), (qx, qy, qz, qw) = tag.position_m, turn(tag, "ruo")
        place = f"x: {x}, y: {y}, z: {z}, qw: {qw:.9f}, qx: {qx:.9f}, qy: {qy:.9f}, qz: {qz:.9f}"
        lines.append(f"          {{id: {tag.id}, size: {size}, {place}}},")
    return "\n".join([*lines, "        ]", "    }", "  ]", ""])


def wpilib(tags):
    """AprilTagFieldLayout: x out of the tag, y right as seen, z up."""

    def pose(tag):
        x, y, z, w = turn(tag, "oru")
        return {
            "translation": dict(zip("xyz", tag.position_m, strict=True)),
            "rotation": {"quaternion": {"W": w, "X": x, "Y": y, "Z": z}},
        }

    tags = [{"ID": tag.id, "pose": pose(tag)} for tag in tags]
    return json.dumps({"tags": tags, "field": {"length": WIDTH, "width": DEPTH}}, indent=1)


@pytest.fixture
def fleet(tmp_path):
    """A function: fleet file with this table [landmarks], and the file that it names."""
    whole = dump(LAYOUT_FILES_TANK)

    def made(name, text, table=""):
        (tmp_path / name).write_text(text)
        path = tmp_path / "fleet.toml"
        path.write_text(f'{whole}\n[landmarks]\nfile = "{name}"\n{table}\n')
        return path

    return made


@pytest.mark.parametrize(("name", "write", "table"), [("tags.yaml", ros, ""), ("f.json", wpilib, "size_m = 0.08")])
def test_a_layout_of_others_gives_the_same_tags(fleet, name, write, table):
    found = load_fleet(fleet(name, write(TAGS), table)).landmarks
    assert found.size_m == 0.08 and found.sigma_m == 0.0005
    for said, tag in zip(found.tag, TAGS, strict=True):
        assert (said.id, said.face) == (tag.id, tag.face)
        assert said.position_m == pytest.approx(tag.position_m) and said.turn_deg == pytest.approx(tag.turn_deg)


def test_a_survey_of_ours_and_what_the_fleet_file_says_beside_it(fleet):
    text = (
        '[landmarks]\nsize_m = 0.08\nsigma_m = 0.002\ntag = [ { id = 7, face = "y0", position_m = [0.4, 0.0, 0.2] } ]'
    )
    path = fleet("tags.toml", text, "sigma_deg = 0.3")
    found = load_fleet(path).landmarks
    assert (found.sigma_m, found.sigma_deg, found.tag[0].id) == (0.002, 0.3, 7)
    path.write_text(dump(load_fleet(path)))  # a dive keeps its fleet file: all in one
    assert load_fleet(path).landmarks == found


OFF = (replace(TAGS[0], position_m=(0.3, 0.6, 0.25)),)
WRONG = [
    ("tags.yaml", ros(OFF), "", r"tags.yaml: tag 3 lies on no wall or floor: .* x is 0 m, and its x is 0.3 m"),
    ("tags.yaml", ros(TAGS).replace("qw: 0.", "qw: 3.", 1), "", r"tag \d+: its quaternion has length"),
    ("tags.yaml", ros(TAGS).replace("{id: 4, size: 0.08", "{id: 4, size: 0.1"), "", "tag 4 is of 0.1 m and tag 3 of"),
    ("tags.yaml", ros(TAGS), "size_m = 0.1", "its tags are of 0.08 m, and .* says size_m = 0.1"),
    ("tags.yaml", ros(TAGS).replace("id: 4,", "id: 3,"), "", r"tag 3 is already tag\[0\]"),
    ("tags.yaml", "standalone_tags: [ {id: 1, size: 0.08} ]", "", "no bundle with a layout; give one in `tag_bundles`"),
    ("tags.yaml", "tag_bundles: [ {layout: [ {id: 1} ]} ]", "", "no layout of tags: .*size"),
    ("tags.yaml", "a: [", "", "no layout of tags: "),
    ("f.json", wpilib(TAGS), "", "does not say how large its tags are; add size_m"),
    ("f.json", wpilib(TAGS).replace('"ID": 17', '"ID": 600'), "size_m = 0.08", "tag 600 is none of the family 36h11"),
    ("f.json", '{"tags": 3}', "size_m = 0.08", "no layout of tags: "),
    ("f.json", wpilib(TAGS), "size_m = 0.08\nsize = 1", r"fleet.toml: key 'landmarks': unknown key `size`"),
    ("tags.yaml", ros(TAGS).replace("qw: 0.", "qw: .nan #", 1), "", r"tags.yaml: "),
    ("tags.yaml", ros(TAGS).replace("x: 0", "x: 1.0e+300 #", 1), "", r"tags.yaml: "),
    ("tags.yaml", "a: " + "[" * 5000, "", "nested too deeply"),
    ("tags.yaml", "- " * 50_000, "", "nested too deeply"),
    ("tags.yaml", "a: &a [1]\ntag_bundles: [*a, *a]", "", "nested too deeply, or with aliases"),
    ("tags.yaml", "tag_bundles: 2001-99-99", "", "no layout of tags: "),
    ("f.json", '{"tags": ' + "[" * 5000, "size_m = 0.08", "nested too deeply"),
    ("f.json", wpilib(TAGS).replace('"x": 0', '"x": 1e300, "_": 0', 1), "size_m = 0.08", r"f.json: "),
    ("tags.toml", "[landmarks]\nsize_m = 1e300\ntag = []", "", "key 'landmarks.size_m': 1e\\+300 is beyond"),
    ("tags.toml", "[landmarks]\nsize_m = inf\ntag = []", "", "key 'landmarks.size_m': not a finite number"),
    ("tags.csv", "", "", r"'tags.csv' is none of .toml \(a survey\), .yaml \(apriltag_ros\) and .json \(WPILib\)"),
]


@pytest.mark.parametrize(("name", "text", "table", "why"), WRONG)
def test_what_cannot_be_used_is_one_line(fleet, name, text, table, why):
    with pytest.raises(ConfigError, match=why) as caught:
        load_fleet(fleet(name, text, table))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(fleet, tmp_path):
    path = fleet("tags.yaml", "")
    (tmp_path / "tags.yaml").unlink()
    with pytest.raises(ConfigError, match=r"tags.yaml: no such file; correct `file`"):
        load_fleet(path)
