"""Today's code on yesterday's inputs: the agent is built again, fed every logged step, and its outputs are compared.

Bytes first. Where they differ, the first difference is told with all that went into that step, and all others are
counted by field. On a CPU of another class numerical libraries add up in another order; there, floats may differ by
TOLERANCE, and the verdict says so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from msgspec import UNSET

from agent.clock import machine
from agent.core.capability_messages import Claim, Keyframe, Light
from agent.core.codec import READABLE, Refusal, decode, encode
from agent.core.config import ConfigError, Fleet, convert, parse_toml
from agent.core.messages import SCHEMA, Estimate, Order, Presence
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Heard, Inputs, Ordered
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, NEAR
from agent.core.verbs import arguments, in_words
from agent.robot.step import Agent
from replay.check.compare import ABSENT, Difference, Ignored, differences, must_differ, note, written
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.info import Info, damages, missing_steps, suspecting
from replay.files.log import info, parts, read
from replay.files.mcap_file import environment, left_out
from replay.files.recover import black_boxes, recordings

# --- the black box as arguments ---
# A robot's recording as the argument list it is: what `Agent.step` was called with, and what it answered.
#
# The file says everything that a fresh `Agent` needs: fleet file and calibration as attachments, robot and
# incarnation in its header. Between the steps nothing else reaches the kernel, so nothing else is read here.

T = TypeVar("T")

NEEDED = "give the black box of a robot: the <robot>.mcap that its agent wrote"
DIGITS = 20  # of a number in a header that is repeated in a line for people
STEP_BYTES = 4 * 1024 * 1024  # limit of one step: this is the robot's own file, not a stranger's message


class Step(NamedTuple):
    number: int
    now_ns: int
    inputs: bytes
    outputs: bytes | None  # None: they are not in the file


class BlackBox(NamedTuple):
    """One start of one robot."""

    path: Path
    robot: str
    incarnation: int
    fleet: Fleet
    calibration: Calibration
    run: dict[str, str]  # the header
    recorded: int  # steps in the file, sound or not
    complete: bool  # finished by its writer, nothing torn
    schema: int = SCHEMA  # of its messages
    retired: tuple[str, ...] = ()  # settings of its fleet file that there are no more, and that were in force
    left_out: tuple[str, ...] = ()  # what of it is not read, a line each

    def agent(self) -> Agent:
        """The robot's agent as it was before its first step."""
        return Agent(self.fleet, self.robot, self.calibration, self.incarnation, schema=self.schema)

    def steps(self) -> Iterator[Step]:
        """The steps in the order they were taken, up to the first that is missing: later ones build on it."""
        waiting: Step | None = None
        expected = 0
        for record in read(self.path):
            if record.channel == STEP_IN.name:
                if waiting is not None:
                    yield waiting
                if record.sequence != expected:
                    return
                waiting = Step(record.sequence, record.log_time_ns, record.data, None)
                expected += 1
            elif record.channel == STEP_OUT.name and waiting is not None and record.sequence == waiting.number:
                yield waiting._replace(outputs=record.data)
                waiting = None
        if waiting is not None:
            yield waiting


def open_boxes(paths: Iterable[Path]) -> list[BlackBox]:
    """The black boxes among files and folders, by folder, robot and start; later parts come with their first one.

    Raises ConfigError if there is none, or if one of them cannot be replayed by this version.
    """
    found = []
    for path in paths:
        files = black_boxes(path) if path.is_dir() else [path]
        if not files:
            has = "only the recording of a fleet" if recordings(path, "fleet") else "no recording (.mcap)"
            raise ConfigError(f"{path}: has {has} in it; {NEEDED}, or the folder of a run with some")
        found += [open_box(file) for file in files]
    return sorted(found, key=lambda box: (str(box.path.parent), box.robot, box.incarnation))


def open_box(path: Path) -> BlackBox:
    """Read the header of a black box. Raises ConfigError as `open_boxes` does."""
    with suspecting(path):
        return _open_box(path)


def _open_box(path: Path) -> BlackBox:
    heads = [head(file) for file in parts(path)]
    run, attachments = heads[0].run, heads[0].attachments
    if run.get("kind") != "black box":
        raise ConfigError(f"{other_kind(path, run, 'black box')}; {NEEDED}")
    schema = schema_of(path, run)
    needs = [name for name in ("robot", "incarnation") if name not in run]
    needs += [name for name in ("fleet.toml", "calibration.toml") if name not in attachments]
    if needs:
        raise ConfigError(f"{path}: has no {needs[0]}, so its agent cannot be built again; record with this version")
    if (part := run.get("part", "1")) != "1":
        raise ConfigError(f"{path}: is part {part[:DIGITS]}, and its steps build on those before; give the first part")
    fleet = attached_toml(path, "fleet.toml", attachments, Fleet)
    if run["robot"] not in fleet.robot or not run["incarnation"].isdecimal():
        raise ConfigError(f"{path}: damaged: its header names no robot of its fleet, or no start; take another copy")
    return BlackBox(
        path=path,
        robot=run["robot"],
        incarnation=int(run["incarnation"]),
        fleet=fleet,
        calibration=attached_toml(path, "calibration.toml", attachments, Calibration),
        run=run,
        recorded=sum(each.steps for each in heads),
        complete=all(each.complete for each in heads),
        schema=schema,
        retired=retire(parse_toml(attachments["fleet.toml"], path)),
        left_out=tuple(_left_out(path, [each.about for each in heads])),
    )


def _left_out(path: Path, files: Sequence[Info]) -> Iterator[str]:
    if (line := left_out(path)) is not None:
        yield line
    if (line := missing_steps(files)) is not None:
        yield f"{path.name}: {line}"


KINDS = {"fleet": "the recording of a fleet, which holds no inputs of a robot", "black box": "one robot's black box"}


def other_kind(path: Path, run: Mapping[str, str], wanted: str) -> str:
    """Which file is not what is wanted, and what it is instead, by its header."""
    if not path.stat().st_size:
        return f"{path}: is empty"
    kind = KINDS.get(run.get("kind", ""))
    return f"{path}: is no {wanted}{f', but {kind}' if kind else ''}"


def schema_of(path: Path, run: Mapping[str, str]) -> int:
    """The schema of a recording's messages, by its header. Raises ConfigError if we cannot read it."""
    schema = run.get("schema", str(SCHEMA))
    if schema not in map(str, READABLE):
        said = schema[:DIGITS]
        raise ConfigError(f"{path}: message schema {said}, ours is {SCHEMA}; replay it with the version it names")
    return int(schema)


RETIRED = (("lighting", "follow"),)  # table and setting of fleet files that older recordings hold


def retire(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Take such settings out of a file that was read; returns those that were in force."""
    tables = ((data.get(table), table, setting) for table, setting in RETIRED)
    return tuple(
        f"[{table}] {setting}" for held, table, setting in tables if isinstance(held, dict) and held.pop(setting, None)
    )


def attached_toml(path: Path, name: str, attachments: Mapping[str, str], kind: type[T]) -> T:
    """An attachment as the struct it holds, without settings that there are no more. Raises ConfigError, one line."""
    try:
        data = parse_toml(attachments[name], path / name)
    except ConfigError:
        raise ConfigError(f"{path}: damaged: {name} in it is no TOML; take another copy of the file") from None
    retire(data)
    return convert(data, kind, path / name)


class Head(NamedTuple):
    """What is needed of one file before its messages are read."""

    run: dict[str, str]
    attachments: dict[str, str]
    steps: int
    complete: bool
    about: Info


def head(file: Path) -> Head:
    """What a file says of itself, after a walk through all of it. Raises ConfigError where it is not as it was written.

    A torn file is not refused: what is before the tear is sound.
    """
    about = info(file)
    if about.damage:
        lasts = any(each.lasts for each in about.damage)
        remedy = "take another copy of it" if lasts else "`aucamp replay recover` makes a sound copy; open that one"
        raise ConfigError(f"{file}: damaged: {damages(about.damage)}; {remedy}")
    if about.torn and not about.run and about.channels:
        raise ConfigError(f"{file}: damaged: its header cannot be read; take another copy of it")
    steps = about.channels[STEP_IN.name].messages if STEP_IN.name in about.channels else 0
    return Head(about.run, about.attachments, steps, about.complete, about)


# --- re-execution ---

TOLERANCE = 1e-9  # relative or absolute: a thousand times what rounding leaves, a millionth of what a measurement means
# Entries of the header that decide how floats are added up. Two models with the same features differ by an ULP.
CPU_CLASS = ("machine", "cpu", "cpu.features")
SHOWN = ("python", "commit", "dirty", *CPU_CLASS, "blas", "version.aucamp", "version.numpy", "version.msgspec")

Verdict = Literal["identical", "within tolerance", "differs", "cannot check"]
StepsDone = Callable[[int], None]  # called with the number of steps done since the last call


class FieldCount(NamedTuple):
    """How one field differs over a whole recording."""

    steps: int = 0
    first: int = 0  # step
    absolute: float = 0.0  # the worst; infinite: not a difference of numbers
    relative: float = 0.0


class Divergence(NamedTuple):
    """The first step that came out differently."""

    robot: str
    step: int
    now_ns: int
    difference: Difference
    inputs: tuple[str, ...]  # what went into that step, a line each

    def as_json(self) -> dict[str, Any]:
        field, recorded, replayed = self.difference
        return {
            "robot": self.robot,
            "step": self.step,
            "now_ns": self.now_ns,
            "field": field,
            "recorded": written(recorded),
            "replayed": written(replayed),
            "text": str(self.difference),
            "inputs": list(self.inputs),
        }


class Reexecution(NamedTuple):
    """What came of one recording."""

    box: BlackBox
    verdict: Verdict
    steps: int  # compared
    recorded_s: float  # that they took when they were recorded
    first: Divergence | None
    fields: dict[str, FieldCount]
    ignored: dict[str, int]  # differences that rows of the ignore list covered, by row
    notes: tuple[str, ...]  # what a reader of the verdict must know
    digest: str  # of all replayed outputs

    @property
    def unchecked(self) -> int:
        """Steps that are in the file and were not compared."""
        return max(0, self.box.recorded - self.steps)

    @property
    def passed(self) -> bool:
        return self.verdict in ("identical", "within tolerance")


def reexecute(
    box: BlackBox,
    ignored: Sequence[Ignored] = (),
    progress: StepsDone = lambda steps: None,
    watch: Callable[[Step], None] = lambda step: None,
) -> Reexecution:
    """Replay one recording from its first step to its last sound one; `watch` is shown each step as it was recorded."""
    agent = box.agent()
    tolerance = TOLERANCE if other_cpu(box) else 0.0
    tally = Tally(box.robot, ignored, tolerance, box.schema, says_grants(box))
    digest = sha256()
    start_ns = now_ns = 0
    reported_s = machine.monotonic_s()
    taken = reported = 0
    for step in box.steps():
        start_ns, now_ns, taken = start_ns or step.now_ns, step.now_ns, taken + 1
        try:
            watch(step)
            outputs = encode(take(agent, step))
        except Refusal as refusal:
            return unreadable(box, step, str(refusal))
        except Exception as error:  # noqa: BLE001 - whatever today's kernel raises is a difference to report
            tally.raised(step, error)
            break
        digest.update(outputs)
        tally.compare(step, outputs)
        if machine.monotonic_s() - reported_s > 0.1:
            progress(taken - reported)
            reported, reported_s = taken, machine.monotonic_s()
    progress(taken - reported)
    notes = (*environment_notes(box), *range_notes(box, taken, tally))
    verdict: Verdict = "cannot check" if tally.compared == 0 and tally.first is None else tally.verdict
    seconds = (now_ns - start_ns) * 1e-9
    return Reexecution(
        box, verdict, tally.compared, seconds, tally.first, tally.fields, dict(tally.ignored), notes, digest.hexdigest()
    )


def take(agent: Agent, step: Step) -> Any:
    """One step of the replayed agent. Raises Refusal if the inputs are not of this version."""
    return agent.step(decode(step.inputs, Inputs, limit=STEP_BYTES), step.now_ns)


class Tally:
    """Compares step by step and keeps the count."""

    def __init__(
        self, robot: str, ignored: Sequence[Ignored], tolerance: float, schema: int = SCHEMA, grants: bool = True
    ) -> None:
        """grants: it was recorded who has camera, body and lamp."""
        self._robot, self._rows, self._tolerance, self._schema = robot, ignored, tolerance, schema
        self.grants = grants
        self.compared = 0
        self.last = -1  # step compared
        self.silent: int | None = None  # the first step without recorded outputs
        self.first: Divergence | None = None
        self.fields: dict[str, FieldCount] = {}
        self.ignored: Counter[str] = Counter()
        self._within = False  # some float differed by less than the tolerance

    @property
    def verdict(self) -> Verdict:
        if self.first is not None:
            return "differs"
        return "within tolerance" if self._within else "identical"

    def compare(self, step: Step, outputs: bytes) -> None:
        if step.outputs is None:
            self.silent = step.number if self.silent is None else self.silent
            return
        self.compared, self.last = self.compared + 1, step.number
        counted: set[str] = set()
        for difference in differences(step.outputs, outputs):
            if not self.grants and difference.recorded is ABSENT and difference.plain.startswith("grants"):
                continue
            row = next((row for row in self._rows if row.covers(difference)), None)
            if must_differ(self._schema, difference):
                continue
            if row is not None:
                self.ignored[row.field] += 1
            elif min(difference.size) <= self._tolerance and _floats(difference):
                self._within = True
            else:
                self._count(step, difference, difference.plain not in counted)
                counted.add(difference.plain)

    def raised(self, step: Step, error: Exception) -> None:
        """The replayed kernel failed where the recorded one went on, or died in the same step."""
        if step.outputs is not None:
            self._count(step, Difference("step", "outputs", f"raised {type(error).__name__}: {error}"), True)

    def _count(self, step: Step, difference: Difference, new_step: bool) -> None:
        if self.first is None:
            self.first = Divergence(self._robot, step.number, step.now_ns, difference, describe_inputs(step))
        absolute, relative = difference.size
        old = self.fields.get(difference.plain, FieldCount(first=step.number))
        self.fields[difference.plain] = old._replace(
            steps=old.steps + new_step, absolute=max(old.absolute, absolute), relative=max(old.relative, relative)
        )


def _floats(difference: Difference) -> bool:
    return isinstance(difference.recorded, float) and isinstance(difference.replayed, float)


def unreadable(box: BlackBox, step: Step, why: str) -> Reexecution:
    refused = f"step {step.number} is not of this version ({why}); replay it with the version it names"
    return Reexecution(box, "cannot check", 0, 0.0, None, {}, {}, (*environment_notes(box), refused), "")


def says_grants(box: BlackBox) -> bool:
    """Whether it was recorded who has camera, body and lamp: all is granted in the first step that does not hold."""
    recorded = (step.outputs for step in box.steps() if step.outputs is not None)
    first = next(recorded, None)
    return first is None or b"grants" in first or any(b"grants" in outputs for outputs in recorded)


def other_cpu(box: BlackBox) -> bool:
    """Whether it was recorded on a CPU that may round differently; unknown counts as the same."""
    here = environment()
    return any(box.run.get(name, here[name]) != here[name] for name in CPU_CLASS)


def environment_notes(box: BlackBox) -> list[str]:
    """Where code, versions or machine are not those of the recording: the reason to replay, or the first suspect."""
    here = environment()
    changed = [
        f"{name} {box.run[name]} -> {here.get(name, 'none')}"
        for name in SHOWN
        if name in box.run and box.run[name] != here.get(name)
    ]
    notes = [f"recorded elsewhere: {', '.join(changed)}"] if changed else []
    notes += [older] if (older := note(box.schema)) is not None else []
    notes += [f"recorded with {setting}, which there is no more: a robot does not repeat it" for setting in box.retired]
    if other_cpu(box):
        notes.append(f"another class of CPU: floats may differ by {TOLERANCE:g}, relative or absolute")
    return notes


def range_notes(box: BlackBox, taken: int, tally: Tally) -> list[str]:
    """Which part of the recording the verdict is about, where it is not all of it."""
    notes = []
    if not tally.grants:
        notes.append("recorded before robots said who has camera, body and lamp: compared but for it")
    broken = tally.first is not None and tally.first.difference.field == "step"
    if taken < box.recorded and not broken:
        notes.append(f"steps are missing after step {taken - 1}: {box.recorded - taken} later ones cannot be checked")
    if not box.complete:
        notes.append(f"not finished by its writer: checked up to step {tally.last}")
    if (missing := left_out(box.path)) is not None:
        notes.append(missing)
    if (silent := taken - tally.compared - broken) > 0:
        later = "" if silent == 1 else f" and {silent - 1} more"
        notes.append(f"the outputs of step {tally.silent}{later} are not in the file")
    return notes


def heard_words(heard: Heard) -> str:
    """What a neighbour said. Raises Refusal if that is not of this version."""
    if heard.topic == NEAR.name:
        p = decode(heard.payload, Presence, accepted=READABLE)
        return f"seq {p.seq}, it is at ({p.x_m:.3f}, {p.y_m:.3f}) m"
    if heard.topic == CLAIM.name:
        c = decode(heard.payload, Claim, accepted=READABLE)
        return f"seq {c.seq}, it knows {100 * c.share:.0f} % of what is wanted"
    if heard.topic == KEYFRAME.name:
        k = decode(heard.payload, Keyframe, accepted=READABLE).frame
        return f"keyframe {k.number} of {k.origin}"
    if heard.topic == LIGHT.name:
        said = decode(heard.payload, Light, accepted=READABLE)
        asks = "" if said.lease is UNSET else f", lease {said.lease.number}{'' if said.lease.granted else ' asked for'}"
        return f"seq {said.seq}, its lamp at {100 * said.lamp.power:.0f} %{asks}"
    e = decode(heard.payload, Estimate, accepted=READABLE)
    return f"seq {e.seq}, iteration {e.t}, {'sees' if e.valid else 'does not see'} the target"


def order_words(ordered: Ordered) -> str:
    """What somebody ordered."""
    try:
        order = decode(ordered.payload, Order, accepted=READABLE)
        return in_words(order.verb, arguments(order.verb, order.args))
    except Refusal as refusal:
        return f"refused: {refusal}"


def describe_inputs(step: Step) -> tuple[str, ...]:
    """A line for each thing that went into a step: what, how old in ms, how large."""

    def age(then_ns: int) -> str:
        return f"{(step.now_ns - then_ns) * 1e-6:.1f} ms old"

    inputs = decode(step.inputs, Inputs, limit=STEP_BYTES)
    lines = [f"telemetry, {age(t.t_ns)}: depth {t.depth_m:.4f} m" for t in inputs.telemetry]
    for s in inputs.sightings:
        what = f"clarity {s.clarity}" if s.found else "target not found"
        lines.append(f"sighting, {age(s.t_ns)}: frame {s.frame}, sweep {s.sweep}[{s.index}], focus {s.focus}, {what}")
    for heard in inputs.heard:
        try:
            what = heard_words(heard)
        except Refusal as refusal:
            what = f"refused: {refusal}"
        lines.append(f"heard from {heard.src}, {age(heard.arrived_ns)}, {len(heard.payload)} bytes: {what}")
    lines += [
        f"order of {o.console}, {age(o.arrived_ns)}, {len(o.payload)} bytes: {order_words(o)}"
        for o in inputs.orders or ()
    ]
    lines += [f"refused by transport: {r.count} x {r.reason}" for r in inputs.refused]
    return tuple(lines)
