"""A control module on a desk whose firmware runs in a thread of this process, where a profiler sees it."""

from __future__ import annotations

import importlib
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hw.firmware import failsafe
from tests.hw.desk import Desk
from tests.hw.firmware.bare_board import firmware_main
from tests.hw.firmware.nominal_plant import AIR_PA
from tests.studies.entered import apart


class DeskInside(Desk):
    """As any desk, it turns the board's clock in `tick` alone. The tether is read by who is at `port`."""

    armed = 0  # by the pins, while it is `ticking`

    def __init__(self, directory: Path) -> None:
        super().__init__(sys.executable, directory, {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING})
        self.port = os.ttyname(self.slave)

    def power_on(self) -> None:
        main = firmware_main()
        self.bus, theirs = socket.socketpair()
        self.bus.settimeout(5.0)
        hal = importlib.import_module("hal_unix").Hal(os.dup(self.master), theirs.detach(), str(self.flash_path))
        self._hal, self._firmware = hal, threading.Thread(target=main.serve, args=(hal,), name="firmware")
        self._firmware.start()

    def listen(self) -> None:
        """What the board says is not for the desk."""

    @contextmanager
    def ticking(self) -> Iterator[None]:
        """Board time goes on by itself, about as the wall's, while the block runs."""
        stop = threading.Event()

        def tick() -> None:
            with apart():  # the board's world is not the product
                while not stop.is_set():
                    self.armed = self.tick()[-1]
                    time.sleep(0.008)

        thread = threading.Thread(target=tick, name="board time")
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def close(self) -> None:
        self.bus.close()
        self._firmware.join()
        self._hal._serial.close()
        self._hal._bus.close()
        os.close(self.master)
        os.close(self.slave)
