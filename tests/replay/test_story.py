"""The story of a dive: what happened is in it, and what did not is not."""

import json
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError
from agent.core.messages import Message, State
from replay.files.info import info
from replay.files.recover import auto_recovered
from replay.report.timeline import open_run
from replay.story import info_all, listed, story, story_facts
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run


def told(path: Path) -> str:
    facts = story_facts(path)
    assert facts is not None
    return story(facts, info(path))


def test_who_told_whom_and_what_came_of_it() -> None:
    text = told(GOLDEN / "outage" / "r2.mcap")
    assert text.startswith("Robot r2 of the fleet tank dived for 21.8 s from 2026-01-01 00:00:00 UTC.")
    assert "r2 was told of the target ball by r1 after 5.0 s and saw it itself after 8.6 s." in text
    assert "it placed it at (760.0, 560.0, 70.0) ± 3.4 mm, from 14 measurements of its own." in text
    assert text.endswith("The file is whole: it was finished by its writer.")
    assert "found the target ball by itself after 4.6 s." in told(GOLDEN / "outage" / "r1.mcap")


def test_a_robot_that_never_knew_and_a_torn_file() -> None:
    assert "The file is not whole" in told(GOLDEN / "torn" / "r1.mcap.active")
    (robot,) = (story_facts(GOLDEN / "empty" / "r1.mcap") or {})["targets"]["ball"]["robots"].values()
    assert robot["estimate_m"] is None or robot["knows"] != "blind"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of r1 to r3, of which r2 loses sight of the ball for a second and r3 has a fault."""

    def change(message: Message) -> Message:
        if isinstance(message, State) and message.robot == "r2" and 60 <= message.seq < 65:
            return replace(message, knows="told")
        if isinstance(message, State) and message.robot == "r3" and 30 <= message.seq < 35:
            return replace(message, faults=("camera: none",))
        return message

    return overheard_run(GOLDEN / "outage", tmp_path_factory.mktemp("fleet") / "fleet.mcap", change)


def test_of_a_fleet_all_robots_and_what_they_agreed_on(fleet: Path) -> None:
    text = told(fleet)
    assert text.startswith("Robots r1, r2 and r3 of the fleet tank dived for")
    assert "It lost sight of it at 11.8 s for 1.0 s." in text
    assert "It had a fault (camera: none), first at 5.8 s and last at 20.6 s." in text
    assert "It started again at 14.0 s." in text  # r3
    assert "At the end they place the target ball within 0.0" in text
    assert text.count("It had no faults.") == 2


def test_info_tells_it_and_programs_get_the_same_facts(fleet: Path) -> None:
    plain = CliRunner().invoke(app, ["replay", "info", str(fleet)])
    assert plain.exit_code == 0
    assert " ".join(told(fleet).split()) in " ".join(plain.output.split())
    programs = json.loads(CliRunner().invoke(app, ["replay", "info", "--json", str(fleet)]).output)
    assert programs["story"] == json.loads(json.dumps(story_facts(fleet)))
    lost = programs["story"]["targets"]["ball"]["robots"]["r2"]["losses"]
    assert [round(loss["until_s"] - loss["from_s"], 3) for loss in lost] == [1.0]


def test_a_folder_stands_for_its_recordings_and_one_without_is_refused(tmp_path: Path) -> None:
    lines: list[str] = []
    info_all([GOLDEN / "outage"], False, lines.append)
    assert [line.splitlines()[0].rpartition("/")[2] for line in lines] == ["r1.mcap", "r2.mcap", "r3.2.mcap", "r3.mcap"]
    with pytest.raises(ConfigError, match=r"has no recording \(\.mcap\) in it"):
        info_all([tmp_path], False, lines.append)
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        info_all([tmp_path / "nowhere" / "r1.mcap"], False, lines.append)


def test_a_robot_that_started_again_is_told_by_its_own_times() -> None:
    lines: list[str] = []
    info_all([GOLDEN / "outage"], False, lines.append)
    again = " ".join(next(line for line in lines if "r3.2.mcap" in line.splitlines()[0]).split())
    assert "dived for 8.0 s from 2026-01-01 00:00:14 UTC, 14.0 s after the run began." in again


def test_what_was_known_before_the_recording_began_was_not_found_in_it(tmp_path: Path) -> None:
    def late(message: Message) -> Message | None:
        return None if message.sent_ns < 1_767_225_600_000_000_000 + 15 * 10**9 else message

    text = told(overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap", late))
    assert "r1 knew of the target ball already when the recording began." in text
    assert "after 0.0 s" not in text


def test_a_torn_file_and_its_mended_copy_are_one_dive(tmp_path: Path) -> None:
    shutil.copy(GOLDEN / "torn" / "r1.mcap.active", tmp_path)
    auto_recovered([tmp_path], lambda line: None)
    lines: list[str] = []
    info_all([tmp_path], False, lines.append)
    assert [line.splitlines()[0].rpartition("/")[2] for line in lines] == ["r1.recovered.mcap", "r1.mcap.active"]
    assert ["dived for" in line for line in lines] == [True, False]


def test_words_are_listed_as_people_do() -> None:
    assert [listed(words) for words in ([], ["r1"], ["r1", "r2"], ["r1", "r2", "r3"])] == [
        "", "r1", "r1 and r2", "r1, r2 and r3",
    ]  # fmt: skip


def test_an_event_has_one_time_in_the_info_of_a_run_and_in_its_report() -> None:
    """Robots start one after the other; all count from the first step of any."""
    run = open_run(GOLDEN / "outage")
    files: dict[str, str] = {}
    info_all([GOLDEN / "outage"], True, lambda text: files.update({json.loads(text)["file"]: text}))
    told = {}
    for text in files.values():
        for robot, facts in json.loads(text)["story"]["targets"]["ball"]["robots"].items():
            told[robot] = facts["seen_s"]
    seen = {
        timeline.robot: next((t_s for t_s, state in timeline.states if state.knows == "sees"), None)
        for timeline in run.about("ball")
    }
    assert len(told) == len(seen) > 1
    for robot, seen_s in seen.items():
        assert told[robot] == (None if seen_s is None else pytest.approx(seen_s, abs=0.06)), robot
