"""A fleet as entities of keelson, read by keelson's own decoder; whole, over links: tests/network/bridges."""

import json
from collections.abc import Iterable

import pytest

pytest.importorskip("keelson", reason="pip install 'aucamp[keelson]'")
from keelson import get_protobuf_message_class_from_type_name
from keelson.codec import uncover_to_json

from agent.core.config import Fleet
from agent.core.messages import Image, LogLine
from agent.ground.bridges.keelson import Keelson
from agent.ground.bridges.outward import Foreign
from tests.ground.bridges.states import START_NS, state


def read(said: Iterable[Foreign]) -> dict[str, dict]:
    """By their keys."""
    return {one.key: json.loads(uncover_to_json(one.key, one.payload)) for one in said}


def values(said: Iterable[Foreign]) -> dict[str, object]:
    return {key.split("/")[4]: told.get("value") for key, told in read(said).items()}


def test_all_that_a_state_knows_has_its_subject(fleet: Fleet) -> None:
    said = read(Keelson(fleet).said(state("r1", roll_deg=2.0, pitch_deg=5.0), START_NS + 1))
    assert set(said) == {
        f"tank/@v0/r1/pubsub/{source_and}"
        for source_and in (
            "roll_deg/pressure",
            "pitch_deg/pressure",
            "yaw_deg/place",
            "frame_transform/place",
            "vehicle_armed/control",
            "vehicle_mode/control",
        )
    }
    at = said["tank/@v0/r1/pubsub/frame_transform/place"]
    pose = fleet.robot["r1"].pose
    where = at["translation"]
    assert (where["x"], where["y"]) == pytest.approx((pose.x_m, pose.y_m))
    assert where["z"] == pytest.approx(fleet.tank.surface_m - 0.4)
    assert sum(value**2 for value in at["rotation"].values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("about", "wanted"),
    [
        ({"roll_deg": 2.0}, {"roll_deg": 2.0, "pitch_deg": 5.0, "vehicle_armed": True, "vehicle_mode": "ALT_HOLD"}),
        ({"armed": None}, {"vehicle_armed": "left out", "battery_voltage_v": "left out"}),
        ({"battery_v": 14.5}, {"battery_voltage_v": 14.5}),
        ({"faults": ("failsafe level 2",)}, {"vehicle_mode": "SURFACE"}),
        ({"roll_deg": None, "depth_m": None}, {"roll_deg": "left out", "frame_transform": "left out"}),
        ({"whereabouts": None, "behaviour": "survey"}, {"yaw_deg": "left out", "vehicle_mode": "GUIDED"}),
    ],
    ids=str,
)
def test_what_nobody_knows_is_left_out(fleet: Fleet, about: dict, wanted: dict) -> None:
    said = values(Keelson(fleet).said(state("r1", **about), START_NS))
    assert {name: said.get(name, "left out") for name in wanted} == wanted


def test_pictures_and_lines(fleet: Fleet) -> None:
    about = {"seq": 1, "sent_ns": 9, "frame": 1, "width_px": 4, "height_px": 3, "enhanced": False}
    ((key, told),) = read(Keelson(fleet).said(Image(robot="r2", t_ns=7, jpeg=b"abc", **about), START_NS)).items()
    assert key == "tank/@v0/r2/pubsub/image_compressed/camera"
    assert (told["data"], told["format"]) == ("YWJj", "jpeg")
    level = get_protobuf_message_class_from_type_name("foxglove.Log").Level
    line = LogLine(robot="r1", sent_ns=START_NS, level="warning", text="no frames")
    ((_, told),) = read(Keelson(fleet).said(line, START_NS)).items()
    assert (told["message"], told["level"]) == ("no frames", level.Value("WARNING"))


def test_strangers_are_passed_over_and_each_source_has_a_token(fleet: Fleet) -> None:
    assert not list(Keelson(fleet).said(state("r99"), START_NS))
    tokens = set(Keelson(fleet).tokens("a"))
    assert "tank/@v0/r1/pubsub/*/pressure" in tokens and len(tokens) == 5 * len(fleet.robot)
