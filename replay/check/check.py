"""`aucamp replay check`: are all robots of a run reproduced byte for byte, and did each hear what the others said?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from agent.clock import machine
from replay.check.black_box import BlackBox, open_boxes
from replay.check.compare import Ignored, load_ignored
from replay.check.links import Correspondence, Link
from replay.check.older import only_younger
from replay.check.reexecute import Divergence, Reexecution
from replay.check.side_by_side import CheckedBox, check_boxes


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
