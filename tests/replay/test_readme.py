"""The README of recordings: its example runs."""

import re
import shutil
from pathlib import Path

import pytest

from tests.places import GOLDEN, ROOT

REPLAY = ROOT / "replay"
TEXT = (REPLAY / "README.md").read_text(encoding="utf-8")


def test_the_example_prints_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(GOLDEN / "three", tmp_path / "runs" / "20260101T120000Z")
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    exec(example, {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 320 + 1 and lines[-1] in ("identical", "within tolerance")
    assert any(line.split(maxsplit=1)[1].startswith("State(") for line in lines[:-1])
