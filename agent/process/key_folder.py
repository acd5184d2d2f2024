"""The public keys of a fleet as they lie in a folder, to which people add and from which they remove while robots dive.

To remove a key is to withdraw all that its robot ever said. What a copy in progress or a disk that is gone does to the
folder is not meant so: a key that was good stays until its file is absent from a folder that can be read.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from agent.process.key_files import PUBLIC, UnusableKeyError, public_file, read_public

LOOK_NS = 1_000_000_000  # between two looks


class Found(NamedTuple):
    """What a folder holds of a fleet, by robot."""

    keys: Mapping[str, bytes]  # 32 bytes each
    missing: Sequence[str]
    unusable: Mapping[str, str]  # why


def read_keys(folder: Path, robots: Collection[str]) -> Found:
    """The public keys of these robots. Files of others are none of our business."""
    keys: dict[str, bytes] = {}
    missing: list[str] = []
    unusable: dict[str, str] = {}
    for name in robots:
        path = public_file(folder, name)
        if not path.exists():
            missing.append(name)
            continue
        try:
            key = read_public(path)
        except UnusableKeyError as error:
            unusable[name] = str(error)
            continue
        same = next((other for other, known in keys.items() if known == key), None)
        if same is None:
            keys[name] = key
        else:
            unusable[name] = f"the same key as {same}{PUBLIC}; give each robot its own"
    return Found(keys, missing, unusable)


class KeyFolder:
    """Looks at a folder now and then. `fault`: what a person should mend there, in one line; None: nothing."""

    def __init__(self, folder: Path, robots: Collection[str]) -> None:
        self.fault: str | None = None
        self._folder, self._robots = folder, robots
        self._keys: Mapping[str, bytes] | None = None  # as they were last told
        self._looked_ns: int | None = None

    def changed(self, now_ns: int) -> dict[str, bytes] | None:
        """All public keys, by robot, at the first call and when one was added, changed or removed; else None.

        Looks at the folder at most once a second of the clock that `now_ns` is of.
        """
        if self._looked_ns is not None and now_ns - self._looked_ns < LOOK_NS:
            return None
        self._looked_ns = now_ns
        keys = self._look()
        if keys == self._keys:
            return None
        self._keys = keys
        return dict(keys)

    def _look(self) -> Mapping[str, bytes]:
        before = self._keys or {}
        try:
            found = read_keys(self._folder, self._robots)
            there = self._folder.is_dir()  # asked last: a folder that goes while it is read tells nothing
        except OSError:
            there = False
        if not there:
            self.fault = "their folder cannot be read; those read before are kept"
            return before
        self.fault = "; ".join(_to_mend(found)) or None
        kept = {name: before[name] for name in found.unusable if name in before}
        return {name: key for name in self._robots if (key := found.keys.get(name) or kept.get(name))}


def _to_mend(found: Found) -> list[str]:
    """Without the folder's path: faults are recorded, and a recording says nothing of the machine it is from."""
    lines = [f"{name}{PUBLIC}: {why}" for name, why in found.unusable.items()]
    if found.missing:
        lines.append(f"nothing of {', '.join(found.missing)} is believed without {found.missing[0]}{PUBLIC}")
    return lines
