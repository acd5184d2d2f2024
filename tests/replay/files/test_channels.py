"""The table of recording channels: every channel is spelt there and nowhere else, and docs/channels.md shows it."""

import re
from pathlib import Path

import pytest

from agent.core import topics
from replay.files.channels import CHANNELS, NETWORK, PRESENCE, PRIOR, Channel, match, name, network_topic
from replay.files.info import info
from tests.places import ROOT
from tests.replay.small_box import write_box

CHUNKS = {"robot": "r1", "neighbour": "r2", "fleet": "tank", "key": "aucamp/tank/robot/r1/state"}
TARGET = {"target": "buoy"}
FILES = {"agent": "black box", "recorder": "fleet file", "recovery": "mended copy"}


@pytest.mark.parametrize("row", CHANNELS, ids=lambda row: row.name)
def test_a_channel_leads_back_to_its_row_and_chunks(row: Channel) -> None:
    used = {chunk: CHUNKS[chunk] for chunk in re.findall(r"{(\w+)}", row.name) if chunk != "target"}
    assert match(name(row, **used)) == (row, used)
    with_target = {**used, **(TARGET if "{target}" in row.name else {})}
    assert match(name(row, **used, **TARGET)) == (row, with_target)


def test_one_target_is_left_off_and_several_have_a_channel_each() -> None:
    assert name(PRIOR, robot="r1") == "/r1/target/prior"
    assert name(PRIOR, robot="r1", target="buoy") == "/r1/target/buoy/prior"


@pytest.mark.parametrize("stranger", ["", "/", "/chatter", "/raw/opinion", "/r1/plot", "/r1/target/a/b/prior"])
def test_a_channel_of_nobody_has_no_row(stranger: str) -> None:
    assert match(stranger) is None


def test_what_is_on_the_network_leads_to_its_topic() -> None:
    key = topics.key(topics.STATE, fleet="tank", robot="r1")
    assert network_topic(name(NETWORK, key=key)) == (topics.STATE, {"fleet": "tank", "robot": "r1"})
    assert network_topic(name(NETWORK, key="somebody/else")) is None
    assert network_topic(name(PRESENCE, fleet="tank", robot="r1")) is None
    assert network_topic(key) is None


def test_a_black_box_holds_the_rows_of_its_writer_as_the_table_says(tmp_path: Path) -> None:
    seen = set()
    for channel, about in info(write_box(tmp_path)).channels.items():
        found = match(channel)
        assert found is not None, channel
        row = found[0]
        seen.add(row)
        assert "agent" in row.writers
        assert about.encoding == row.encoding
        assert (about.schema if row.encoding == "protobuf" else about.metadata.get("schema", "")) == row.schema
    of_a_survey = {"/{robot}/plot/survey", "/{robot}/survey/keyframe", "/{robot}/survey/next"}
    assert {row.name for row in CHANNELS if "agent" in row.writers and row not in seen} == {
        "/raw/drops",
        "/raw/log",
        *of_a_survey,
    }


def test_no_other_file_spells_a_channel() -> None:
    sources = [path for folder in ("agent", "hw", "replay", "router_config") for path in (ROOT / folder).rglob("*.py")]
    of_robots = [re.sub(r"^/{robot}|\[.*\]|{neighbour}", "", row.name) for row in CHANNELS if "{robot}" in row.name]
    pattern = re.compile(r"/raw/|/zenoh/|\"/plot/|(}|r\d)(" + "|".join(of_robots) + r")\b")
    guilty = [str(path.relative_to(ROOT)) for path in sources if pattern.search(path.read_text(encoding="utf-8"))]
    # The first is the other table: a key of the network also ends in "{robot}/log".
    assert guilty == ["agent/core/topics.py", "replay/files/channels.py"]


def test_the_page_shows_the_table() -> None:
    text = (ROOT / "docs" / "channels.md").read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.startswith("| `")] == [shown(row) for row in CHANNELS]


def shown(row: Channel) -> str:
    """The row of the page."""
    channel = row.name.replace("{", "<").replace("}", ">")
    schema = f" `{row.schema.replace('{', '<').replace('}', '>')}`" if row.schema else ""
    files = ", ".join(FILES[writer] for writer in row.writers)
    return f"| `{channel}` | {row.about} | {row.encoding}{schema} | {files} |"
