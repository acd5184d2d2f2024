"""The driver's own half of the tether (hw.stm32.protocol), in the virtual time of a dive that goes in lock-step.

It talks to a board of the twin on its real pty, and is called once a tick.
"""

from __future__ import annotations

import contextlib
import os

from agent.core.step_io import SetPoint, Telemetry
from hw.stm32.protocol import HostProtocol
from hw.twin.devices.board import Board
from hw.twin.dive import Dive

SET_POINT_TICKS = 5  # 20 Hz


class Host:
    """The ground computer's half of one tether."""

    def __init__(self, board: Board) -> None:
        self.protocol = HostProtocol(1)
        self.heard: list[Telemetry] = []
        self._path = board.port
        self._port = -1

    def __enter__(self) -> Host:
        self._port = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.protocol.connected()
        self.protocol.arm()
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._port)

    def exchange(self, wanted: SetPoint, dive: Dive) -> None:
        """Take what the board said, say what is due; the set-point in every SET_POINT_TICKS-th tick."""
        now_ns, protocol = dive.now_ns, self.protocol
        with contextlib.suppress(BlockingIOError):  # nothing said since
            protocol.receive(os.read(self._port, 4096), now_ns)
        self.heard += protocol.telemetry
        protocol.telemetry.clear()
        out = protocol.due(now_ns)
        if dive.ticks % SET_POINT_TICKS == 0:
            out += protocol.set_point(wanted, now_ns)
        if out:
            os.write(self._port, out)

    def last_said(self) -> str:
        """The board's last line of text."""
        return self.protocol.lines[-1].text if self.protocol.lines else "nothing heard"
