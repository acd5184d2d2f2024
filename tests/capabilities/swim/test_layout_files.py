"""Tags from other files: written as the other programs do, read as our own; what cannot be used is one line."""

import json

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from agent.capabilities.swim.landmarks import axes
from agent.core.config import ConfigError, Tag, dump
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

TANK = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
WIDTH, DEPTH, _ = TANK.tank.size_m
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
    whole = dump(TANK)

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
    with pytest.raises(ConfigError, match=r"cannot be read \(No such file or directory\); correct `file`"):
        load_fleet(path)
