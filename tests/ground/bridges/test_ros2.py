"""A fleet as topics of ROS 2: keys and tokens as rmw_zenoh has them, and messages in ROS's own directions."""

import hashlib
import struct

import pytest
from msgspec.structs import replace

from agent.core.config import Body, ConfigError, Fleet
from agent.core.messages import Estimate, Image, Whereabouts
from agent.core.ranging.camera_model import camera_pose
from agent.ground.bridges.ros2 import Kind, nodes
from tests.full_disk import room
from tests.ground.bridges.states import START_NS, state
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run

STRING = Kind("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")


def test_keys_and_tokens_are_those_of_the_design_note_of_rmw_zenoh() -> None:
    """Its own example is /chatter of talker; ours stands in the name space of a robot."""
    node = nodes("aac3178e146ba6f1fc6e6a4085e77f21", 0, {"r1": {"chatter": STRING}})["r1"]
    zid = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert node.token == f"@ros2_lv/0/{zid}/0/0/NN/%/%r1/aucamp"
    chatter = node.publishers["chatter"]
    tail = f"std_msgs::msg::dds_::String_/{STRING.digest}"
    assert chatter.key == f"0/r1/chatter/{tail}"
    assert chatter.token == f"@ros2_lv/0/{zid}/0/1/MP/%/%r1/aucamp/%r1%chatter/{tail}/::,10:,:,:,,"
    number, sent_ns, length = struct.unpack_from("<qqB", chatter.attachment(7, START_NS))
    assert (number, sent_ns, length) == (7, START_NS, 16)
    assert chatter.attachment(7, START_NS)[17:] == hashlib.md5(chatter.token.encode()).digest()


def test_no_two_have_one_number() -> None:
    found = nodes("a", 5, {"r1": {"x": STRING, "y": STRING}, "r2": {"x": STRING}})
    tokens = [node.token for node in found.values()]
    tokens += [each.token for node in found.values() for each in node.publishers.values()]
    assert len({token.split("/")[4] for token in tokens}) == len(tokens) == 5
    assert all(token.startswith("@ros2_lv/5/a/") for token in tokens)


@pytest.fixture
def telling(fleet: Fleet):
    pytest.importorskip("rosbags", reason="pip install 'aucamp[ros]'")
    from agent.ground.bridges.ros2 import Telling

    return Telling(fleet)


def read(data: bytes, name: str):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, name)


def turned(q, vector: tuple[float, float, float]) -> tuple[float, ...]:
    """A vector of the body, in the world: the quaternion's own rule, v + 2 q x (q x v + w v)."""
    x, y, z = vector
    a = (q.y * z - q.z * y + q.w * x, q.z * x - q.x * z + q.w * y, q.x * y - q.y * x + q.w * z)
    return (
        x + 2.0 * (q.y * a[2] - q.z * a[1]),
        y + 2.0 * (q.z * a[0] - q.x * a[2]),
        z + 2.0 * (q.x * a[1] - q.y * a[0]),
    )


@pytest.mark.parametrize("angles", [(0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (-15.0, 25.0)])
def test_a_pose_turns_as_the_estimator_turns(telling, fleet: Fleet, angles: tuple[float, float]) -> None:
    """The camera's arm, turned by the quaternion, is where the model of our cameras puts it."""
    roll_deg, pitch_deg = angles
    body = Body(camera_m=(0.11, 0.05, -0.07))
    pose, surface_m = fleet.robot["r1"].pose, fleet.tank.surface_m
    eye = camera_pose(pose, body, 0.4, roll_deg, pitch_deg, 0.0, 0.0, surface_m)
    told = read(telling.pose(state("r1", roll_deg=roll_deg, pitch_deg=pitch_deg)), "geometry_msgs/msg/PoseStamped")
    at = told.pose.position
    assert (at.x, at.y, at.z) == pytest.approx((pose.x_m, pose.y_m, surface_m - 0.4))
    arm = turned(told.pose.orientation, body.camera_m)
    assert (at.x + arm[0], at.y + arm[1], at.z + arm[2]) == pytest.approx(eye.position_m)
    assert (told.header.frame_id, told.header.stamp.sec, told.header.stamp.nanosec) == ("world", 1_700_000_000, 0)


def test_who_does_not_know_where_it_is_says_nothing(telling) -> None:
    assert telling.pose(state("r1", whereabouts=None, behaviour="hold")) is None
    assert telling.pose(state("r1", depth_m=None, roll_deg=None, pitch_deg=None)) is None
    where = Whereabouts(x_m=0.5, y_m=0.75, yaw_deg=90.0, place_sigma_m=0.02, yaw_sigma_deg=1.0)
    told = read(telling.pose(state("r1", whereabouts=where, behaviour="hold")), "geometry_msgs/msg/PoseStamped")
    assert (told.pose.position.x, told.pose.position.y) == (0.5, 0.75)


def estimate(**about) -> Estimate:
    rest = {"incarnation": 1, "seq": 0, "sent_ns": START_NS + 5, "target": "ball", "t": 3, "valid": True}
    return Estimate(fleet="tank", src="r1", dst="r2", **{**rest, **about})


def test_a_target_has_its_covariance(telling) -> None:
    covariance = (4.0, 0.1, 0.2, 5.0, 0.3, 6.0)
    data = telling.target(estimate(x_m=(0.1, 0.2, 0.3), cov_m2=covariance))
    told = read(data, "geometry_msgs/msg/PoseWithCovarianceStamped")
    at, whole = told.pose.pose.position, told.pose.covariance.reshape(6, 6)
    assert (at.x, at.y, at.z, told.header.stamp.nanosec) == (0.1, 0.2, 0.3, 5)
    assert whole[:3, :3].tolist() == [[4.0, 0.1, 0.2], [0.1, 5.0, 0.3], [0.2, 0.3, 6.0]]
    assert (whole == whole.T).all()
    assert telling.target(estimate()) is None


def test_a_picture_is_the_file_itself(telling) -> None:
    jpeg = bytes(range(256)) * 3
    about = {"seq": 1, "sent_ns": 9, "frame": 1, "width_px": 4, "height_px": 3, "enhanced": False}
    image = Image(robot="r1", t_ns=START_NS + 7, jpeg=jpeg, **about)
    told = read(telling.image(image), "sensor_msgs/msg/CompressedImage")
    assert (told.format, told.header.frame_id, told.header.stamp.nanosec) == ("jpeg", "r1_camera", 7)
    assert told.data.tobytes() == jpeg


def test_several_targets_stand_in_their_topics(telling, fleet: Fleet) -> None:
    assert set(telling.topics("r1")) == {"pose", "camera/compressed", "target"}
    two = replace(fleet, target={**fleet.target, "buoy": fleet.target["ball"]})
    assert set(type(telling)(two).topics("r1")) == {"pose", "camera/compressed", "target/ball", "target/buoy"}


def test_what_is_said_goes_to_its_topic_and_is_counted(telling, fleet: Fleet) -> None:
    from agent.ground.bridges.ros2 import Ros2

    ros = Ros2(fleet, 0)
    tokens = list(ros.tokens("a"))
    assert len(tokens) == len(set(tokens)) == 4 * len(fleet.robot)
    first, second = [one for _ in range(2) for one in ros.said(state("r1"), START_NS)]
    assert first.key == second.key and first.key.startswith("0/r1/pose/geometry_msgs::msg::dds_::PoseStamped_/RIHS01_")
    assert [struct.unpack_from("<qq", one.attachment) for one in (first, second)] == [(1, START_NS), (2, START_NS)]
    assert not list(ros.said(state("r1", whereabouts=None, behaviour="hold"), START_NS))
    assert not list(ros.said(state("r99"), START_NS))
    assert not list(ros.said(estimate(target="other", x_m=(0.0, 0.0, 0.0), cov_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), 0))


def test_a_recording_is_a_bag_that_others_read(tmp_path) -> None:
    pytest.importorskip("rosbags", reason="pip install 'aucamp[ros]'")
    from rosbags.highlevel import AnyReader

    from agent.ground.bridges.ros2 import write_bag

    fleet = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap")
    count = write_bag(fleet, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as bag:
        told = {each.topic: (each.msgtype, each.msgcount) for each in bag.connections}
        targets = [each for each in bag.connections if each.topic == "/r1/target"]
        placed = [bag.deserialize(raw, each.msgtype) for each, _, raw in bag.messages(connections=targets)]
    assert sum(number for _, number in told.values()) == count
    assert told["/r1/pose"][0] == "geometry_msgs/msg/PoseStamped" and told["/r2/pose"][1] > 10
    assert {each.header.frame_id for each in placed} == {"world"} and len(placed) > 10
    stamps = [(each.header.stamp.sec, each.header.stamp.nanosec) for each in placed]
    assert len(set(stamps)) == len(stamps)  # once, and not once for each neighbour


def test_a_bag_is_made_of_a_fleet_s_recording_or_not_at_all(tmp_path) -> None:
    pytest.importorskip("rosbags", reason="pip install 'aucamp[ros]'")
    from agent.ground.bridges.ros2 import write_bag

    with pytest.raises(ConfigError, match="no recording of a fleet"):
        write_bag(GOLDEN / "outage", tmp_path / "bag")
    with pytest.raises(ConfigError, match="is no recording of a fleet"):
        write_bag(GOLDEN / "outage" / "r1.mcap", tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_bag_that_finds_no_room_blames_the_disk_and_not_the_recording(tmp_path) -> None:
    pytest.importorskip("rosbags", reason="pip install 'aucamp[ros]'")
    from agent.ground.bridges.ros2 import write_bag

    fleet = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap")
    with room(2000), pytest.raises(OSError, match="File too large") as refused:
        write_bag(fleet, tmp_path / "bag")
    assert str(refused.value.filename).startswith(str(tmp_path / "bag"))
    assert not (tmp_path / "bag").exists()
