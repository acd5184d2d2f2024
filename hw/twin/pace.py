"""How fast a dive goes: by a clock that its agents follow, or as fast as every firmware answers, for experiments."""

from __future__ import annotations

import threading

from agent.clock.clock import REST_NS, SERIAL, part_name
from agent.clock.keeper import Keeper
from hw.twin.devices.board import PATIENCE_S, Board
from hw.twin.dive import Dive
from hw.twin.physics.tank import TICK_NS

LOCK_STEP_S = 5.0  # in virtual time a firmware that is silent for longer is taken for dead
UNREAD_NS = 25_000_000  # how long bytes may lie at the agent's end of a cable before time waits for who reads them


def run_by_clock(dive: Dive, keeper: Keeper, stop: threading.Event) -> None:
    """Tick as the keeper lets time go, until stopped."""
    for board in dive.boards:
        reader = part_name(board.robot, SERIAL)
        keeper.limits[f"{board.robot}.port"] = PortLimit(reader, board, dive, keeper)
    while not stop.is_set():
        keeper.advance(dive.now_ns + TICK_NS, stop)
        dive.tick(PATIENCE_S)
        keeper.busy_s = {f"{board.robot}.firmware": s for board, s in zip(dive.boards, dive.answered_s, strict=True)}


class PortLimit:
    """How far time may go before an agent has taken what lies at its end of the cable; anywhere if nobody is there."""

    def __init__(self, part: str, board: Board, dive: Dive, keeper: Keeper) -> None:
        self._part, self._board, self._dive, self._keeper = part, board, dive, keeper
        self._empty_ns = dive.now_ns

    def __call__(self) -> int:
        if not self._keeper.takes_part(self._part):
            return REST_NS
        if not self._board.unread():
            self._empty_ns = self._dive.now_ns
        return self._empty_ns + UNREAD_NS


def run_in_lock_step(dive: Dive, ticks: int) -> None:
    """Tick as fast as every firmware answers. Raises TimeoutError naming one that does not."""
    for _ in range(ticks):
        dive.tick(LOCK_STEP_S)
        for board in dive.boards:
            if board.overdue:
                raise TimeoutError(f"the firmware of {board.robot} did not answer for {LOCK_STEP_S} s")
