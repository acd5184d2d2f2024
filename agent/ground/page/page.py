"""`aucamp page`: a running fleet or a recording, in a browser, until it is ended."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event

from agent.clock.clock import Clock
from agent.core.codec import prepare
from agent.core.config import Fleet
from agent.ground.page.board import Board
from agent.ground.page.hello import hello
from agent.ground.page.live import Give, Live
from agent.ground.page.record import Recording
from agent.ground.page.reel import Reel
from agent.ground.page.replayed import Replayed
from agent.ground.page.rows import text
from agent.ground.page.server import address, new_token, serving
from agent.process.transport import Observer

Say = Callable[[str], None]


def page_of_fleet(
    fleet: Fleet,
    observer: Observer,
    stop: Event,
    clock: Clock,
    port: int,
    say: Say,
    beside: Path | None = None,
    console: str | None = None,
    give: Give | None = None,
    recording: Recording | None = None,
    verbs: Sequence[str] = (),
) -> None:
    """Serve what a fleet shows until `stop` is set. `say` gets the address, for a person.

    `console` and `give`: as whom, and how, orders are given; without them the page reads alone. See `hello` for others.
    """
    board, token = Board(), new_token()
    live = Live(fleet, board, clock, give, recording)
    about = hello(fleet, "live", beside, console, recording is not None, verbs)
    board.show("hello", lambda: text(about))

    async def run() -> None:
        async with serving(board, live.heard, port, token):
            say(address(port, token))
            await live.run(observer, stop)

    try:
        with observer:
            asyncio.run(run())
    finally:
        if recording is not None:
            recording.close()


def page_of_recording(path: Path, stop: Event, port: int, say: Say) -> None:
    """Serve a recording until `stop` is set. Raises ConfigError for a path without one of a fleet."""
    from agent.ground.page.came import show_what_came  # with what draws and counts: a live page needs none of it

    prepare()
    board, token = Board(), new_token()
    with Reel(path) as reel:
        replayed = Replayed(reel, board)
        about = hello(reel.fleet, "recording", reel.file.parent)
        board.show("hello", lambda: text(about))

        async def run() -> None:
            async with serving(board, replayed.heard, port, token):
                show_what_came(path, board, asyncio.get_running_loop())
                say(address(port, token))
                await replayed.run(stop)

        asyncio.run(run())
