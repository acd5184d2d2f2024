"""A recording on the page: the same messages as live, at the time that is sought."""

import asyncio
import html
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from threading import Event

import msgspec
import pytest

from agent.core.config import ConfigError, dump
from agent.core.ranging.camera_model import Calibration
from agent.core.topics import IMAGE, LINK, LOG, STATE
from agent.ground.page.replayed import Reel, Replayed, came_of, show_what_came
from agent.ground.page.rows import LINES, Board, Rows
from agent.ground.page.server import hello
from agent.ground.page.server import run as run_page
from replay.files.mcap_file import active, recovered
from replay.report.report import report
from tests.ground.page.shown import FLEET, NOW_NS, image, log, record, row, state
from tests.known_lens import CAMERA, PLAIN
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.page_tables import table
from tests.sample_messages import estimate

S = 1_000_000_000


@pytest.fixture
def reel(tmp_path):
    said = []
    for number in range(100):  # ten seconds of r1's states, a picture and a line each second
        at_ns = NOW_NS + number * S // 10
        said.append((at_ns, row(state(sent_ns=at_ns, t=number), STATE, robot="r1", target="ball")))
        if number % 10 == 0:
            said.append((at_ns, row(image(frame=number, t_ns=at_ns), IMAGE, robot="r1")))
            said.append((at_ns, row(log(text=f"line {number}"), LOG, robot="r1")))
    said.append((NOW_NS + 5 * S, (STATE, {"fleet": "test", "robot": "r2", "target": "ball"}, b"garbage")))
    record(tmp_path / "fleet.mcap", sorted(said, key=lambda one: one[0]))
    with Reel(tmp_path) as found:
        yield found


def shown(board: Board) -> dict[str, object]:
    """What a page that is opened now is sent, by key."""
    viewer, found = board.join(), {}
    for message in board.next_for(viewer):
        if isinstance(message, bytes):
            found["image"] = message
        else:
            fields = json.loads(message)
            found[fields["k"]] = fields
    board.leave(viewer)
    return found


def test_a_row_live_and_replayed_is_the_same_message_to_the_byte(tmp_path) -> None:
    rows = [
        row(state(), STATE, robot="r1", target="ball"),
        row(image("r2"), IMAGE, robot="r2"),
        row(log("r2"), LOG, robot="r2"),
        row(
            estimate("r1", "r2", fleet="test", x_m=(1 / 3, 0.1, 0.2), cov_m2=(1e-6, 0, 0, 1e-6, 0, 1e-6)),
            LINK,
            src="r1",
            dst="r2",
            target="ball",
        ),
    ]
    live = [Rows(FLEET).message(*each, NOW_NS + n) for n, each in enumerate(rows)]
    record(tmp_path / "fleet.mcap", [(NOW_NS + n, each) for n, each in enumerate(rows)])
    with Reel(tmp_path / "fleet.mcap") as reel:
        again = Rows(reel.fleet)
        replayed = [
            again.message(kept.topic, kept.chunks, reel.payload(kept), at_ns)
            for at_ns, kept in reel.between(0, NOW_NS + S)
        ]
    assert replayed == live and len(live) == 4


def test_what_was_newest_at_a_time_is_shown_with_the_lines_and_the_way_there(reel) -> None:
    board = Board()
    replayed = Replayed(reel, board)
    replayed.seek(NOW_NS + 4 * S + S // 20)
    page = shown(board)
    assert page["state/r1/ball"]["t"] == 40
    assert page["state/r1/ball"]["arrived_ms"] == pytest.approx((NOW_NS + 4 * S) * 1e-6, abs=1e-3)
    assert [line["text"] for line in page["lines"]["lines"]] == [f"line {n}" for n in (0, 10, 20, 30, 40)]
    assert page["clock"]["now_ms"] == pytest.approx((NOW_NS + 4.05 * S) * 1e-6)
    assert [past["t"] for past in page["past"]["rows"]] == list(range(0, 41, 5)), "twice a second"
    replayed.seek(NOW_NS)
    assert shown(board)["state/r1/ball"]["t"] == 0
    assert len(shown(board)["lines"]["lines"]) == 1


async def comes(true: Callable[[], bool]) -> None:
    """Wait for it, a minute at most: a machine may be busy."""
    for _ in range(1200):
        if true():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("it does not come")


def test_it_goes_on_only_while_a_page_is_open(reel) -> None:
    board = Board()
    replayed = Replayed(reel, board)

    async def plays() -> None:
        stop = Event()
        running = asyncio.create_task(replayed.run(stop))
        await asyncio.sleep(0.3)
        assert shown(board)["clock"]["now_ms"] == pytest.approx(NOW_NS * 1e-6)
        viewer = board.join()
        await comes(lambda: shown(board)["clock"]["now_ms"] >= (NOW_NS + S // 10) * 1e-6)
        board.leave(viewer)
        await asyncio.sleep(0.5)  # until it has said where it stands
        left_ms = shown(board)["clock"]["now_ms"]
        await asyncio.sleep(0.5)
        assert shown(board)["clock"]["now_ms"] == left_ms
        stop.set()
        await running

    asyncio.run(plays())


def test_it_goes_on_by_itself_faster_or_not_at_all(reel) -> None:
    board = Board()
    replayed = Replayed(reel, board)

    async def plays() -> None:
        stop = Event()
        running, viewer = asyncio.create_task(replayed.run(stop)), board.join()
        await replayed.heard({"play": {"speed": 20.0}})
        await comes(lambda: shown(board).get("state/r1/ball", {}).get("t") == 99)  # of 9.9 s, in half a second
        await comes(lambda: shown(board)["clock"]["rate"] == 0.0)  # at its end it stands
        await replayed.heard({"play": {"at_ms": (NOW_NS + 2 * S) * 1e-6 + 1, "paused": True}})
        await comes(lambda: shown(board)["state/r1/ball"]["t"] == 20)
        for nonsense in ({}, {"play": 7}, {"play": {"speed": "x"}}, {"order": {"robots": ["r1"], "verb": "stop"}}):
            await replayed.heard(nonsense)
        await replayed.heard({"play": {"at_ms": -1e30, "speed": 1e9}})
        assert shown(board)["state/r1/ball"]["t"] == 0
        board.leave(viewer)
        stop.set()
        await running

    asyncio.run(plays())


def test_what_does_not_decode_is_passed_over(reel) -> None:
    board = Board()
    Replayed(reel, board).seek(NOW_NS + 9 * S)
    assert "state/r2/ball" not in shown(board) and board.refused == 1


def test_more_rows_than_can_be_drawn_are_left_out_but_no_line(tmp_path) -> None:
    said = [(NOW_NS + n * 1_000_000, row(state(t=n), STATE, robot="r1", target="ball")) for n in range(100)]
    said += [(NOW_NS + n * 1_000_000, row(log(text=str(n)), LOG, robot="r1")) for n in range(100)]
    record(tmp_path / "fleet.mcap", sorted(said, key=lambda one: one[0]))
    with Reel(tmp_path / "fleet.mcap") as reel:
        kept = [each.topic.message in LINES for _, each in reel.between(0, NOW_NS + S)]
    assert kept.count(True) == 100 and kept.count(False) == 2


def test_what_is_no_recording_of_a_fleet_is_one_line(tmp_path) -> None:
    with pytest.raises(ConfigError, match="no recording of a fleet"):
        Reel(tmp_path)
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    with pytest.raises(ConfigError):
        Reel(tmp_path / "x.mcap")
    (tmp_path / "x.mcap").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"x\.mcap: is empty; give what `aucamp record` wrote$"):
        Reel(tmp_path / "x.mcap")
    with pytest.raises(
        ConfigError, match=r"r1\.mcap: is no recording of a fleet, but one robot's black box; give what"
    ):
        Reel(GOLDEN / "three" / "r1.mcap")


# --- came ---
# What came of a recording, on the page: the very words, pictures and figures of its report.


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(GOLDEN / "outage", tmp_path_factory.mktemp("came") / "run"))
    overheard_run(GOLDEN / "outage", folder / "fleet.mcap")
    return folder


def test_it_is_what_the_report_leads_with(run: Path) -> None:
    message = json.loads(came_of(run))
    page = report(run).read_text(encoding="utf-8")
    (said,) = re.findall(r'<p class="lead">(.*?)</p>', page, re.DOTALL)
    text = html.unescape(re.sub(r"<.*?>\n?", "", said)).replace("\u00a0", " ")
    assert "".join(words for _, words in message["said"]).replace("\u00a0", " ") == text.strip()
    assert "r3 started again" in text
    assert next(kind for kind, _ in message["said"]) == "good" and message["said"][-1][0] == "bad"
    assert len(message["looks"]) == 2 and all(svg in page for _, svg in message["looks"])
    assert message["ends"] == table(page, "ends") and message["ends"][1][0] == "r1"


def test_it_comes_beside_the_page_and_stays_when_another_time_is_sought(run: Path) -> None:
    board = Board()

    async def shown() -> list[str]:
        show_what_came(run, board, asyncio.get_running_loop())
        for _ in range(600):
            await asyncio.sleep(0.1)
            board.start_over()
            viewer = board.join()
            keys = [json.loads(message)["k"] for message in board.next_for(viewer)]
            board.leave(viewer)
            if "came" in keys:
                return keys
        return keys

    assert set(asyncio.run(shown())) == {"came", "over"}


def test_why_it_cannot_be_told_is_said(tmp_path: Path) -> None:
    message = json.loads(came_of(tmp_path))
    assert message["looks"] == message["ends"] == []
    ((kind, text),) = message["said"]
    assert kind == "bad" and text.startswith("What came of it cannot be told: ") and "no recording" in text


def test_a_recording_names_no_calibration_outside_of_its_folder(tmp_path) -> None:
    """A FIFO hangs who opens it, and /dev/zero never ends."""
    os.mkfifo(tmp_path / "pipe")
    whole = Calibration(robot="r1", made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)
    run = tmp_path / "run"
    run.mkdir()
    for folder in (run, tmp_path):
        (folder / "r1.toml").write_text(dump(whole))
    for name, kind, seen in (
        ("r1.toml", "recording", True),
        ("../r1.toml", "recording", False),
        (str(tmp_path / "r1.toml"), "recording", False),
        ("../r1.toml", "live", True),
        ("../pipe", "recording", False),
        ("../pipe", "live", False),
        ("/dev/zero", "recording", False),
        ("/dev/zero", "live", False),
    ):
        robot = msgspec.structs.replace(FLEET.robot["r1"], calibration=name)
        fleet = msgspec.structs.replace(FLEET, robot={**FLEET.robot, "r1": robot})
        found = hello(fleet, kind, run)["robots"][0]
        assert (found["half_view_deg"] is not None) == (found["lens"] is not None) == seen, (name, kind)


def test_a_recording_that_breaks_its_report_is_told_on_the_page(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("agent.ground.page.replayed.open_run", lambda path: {}["x"])
    assert "cannot be told" in json.loads(came_of(tmp_path))["said"][0][1]


def test_a_torn_recording_is_mended_before_it_is_shown(tmp_path, monkeypatch) -> None:
    whole = overheard_run(GOLDEN / "three", tmp_path / "fleet.mcap")
    active(whole).write_bytes(whole.read_bytes()[:-30])
    whole.unlink()
    shown, lines = [], []
    monkeypatch.setattr("agent.ground.page.server.page_of_recording", lambda path, *_: shown.append(path))
    run_page(active(whole), None, 0, tmp_path, Event(), lines.append)
    assert shown == [recovered(whole)]
    assert len(lines) == 1 and "was torn, mended as" in lines[0]
