"""One thing that was looked at before a fleet dives, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from agent.core.config import ConfigError
from hw.camera.camera import CameraError

Level = Literal["ok", "warning", "wrong"]


class Finding(NamedTuple):
    level: Level
    about: str  # a robot's name, or the fleet
    text: str  # what was found; unless it is well, what to do about it

    def __str__(self) -> str:
        return f"{self.level:8} {self.about}: {self.text}"


def tried(about: str, attempt: Callable[[], str], otherwise: Level = "wrong") -> Finding:
    """What an attempt says, or why it failed: the words in which an agent would refuse to start."""
    try:
        return Finding("ok", about, attempt())
    except (ConfigError, CameraError) as error:
        return Finding(otherwise, about, str(error))
