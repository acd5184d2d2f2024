"""Mends a torn recording: copies all that is sound into a new file with a summary, and says what was lost. Agents,
recorders and readers do so unasked.

A file tears when its writer is killed, the power fails, the disk fills up or a copy breaks off. It is never changed
itself. A black box is cut behind its last whole step; inputs without their outputs, perhaps of the very step that ended
the process, are kept on a channel of their own.
"""

from __future__ import annotations

import json
import logging
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Thread
from typing import NamedTuple

from agent.clock import machine
from agent.core.config import ConfigError
from replay.files.channels import CUT, STEP_IN, STEP_OUT, Entry
from replay.files.channels import Schema as ChannelSchema
from replay.files.info import Info, damages, info, missing_steps, suspecting
from replay.files.mcap_file import (
    SUFFIX,
    Part,
    active,
    firsts,
    is_held,
    is_of,
    left_out,
    parts,
    recovered,
    standing,
)
from replay.files.mcap_walk import DAMAGED, OURS, Channel, Damage, Message, Schema, Tear, last_note, records, run_note


class Recovered(NamedTuple):
    """What became of one file."""

    source: Path
    out: Path | None  # the mended copy; None: the file is whole, or empty, and nothing was written
    messages: dict[str, int]  # kept, by channel
    bytes_read: int
    bytes_lost: int  # written, but cannot be believed
    tears: int
    last_step: int | None  # of a black box: the last one with inputs and outputs
    cut_step: int | None  # a step with inputs alone, kept on the channel CUT
    last_ns: int | None  # newest log time that was kept
    nameless: int = 0  # messages that are lost because what they are about is
    damage: tuple[Damage, ...] = ()  # what was whole, but not as it was written

    @property
    def lossy(self) -> bool:
        return self.bytes_lost > 0 or self.cut_step is not None or self.nameless > 0

    @property
    def summary(self) -> str:
        """One line for a person."""
        if not self.messages:
            return "holds no message, nothing to save"
        if self.out is None and not self.damage:
            return "whole, nothing to mend"
        kept = f"{sum(self.messages.values())} messages kept"
        if self.last_step is not None:
            kept += f" up to step {self.last_step}"
        lost = f"{self.bytes_lost} of {self.bytes_read} bytes lost at {self.tears} places" if self.bytes_lost else ""
        cut = f"step {self.cut_step} has no outputs" if self.cut_step is not None else ""
        nameless = f"{self.nameless} messages lost with the name of their channel" if self.nameless else ""
        damage = f"damaged: {damages(self.damage)}" if self.damage else ""
        unwritten = "what its writer had not yet flushed, less than a second, is not in it"
        if lost or damage:
            unwritten = ""
        return "; ".join(part for part in (kept, lost, nameless, cut, damage, unwritten) if part)


def recover(path: Path, force: bool = False) -> Recovered:
    """Write the mended copy of a torn file beside it, as NAME.recovered.mcap; a whole file is left alone.

    A damage that lies in what was recorded is in the copy, too, and the copy says so. A copy of less of the same file
    is replaced. Raises ConfigError if the file cannot be read or is no recording, is still being written (unless
    `force`), or if there is another copy already.
    """
    about = info(path)
    size = path.stat().st_size
    whole = about.complete or (about.recovered and not about.torn and not about.damage)
    if whole or not about.channels:
        counts = {name: channel.messages for name, channel in about.channels.items()}
        return Recovered(path, None, counts, size, 0, 0, None, None, None)
    if not force and is_held(path):
        raise ConfigError(f"{path}: still being written; end its writer first, or give --force for what is in it now")
    half_done = active(recovered(path))
    if half_done.exists() and not is_held(half_done):
        half_done.unlink()  # of a recovery that was broken off; the torn file itself is as it was
    if _is_outgrown(recovered(path), about, size):
        recovered(path).unlink()  # all that is in it is in the file
    part = Part(recovered(path))
    walk = _Walk(path)
    try:
        part.start(about.run, about.attachments)
        for when, sample in about.clock.items():
            part.note(f"aucamp.clock.{when}", sample)
        for entry in walk.entries():
            part.add(entry)
        result = walk.result(part.path, size, about)
        lasting = "; ".join(each.what for each in about.damage if each.lasts)
        if not about.run and (not about.library or about.library.startswith(OURS)):
            lasting = lasting or "its header could not be read"
        facts = {
            **({"cause": about.end["cause"]} if "cause" in about.end else {}),
            **({DAMAGED: lasting} if lasting else {}),
            "source": path.name,
            "summary": result.summary,
            "messages": json.dumps(result.messages),
            **{
                name: getattr(result, name) for name in ("bytes_read", "bytes_lost", "last_step", "cut_step", "last_ns")
            },
        }
        part.finish("aucamp.recovered", facts)
    except OSError as error:
        part.abandon()
        active(part.path).unlink(missing_ok=True)  # half a copy is no use, and takes the room that is missing
        raise ConfigError(f"{part.path}: cannot be written: {error.strerror}; make room there") from None
    return result


def _is_outgrown(copy: Path, about: Info, size: int) -> bool:
    """Whether a mended copy is of the beginning of the file that `about` is of, when that was shorter."""
    if not copy.is_file():
        return False
    old = info(copy)
    said = old.recovered.get("bytes_read", "")
    begun = (old.run, old.clock.get("start")) == (about.run, about.clock.get("start"))
    return begun and bool(about.run) and said.isdecimal() and int(said) < size


def sound(path: Path, say: Callable[[str], None]) -> Path:
    """The file to open for `path`: itself, or its mended copy, which is made now if there is none of it as it is now.

    `say` gets one line about what was lost. A file that is being written, or whose folder cannot be written, is opened
    as it is: reading ends at the tear. Raises ConfigError as `info` does.
    """
    return _sound(path, say)[0]


def _sound(path: Path, say: Callable[[str], None]) -> tuple[Path, Info]:
    """The same, and what is in that file."""
    there = path if path.exists() else standing(path) or path
    about = info(there)
    if (about.end and not about.torn) or about.recovered or is_held(there):
        if about.recovered:
            say(f"{there}: {about.recovered.get('summary', '')}")
        elif is_held(there):
            say(f"{there}: still being written; what is in it by now is read")
        return there, about
    if recovered(there).exists() and is_of(recovered(there), there):
        return _sound(recovered(there), say)
    try:
        with suspecting(there):
            result = recover(there)
    except ConfigError as error:
        say(str(error))
        return there, about
    if result.out is None:
        say(f"{there}: {result.summary}")
        return there, about
    say(f"{there} was torn, mended as {result.out}: {result.summary}")
    return result.out, info(result.out)


class _Walk:
    """One pass through a torn file, in which steps without outputs are held back."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: Counter[str] = Counter()
        self._bytes_lost = self._tears = self._nameless = 0
        self._last_step: int | None = None
        self._cut: Entry | None = None
        self._last_ns: int | None = None

    def entries(self) -> Iterator[Entry]:
        """What belongs into the copy, in order."""
        held: list[Entry] = []  # since a step's inputs: they count when its outputs come
        for entry in self._messages():
            self._last_ns = max(entry.log_time_ns, self._last_ns or 0)
            if entry.channel == STEP_IN.name and not held:
                held.append(entry)
            elif entry.channel == STEP_OUT.name and held and held[0].sequence == entry.sequence:
                self._last_step = entry.sequence
                yield from self._counted([*held, entry])
                held = []
            elif held and entry.channel != STEP_IN.name:
                held.append(entry)
            elif held:  # the outputs of the step before are missing
                yield from self._counted(self._without_step(held))
                held = [entry]
            else:
                yield from self._counted([entry])
        yield from self._counted(self._without_step(held))

    def result(self, out: Path, size: int, about: Info) -> Recovered:
        return Recovered(
            source=self._path,
            out=out,
            messages=dict(self._counts),
            bytes_read=size,
            bytes_lost=self._bytes_lost,
            tears=self._tears,
            last_step=self._last_step,
            cut_step=self._cut.sequence if self._cut else None,
            last_ns=self._last_ns,
            nameless=self._nameless,
            damage=about.damage,
        )

    def _without_step(self, held: list[Entry]) -> list[Entry]:
        if not held:
            return []
        self._cut = held[0]._replace(channel=CUT.name)
        return [self._cut, *held[1:]]

    def _counted(self, entries: list[Entry]) -> list[Entry]:
        self._counts.update(entry.channel for entry in entries)
        return entries

    def _messages(self) -> Iterator[Entry]:
        schemas: dict[int, ChannelSchema] = {}
        channels: dict[int, Channel] = {}
        for record in records(self._path):
            match record:
                case Schema():
                    schemas[record.id] = ChannelSchema(record.name, record.encoding, record.data)
                case Channel():
                    channels[record.id] = record
                case Message() if record.channel_id in channels:
                    about = channels[record.channel_id]
                    yield Entry(
                        about.topic,
                        record.log_time,
                        record.publish_time,
                        record.sequence,
                        record.data,
                        about.message_encoding,
                        about.metadata,
                        schemas.get(about.schema_id),
                    )
                case Message():
                    self._nameless += 1
                case Tear() | Damage():
                    self._bytes_lost += record.bytes
                    self._tears += record.bytes > 0


def recover_all(paths: Iterable[Path], force: bool, say: Callable[[str], None]) -> int:
    """`aucamp replay recover`: one line for each file. Exit code 0: each is whole now; 1: in one there was nothing."""
    code = 0
    for path in paths:
        if (mended := _mended_already(path)) is not None:
            say(f"{path} -> {recovered(path)}: mended already; {mended}")
            continue
        with suspecting(path):
            result = recover(path, force)
        say(f"{path}{f' -> {result.out}' if result.out else ''}: {result.summary}")
        code = code if result.messages else 1
    return code


def _mended_already(path: Path) -> str | None:
    """What the mended copy of a file as it is now says; None: there is none."""
    copy = recovered(path)
    return last_note(copy).get("summary") if path.is_file() and copy.is_file() and is_of(copy, path) else None


# --- the recordings of a folder ---


def black_boxes(folder: Path) -> list[Path]:
    """The black boxes in a folder by their first part, whether finished, mended or torn; of several of one start of a
    robot, which are copies, the largest."""
    return recordings(folder, "black box")


def recordings(folder: Path, kind: str) -> list[Path]:
    """The recordings of a kind in a folder, "black box" or "fleet", as `black_boxes` does."""
    return sorted(copies[0] for copies in _starts(folder, kind))


def _starts(folder: Path, kind: str) -> list[list[Path]]:
    """Recordings of a kind, those of one start of a robot together, the largest first."""
    starts: dict[object, list[Path]] = {}
    for first in firsts(folder):
        there = standing(first)
        run = {} if there is None else _run(there)
        if run.get("kind") == kind:
            start = tuple(run.get(name, "") for name in ("fleet", "robot", "incarnation"))
            mended = there == recovered(first)
            starts.setdefault(start if kind == "black box" and all(start) else first, []).append(
                recovered(first) if mended else first
            )
    return [sorted(copies, key=_size, reverse=True) for copies in starts.values()]


def _size(first: Path) -> int:
    return sum(file.stat().st_size for file in parts(first))


def fleet_recordings(folder: Path) -> list[list[Path]]:
    """The recordings of a fleet in a folder, the largest first. Each is one or more: NAME, and NAME.2 and so on of a
    recorder that was started again."""
    found: dict[str, list[tuple[int, Path]]] = {}
    for path in recordings(folder, "fleet"):
        name = path.name.removesuffix(".mcap").removesuffix(".recovered")
        again = re.fullmatch(r"(.+)\.(\d+)", name)
        found.setdefault(again[1] if again else name, []).append((int(again[2]) if again else 1, path))
    chains = [[path for _, path in sorted(chain)] for _, chain in sorted(found.items())]
    return sorted(chains, key=lambda chain: sum(map(_size, chain)), reverse=True)


def _run(file: Path) -> dict[str, str]:
    """What the header of a file says. Raises ConfigError for a finished file that has lost it, and for the mended copy
    of one: it may be any."""
    run, is_sound = run_note(file)
    if "kind" not in run and file.suffix == ".mcap" and (not (run or is_sound) or last_note(file).get(DAMAGED)):
        raise ConfigError(f"{file}: damaged: its header cannot be read; move it away to do without it")
    return run


# --- unasked ---
# Recordings whose writer was killed are mended without being asked: by who starts again, and by who opens them.
#
# A robot that starts has better things to do than to read half a gigabyte, so that is left to a process of its own,
# at low priority. What cannot be mended is said, and nothing else happens.

logger = logging.getLogger(__name__)

PAUSE_S = 3.0  # who has just started needs the machine for itself

Say = Callable[[str], None]


def auto_recovered(paths: Iterable[Path], say: Say) -> list[Path]:
    """What to open for each of some folders and files, after their torn files were mended; a line for each of those.

    In a folder, and for later parts, the mended copy stands in for the torn file by its name.
    """
    found = []
    for path in paths:
        if path.is_dir():
            _mend_all_in(path, say)
            found.append(path)
        else:
            there = dict(_sound(file, say) for file in parts(path))
            found.append(next(iter(there)))
            _tell_left_out(found[-1], list(there.values()), say)
    return found


def _mend_all_in(folder: Path, say: Say) -> None:
    """Mend what is torn in a folder, and say which of its files are not read."""
    copies = {recovered(file) for file in folder.glob("*.mcap*")}
    half_done = {active(copy) for copy in copies}
    there: dict[Path, Info] = {}
    for file in sorted({*folder.glob("*.mcap"), *folder.glob(f"*.mcap{SUFFIX}")} - copies - half_done):
        read, about = _sound(file, say)
        there[read] = about
        if read == file and recovered(file).exists():
            if is_of(recovered(file), file):
                what = "damaged" if about.damage else "whole; move it away"
                say(f"{recovered(file)} is read in place of {file}, which is {what}")
            else:
                say(f"{recovered(file)} is not of {file} as it is now, and is left out; move it away")
    for first in firsts(folder):
        files = [file for file in parts(first) if file.exists()]
        _tell_left_out((files or [first])[0], [there.get(file) or info(file) for file in files], say)
    for kept, *others in _starts(folder, "black box"):
        for other in others:
            say(f"{other} is of the same start of the same robot as {kept}, which is larger; it is left out")
    kept, *others = [chain[0] for chain in fleet_recordings(folder)] or [folder]
    for other in others:
        say(f"{other} is another recording of the fleet than {kept}, which is larger; give it alone to see it")
    _tell_apart(there.values(), folder, say)


def _tell_left_out(first: Path, files: Sequence[Info], say: Say) -> None:
    """Say what of a recording is not read: later parts, or steps."""
    if (line := left_out(first)) is not None:
        say(line)
    if (line := missing_steps(files)) is not None:
        say(f"{first}: {line}")


def _tell_apart(files: Iterable[Info], folder: Path, say: Say) -> None:
    """Say which robots were recorded while no other was: their recordings are of another dive, or their clock was."""
    spans: dict[str, tuple[int, int]] = {}
    for about in files:
        steps, robot = about.channels.get(STEP_IN.name), about.run.get("robot")
        if steps is not None and robot is not None:
            first_ns, last_ns = spans.get(robot, (steps.first_ns, steps.last_ns))
            spans[robot] = min(first_ns, steps.first_ns), max(last_ns, steps.last_ns)
    for robot, (first_ns, last_ns) in spans.items():
        others = [span for name, span in spans.items() if name != robot]
        if others and all(last_ns < first or last < first_ns for first, last in others):
            began = datetime.fromtimestamp(first_ns * 1e-9, UTC)
            say(
                f"{folder}: {robot} was recorded from {began:%Y-%m-%d %H:%M:%S} UTC, while no other robot was; "
                "if that is another dive, move its recording away"
            )


def broken_off(path: Path) -> list[Path]:
    """Torn files of the recording `path`, of its parts and of earlier starts."""
    name = re.compile(re.escape(path.name.removesuffix(".mcap")) + r"(\.\d+)?(\.part\d{3,})?\.mcap" + re.escape(SUFFIX))
    if not path.parent.is_dir():
        return []
    return sorted(file for file in path.parent.iterdir() if name.fullmatch(file.name) and not is_held(file))


def torn_files(path: Path) -> list[Path]:
    """Those that nobody has mended yet."""
    return [file for file in broken_off(path) if not recovered(file).exists()]


@contextmanager
def recovering(files: Sequence[Path], say: Say = logger.warning, pause_s: float = PAUSE_S) -> Iterator[None]:
    """Mend these files meanwhile, in a process that gives way to all others; `say` gets a line for each.

    Not before `pause_s` have passed. What is not done at the end is left to the next start.
    """
    stop = Event()
    worker = Thread(target=_mend, args=(files, say, pause_s, stop), name="recovering", daemon=True)
    if files:
        worker.start()
    try:
        yield
    finally:
        stop.set()
        if files:
            worker.join()


def _mend(files: Sequence[Path], say: Say, pause_s: float, stop: Event) -> None:
    gentle = ["nice", "-n", "19"] if shutil.which("nice") else []
    machine.wait(stop, pause_s)
    for file in files:
        if stop.is_set():
            return
        command = [*gentle, sys.executable, "-m", "agent", "replay", "recover", str(file)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
            while process.poll() is None:
                if machine.wait(stop, 0.1):
                    process.terminate()
                    break
            said = process.communicate()[0].strip()
        if said:
            say(said.splitlines()[-1])
