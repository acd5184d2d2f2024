"""The truth about creatures, beside that about robots (hw.twin.truth): creatures.csv and, of each frame, boxes.csv.

For who judges a dive, never for an agent. Both stay in the twin's folder until its next dive begins.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hw.twin.creatures.swimmer import Attitude

if TYPE_CHECKING:
    from hw.twin.optics.outline import Outline

CREATURES, BOXES = "creatures.csv", "boxes.csv"
HEAD = "t_ns,creature,x_m,y_m,z_m,heading_rad,pitch_rad"
BOXES_HEAD = "t_ns,robot,frame,creature,x0,y0,x1,y1,pixels,visible"
FLUSH = 20  # looks, a second


class Lookout:
    """Writes where each creature is at each look, and what frames show of them; cameras tell from threads of theirs."""

    def __init__(self, creatures: Sequence[str], folder: Path) -> None:
        self._names, self._looks = list(creatures), 0
        self._paths = (folder / CREATURES).open("w", encoding="utf-8")
        self._boxes = (folder / BOXES).open("w", encoding="utf-8")
        self._paths.write(HEAD + "\n")
        self._boxes.write(BOXES_HEAD + "\n")
        self._lock = threading.Lock()

    def see(self, attitudes: Sequence[Attitude], t_ns: int) -> None:
        """Where the creatures are at t_ns, in the order of the scene."""
        with self._lock:
            if self._paths.closed:
                return
            for name, at in zip(self._names, attitudes, strict=True):
                self._paths.write(f"{t_ns},{name},{','.join(f'{number:.5f}' for number in at[:5])}\n")
            self._looks += 1
            if self._looks % FLUSH == 0:
                self._paths.flush()
                self._boxes.flush()

    def frame(self, robot: str, t_ns: int, number: int, shown: Sequence[Outline]) -> None:
        """What a robot's frame of that number shows, whose exposure had its middle at t_ns."""
        with self._lock:
            if self._boxes.closed:
                return
            for name, box, pixels, visible in shown:
                self._boxes.write(f"{t_ns},{robot},{number},{name},{','.join(map(str, box))},{pixels},{visible}\n")

    def close(self) -> None:
        with self._lock:
            self._paths.close()
            self._boxes.close()
