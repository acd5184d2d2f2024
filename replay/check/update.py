"""`aucamp replay check --update`: what the kernel does today becomes what the recording says, with a reason.

Inputs stay as they were; only outputs are replaced, and the reason is kept in the header. The old file goes last, when
the new one is whole.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from agent.core.codec import decode, encode
from agent.core.config import ConfigError
from agent.core.messages import SCHEMA, State, Vector
from agent.core.step_io import Outputs
from replay.check.black_box import STEP_BYTES, BlackBox, open_boxes
from replay.check.reexecute import reexecute, take
from replay.files.backlog import Entry
from replay.files.channels import STEP_OUT
from replay.files.log import info, parts, read
from replay.files.mcap_file import Part
from replay.files.names import active
from replay.files.suspect import suspecting

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
        raise ConfigError("--update needs --reason: one sentence on why the robots now behave differently")
    for box in boxes:
        if box.schema != SCHEMA:
            raise ConfigError(f"{box.path}: recorded with schema {box.schema}; it stays the reference for that one")
        if not box.complete or len(list(box.steps())) < box.recorded or len(parts(box.path)) > 1:
            raise ConfigError(f"{box.path}: is torn, lacks steps or has later parts; only whole recordings are updated")
    for folder in sorted({box.path.parent for box in boxes}):
        _refuse_dirty(folder)
    updated = []
    for box in boxes:
        with suspecting(box.path):
            result = reexecute(box)
            if result.verdict == "cannot check":
                raise ConfigError(f"{box.path}: {result.notes[-1] if result.notes else 'has no steps'}")
            if result.verdict != "identical":
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
