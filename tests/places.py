"""Where tests find what is no code: the repository itself, the golden logs, data that others made."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden"
DATA = Path(os.environ.get("AUCAMP_DATA", ROOT / ".." / "shared" / "data"))  # absent: what needs it is skipped
