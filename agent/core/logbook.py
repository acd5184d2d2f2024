"""What the robot writes to its log. A line that could come with every step or every message is thinned, and counted."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.messages import MAX_TEXT, Level, LogLine
from agent.core.savepoint import Revertible

AGAIN_NS = 1_000_000_000  # the same text at most once in this time
SELDOM_NS = 5_000_000_000  # about one subject at most one line in this time, for texts that are never the same


class Held(NamedTuple):
    """A text that was written lately."""

    level: Level
    written_ns: int
    more: int = 0  # how often it came again since, unwritten


class Logbook(Revertible):
    """The lines since they were last fetched, and which texts were written lately."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._lines: list[LogLine] = []
        self._lately: dict[str, Held] = {}
        self._about_ns: dict[str, int] = {}  # subject -> when it last had a line

    def note(self, level: Level, text: str, now_ns: int) -> None:
        """Write a line, or count it when it was written within the last second."""
        text = text[:MAX_TEXT]
        held = self._lately.get(text)
        if held is None:
            self._write(level, text, text, now_ns)
        else:
            self._lately[text] = held._replace(more=held.more + 1)

    def note_seldom(self, level: Level, about: str, text: str, now_ns: int) -> None:
        """A line whose text is another one each time: at most one in five seconds for each subject."""
        last_ns = self._about_ns.get(about)
        if last_ns is None or now_ns - last_ns > SELDOM_NS:
            self._about_ns[about] = now_ns
            self.note(level, text, now_ns)

    def fetch(self, now_ns: int) -> tuple[LogLine, ...]:
        """The lines since the last call; to be called with every step. What was held back for a second comes now."""
        for text, held in tuple(self._lately.items()):
            if now_ns - held.written_ns < AGAIN_NS:
                continue
            del self._lately[text]
            if held.more:
                count = f" ({held.more} times more in {(now_ns - held.written_ns) * 1e-9:.1f} s)" * (held.more > 1)
                self._write(held.level, text, text[: MAX_TEXT - len(count)] + count, now_ns)
        lines, self._lines = tuple(self._lines), []
        return lines

    def _write(self, level: Level, text: str, shown: str, now_ns: int) -> None:
        self._lately[text] = Held(level, now_ns)
        self._lines.append(LogLine(robot=self._robot, sent_ns=now_ns, level=level, text=shown))
