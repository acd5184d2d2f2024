"""What happened in a dive, as one recording has it: as facts for a program, in sentences for a person, and `aucamp
replay info`.

Of a black box they are about its robot, of a fleet file about all whom the recorder heard. Seconds count from the first
state that anybody showed.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import chain, combinations, islice
from pathlib import Path
from typing import Any, NamedTuple

from agent.core import topics
from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import ConfigError
from agent.core.messages import State, Vector
from agent.core.robot_view import in_own_name
from agent.core.status import fault_kind
from agent.core.step_io import Outputs
from replay.check.reexecute import STEP_BYTES
from replay.files.channels import STEP_IN, STEP_OUT, network_topic
from replay.files.info import Info, as_json, describe, info, suspecting
from replay.files.log import read
from replay.files.mcap_file import ENDING, firsts, left_out, parts

MOST = 12  # losses or faults of one robot: more are counted, not told one by one


class RobotFacts:
    """One robot and one target, from the states that the robot shows."""

    def __init__(self) -> None:
        self.starts_s: list[float] = []
        self.knew = False  # already when the recording began
        self.told_s: float | None = None
        self.told_by: list[str] = []
        self.seen_s: float | None = None
        self.seen_t: int | None = None
        self.losses: list[dict[str, float | None]] = []
        self.faults: dict[str, dict[str, Any]] = {}
        self._before: State | None = None

    def show(self, state: State, t_s: float, late: bool) -> None:
        """The next state of this robot about this target; `late`: it had shown others before the recording began."""
        before, self._before = self._before, state
        if before is None or before.incarnation != state.incarnation:
            self.knew |= late and not self.starts_s and state.knows != "blind"
            self.starts_s.append(t_s)
            before = None
        if state.knows == "told" and self.told_s is None and self.seen_s is None:
            self.told_s, self.told_by = t_s, _tellers(state)
        if state.knows == "sees" and self.seen_s is None:
            self.seen_s, self.seen_t = t_s, state.acquired_t
        if before is not None and before.knows == "sees" and state.knows != "sees":
            self.losses.append({"from_s": t_s, "until_s": None})
        if state.knows == "sees" and self.losses and self.losses[-1]["until_s"] is None:
            self.losses[-1]["until_s"] = t_s
        for fault in state.faults:
            about = self.faults.setdefault(fault_kind(fault), {"text": fault, "from_s": t_s})
            about["until_s"] = t_s

    def as_json(self) -> dict[str, Any]:
        last = self._before
        assert last is not None  # there is no robot without a state
        return {
            "starts_s": self.starts_s,
            "knew_before": self.knew,
            "told_s": self.told_s,
            "told_by": self.told_by,
            "seen_s": self.seen_s,
            "seen_iteration": self.seen_t,
            "losses": self.losses,
            "faults": list(self.faults.values()),
            "ended": last.mode,
            "knows": last.knows,
            "iteration": last.t,
            "measurements": last.measurements,
            "estimate_m": last.posterior_m,
            "sigma_m": last.posterior_sigma_m,
            "heard": {other.robot: {"messages": other.heard, "lost": other.gaps} for other in last.neighbours},
            "refused": sum(last.refused.values()),
            "protocol_says": last.explain.status if last.explain is not None else "",
        }


def story_facts(path: Path, start_ns: int | None = None) -> dict[str, Any] | None:
    """The facts of one recording, all of its parts; None where it has no state in it.

    Times count from `start_ns`, when the run began (`began_ns`); None: when this recording did.
    """
    robots: dict[tuple[str, str], RobotFacts] = {}
    late: dict[str, bool] = {}
    own_ns, last_ns = began_ns([path]), 0
    for state in _states(path):
        own_ns = state.sent_ns if own_ns is None else own_ns
        first_ns, last_ns = own_ns if start_ns is None else start_ns, max(last_ns, state.sent_ns)
        facts = robots.setdefault((state.robot, state.target), RobotFacts())
        facts.show(state, (state.sent_ns - first_ns) * 1e-9, late.setdefault(state.robot, state.seq > 0))
    if own_ns is None or not robots:
        return None
    targets: dict[str, dict[str, Any]] = {}
    for (robot, target), facts in sorted(robots.items()):
        targets.setdefault(target, {"robots": {}})["robots"][robot] = facts.as_json()
    for about in targets.values():
        about["apart_m"] = apart_m([facts["estimate_m"] for facts in about["robots"].values() if facts["estimate_m"]])
    return {"first_ns": first_ns, "began_ns": own_ns, "lasts_s": (last_ns - own_ns) * 1e-9, "targets": targets}


def began_ns(paths: Iterable[Path]) -> int | None:
    """When a run began, as its report counts: the first step of any robot; None where no recording has one."""
    steps = ((record.log_time_ns for record in read(path) if record.channel == STEP_IN.name) for path in paths)
    return min((at_ns for each in steps for at_ns in islice(each, 1)), default=None)


def _states(path: Path) -> Iterator[State]:
    """Every state in a black box or a fleet file; what does not decode is passed over."""
    for record in read(path):
        row = network_topic(record.channel)
        try:
            if record.channel == STEP_OUT.name:
                state = decode(record.data, Outputs, STEP_BYTES, READABLE).state
            elif row is not None and row[0] is topics.STATE:
                state = in_own_name(*row, record.data, READABLE)
            else:
                continue
        except Refusal:
            continue
        if state is not None:
            yield state


class Said(NamedTuple):
    """A message of the network as a recording has it."""

    log_time_ns: int
    topic: topics.Topic
    chunks: Mapping[str, str]
    message: Any


def said_in(paths: Iterable[Path], rows: Collection[topics.Topic] = topics.TOPICS) -> Iterator[Said]:
    """What was said on these rows, in the order of the files; what does not decode is passed over."""
    for record in chain.from_iterable(map(read, paths)):
        row = network_topic(record.channel)
        if row is None or row[0] not in rows:
            continue
        with suppress(Refusal):
            message = in_own_name(*row, record.data, READABLE)
            yield Said(record.log_time_ns, *row, message)


def _tellers(state: State) -> list[str]:
    """Whose words the robot's knowledge is made of."""
    weights = state.explain.weights if state.explain is not None else {}
    named = [robot for robot, weight in weights.items() if weight > 0.0 and robot != state.robot]
    return sorted(named or [other.robot for other in state.neighbours if other.used])


def apart_m(places_m: Collection[Vector]) -> float | None:
    """The largest distance between what two robots believe; None of fewer than two."""
    return max((math.dist(a, b) for a, b in combinations(places_m, 2)), default=None)


# --- in sentences ---
# The facts of a dive in one paragraph of plain sentences.

LATE_S = 1.0  # robots are started one after the other
MODES = {"failed": "a fault ended it", "degraded": "something was wrong with it at the end"}


def story(facts: Mapping[str, Any], about: Info) -> str:
    """One paragraph. `about`: the file's own account of itself."""
    return " ".join(_sentences(facts, about))


def _sentences(facts: Mapping[str, Any], about: Info) -> Iterator[str]:
    targets = facts["targets"]
    robots = sorted({robot for target in targets.values() for robot in target["robots"]})
    began = datetime.fromtimestamp(facts["began_ns"] * 1e-9, UTC)
    after_s = (facts["began_ns"] - facts["first_ns"]) * 1e-9
    later = f", {after_s:.1f} s after the run began" if after_s >= LATE_S else ""
    who = f"{'Robot' if len(robots) == 1 else 'Robots'} {listed(robots)} of the fleet {about.run.get('fleet', '?')}"
    yield f"{who} dived for {facts['lasts_s']:.1f} s from {began:%Y-%m-%d %H:%M:%S} UTC{later}."
    for target, of in targets.items():
        for robot, one in of["robots"].items():
            yield from _robot(robot, target, one)
        if of["apart_m"] is not None:
            places = [one["sigma_m"] for one in of["robots"].values() if one["estimate_m"] and one["sigma_m"]]
            sure = f", and state standard deviations of {_range_mm(places)}" if places else ""
            yield f"At the end they place the target {target} within {1e3 * of['apart_m']:.2f} mm of each other{sure}."
    if about.complete or about.recovered:
        mended = "it is the mended copy of a torn one" if about.recovered else "it was finished by its writer"
        yield f"The file is whole: {mended}."
    else:
        yield "The file is not whole: what comes after its tear is not told here."


def _robot(robot: str, target: str, one: Mapping[str, Any]) -> Iterator[str]:
    """What one robot came to know of one target."""
    if one["knew_before"]:
        yield f"{robot} knew of the target {target} already when the recording began."
    elif one["told_s"] is not None:
        by = f" by {listed(one['told_by'])}" if one["told_by"] else ""
        yield f"{robot} was told of the target {target}{by} after {one['told_s']:.1f} s" + (
            f" and saw it itself after {one['seen_s']:.1f} s."
            if one["seen_s"] is not None
            else " and never saw it itself."
        )
    elif one["seen_s"] is not None:
        yield f"{robot} found the target {target} by itself after {one['seen_s']:.1f} s."
    else:
        yield f"{robot} never knew of the target {target}."
    if (again := one["starts_s"][1:]) != []:
        yield f"It started again {_times(again)}."
    if one["losses"]:
        yield f"It lost sight of it {_losses(one['losses'])}."
    for fault in one["faults"][:MOST]:
        when = f"first at {fault['from_s']:.1f} s and last at {fault['until_s']:.1f} s"
        yield f"It had a fault ({fault['text']}), {when}."
    if not one["faults"]:
        yield "It had no faults."
    if len(one["faults"]) > MOST:
        yield f"It had {len(one['faults']) - MOST} more kinds of faults."
    if one["estimate_m"]:
        place = ", ".join(f"{1e3 * x:.1f}" for x in one["estimate_m"])
        sigma = f" ± {1e3 * one['sigma_m']:.1f}" if one["sigma_m"] is not None else ""
        own = one["measurements"]
        measured = f"from {own} measurement{'s' if own > 1 else ''} of its own" if own else "by others alone"
        yield f"In iteration {one['iteration']}, its last, it placed it at ({place}){sigma} mm, {measured}."
    if one["heard"]:
        heard = [f"{other} {of['messages']} times" for other, of in one["heard"].items()]
        lost = sum(of["lost"] for of in one["heard"].values())
        yield f"It heard {listed(heard)}, and {lost or 'none'} of their messages were lost on the way."
    if one["refused"]:
        yield f"It refused {one['refused']} messages."
    if one["ended"] in MODES:
        yield f"Of itself it says that {MODES[one['ended']]}."


def _losses(losses: list[dict[str, float | None]]) -> str:
    if len(losses) > MOST:
        return f"{len(losses)} times"
    told = [
        f"at {loss['from_s']:.1f} s "
        + (f"for {loss['until_s'] - (loss['from_s'] or 0.0):.1f} s" if loss["until_s"] is not None else "for good")
        for loss in losses
    ]
    return listed(told)


def _times(moments_s: list[float]) -> str:
    return listed([f"at {t_s:.1f} s" for t_s in moments_s]) if len(moments_s) <= MOST else f"{len(moments_s)} times"


def _range_mm(values_m: list[float]) -> str:
    least, most = 1e3 * min(values_m), 1e3 * max(values_m)
    return f"{least:.1f} mm" if f"{least:.1f}" == f"{most:.1f}" else f"{least:.1f} to {most:.1f} mm"


def listed(words: Sequence[str]) -> str:
    """r1, r2 and r3."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


# --- the story for a person ---
# `aucamp replay info`: the story of each recording, then what is in its files.

WIDTH = 100  # characters of a line


def info_all(paths: Iterable[Path], json_: bool, say: Callable[[str], None]) -> None:
    """Each file of each recording, later parts included; the story stands with the first. Raises as `info` does.

    A folder stands for the recordings in it, and all that is in them. Raises ConfigError for one that has none.
    """
    recordings = [files for path in paths for files in _recordings(path)]
    boxes = [files[0] for files, _ in recordings]
    for files, missing in recordings:
        for number, file in enumerate(files):
            with suspecting(file):
                about = info(file)
                told = _facts(file, about, boxes) if number == 0 else None
                lacks = missing if number == 0 else None
                text = (_for_programs if json_ else _for_people)(file, about, told, lacks)
            say(text)


def _recordings(path: Path) -> list[tuple[list[Path], str | None]]:
    """The files of each recording: those that are read in their order, and what else there is of it; and what is
    missing."""
    if not path.is_dir():
        return [(parts(path), left_out(path))]
    found = []
    for first in firsts(path):
        read = [file for file in parts(first) if file.exists()]
        of = (file for file in path.iterdir() if ENDING.sub(".mcap", file.name) == first.name)
        found.append(([*read, *sorted(set(of) - set(read))], left_out(first)))
    if not found:
        raise ConfigError(f"{path}: has no recording (.mcap) in it; give the folder of a run, or a recording")
    return found


def _facts(path: Path, about: Info, together: Sequence[Path]) -> dict[str, Any] | None:
    """None of a file that is no recording of ours, or whose header cannot be believed: `describe` says so. Recordings
    of one folder are `together`, and count from one moment."""
    if about.run.get("kind") not in ("black box", "fleet") or about.damage:
        return None
    beside = [other for other in together if other.parent == path.parent]
    return story_facts(path, began_ns(other for other in beside if _is_sound(other)))


def _is_sound(path: Path) -> bool:
    """Whether its beginning can be read."""
    try:
        next(iter(read(path)), None)
    except ConfigError:
        return False
    return True


def _for_people(file: Path, about: Info, facts: dict[str, Any] | None, lacks: str | None) -> str:
    head, _, rest = describe(file, about).partition("\n")
    head += f"\n  {lacks}" if lacks else ""
    if facts is None:
        return f"{head}\n{rest}"
    paragraph = textwrap.fill(story(facts, about), WIDTH, initial_indent="  ", subsequent_indent="  ")
    return f"{head}\n{paragraph}\n\n{rest}"


def _for_programs(file: Path, about: Info, facts: dict[str, Any] | None, lacks: str | None) -> str:
    return json.dumps({**json.loads(as_json(file, about)), "left_out": lacks, "story": facts}, indent=1)
