"""What came of a recorded run, as its report says it: found beside the page, for a long recording takes a while."""

from __future__ import annotations

import asyncio
from pathlib import Path
from threading import Thread

from agent.core.codec import Refusal
from agent.core.config import ConfigError
from agent.ground.page.board import CAME, Board
from agent.ground.page.rows import text
from replay.report.lead.lead import lead
from replay.report.run import open_run
from replay.report.surveyed import surveyed


def show_what_came(path: Path, board: Board, loop: asyncio.AbstractEventLoop) -> None:
    """Show it on the board when it is found. A page that ends before does not wait for it."""

    def find() -> None:
        message = came_of(path)
        if not loop.is_closed():
            loop.call_soon_threadsafe(board.show, CAME, lambda: message)

    Thread(target=find, name="what came of it", daemon=True).start()


def came_of(path: Path) -> str:
    """The page's message: the sentence, the pictures and the table that the report of `path` leads with."""
    try:
        run = open_run(path)
        found = lead(run, surveyed(run.fleet, run.boxes))
    except (ConfigError, Refusal) as error:
        return text({"k": CAME, "said": [["bad", f"What came of it cannot be told: {error}"]], "looks": [], "ends": []})
    looks = [(look.caption, str(look.svg)) for look in found.looks]
    return text({"k": CAME, "said": found.said, "looks": looks, "ends": found.ends.rows})
