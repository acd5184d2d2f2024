"""The terminal, on which a text stands as it was written: rich would take `[focus]` for a colour and drop it."""

from __future__ import annotations

import sys

from rich.console import Console

PIPE_COLUMNS = 140  # a pipe is as wide as our widest table


def plain_console(stderr: bool = False) -> Console:
    """No markup and no emoji by name; lines with paths are not folded."""
    stream = sys.stderr if stderr else sys.stdout
    width = None if stream.isatty() else PIPE_COLUMNS
    return Console(stderr=stderr, soft_wrap=True, width=width, markup=False, emoji=False)
