"""Differences between messages, whatever a damaged recording holds in their place."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import msgpack
import pytest

from agent.core.config import ConfigError
from agent.core.step_io import OLDER
from agent.perception.vision import rerun_vision
from replay.check.check import check, text, update_recordings
from replay.check.compare import ABSENT, Difference, differences, must_differ
from replay.check.explain import explain
from replay.check.reexecute import Divergence, environment_notes, open_box, schema_of
from replay.check.vision_check import check_vision
from replay.files.log import Record
from replay.files.recover import recover
from replay.report.report import report
from replay.report.timeline import open_run
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.rewritten import rewritten


def test_what_nests_deeper_than_python_writes_is_told_in_one_short_line():
    recorded = b"\x91" * 1020 + b"\x02"  # lists in lists: msgpack reads 1024 of them
    try:
        msgpack.unpackb(recorded)
    except ValueError as error:
        raise AssertionError("the case has to be one that msgpack reads") from error
    assert sys.getrecursionlimit() <= 1020, "and one that Python does not write"
    for replayed in (3, [4], {"a": 5}):
        (difference,) = differences(recorded, msgpack.packb(replayed))
        assert "beyond what can be shown" in str(difference) and len(str(difference)) < 300


def test_its_json_form_is_written_too():
    (difference,) = differences(b"\x91" * 1020 + b"\x02", msgpack.packb(3))
    assert "beyond what can be shown" in Divergence("r1", 1, 2, difference, ()).as_json()["recorded"]


# --- older ---
# Recordings of schema 1 are still read and replayed; what later schemas added is no difference, all else is.

OLD = GOLDEN / "schema1"


def test_todays_kernel_does_what_it_did_then() -> None:
    checked = check([OLD])
    assert checked.exit_code == 0, text(checked)
    assert sum(each.steps for each in checked.results) == 3 * 320
    assert "recorded with schema 1: compared but for the schema itself" in text(checked)
    assert all(link.unknown == 0 for found in checked.links.values() for link in found)
    assert [open_box(OLD / f"{robot}.mcap").agent() for robot in ("r1", "r2", "r3")]


def test_another_behaviour_is_noticed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.robot.targets.LATEST_ITERATION", 1.4)
    assert check([OLD]).exit_code == 1


def without_grants(record: Record) -> bytes:
    """As robots recorded it that did not say who has what, and had a field for each topic."""
    if record.channel != "/raw/step_out":
        return record.data
    fields = msgpack.unpackb(record.data)
    fields.pop("grants", None)
    for said in fields.pop("outgoing", ()):
        name = next(name for name, topic in OLDER.items() if topic == said["topic"])
        fields.setdefault(name, []).append(msgpack.unpackb(said["payload"]))
    return msgpack.packb(fields)


def test_a_recording_from_before_grants_is_compared_but_for_them(tmp_path: Path) -> None:
    old = rewritten(GOLDEN / "dark_survey" / "r1.mcap", tmp_path / "r1.mcap", without_grants)
    checked = check([old])
    assert checked.exit_code == 0, text(checked)
    assert "recorded before robots said who has camera, body and lamp" in text(checked)


def test_a_grant_that_is_missing_is_a_difference(tmp_path: Path) -> None:
    """Of a recording that says who has what at its beginning."""

    def change(record: Record) -> bytes:
        if record.channel != "/raw/step_out" or record.sequence < 50:
            return record.data
        fields = msgpack.unpackb(record.data)
        fields.pop("grants", None)
        return msgpack.packb(fields)

    checked = check([rewritten(GOLDEN / "dark_survey" / "r1.mcap", tmp_path / "r1.mcap", change)])
    assert checked.exit_code == 1 and "grants" in text(checked)


def test_a_setting_that_there_is_no_more_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_box(GOLDEN / "lit" / "r1.mcap").retired == ()
    monkeypatch.setattr("replay.check.reexecute.RETIRED", (("link", "send_hz"),))
    box = open_box(GOLDEN / "lit" / "r1.mcap")
    assert any("recorded with [link] send_hz, which there is no more" in line for line in environment_notes(box))


def said(topic: str, to: str, payload: bytes = msgpack.packb({"a": 1})) -> dict:
    return {"topic": topic, "to": to, "payload": payload}


@pytest.mark.parametrize(
    ("outgoing", "field"),
    [
        ([said("near", "r3"), said("light", "r2")], "outgoing[0].to"),
        ([said("light", "r2"), said("near", "r2")], "outgoing[0].topic"),
        ([said("near", "r2", msgpack.packb({"a": 2})), said("light", "r2")], "outgoing[0].payload.a"),
        ([said("near", "r2", b"\x81\xd9\x01a\x01"), said("light", "r2")], "outputs"),  # the same, but longer
    ],
)
def test_every_way_in_which_neighbours_are_told_something_else_is_a_difference(outgoing: list, field: str) -> None:
    recorded = {"state": 1, "outgoing": [said("near", "r2"), said("light", "r2")]}
    found = differences(msgpack.packb(recorded), msgpack.packb(recorded | {"outgoing": outgoing}))
    assert found and found[0].field == field


def test_a_topic_may_have_the_name_of_a_field() -> None:
    recorded = {"state": 1, "outgoing": [said("state", "r2")]}
    (found,) = differences(msgpack.packb(recorded), msgpack.packb(recorded | {"state": 2}))
    assert found.field == "state"


@pytest.mark.parametrize("schema", ["4", "x" * 9000])
def test_a_schema_that_we_cannot_read_is_named_in_one_line(schema: str) -> None:
    with pytest.raises(ConfigError, match="ours is 3; replay it with the version it names") as caught:
        schema_of(Path("r1.mcap"), {"schema": schema})
    assert len(str(caught.value)) < 120


@pytest.mark.parametrize(
    ("difference", "excused"),
    [
        (Difference("says[0].schema", 1, 3), True),
        (Difference("says[0].schema", 3, 1), False),
        (Difference("says[1].common", ABSENT, "ab"), True),
        (Difference("says[1].common", "ab", "cd"), False),
        (Difference("says[0].gossip[1][2][6]", ABSENT, b""), True),
        (Difference("says[0].gossip[1][2]", ABSENT, ["r1"]), False),
        (Difference("says[0].gossip[2][0][7]", ABSENT, b""), True),
        (Difference("says[0].gossip[4]", ABSENT, []), True),
        (Difference("state.signed", ABSENT, False), True),
        (Difference("says[0].gossip[4][1][5]", ABSENT, None), True),
        (Difference("state.verdict", ABSENT, "consistent"), True),
        (Difference("state.battery_v", ABSENT, 14.0), True),
        (Difference("state.battery_v", 14.0, 13.9), False),
        (Difference("state.ladder", ABSENT, 0), True),
        (Difference("state.posterior_m", ABSENT, 1.0), False),
        (Difference("state.posterior_m[0]", 1.0, 1.1), False),
        (Difference("state.posterior_sigma_m", 0.001, 0.002), True),
        (Difference("says[0].cov_m2[5]", 1e-6, 2e-6), True),
        (Difference("state.refused.flood", ABSENT, 1), False),
    ],
)
def test_only_what_the_older_one_lacks_is_excused(difference: Difference, excused: bool) -> None:
    assert must_differ(1, difference) is excused
    assert not must_differ(3, difference)


def test_a_recording_from_before_batteries_were_said_is_told_from_another_behaviour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(record: Record) -> bytes:
        if record.channel != "/raw/step_out":
            return record.data
        outputs = msgpack.unpackb(record.data)
        for name in ("battery_v", "ladder"):
            (outputs["state"] or {}).pop(name, None)
        return msgpack.packb(outputs)

    said = "only what robots say of late"
    old = rewritten(GOLDEN / "three" / "r1.mcap", tmp_path / "r1.mcap", without)
    checked = check([old])
    assert checked.exit_code == 1 and said in text(checked)
    assert set(checked.results[0].fields) == {"state.battery_v", "state.ladder"}
    rows = tmp_path / "ignore.toml"
    row = '[[ignore]]\nfield = "state.{}"\nreason = "not said then"\nsince = "2026-11-25"\n'
    rows.write_text("".join(map(row.format, ("battery_v", "ladder"))))
    assert check([old], rows).exit_code == 0
    monkeypatch.setattr("agent.robot.targets.STATE_NS", 250_000_000)
    assert said not in text(check([old]))


@pytest.mark.usefixtures("undrawn")
def test_every_other_verb_reads_them(tmp_path: Path) -> None:
    shutil.copytree(OLD, tmp_path / "run")
    assert "iteration 15" in explain(OLD / "r1.mcap")
    assert report(tmp_path / "run").stat().st_size > 10_000
    assert [each.frames for each in check_vision([OLD], rerun_vision)] == [0, 0, 0]
    torn = tmp_path / "r1.mcap.active"
    torn.write_bytes((OLD / "r1.mcap").read_bytes()[:22_000])
    copy = recover(torn).out
    assert copy is not None
    assert check([copy]).exit_code == 0
    fleet = overheard_run(OLD, tmp_path / "fleet.mcap")
    assert len(open_run(fleet).timelines) == 3


def test_they_stay_what_they_are(tmp_path: Path) -> None:
    shutil.copytree(OLD, tmp_path / "run")
    with pytest.raises(ConfigError, match="recorded with schema 1; it stays the reference"):
        update_recordings([tmp_path / "run"], "because")
