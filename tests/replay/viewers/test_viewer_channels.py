"""Viewer channels: they follow from the raw ones, and both viewers open the file as it is."""

import importlib.util
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from agent.core.codec import decode
from agent.core.ranging.camera_model import camera_pose
from agent.core.robot_view import robot_view
from agent.core.step_io import Sighting
from replay.files.channels import FRAME, VISION, Entry
from replay.files.frames import EXACT_EVERY, Frames, pixels
from replay.files.info import info
from replay.files.log import read
from replay.viewers import layout
from replay.viewers.foxglove import PLOTS, Turn, plot, transforms
from replay.viewers.layout import shipped
from replay.viewers.viewer_channels import ViewerChannels
from tests.replay.small_box import CALIBRATION, FLEET, START_NS, STEP_NS, STEPS, disc, flat, state, write_box

SCHEMAS = {  # channel -> what Foxglove decodes it as, what Rerun shows it as
    "/plot/clock": ("aucamp.Clock", "aucamp.Clock"),
    "/r1/camera/calibration": ("foxglove.CameraCalibration", "Pinhole"),
    "/r1/camera/image": ("foxglove.CompressedImage", "EncodedImage"),
    "/r1/depth/points": ("foxglove.PointCloud", "Points3D"),
    "/r1/log": ("foxglove.Log", "TextLog"),
    "/r1/plot/attitude": ("aucamp.Attitude", "aucamp.Attitude"),
    "/r1/plot/focus": ("aucamp.Focus", "aucamp.Focus"),
    "/r1/plot/hears/r2": ("aucamp.Neighbour", "aucamp.Neighbour"),
    "/r1/plot/protocol": ("aucamp.Protocol", "aucamp.Protocol"),
    "/r1/plot/thrusters": ("aucamp.Thrusters", "aucamp.Thrusters"),
    "/r1/sweep/calibration": ("foxglove.CameraCalibration", "Pinhole"),
    "/r1/sweep/image": ("foxglove.CompressedImage", "EncodedImage"),
    "/r1/target/estimate": ("foxglove.PoseInFrame", "InstancePoses3D"),
    "/r1/target/prior": ("foxglove.PoseInFrame", "InstancePoses3D"),
    "/r1/tf": ("foxglove.FrameTransforms", "Transform3D"),
}
RAW = {  # bytes to a viewer
    *("/raw/clock", "/raw/frame", "/raw/serial/from_board", "/raw/serial/to_board"),
    *("/raw/step_in", "/raw/step_out", "/raw/vision"),
}
PICTURES = {"/r1/camera/image", "/r1/sweep/image"}  # viewers draw what replay reads


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_box(tmp_path_factory.mktemp("box"))


def decoded(path: Path) -> Iterator[tuple[str, int, Any]]:
    """(channel, log time, message) by nothing but the descriptors in the file."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages(topics=list(SCHEMAS)):
            yield channel.topic, message.log_time, content


def test_every_viewer_channel_decodes_by_its_own_descriptor(box: Path) -> None:
    channels = info(box).channels
    assert {name: channel.schema for name, channel in channels.items() if name not in RAW} == {
        name: schema for name, (schema, _) in SCHEMAS.items()
    }
    assert channels.keys() >= RAW
    contents: dict[str, list[Any]] = {}
    for channel, log_time_ns, content in decoded(box):
        contents.setdefault(channel, []).append(content)
        assert START_NS < log_time_ns <= START_NS + STEPS * STEP_NS
    assert contents.keys() == SCHEMAS.keys()
    estimate = contents["/r1/target/estimate"][0]
    assert (estimate.frame_id, estimate.pose.orientation.w) == ("world", 1.0)
    assert (estimate.pose.position.x, estimate.pose.position.y) == (0.76, 0.56)
    assert contents["/r1/log"][3].message == "step 3"
    assert contents["/r1/plot/attitude"][0].sensor4_depth_m == 0.41
    assert contents["/r1/plot/thrusters"][0].pwm8_us == 1507
    assert contents["/r1/plot/focus"][5].clarity == 105
    assert [clock.rate for clock in contents["/plot/clock"]] == [1.0] * 5
    assert contents["/plot/clock"][1].dive_s == pytest.approx(0.5)
    assert math.isnan(contents["/r1/plot/protocol"][0].alpha)  # not known, and not zero
    assert contents["/r1/plot/protocol"][0].valid_robots == 2
    assert contents["/r1/plot/hears/r2"][0].age_s == 0.1
    image = cv2.imdecode(np.frombuffer(contents["/r1/camera/image"][0].data, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (480, 640, 3)
    cloud = contents["/r1/depth/points"][0]
    assert (cloud.frame_id, cloud.point_stride, len(contents["/r1/depth/points"])) == ("r1/camera", 16, 4)
    assert [(field.name, field.offset) for field in cloud.fields][2:5] == [("z", 8), ("red", 12), ("green", 13)]
    point = np.frombuffer(cloud.data, [(field.name, "<f4" if field.offset < 12 else "u1") for field in cloud.fields])
    assert len(point) == 3  # one of the four blocks has no range
    assert point["z"].tolist() == pytest.approx([0.5, 0.5, 0.5])
    # Upper left block: pixels 200 to 239 and 120 to 159 of the frame.
    assert (point["x"][0], point["y"][0]) == pytest.approx(((219.5 - 319.5) / 1169 * 0.5, (139.5 - 239.5) / 1169 * 0.5))
    assert point[0].tolist()[3:] == (180, 50, 20, 255)
    part = contents["/r1/sweep/calibration"][0]  # the principal point moves with the part that is read
    assert (part.width, part.height, part.K[2], part.K[5]) == (240, 240, 319.5 - 200, 239.5 - 120)


def test_viewer_channels_can_be_derived_again(box: Path) -> None:
    """The recording's own, message for message, from its raw channels."""
    derive, made, recorded = ViewerChannels(FLEET, "r1", CALIBRATION, flat), [], []
    for record in read(box):
        if record.channel in SCHEMAS.keys() - PICTURES:
            recorded.append(record)
        else:
            made += [entry[:5] for entry in derive(Entry(*record, "msgpack", {}))]
    assert made == recorded


def test_they_can_be_left_out_but_for_the_pictures(tmp_path: Path, box: Path) -> None:
    """Which are what vision is replayed with; so both recordings hold each frame, and hold it once."""
    bare = write_box(tmp_path, views=False)
    assert info(bare).channels.keys() == RAW | PICTURES
    kept = [(record.channel, record.data) for record in read(box) if record.channel in RAW | PICTURES]
    assert [(record.channel, record.data) for record in read(bare)] == kept
    abouts = [data for channel, data in kept if channel == FRAME.name]
    pictures = [data for channel, data in kept if channel in PICTURES]
    assert len(pictures) == len(abouts) == STEPS
    assert max(map(len, abouts)) < 200 < 10_000 < min(map(len, pictures))


def test_what_does_not_decode_has_no_viewer_channel() -> None:
    derive = ViewerChannels(FLEET)
    for channel in ("/raw/step_in", "/zenoh/aucamp/tank/robot/r1/state", "/zenoh/aucamp/tank/alive/r1", "/other"):
        assert list(derive(Entry(channel, 0, 0, 0, b"\xc1", "msgpack", {}))) == []


def test_frames_come_back(tmp_path: Path) -> None:
    """Bit by bit where they are lossless, as one in EXACT_EVERY always is, otherwise nearly; with what vision knew."""
    for lossless in (True, False):
        folder = tmp_path / str(lossless)
        folder.mkdir()
        frames, found = Frames(), 0
        for record in read(write_box(folder, lossless=lossless)):
            frames.take(record.channel, record.sequence, record.data)
            if record.channel != VISION.name:
                continue
            picture, sighting = frames.at(record.sequence), decode(record.data, Sighting)
            assert picture is not None
            for name in ("t_ns", "frame", "sweep", "index", "focus"):
                assert getattr(picture, name) == getattr(sighting, name)
            x, y, width, height = picture.roi
            error = np.abs(pixels(picture).astype(int) - disc(picture.frame)[y : y + height, x : x + width])
            exact = lossless or record.sequence % EXACT_EVERY == 0
            assert (picture.format, error.max() == 0) == (("png", True) if exact else ("jpeg", False))
            assert error.mean() < 6.0
            found += 1
        assert found == STEPS


@pytest.mark.parametrize("gone", ["/r1/sweep/image", FRAME.name])
def test_a_frame_that_lost_its_picture_or_what_belongs_to_it_is_no_other_frame(box: Path, gone: str) -> None:
    frames, missing = Frames(), []
    for record in read(box):
        if record.channel != gone or record.sequence != 5:
            frames.take(record.channel, record.sequence, record.data)
        if record.channel == VISION.name and frames.at(record.sequence) is None:
            missing.append(record.sequence)
    assert missing == [5]


def rotate(turn: Turn, v: tuple[float, float, float]) -> np.ndarray:
    q, w = np.array(turn[:3]), turn[3]
    return np.array(v) + 2.0 * np.cross(q, np.cross(q, v) + w * np.array(v))


def test_the_frame_tree_ends_where_the_kernel_says_the_camera_is() -> None:
    place, surface_m = FLEET.robot["r1"].pose, FLEET.tank.surface_m
    tree = transforms(robot_view(state(START_NS, 0), FLEET), FLEET.body)
    assert [(link.parent_frame_id, link.child_frame_id) for link in tree.transforms] == [
        ("world", "r1/body"),
        ("r1/body", "r1/gimbal"),
        ("r1/gimbal", "r1/camera"),
    ]
    eye = camera_pose(place, FLEET.body, 0.4, 1.0, -2.0, 12.0, -20.0, surface_m)

    def to_world(v: tuple[float, float, float]) -> np.ndarray:
        point = np.array(v)
        for link in reversed(tree.transforms):
            q, t = link.rotation, link.translation
            point = rotate((q.x, q.y, q.z, q.w), tuple(point)) + np.array([t.x, t.y, t.z])
        return point

    assert to_world((0.0, 0.0, 0.0)) == pytest.approx(eye.position_m, abs=1e-12)
    for axis, column in zip(np.eye(3), np.array(eye.rotation).T, strict=True):
        assert to_world(tuple(axis)) - eye.position_m == pytest.approx(column, abs=1e-12)


def test_a_plot_names_every_field() -> None:
    for name, fields in PLOTS.items():
        assert [field.name for field in plot(name, **dict.fromkeys(fields)).DESCRIPTOR.fields] == list(fields)
    with pytest.raises(ValueError, match="age_s"):
        plot("Neighbour", valid=True, used=True, heard=1, gaps=0, weight=None)


def test_the_layouts_show_channels_that_exist(box: Path) -> None:
    text = shipped("foxglove.json").read_text(encoding="utf-8")
    json.loads(text)
    named = set(re.findall(r"/r\d/[a-z/]*[a-z]", text))
    named |= {channel for view in layout.shown_channels().values() for channel in view}
    # The last: of a fleet file, and of a survey.
    exist = {*info(box).channels, "/r1/preview", "/r1/survey/keyframe", "/r1/survey/next", "/survey/map"}
    assert len(named) > 12
    assert {re.sub(r"/r\d/", "/r1/", name) for name in named} <= exist
    assert {name for name in named if name.endswith("/preview")} == {f"/r{n}/preview" for n in (1, 2, 3)}
    for channel in re.findall(r'"(/plot/\w+)', text):
        assert channel in exist
    for path, field in re.findall(r"/plot/(\w+)\.(\w+)", text):
        assert field in PLOTS[path.capitalize()]
    assert (resources.files("replay.viewers") / "layouts" / "rerun.rbl").read_bytes()[:3] == b"RRF"


def tool(name: str) -> str:
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        pytest.skip(f"{name} is not installed")
    return str(path)


def run(command: list[str], home: Path) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "HOME": str(home), "COLUMNS": "200"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_pymcap_cli_finds_no_error(box: Path, tmp_path: Path) -> None:
    said = run([tool("pymcap-cli"), "doctor", str(box)], tmp_path)
    assert "passed MCAP doctor checks" in said or ": 0 errors," in said
    assert set(re.findall(r"\b[A-Z]+(?:_[A-Z]+)+\b", said)) <= {"CHUNK_COMPRESSION_INEFFICIENT"}  # one PNG is a chunk


def test_rerun_accepts_the_file_and_shows_each_channel_as_what_it_is(box: Path, tmp_path: Path) -> None:
    rerun = tool("rerun")
    checked = run([rerun, "mcap", "check", str(box)], tmp_path)
    rows = {topic: status for status, topic in re.findall(r"^(\w+) +\d+ +\d+ +(/\S+)", checked, re.MULTILINE)}
    assert rows == dict.fromkeys(RAW | SCHEMAS.keys(), "ok")
    run([rerun, "mcap", "convert", str(box), "-o", str(tmp_path / "box.rrd")], tmp_path)
    run([rerun, "rrd", "verify", str(tmp_path / "box.rrd")], tmp_path)
    printed = run([rerun, "rrd", "print", "-v", str(tmp_path / "box.rrd")], tmp_path)
    shown = {(topic, kind) for topic, kind in re.findall(r"(/\S+?)@([\w.]+):", printed)}
    for topic, (_, kind) in SCHEMAS.items():
        assert (topic, kind) in shown
    for topic in RAW:
        assert (topic, "McapMessage") in shown  # a blob


def test_the_rerun_layout_can_be_written_again(tmp_path: Path) -> None:
    if importlib.util.find_spec("rerun") is None:
        pytest.skip("rerun-sdk is not installed")
    layout.write_blueprint(tmp_path / "rerun.rbl")
    assert (tmp_path / "rerun.rbl").read_bytes()[:3] == b"RRF"
