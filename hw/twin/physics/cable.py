"""The serial cable between the agent's computer and one control module: a pty behind a path that can vanish.

The twin carries the bytes itself, once a tick, because only who holds the pty's master can pull the cable: when the
master closes, the agent's end hangs up as a USB adapter does.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import sys
import termios
import tty
from pathlib import Path

CHUNK = 65536  # more than a pty holds


class Cable:
    """Plugged in, `path` leads to the agent's end. Bytes for an end that is not there are lost."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._master = self._slave = -1

    @property
    def plugged(self) -> bool:
        return self._master >= 0

    def plug(self) -> None:
        """A new pty at the old path."""
        if self.plugged:
            return
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # one setting for both ends; a cooked pty would echo and rewrite CR and LF
        os.set_blocking(self._master, False)
        # Our own hold on the agent's end keeps its raw mode, and the path good, while no agent has it open.
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if not self.plugged:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def receive(self) -> bytes:
        """What the agent wrote since the last call."""
        if self.plugged:
            with contextlib.suppress(BlockingIOError):
                return os.read(self._master, CHUNK)
        return b""

    def unread(self) -> int:
        """Bytes that the agent's end has not been read of."""
        if not self.plugged:
            return 0
        answer = fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4))
        return int.from_bytes(answer, sys.byteorder)

    def send(self, data: bytes) -> None:
        """Write to the agent; what its buffer does not take is lost, as on a wire that nobody listens to."""
        if self.plugged and data:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)
