"""The names of the ways to enhance a picture. The command line reads them before anything else: nothing heavy here."""

from __future__ import annotations

from typing import Literal

Variant = Literal["plain", "folded", "fast", "classic", "auto"]
