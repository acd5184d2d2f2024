"""What the files of a recording are called.

r1.mcap, r1.part002.mcap ...   a recording and its later parts
r1.2.mcap                      the same robot started again in the same folder
r1.mcap.active                 being written, or its writer was killed
r1.recovered.mcap              the mended copy of a torn file
"""

from __future__ import annotations

import re
from pathlib import Path

SUFFIX = ".active"


def active(path: Path) -> Path:
    """The name of `path` while it is being written."""
    return path.with_name(path.name + SUFFIX)


def recovered(path: Path) -> Path:
    """Where the mended copy of a torn file goes."""
    return path.with_name(_stem(path) + ".recovered.mcap")


def part(path: Path, number: int) -> Path:
    """The file of the `number`-th part of the recording `path`; the first has no number in its name."""
    return path if number == 1 else path.with_name(f"{_stem(path)}.part{number:03d}.mcap")


def unused(path: Path) -> Path:
    """`path`, or NAME.2.mcap and so on if it is taken: a robot that starts again keeps what it recorded before."""
    stem, number = _stem(path), 2
    while path.exists() or active(path).exists():
        path = path.with_name(f"{stem}.{number}.mcap")
        number += 1
    return path


def parts(path: Path) -> list[Path]:
    """The files of the recording that begins with `path`, in order. A later part, asked for by name, comes alone.

    Of a part that was not finished the mended copy is taken, or else the torn file itself.
    """
    if re.search(r"\.part\d{3,}$|\.recovered$", _stem(path)):
        return [path]
    first = path.with_name(_stem(path) + ".mcap")
    found, number = [path if path.exists() else standing(first) or path], 2
    while (later := standing(part(first, number))) is not None:
        found.append(later)
        number += 1
    return found


def standing(path: Path) -> Path | None:
    """What there is of `path`: the finished file, its mended copy, or the torn one."""
    return next((file for file in (path, recovered(path), active(path)) if file.exists()), None)


def _stem(path: Path) -> str:
    return path.name.removesuffix(SUFFIX).removesuffix(".mcap")
