"""The table of topics: every key is spelt there and nowhere else."""

import re

import pytest

from agent.core.messages import Message
from agent.core.topics import (
    ALIVE,
    ALL,
    CLAIM,
    KEYFRAME,
    LIGHT,
    LINK,
    LOG,
    NEAR,
    STATE,
    TOPICS,
    TWICE,
    Topic,
    chunks,
    key,
    match,
    target_chunk,
)
from tests.places import ROOT

CHUNKS = {"fleet": "tank", "robot": "r1", "src": "r1", "dst": "r2", "console": "ann"}
TARGET = {"target": "buoy"}


@pytest.mark.parametrize("row", TOPICS, ids=lambda row: row.name)
def test_a_key_leads_back_to_its_row_and_chunks(row: Topic) -> None:
    used = {name: CHUNKS[name] for name in re.findall(r"{(\w+)}", row.key) if name != "target"}
    assert match(key(row, **used)) == (row, used)
    assert row.writer in used
    with_target = {**used, **(TARGET if "target" in row.key else {})}
    assert match(key(row, **used, **TARGET)) == (row, with_target)


def test_one_target_leaves_the_key_as_it_is_and_two_have_a_key_each() -> None:
    assert target_chunk({"ball"}, "ball") == {}
    keys = [key(LINK, **CHUNKS, **target_chunk(("ball", "buoy"), target)) for target in ("ball", "buoy")]
    assert keys == ["aucamp/tank/link/r1/r2/ball", "aucamp/tank/link/r1/r2/buoy"]
    assert key(STATE, fleet="tank", robot="*", target="**") == "aucamp/tank/robot/*/state/**"


@pytest.mark.parametrize(
    "stranger",
    [
        "",
        "aucamp",
        "aucamp/tank/link/r1",
        "aucamp/tank/link/r1/r2/ball/now",
        "aucamp/tank/robot/r1/opinion",
        "other/tank/link/r1/r2",
        ALIVE.format(**CHUNKS, session="1a"),
    ],
)
def test_a_key_of_nobody_has_no_row(stranger: str) -> None:
    assert match(stranger) is None


def test_rows_do_not_answer_to_the_same_key() -> None:
    keys = [key(row, **CHUNKS) for row in TOPICS]
    assert len(set(keys)) == len(TOPICS) == len({row.name for row in TOPICS})
    for row, text in zip(TOPICS, keys, strict=True):
        found = match(text)
        assert found is not None
        assert found[0] is row


def test_both_ends_of_a_link_stand_in_its_key() -> None:
    assert key(LINK, fleet="tank", src="*", dst="r2") == "aucamp/tank/link/*/r2"
    assert key(STATE, fleet="tank", robot="r1") == "aucamp/tank/robot/r1/state"
    assert key(LOG, fleet="tank", robot="r1").startswith(ALL.format(fleet="tank").removesuffix("**"))


@pytest.mark.parametrize("row", TOPICS, ids=lambda row: row.name)
def test_every_row_has_a_message_and_room_for_two_seconds_of_it_unless_the_newest_stands_for_all(row: Topic) -> None:
    assert issubclass(row.message, Message)
    assert row.qos.buffer == 2 if row in (LINK, NEAR, CLAIM, KEYFRAME, LIGHT) else row.qos.buffer >= 2 * row.hz


def test_a_token_leads_back_to_its_chunks() -> None:
    who = {"fleet": "tank", "robot": "r1", "session": "1a"}
    assert chunks(ALIVE, ALIVE.format(**who)) == who
    assert chunks(ALIVE, "aucamp/tank/alive/r1") is None
    assert chunks(TWICE, ALIVE.format(**who)) is None


def test_no_other_file_spells_a_key() -> None:
    sources = [path for folder in ("agent", "hw", "replay") for path in (ROOT / folder).rglob("*.py")]
    assert len(sources) > 5
    guilty = [str(path.relative_to(ROOT)) for path in sources if "aucamp/" in path.read_text(encoding="utf-8")]
    assert guilty == ["agent/core/topics.py"]
