"""What a recording can do to its reader: nothing but make it say, in one line, that it is damaged.

Whoever reads checks what can be checked. What still goes wrong in bytes that no recorder of ours wrote ends here, with
the place in our code that could not go on: if it is the code's mistake and not the file's, that is where to look.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agent.core.codec import Refusal
from agent.core.config import ConfigError

PACKAGE = Path(__file__).parents[2]
MOST = 160  # characters of what was wrong
REMEDY = "take another copy of it, or report this line if its recorder is of this version"


@contextmanager
def suspecting(path: Path) -> Iterator[None]:
    """Raise ConfigError, one line that names the file, for whatever its content does to the code in this block.

    An OSError that names its own file comes through: it is about a disk.
    """
    try:
        yield
    except ConfigError:
        raise
    except Refusal as refusal:
        raise ConfigError(f"{path}: holds a message that is none ({refusal}); {REMEDY}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        said = " ".join(str(error).split())[:MOST]
        what = f"{type(error).__name__}{f': {said}' if said else ''}"
        raise ConfigError(f"{path}: holds what no recorder writes ({what}, in {_place(error)}); {REMEDY}") from error


def _place(error: Exception) -> str:
    """Where in our code it happened: file and line."""
    frames = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    rooms = [PACKAGE / room for room in ("agent", "replay")]
    path, line = [each for each in frames if any(each[0].is_relative_to(room) for room in rooms)][-1]
    return f"{path.relative_to(PACKAGE)}:{line}"
