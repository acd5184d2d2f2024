"""What a recording says of itself as SHA-256, so that a reader notices what was changed after it was written.

The header `aucamp.run` has a digest of itself and of each attachment; every other note has its own. The last note has
one of all bytes before it. A digest is no signature: who writes a whole new file writes new digests into it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import IO

OWN = "sha256"  # entry of a note: digest of its name and its other entries
BEFORE = "sha256.before"  # entry of the last note: of all bytes of the file before that note
ATTACHED = "sha256."  # and the attachment's name: entry of the header


def stamped(name: str, facts: Mapping[str, object]) -> dict[str, str]:
    """The entries of a note as texts, its own digest among them."""
    entries = {key: str(value) for key, value in facts.items() if key != OWN}
    return {**entries, OWN: _digest(name, entries)}


def is_as_written(name: str, entries: Mapping[str, str]) -> bool | None:
    """Whether a note is what its digest says; None: it is older than digests."""
    said = entries.get(OWN)
    if said is None:
        return None
    return said == _digest(name, {key: value for key, value in entries.items() if key != OWN})


def of_attachments(attachments: Mapping[str, str]) -> dict[str, str]:
    """Entries of the header for texts by file name."""
    return {f"{ATTACHED}{name}": sha256(text.encode()).hexdigest() for name, text in attachments.items()}


def attached(run: Mapping[str, str]) -> dict[str, str]:
    """Digests of the attachments by file name, as a header has them."""
    return {key.removeprefix(ATTACHED): value for key, value in run.items() if key.startswith(ATTACHED)}


def _digest(name: str, entries: Mapping[str, str]) -> str:
    return sha256(json.dumps([name, sorted(entries.items())]).encode()).hexdigest()


class HashedFile:
    """A file that is written once from its beginning; `before` is the digest of what was written so far."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._digest = file, sha256()

    def write(self, data: bytes) -> int:
        """Write and take into the digest."""
        self._digest.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._file.tell()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    @property
    def before(self) -> str:
        return self._digest.hexdigest()
