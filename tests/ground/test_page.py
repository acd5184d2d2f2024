"""docs/doctor.md has a row for whatever the doctor names as a cause, docs/doubt.md for whatever robots doubt."""

import errno
import re
from collections.abc import Iterator
from datetime import UTC, datetime

import pytest

from agent.capabilities.swim.localizer import CHECK
from agent.core.messages import Explain
from agent.core.verdict import ORDER, Consistency, Ratio
from agent.ground.doctor import HANGS, NO_HOST, NO_TLS, OURS, PORT, SILENT, THEIRS, port_cause, theirs
from tests.places import ROOT


def phrases(page: str) -> list[str]:
    """What stands as code in the first column of its tables."""
    rows = re.findall(r"^\| (.*?) \| ", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.MULTILINE)
    return [phrase for row in rows for phrase in re.findall(r"`([^`]+)`", row)]


def is_told(cause: str, shown: list[str]) -> bool:
    parts = [[part.strip() for part in phrase.split("…") if part.strip()] for phrase in shown]
    return any(all(part in cause for part in phrase) for phrase in parts if phrase)


SHOWN = phrases("doctor.md")
CAUSES = (HANGS, NO_HOST, NO_TLS, SILENT, *PORT.values(), *THEIRS.values(), *OURS.values())


@pytest.mark.parametrize("cause", CAUSES)
def test_a_cause_is_on_the_page(cause: str) -> None:
    assert is_told(cause, SHOWN)


def doubts() -> Iterator[str]:
    """All that a robot says against what it believes."""
    why = Explain(moved_m=(0.06, 0.0, 0.0), stretch=(0.02, 0.002), doubted={"r2": 0.1}, nis=60.0)
    for explain in (why, Explain(doubted={"r1": 0.1}), Explain(status="ambiguous")):
        one = Consistency("r1")
        for k in range(40):
            one.update(explain, False, k * 10**9)
        for k in range(10):
            one.sweep(Ratio(0.03, 1e-6, 1e-6), True, (30 + k) * 10**9)
        yield from one.verdict(39 * 10**9)[1]
    for who, sees, s in (("r1",), (), 9), (("r1",), (), 21), (("r1", "r2"), (), 9), (("r1", "r2"), ("r3",), 0):
        one = Consistency("r1")
        one.missed(dict.fromkeys(who, 5.0), sees, 0, s * 10**9)
        yield from one.verdict(s * 10**9)[1]


def test_whatever_a_robot_doubts_is_on_the_page() -> None:
    said, shown = list(doubts()), phrases("doubt.md")
    assert len({re.sub(r"[\d.]+", "#", cause) for cause in said}) >= 10
    assert not [cause for cause in said if not is_told(cause, shown)]
    assert set(ORDER) <= set(shown)
    assert is_told(f"tags: suspect: 12 % of the frames with tags give no place: {CHECK}", shown)


def test_what_no_table_has_is_told_as_the_system_says_it() -> None:
    assert "Permission denied" in port_cause(OSError(errno.EACCES, "Permission denied"))
    assert "new fault" in theirs("new fault", "127.0.0.1", datetime(2026, 1, 1, tzinfo=UTC))
