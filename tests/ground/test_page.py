"""docs/doctor.md has a row for whatever the doctor names as a cause."""

import errno
import re
from datetime import UTC, datetime

import pytest

from agent.ground.doctor import HANGS, NO_HOST, NO_TLS, OURS, PORT, SILENT, THEIRS, port_cause, theirs
from tests.places import ROOT

PAGE = (ROOT / "docs" / "doctor.md").read_text(encoding="utf-8")
SHOWN = [phrase for row in re.findall(r"^\| (.*?) \| ", PAGE, re.MULTILINE) for phrase in re.findall(r"`([^`]+)`", row)]
CAUSES = (HANGS, NO_HOST, NO_TLS, SILENT, *PORT.values(), *THEIRS.values(), *OURS.values())


@pytest.mark.parametrize("cause", CAUSES)
def test_a_cause_is_on_the_page(cause: str) -> None:
    parts = [[part.strip() for part in phrase.split("…") if part.strip()] for phrase in SHOWN]
    assert any(all(part in cause for part in phrase) for phrase in parts if phrase)


def test_what_no_table_has_is_told_as_the_system_says_it() -> None:
    assert "Permission denied" in port_cause(OSError(errno.EACCES, "Permission denied"))
    assert "new fault" in theirs("new fault", "127.0.0.1", datetime(2026, 1, 1, tzinfo=UTC))
