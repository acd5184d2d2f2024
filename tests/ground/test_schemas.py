"""The JSON Schemas say what the structs say, what the robots have said, and nothing else."""

import json
from typing import Any

import msgpack
import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.codec import decode, encode
from agent.core.messages import MAX_JPEG, SCHEMA, Answer, Image, LogLine, Order, State
from agent.core.step_io import Inputs, Outputs
from agent.core.topics import TOPICS
from agent.ground.schemas import INDEX, texts
from docs import write_messages
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.log import read
from tests.places import GOLDEN
from tests.sample_messages import estimate, presence
from tests.schema_check import SCHEMAS, wrong

IMAGE = Image(
    robot="r1", seq=1, sent_ns=3, t_ns=2, frame=4, width_px=640, height_px=480, enhanced=False, jpeg=bytes(MAX_JPEG)
)
STATE = State(fleet="tank", robot="r1", incarnation=1, seq=1, sent_ns=2, target="ball", knows="told", t=3)
ANSWER = Answer(robot="r1", console="ann", id=1, order="stop", ok=True, arrived_ns=1, sent_ns=2)
LINE = LogLine(robot="r1", sent_ns=1, level="info", text="here")


def test_the_files_that_ship_are_those_of_today() -> None:
    shipped = {path.name: path.read_text(encoding="utf-8") for path in SCHEMAS.iterdir()}
    assert shipped == texts(), "out of date: python docs/write_messages.py"
    page = write_messages.PAGE.read_text(encoding="utf-8")
    assert page == write_messages.with_tables(page), "out of date: python docs/write_messages.py"
    assert all(f"### {row.message.__name__}\n" in page for row in TOPICS)


def test_every_field_of_every_message_says_what_it_is() -> None:
    for name, text in texts().items():
        whole = json.loads(text)
        for part in (whole, *whole.get("$defs", {}).values()) if name != INDEX else ():
            fields = part.get("properties") or {item["title"]: item for item in part["prefixItems"]}
            assert part["description"] and fields
            assert not [field for field, about in fields.items() if not about.get("description")], part["title"]


@pytest.mark.parametrize("case", ["three_evidence", "two", "signed"])
def test_what_robots_said_in_the_golden_dives_is_what_the_schemas_say(case: str) -> None:
    heard, said = 0, 0
    for record in list(read(GOLDEN / case / "r2.mcap"))[::15]:  # any dive has thousands, which say the same
        if record.channel == STEP_IN.name:
            for item in decode(record.data, Inputs, len(record.data)).heard:
                assert not wrong("Estimate", item.payload)
                heard += 1
        if record.channel == STEP_OUT.name:
            outputs = decode(record.data, Outputs, len(record.data))
            for message in (*outputs.says, outputs.state, *outputs.log):
                if message is not None:
                    assert not wrong(type(message).__name__, encode(message))
                    said += 1
    assert heard > 10 and said > 10


@pytest.mark.parametrize(
    "message", [IMAGE, STATE, LINE, ANSWER, estimate(), presence()], ids=lambda message: type(message).__name__
)
def test_a_message_that_a_robot_would_refuse_is_wrong(message: Any) -> None:
    name = type(message).__name__
    assert not wrong(name, encode(message))
    fields = msgpack.unpackb(encode(message))
    for change in ({"schema": SCHEMA + 1}, {"opinion": 1}, {"sent_ns": -1}, {"sent_ns": "now"}):
        assert wrong(name, msgpack.packb({**fields, **change})), change
    for missing in ("schema", "sent_ns"):
        assert wrong(name, msgpack.packb({key: value for key, value in fields.items() if key != missing})), missing


def test_limits_and_shapes_are_in_them_too() -> None:
    fields = msgpack.unpackb(encode(estimate()))
    assert wrong("Estimate", msgpack.packb({**fields, "x_m": [0.1, 0.2]}))
    assert wrong("Estimate", msgpack.packb({**fields, "src": "R1"}))
    assert wrong("Image", msgpack.packb({**msgpack.unpackb(encode(IMAGE)), "jpeg": bytes(MAX_JPEG + 3)}))


def test_they_can_be_written_and_nothing_is_overwritten(tmp_path) -> None:
    done = CliRunner().invoke(app, ["schemas", "--out", str(tmp_path / "new")])
    assert done.exit_code == 0, done.output
    assert {path.name: path.read_text() for path in (tmp_path / "new").iterdir()} == texts()
    again = CliRunner().invoke(app, ["schemas", "--out", str(tmp_path / "new")])
    assert again.exit_code != 0 and "not empty" in str(again.exception)


def test_an_order_is_as_its_schema_says() -> None:
    order = Order(id=1, verb="follow", args={"target": "ball", "standoff_m": 0.5, "search": True}, seen=(1, 2))
    assert not wrong("Order", encode(order)) and not wrong("Order", encode(Order(id=1, verb="stop")))
    fields = msgpack.unpackb(encode(order))
    for change in ({"schema": SCHEMA + 1}, {"id": -1}, {"args": {"x_m": [1]}}, {"seen": [1]}, {"verb": "x" * 17}):
        assert wrong("Order", msgpack.packb({**fields, **change})), change
