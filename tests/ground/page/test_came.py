"""What came of a recording, on the page: the very words, pictures and figures of its report."""

import asyncio
import html
import json
import re
import shutil
from pathlib import Path

import pytest

from agent.ground.page.replayed import came_of, show_what_came
from agent.ground.page.rows import Board
from replay.report.report import report
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.page_tables import table


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
