"""`aucamp replay check`: whether all robots of a run are reproduced byte for byte, and whether each heard what the
others said. `--update` accepts what the kernel does today.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from agent.clock import machine
from agent.core.codec import Refusal, decode, encode
from agent.core.config import ConfigError
from agent.core.messages import SCHEMA, State, Vector
from agent.core.step_io import OLDER, Outputs
from replay.check.compare import Ignored, load_ignored, only_younger
from replay.check.reexecute import (
    STEP_BYTES,
    BlackBox,
    Divergence,
    Reexecution,
    Step,
    StepsDone,
    open_boxes,
    reexecute,
    says_grants,
    take,
)
from replay.files.channels import STEP_OUT, Entry
from replay.files.info import suspecting
from replay.files.log import info, parts, read
from replay.files.mcap_file import Part, active

# --- who heard whom ---
# Who heard whom: every message that a robot took in must be one that its sender gave out, byte for byte.
#
# One that is not was forged or damaged on the way, or the sender's recording is not whole. The signatures under what
# the sender itself measured are the exception: it puts them there as a message leaves, so its recording is without.


class Link(NamedTuple):
    """Messages from one robot to another over a run."""

    src: str
    dst: str
    said: int | None  # None: the sender left no recording
    heard: int
    unknown: int  # heard, but not among those said
    after_end: int  # of those: sent after the sender's recordings end, so nobody can tell
    least_ns: int | None = None  # of any message, from its sender's clock to its reader's: below 0 these differ


Times = dict[bytes, list[int]]  # a message: each time, ns


class Correspondence:
    """What all robots of a run said and heard, gathered step by step."""

    def __init__(self) -> None:
        self._said: dict[tuple[str, str], Times] = {}  # when, by its sender's clock
        self._heard: dict[tuple[str, str], Times] = {}  # and by its reader's
        self._last_ns: dict[str, int] = {}  # of each robot that left a recording

    def add(self, robot: str, step: Step) -> None:
        """One step of a robot. Raises Refusal for one that holds something else than inputs and outputs."""
        for src, payload in _heard(step.inputs):
            self._heard.setdefault((src, robot), {}).setdefault(as_said(payload, src), []).append(step.now_ns)
        if step.outputs is not None:
            self._last_ns[robot] = max(step.now_ns, self._last_ns.get(robot, 0))
            for dst, payload in _said(step.outputs):
                self._said.setdefault((robot, dst), {}).setdefault(as_said(payload, robot), []).append(step.now_ns)

    def join(self, other: Correspondence) -> None:
        """Take in what another gathered."""
        for ours, theirs in ((self._said, other._said), (self._heard, other._heard)):
            for pair, payloads in theirs.items():
                for payload, times_ns in payloads.items():
                    ours.setdefault(pair, {}).setdefault(payload, []).extend(times_ns)
        for robot, last_ns in other._last_ns.items():
            self._last_ns[robot] = max(last_ns, self._last_ns.get(robot, 0))

    def links(self) -> list[Link]:
        """One for each pair that spoke or heard."""
        return [self._link(src, dst) for src, dst in sorted({*self._said, *self._heard})]

    def _link(self, src: str, dst: str) -> Link:
        said, heard = self._said.get((src, dst), {}), self._heard.get((src, dst), {})
        n_said, n_heard = (sum(map(len, each.values())) for each in (said, heard))
        if src not in self._last_ns:
            return Link(src, dst, None, n_heard, 0, 0)
        more = {payload: len(times_ns) - len(said.get(payload, ())) for payload, times_ns in heard.items()}
        unknown = {payload: count for payload, count in more.items() if count > 0}
        after_end = sum(count for payload, count in unknown.items() if _sent_ns(payload) > self._last_ns[src])
        least_ns = min((min(heard[each]) - min(said[each]) for each in heard.keys() & said.keys()), default=None)
        return Link(src, dst, n_said, n_heard, sum(unknown.values()), after_end, least_ns)


APART_NS = 1_000_000_000  # of two robots' clocks: less may be what messages took


def clocks_apart(links: Iterable[Link]) -> list[str]:
    """Whose clocks differ, a line for each pair: by the fastest message each way, which took as long as the other."""
    least_ns = {(link.src, link.dst): link.least_ns for link in links if link.least_ns is not None}
    found = []
    for a, b in sorted(pair for pair in least_ns if pair[0] < pair[1] and pair[::-1] in least_ns):
        ahead_ns = (least_ns[a, b] - least_ns[b, a]) // 2
        if abs(ahead_ns) > APART_NS:
            fast, slow = (b, a) if ahead_ns > 0 else (a, b)
            by = f"{fast}'s clock is {abs(ahead_ns) * 1e-9:.1f} s ahead of {slow}'s"
            found.append(f"{by}: their times do not compare")
    return found


def links(boxes: Iterable[BlackBox]) -> list[Link]:
    """The links of a run, from the recordings of all starts of its robots."""
    correspondence = Correspondence()
    for box in boxes:
        for step in box.steps():
            correspondence.add(box.robot, step)
    return correspondence.links()


def as_said(payload: bytes, src: str) -> bytes:
    """A message without the signatures of its sender's own word; payloads that are none stay as they are."""
    try:
        message = msgpack.unpackb(payload)
        if "frame" in message:  # capability_messages.Keyframe: the whole of it is one word
            if message["frame"][0] == src:
                message.pop("signature", None)
            return bytes(msgpack.packb(message))
        _, entries, samples, _, proposals = message["gossip"]  # in the order of messages.Gossip
        for said in (*entries, *samples, *proposals):
            if said[0] == src:  # its origin is first; of all parts its signature alone is bytes
                said[:] = [b"" if isinstance(part, bytes) else part for part in said]
        return bytes(msgpack.packb(message))
    except (ValueError, TypeError, LookupError, msgpack.UnpackException, RecursionError):
        return payload


def _heard(inputs: bytes) -> list[tuple[str, bytes]]:
    found = _list(inputs, "heard")
    if not all(isinstance(each.get("src"), str) and isinstance(each.get("payload"), bytes) for each in found):
        raise Refusal("content", "a message heard from nobody")
    return [(each["src"], each["payload"]) for each in found]


def _said(outputs: bytes) -> list[tuple[str, bytes]]:
    """What a step said to whom: its very bytes, which need not be of today's version."""
    found = [each for field in ("says", *OLDER) for each in _list(outputs, field)]
    sent = _list(outputs, "outgoing")
    if not all(isinstance(each.get("dst"), str) for each in found):
        raise Refusal("content", "a message said to nobody")
    if not all(isinstance(each.get("to"), str) and isinstance(each.get("payload"), bytes) for each in sent):
        raise Refusal("content", "a message said to nobody, or no message")
    said = [(each["dst"], bytes(msgpack.packb(each))) for each in found]
    return [*said, *((each["to"], each["payload"]) for each in sent)]


def _list(data: bytes, field: str) -> list[dict[str, Any]]:
    """A field that holds maps, of inputs or outputs. Raises Refusal if it does not."""
    fields = _map(data)
    found = fields.get(field, []) if fields is not None else None
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise Refusal("garbage", f"no step: its '{field}' is no list of messages")
    return found


def _sent_ns(payload: bytes) -> int:
    """The sender's time in a message that nobody vouches for; 0 if it has none."""
    sent_ns = (_map(payload) or {}).get("sent_ns", 0)
    return sent_ns if isinstance(sent_ns, int) else 0


def _map(data: bytes) -> dict[str, Any] | None:
    try:
        fields = msgpack.unpackb(data)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError):
        return None
    return fields if isinstance(fields, dict) else None


# --- recordings side by side ---
# Recordings that are checked side by side, each in a process of its own: no robot's replay needs another's.

WORTH_STEPS = 1500  # of all recordings but the longest: less is done sooner than another process has started
SHOWN_S = 0.2  # between two looks at how far the others are

_done: Synchronized[int] | None = None  # in a process of the pool: steps, counted by all of them


class CheckedBox(NamedTuple):
    """What came of one recording, and who said what to whom in it."""

    result: Reexecution
    correspondence: Correspondence


def check_boxes(boxes: Sequence[BlackBox], rows: Sequence[Ignored], progress: StepsDone) -> list[CheckedBox]:
    """Each of the boxes, in order. Raises ConfigError for one that holds what no recorder writes."""
    spare = sum(box.recorded for box in boxes) - max((box.recorded for box in boxes), default=0)
    processes = min(len(boxes), os.cpu_count() or 1)
    if processes < 2 or spare < WORTH_STEPS:
        return [_check_box(box, rows, progress) for box in boxes]
    context = multiprocessing.get_context("spawn")  # a fork would copy the progress bar's thread in mid-step
    done: Synchronized[int] = context.Value("q", 0)
    with ProcessPoolExecutor(processes, context, _share, (done,)) as pool:
        longest_first = sorted(boxes, key=lambda box: -box.recorded)
        jobs = {box.path: pool.submit(_check_box, box, rows, _count) for box in longest_first}
        shown, due = 0, set(jobs.values())
        while due:
            due = wait(due, SHOWN_S).not_done
            now = done.value
            progress(now - shown)
            shown = now
        return [jobs[box.path].result() for box in boxes]


def _check_box(box: BlackBox, rows: Sequence[Ignored], progress: StepsDone) -> CheckedBox:
    correspondence = Correspondence()
    with suspecting(box.path):
        result = reexecute(box, rows, progress, partial(correspondence.add, box.robot))
    return CheckedBox(result, correspondence)


def _share(done: Synchronized[int]) -> None:
    """First of all in each process of the pool."""
    global _done
    _done = done


def _count(steps: int) -> None:
    assert _done is not None
    with _done.get_lock():
        _done.value += steps


# --- the verdict ---


class Checked(NamedTuple):
    """The verdict on a run. `exit_code` 0: reproduced; 1: it differs; 2: something could not be checked."""

    results: list[Reexecution]
    links: dict[Path, list[Link]]  # by folder: what lies in one folder is one run
    unused: tuple[str, ...]  # rows of the ignore list that covered nothing
    wall_s: float

    @property
    def exit_code(self) -> int:
        if any(each.verdict == "differs" for each in self.results):
            return 1
        return 0 if all(each.passed for each in self.results) else 2

    @property
    def first(self) -> Divergence | None:
        """The earliest of all robots: what came later may be its consequence."""
        found = [each.first for each in self.results if each.first is not None]
        return min(found, key=lambda divergence: divergence.now_ns, default=None)

    @property
    def speed(self) -> float:
        """Times real time: how long each run took, by its longest recording, over the time that checking all took."""
        runs: dict[Path, float] = {}
        for each in self.results:
            runs[each.box.path.parent] = max(each.recorded_s, runs.get(each.box.path.parent, 0.0))
        return sum(runs.values()) / self.wall_s

    def as_json(self) -> dict[str, Any]:
        return {
            "identical": all(each.verdict == "identical" for each in self.results),
            "steps": sum(each.steps for each in self.results),
            "speed_x_realtime": round(self.speed, 1),
            "first_divergence": self.first.as_json() if self.first else None,
            "recordings": [
                {
                    "file": str(each.box.path),
                    "robot": each.box.robot,
                    "incarnation": each.box.incarnation,
                    "verdict": each.verdict,
                    "steps": each.steps,
                    "unchecked": each.unchecked,
                    "recorded_s": round(each.recorded_s, 3),
                    "outputs_sha256": each.digest,
                    "fields": {name: _finite(count._asdict()) for name, count in each.fields.items()},
                    "ignored": each.ignored,
                    "notes": list(each.notes),
                }
                for each in self.results
            ],
            "links": [{"run": str(run), **link._asdict()} for run, found in self.links.items() for link in found],
            "unused_ignore_rows": list(self.unused),
        }


def check(paths: Sequence[Path], ignore: Path | None = None, console: Console | None = None) -> Checked:
    """Replay every black box among files and folders; several starts and parts of a robot belong together.

    `ignore`: a TOML file of fields that may differ. `console` gets a progress bar. Raises ConfigError for input that is
    no recording.
    """
    rows = load_ignored(ignore) if ignore else ()
    started_s = machine.monotonic_s()
    boxes = open_boxes(paths)
    checked = _check_all(boxes, rows, console)
    results = [each.result for each in checked]
    correspondences = {run: Correspondence() for run in sorted({box.path.parent for box in boxes})}
    for result, correspondence in checked:
        correspondences[result.box.path.parent].join(correspondence)
    found = {run: correspondence.links() for run, correspondence in correspondences.items()}
    wall_s = machine.monotonic_s() - started_s
    used: Counter[str] = Counter()
    for each in results:
        used.update(each.ignored)
    unused = tuple(row.field for row in rows if row.field not in used)
    return Checked(results, found, unused, wall_s)


def _check_all(boxes: Sequence[BlackBox], rows: Sequence[Ignored], console: Console | None) -> list[CheckedBox]:
    name, unit = (TextColumn(text, markup=False) for text in ("{task.description}", "steps"))
    columns = (name, BarColumn(), MofNCompleteColumn(), unit)
    shown = console is not None and console.is_terminal  # else it leaves an empty line behind
    with Progress(*columns, TimeElapsedColumn(), console=console, disable=not shown, transient=True) as bar:
        task = bar.add_task(", ".join(box.path.name for box in boxes), total=sum(box.recorded for box in boxes))
        return check_boxes(boxes, rows, partial(bar.advance, task))


def text(checked: Checked) -> str:
    """The verdict for a person, most important last."""
    lines = []
    for each in checked.results:
        lines.append(f"{each.box.path}: {each.verdict}, {each.steps} steps, {each.recorded_s:.1f} s")
        lines += [f"  {note}" for note in each.notes]
        lines += [f"  ignored: {count} x {field}" for field, count in each.ignored.items()]
        lines += _divergence_lines(each)
    lines += [line for found in checked.links.values() for link in found if (line := _link_line(link))]
    lines += [f"ignore list: '{field}' covered nothing; remove the row" for field in checked.unused]
    whole = "identical" if checked.exit_code == 0 else "differs" if checked.exit_code == 1 else "cannot be checked"
    if checked.exit_code == 0 and any(each.verdict != "identical" for each in checked.results):
        whole = "equal within tolerance"
    steps = sum(each.steps for each in checked.results)
    unchecked = sum(each.unchecked for each in checked.results)
    rest = f"; {unchecked} steps could not be checked" if unchecked else ""
    lines.append(f"{whole}: {steps} steps in {checked.wall_s:.2f} s, {checked.speed:.0f} times real time{rest}")
    return "\n".join(lines)


def _divergence_lines(each: Reexecution) -> list[str]:
    if each.first is None:
        return []
    lines = [f"  first at step {each.first.step} of {each.first.robot}, now_ns {each.first.now_ns}:"]
    lines += [f"    {each.first.difference}", "    that step took in:"]
    lines += [f"      {line}" for line in each.first.inputs or ("nothing",)]
    for name, count in sorted(each.fields.items(), key=lambda item: item[1].first):
        worst = f", by at most {count.absolute:.3g} (relative {count.relative:.2g})" if count.absolute < 1e300 else ""
        lines.append(f"  {name}: {count.steps} steps differ, the first is {count.first}{worst}")
    if only_younger(each.fields, each.first.difference):
        lines.append(
            "  only what robots say of late, and did not when this was recorded: accept it, or ignore these fields"
        )
    return lines


def _link_line(link: Link) -> str | None:
    """What is wrong with a link; nothing if all that was heard was said."""
    if link.unknown == 0:
        return None
    line = f"{link.src} -> {link.dst}: {link.unknown} of {link.heard} messages heard were not said"
    if link.after_end == link.unknown:
        return f"{line} in the recording of {link.src}, which ends before them"
    return f"{line} by {link.src}: forged, damaged on the way, or missing from its recording"


def _finite(count: dict[str, Any]) -> dict[str, Any]:
    """JSON has no infinity: null says that the difference is not one of numbers."""
    return {name: None if value == float("inf") else value for name, value in count.items()}


# --- accepting new outputs ---
# `aucamp replay check --update`: what the kernel does today becomes what the recording says, with a reason.
#
# Inputs stay as they were; only outputs are replaced, and the reason is kept in the header. The old file goes last,
# when the new one is whole.

GIT_S = 10.0


class Outcome(NamedTuple):
    """What a recording amounts to."""

    iterations: int
    acquired_t: int | None
    estimate_m: Vector | None
    sigma_m: float | None


class Updated(NamedTuple):
    box: BlackBox
    steps: int  # whose outputs changed
    before: Outcome
    after: Outcome

    def __str__(self) -> str:
        """One row for the person who reviews the change."""
        shown = [f"{self.box.path}: {self.steps} steps changed"]
        for name, before, after in zip(Outcome._fields, self.before, self.after, strict=True):
            same = before == after
            shown.append(f"  {name}: {_text(before)}" + ("" if same else f" -> {_text(after)}"))
        return "\n".join(shown)


def update_recordings(paths: Iterable[Path], reason: str) -> list[Updated]:
    """Rewrite the black boxes that today's kernel does not reproduce; returns those.

    Raises ConfigError without a reason, in a checkout with uncommitted changes, and for a recording that is torn, has
    later parts, lacks steps or is of an older schema: such a one is evidence, not a reference.
    """
    boxes = open_boxes(paths)
    if not reason.strip():
        raise ConfigError("--update needs a reason: one sentence on why the robots now behave differently")
    for box in boxes:
        if box.schema != SCHEMA:
            raise ConfigError(f"{box.path}: recorded with schema {box.schema}; it stays the reference for that one")
        if not box.complete or box.left_out or len(parts(box.path)) > 1:
            raise ConfigError(f"{box.path}: is torn, lacks steps or has later parts; only whole recordings are updated")
    for folder in sorted({box.path.parent for box in boxes}):
        _refuse_dirty(folder)
    updated = []
    for box in boxes:
        with suspecting(box.path):
            result = reexecute(box)
            if result.verdict == "cannot check":
                raise ConfigError(f"{box.path}: {result.notes[-1] if result.notes else 'has no steps'}")
            if result.verdict != "identical" or not says_grants(box):
                updated.append(_rewrite(box, reason.strip()))
    return updated


def _rewrite(box: BlackBox, reason: str) -> Updated:
    about = info(box.path)
    before = outcome(step.outputs for step in box.steps() if step.outputs is not None)
    outputs = list(_replayed(box))
    new = Part(box.path.with_name(f"{box.path.stem}.new.mcap"))
    changed = 0
    try:
        reasons = [about.run["accepted"]] if "accepted" in about.run else []
        new.start({**about.run, "accepted": "; ".join([*reasons, reason])}, about.attachments)
        for record in read(box.path):
            data = record.data
            if record.channel == STEP_OUT.name:
                data = outputs[record.sequence]
                changed += data != record.data
            channel = about.channels[record.channel]
            new.add(
                Entry(
                    record.channel,
                    record.log_time_ns,
                    record.publish_time_ns,
                    record.sequence,
                    data,
                    channel.encoding,
                    channel.metadata,
                )
            )
        new.finish("aucamp.end", {name: value for name, value in about.end.items() if name != "last_sequence"})
    except OSError as error:
        new.abandon()
        active(new.path).unlink(missing_ok=True)
        raise ConfigError(f"{new.path}: cannot be written: {error.strerror}; the old file is as it was") from None
    new.path.replace(box.path)
    return Updated(box, changed, before, outcome(outputs))


def _replayed(box: BlackBox) -> Iterator[bytes]:
    agent = box.agent()
    for step in box.steps():
        yield encode(take(agent, step))


def outcome(outputs: Iterable[bytes]) -> Outcome:
    """What the last state says that the robot showed."""
    last: State | None = None
    for data in outputs:
        last = decode(data, Outputs, limit=STEP_BYTES).state or last
    if last is None:
        return Outcome(0, None, None, None)
    return Outcome(last.t, last.acquired_t, last.posterior_m, last.posterior_sigma_m)


def _refuse_dirty(folder: Path) -> None:
    """A reference must say which commit it belongs to. Outside of a checkout there is nothing to ask."""
    command = ["git", "-C", str(folder), "status", "--porcelain", "--untracked-files=no"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_S)
    except (OSError, subprocess.SubprocessError):
        return
    if done.returncode == 0 and done.stdout.strip():
        raise ConfigError(f"{folder}: the checkout has uncommitted changes; commit the change of behaviour first")


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{1e3 * x:.3f}" for x in value) + ") mm"
    return f"{1e3 * value:.3f} mm" if isinstance(value, float) else str(value)
