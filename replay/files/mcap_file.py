"""One MCAP file under construction: its name, its lock, what it says of code and machine, and its records. Reading is
`mcap_walk`'s.

NAME.mcap.active is being written, or its writer was killed; NAME.mcap has been finished and has a summary. Metadata
`aucamp.run` comes first, `aucamp.end` last; without the latter the end was not clean.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import importlib.metadata
import json
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer

from agent.core.config import ConfigError
from replay.files.channels import ATTACHED, BEFORE, Entry, HashedFile, of_attachments, stamped
from replay.files.mcap_walk import last_note

# --- environment ---
# What a recording was made with: code, versions and machine, the first suspects when a replay differs.

PACKAGES = (
    "aucamp",
    "eclipse-zenoh",
    "numpy",
    "opencv-python-headless",
    "numba",
    "torch",
    "msgpack",
    "msgspec",
    "mcap",
)
FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve")  # on which numerical libraries choose their code
THREADS = ("OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
GIT_S = 2.0  # a checkout on a slow network drive is not worth waiting for


@cache
def environment() -> dict[str, str]:
    """Entries for the metadata `aucamp.run`; what cannot be found out is "unknown"."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "libc": " ".join(platform.libc_ver()).strip() or "unknown",
        **_cpu(),
        "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
        **{name: os.environ[name] for name in THREADS if name in os.environ},
        **_checkout(Path(__file__).parents[2]),
        **{f"version.{package}": version(package) for package in PACKAGES},
    }


def version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _cpu() -> dict[str, str]:
    """Model, and those of its instruction sets that decide how floating point is computed (Linux)."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    facts = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    flags = facts.get("flags", facts.get("Features", "")).split()
    return {
        "cpu": facts.get("model name") or platform.processor() or "unknown",
        "cpu.features": " ".join(feature for feature in FEATURES if feature in flags) or "unknown",
    }


def _checkout(root: Path) -> dict[str, str]:
    """Commit, and whether the files differ from it; an installed package has neither."""
    if not (root / ".git").exists():
        return {"commit": "unknown", "dirty": "unknown"}
    commit = _git(root, "rev-parse", "HEAD")
    changes = _git(root, "status", "--porcelain", "--untracked-files=no")
    return {"commit": commit or "unknown", "dirty": "unknown" if changes is None else "yes" if changes else "no"}


def _git(root: Path, *arguments: str) -> str | None:
    # Without optional locks: a robot that starts must not stand in the way of somebody who commits.
    command = ["git", "--no-optional-locks", "-C", str(root), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


# --- file lock ---
# Who is writing a file: its writer holds a lock on it, which the operating system takes back when the writer dies.
#
# So a file with the name of an unfinished one and without a lock is one whose writer was killed, however short ago.
# Where a file system has no locks, nobody seems to be writing.


def hold(file: IO[bytes]) -> None:
    """Mark an open file as being written, until it is closed."""
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX)


def is_held(path: Path) -> bool:
    """Whether a writer is at work on this file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # not there, not ours to read, or no locks
        return False
    return False


# --- names of files ---
# What the files of a recording are called:
#
# * r1.mcap, r1.part002.mcap and so on: a recording and its later parts
# * r1.2.mcap: the same robot, started again in the same folder
# * r1.mcap.active: being written, or its writer was killed
# * r1.recovered.mcap: the mended copy of a torn file, which takes its place

SUFFIX = ".active"
ENDING = re.compile(r"(\.part(\d{3,}))?(\.recovered)?\.mcap(\.active)?$")


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
    taken = firsts(path.parent) if path.parent.is_dir() else []
    while path in taken:
        path = path.with_name(f"{stem}.{number}.mcap")
        number += 1
    return path


def parts(path: Path) -> list[Path]:
    """The files of the recording that begins with `path`, in order. A later part, asked for by name, comes alone.

    Of a part that was torn the mended copy is taken, or else the torn file itself.
    """
    if number_of(path) > 1:
        return [path]
    first = path.with_name(_stem(path).removesuffix(".recovered") + ".mcap")
    found, number = [path if path.exists() else standing(first) or path], 2
    while found[0].exists() and (later := standing(part(first, number))) is not None:
        found.append(later)
        number += 1
    return found


def number_of(path: Path) -> int:
    """Which part of a recording a file is, by its name."""
    match = ENDING.search(path.name)
    return int(match[2]) if match and match[2] else 1


def firsts(folder: Path) -> list[Path]:
    """The recordings in a folder, by what their first parts are called when they are finished, be they there or not."""
    return sorted({folder / ENDING.sub(".mcap", file.name) for file in folder.iterdir() if ENDING.search(file.name)})


def left_out(path: Path) -> str | None:
    """Which part of the recording that begins with `path` is missing, so that later ones are not read, in a line; None:
    none, as far as can be told. Of a later part that was asked for by name nothing is told."""
    if number_of(path) > 1:
        return None
    first = path.with_name(_stem(path).removesuffix(".recovered") + ".mcap")
    there = [file for file in parts(path) if file.exists()]
    missing = part(first, len(there) + 1)
    beside = {part(first, number_of(file)) for file in first.parent.glob(f"{glob.escape(_stem(first))}.part*")}
    found = (standing(each) for each in sorted(beside, key=number_of) if number_of(each) > len(there))
    later = [file.name for file in found if file is not None]
    if later:
        names = later[0] if len(later) == 1 else f"{later[0]} {'and' if len(later) == 2 else 'to'} {later[-1]}"
        return f"{missing} is missing: {names} {'is' if len(later) == 1 else 'are'} left out; put it back there"
    if there and last_note(there[-1]).get("cause") == ROTATED:
        return f"{there[-1]} goes on in {missing.name}, which is not here; put it back there"
    return None


def standing(path: Path) -> Path | None:
    """What there is of `path`: the finished file or the torn one, or the mended copy of it as it is now, or alone."""
    there = next((file for file in (path, active(path)) if file.exists()), None)
    copy = recovered(path)
    return copy if copy.exists() and (there is None or is_of(copy, there)) else there


def is_of(copy: Path, source: Path) -> bool:
    """Whether a mended copy is of all that is in its source now, and of nothing else."""
    return last_note(copy).get("bytes_read") == str(source.stat().st_size)


def _stem(path: Path) -> str:
    return path.name.removesuffix(SUFFIX).removesuffix(".mcap")


# --- a file under construction ---

ROTATED = "rotated"  # cause of the end of a part that another one follows
CHUNK_BYTES = 256 * 1024  # the format's default, 1 MiB, is minutes of telemetry: all lost when the process is killed


class Part:
    """One file under construction. Not for several threads. OSError comes through: the caller knows what to stop."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises ConfigError if it cannot be created, or if there is one already."""
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; give the name of a file in it")
        if is_held(active(path)):
            raise ConfigError(f"{active(path)}: is being written by another process; give another name")
        for taken in (path, active(path)):
            if taken.exists():
                raise ConfigError(f"{taken}: exists already; give another name or move it away")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = active(path).open("xb")
        except OSError as error:
            raise ConfigError(f"{active(path)}: cannot be written: {error.strerror}; give another place") from None
        hold(self._file)
        self.path = path
        self._hashed = HashedFile(self._file)
        out: Any = self._hashed  # as much of a file as a writer needs
        self._writer: Any = Writer(out, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._last: dict[str, int] = {}  # newest sequence number, by channel
        self._sound = 0  # bytes of whole records

    def start(self, run: Mapping[str, object], attachments: Mapping[str, str]) -> None:
        """Write and flush what stands at the head of the file. `attachments` are texts by file name.

        Their digests become entries of the header, in place of those that `run` has.
        """
        self._writer.start(library=f"aucamp {version('aucamp')}; mcap {version('mcap')}")
        facts = {name: value for name, value in run.items() if not name.startswith(ATTACHED)}
        self.note("aucamp.run", {**facts, **of_attachments(attachments)})
        for name, text in attachments.items():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
        self.flush()

    def note(self, name: str, facts: Mapping[str, object]) -> None:
        """Add a metadata record, with a digest of itself."""
        self._writer.add_metadata(name, stamped(name, facts))

    def has_room(self, channel: str, most: int) -> bool:
        """Whether a message on this channel leaves the file with no more than so many channels."""
        return channel in self._channels or len(self._channels) < most

    def add(self, entry: Entry) -> None:
        """Append one message; its channel and schema are registered as they come."""
        channel = self._channels.get(entry.channel)
        if channel is None:
            channel = self._channels[entry.channel] = self._register(entry)
        sequence = entry.sequence % 2**32  # the format's width
        self._writer.add_message(channel, entry.log_time_ns, entry.data, entry.publish_time_ns, sequence)
        self._last[entry.channel] = entry.sequence

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system: what SIGKILL cannot take away any more."""
        self._writer.flush()
        self._sound = self._file.tell()

    def sync(self) -> None:
        """Force everything flushed to the disk: what a power cut cannot take away any more."""
        os.fsync(self._file.fileno())

    def is_gone(self) -> bool:
        """Whether the file was removed, overwritten by another one, or moved away."""
        return os.fstat(self._file.fileno()).st_nlink == 0 or not active(self.path).exists()

    @property
    def bytes(self) -> int:
        """Flushed so far."""
        return self._sound

    def finish(self, last_note: str, facts: Mapping[str, object]) -> None:
        """Write the summary, make it last, and give the file its final name."""
        self._writer.flush()  # messages that still wait stand before the last note, and are in its digest
        self.note(last_note, {**facts, "last_sequence": json.dumps(self._last), BEFORE: self._hashed.before})
        self._writer.finish()
        self._file.flush()
        self.sync()
        self._file.close()
        active(self.path).rename(self.path)
        _sync_directory(self.path.parent)

    def abandon(self) -> None:
        """For a disk that takes no more: cut the file after its last flush; it stays `.active`, unless it is empty."""
        with contextlib.suppress(OSError, ValueError):  # closing flushes, which that disk refuses again
            self._file.close()
        with contextlib.suppress(OSError):  # it went away, or it is finished
            os.truncate(active(self.path), self._sound)
            if not self._sound:
                active(self.path).unlink()

    def _register(self, entry: Entry) -> int:
        schema = 0  # none
        if entry.schema is not None:
            schema = self._schemas.get(entry.schema.name, 0)
        if entry.schema is not None and schema == 0:
            schema = self._writer.register_schema(*entry.schema)
            self._schemas[entry.schema.name] = schema
        return int(self._writer.register_channel(entry.channel, entry.encoding, schema, dict(entry.metadata)))


def _sync_directory(path: Path) -> None:
    """Make a rename last: it is a change of the directory, not of the file."""
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
