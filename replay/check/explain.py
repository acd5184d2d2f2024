"""`aucamp replay explain`: why a robot believed what it believed, iteration by iteration, from its own recording."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from msgspec import UNSET

from agent.core.codec import decode
from agent.core.config import ConfigError
from agent.core.messages import Explain, LampState, LogLine, State
from agent.core.step_io import Outputs, SweepOutcome
from agent.robot.arbiter import NOBODY, priorities
from replay.check.reexecute import STEP_BYTES, open_box, open_boxes
from replay.files.info import suspecting

RULES = {
    "mix": "mixed its own measurement with what its neighbours said",
    "told": "did not measure, and took what its neighbours said",
    "alone": "measured, and heard no neighbour that sees the target",
    "fuse": "joined all that it knows of what robots have measured",
    "hold": "neither measured nor heard a neighbour that sees the target, and kept what it had",
}

OUTCOMES = {  # Explain.status of the protocol `evidence`
    "none": "nobody's measurements are known yet",
    "single": "only one robot's measurements are known, so nobody can contradict it",
    "ok": "all agree",
    "ambiguous": "robots contradict each other, and it cannot be told who is wrong",
    "outlier": "one contradicts the others and is left out",
}


class TooLate(ConfigError):
    """The recording ends before the moment asked for; the message says where."""


class Moment(NamedTuple):
    """The state in which a robot showed the outcome of an iteration, and what it wrote to its log until then."""

    step: int
    seconds: float  # since the first step
    state: State
    before: State | None  # of the iteration before
    log: tuple[LogLine, ...]
    sweeps: tuple[SweepOutcome, ...] = ()  # that ended since then
    held: Mapping[str, Held] = MappingProxyType({})  # who has what, by resource


class Held(NamedTuple):
    """A resource of the robot."""

    holder: str  # a row of the table of priorities
    since_s: float  # since the first step


def explain(path: Path, at: str | None = None) -> str:
    """The iteration that holds a moment of a black box, in sentences, for each target. Raises ConfigError.

    `at`: "16" is an iteration, "12.5s" a time since the first step, "step:812" a step; None: the last iteration.
    """
    with suspecting(path):
        return _explain(path, at)


def _explain(path: Path, at: str | None) -> str:
    box = open_box(path)
    lines, found = [f"{box.robot}, protocol {box.fleet.estimation.protocol}"], False
    late: TooLate | None = None
    for target in box.fleet.target:
        if len(box.fleet.target) > 1:
            lines += ["", f"target {target}"]
        try:
            moment = find(path, at, target)
        except TooLate as error:
            late = error
            lines.append(str(error))
            continue
        found |= moment is not None
        lines += ["no iteration yet"] if moment is None else sentences(moment)
    if not found and late is not None:
        raise late
    if not found:
        raise ConfigError(f"{path}: no iteration at {at or 'its end'}; give --at 16, --at 12.5s or --at step:812")
    return "\n".join(lines)


def find(path: Path, at: str | None, target: str | None = None) -> Moment | None:
    """The moment that `at` names; the last iteration shown before it, where it falls between two.

    `target`: whose iterations; those of the fleet's first one if not given. Raises TooLate, and ConfigError for an
    `at` that is none of the three.
    """
    wanted = _parse(at)
    box, start_ns = open_box(path), 0
    target = target or next(iter(box.fleet.target))
    others = tuple(f"{name}: " for name in box.fleet.target if name != target)
    found: Moment | None = None
    log: list[LogLine] = []
    sweeps: list[SweepOutcome] = []
    held: dict[str, Held] = {}
    for step in box.steps():
        start_ns = start_ns or step.now_ns
        seconds = (step.now_ns - start_ns) * 1e-9
        if found is not None and wanted.over(found.state.t + 1, step.number, seconds):
            break
        if step.outputs is None:
            continue
        outputs = decode(step.outputs, Outputs, limit=STEP_BYTES)
        log += [line for line in outputs.log if not line.text.startswith(others)]
        held |= {grant.resource: Held(grant.holder, seconds) for grant in outputs.grants or ()}
        if outputs.outcome is not UNSET and outputs.outcome.target == target:
            sweeps.append(outputs.outcome)
        state = outputs.state
        if state is None or state.target != target or state.t == 0 or (found is not None and state.t == found.state.t):
            continue
        if wanted.over(state.t, step.number, seconds):
            break
        before = found.state if found else None
        found = Moment(step.number, seconds, state, before, tuple(log), tuple(sweeps), dict(held))
        log, sweeps = [], []
    else:
        if found is not None and at is not None and wanted.after(found.state.t, step.number, seconds):
            reach = f"iterations of '{target}' from 1 to {found.state.t}, steps to {step.number}, {seconds:.1f}s in all"
            raise TooLate(f"--at {at}: {path} has {reach}; choose a moment within")
    return found


class _At(NamedTuple):
    """A moment by one of three scales; the others are infinite."""

    iteration: float = math.inf
    step: float = math.inf
    seconds: float = math.inf

    def over(self, iteration: int, step: int, seconds: float) -> bool:
        """Whether this is later than the moment."""
        passed = self.iteration != math.inf and iteration > self.iteration
        return passed or step > self.step or seconds > self.seconds

    def after(self, iteration: int, step: int, seconds: float) -> bool:
        """Whether the moment is later than this."""
        ends = (iteration, step, seconds)
        return any(end < wanted < math.inf for wanted, end in zip(self, ends, strict=True))


def _parse(at: str | None) -> _At:
    if at is None:
        return _At()
    if match := re.fullmatch(r"step:(\d+)", at):
        return _At(step=int(match[1]))
    if match := re.fullmatch(r"(\d+(?:\.\d+)?)s", at):
        return _At(seconds=float(match[1]))
    if at.isdecimal():
        return _At(iteration=int(at))
    raise ConfigError(f"--at {at}: write an iteration (16), a time (12.5s) or a step (step:812)")


PARTS = "random", "of each robot by itself", "scale of all ranges", "level and survey"  # Explain.parts_m2


def sigma_parts(run: Path) -> list[tuple[str, ...]]:
    """Of what the sigma of each robot of a run is made at its end, in millimetres: robot, target, whole, PARTS; without
    the parts where its protocol does not tell them. Raises ConfigError."""
    rows = []
    for box in open_boxes([run]):
        for target in box.fleet.target:
            with suspecting(box.path):
                moment = find(box.path, None, target)
            if moment is None or moment.state.posterior_sigma_m is None:
                continue
            why = moment.state.explain or Explain()
            parts = () if why.parts_m2 is UNSET else tuple(f"{1e3 * math.sqrt(m2):.2f}" for m2 in why.parts_m2)
            whole = f"{1e3 * moment.state.posterior_sigma_m:.2f}"
            rows.append((box.robot, target, whole, *(parts or ("",) * len(PARTS))))
    if not rows:
        raise ConfigError(f"{run}: no robot knew of a target at its end, so there is no sigma to explain")
    return rows


def sentences(moment: Moment) -> list[str]:
    """What happened in the iteration, most important first."""
    state, before = moment.state, moment.before
    why = state.explain or Explain()
    lines = [
        f"iteration {state.t}, shown at step {moment.step}, {moment.seconds:.2f} s after the first step",
        f"It {RULES.get(state.rule, f'followed the rule {state.rule!r}')}."
        + (f" The outcome is '{why.status}': {OUTCOMES.get(why.status, 'see the protocol')}." if why.status else ""),
        f"It {_knows(state)}.",
    ]
    lines += [_sweep(outcome) for outcome in moment.sweeps]
    if state.prior_m is not None and state.alpha:
        lines.append(f"Its own measurement: {_place(state.prior_m, state.prior_sigma_m)}; alpha {state.alpha:.4f}.")
    if why.nis is not None:
        lines.append(
            f"That measurement's squared distance from the estimate, over its variance: {why.nis:.2f}; 3 is usual."
        )
    lines += _neighbours(state, why)
    lines.append(f"Estimate: {_place(state.posterior_m, state.posterior_sigma_m)}{_moved(state, before)}.")
    if why.parts_m2 is not UNSET:
        parts = zip(PARTS, why.parts_m2, strict=True)
        lines.append(
            f"Its sigma is made of: {', '.join(f'{what} {1e3 * math.sqrt(m2):.2f} mm' for what, m2 in parts)}."
        )
    if why.speed_m_s is not None:
        lines.append(f"It takes the target to move at {1e3 * why.speed_m_s:.1f} mm/s.")
    if why.epoch.counter:
        what = "moving" if why.epoch.moving else "at rest"
        lines.append(f"Epoch {why.epoch.counter}, opened by {why.epoch.proposer}: the target is {what}.")
    if state.behaviour is not UNSET:
        lines.append(f"What it does: {state.behaviour}.")
    if state.lamp is not UNSET:
        lines.append(f"{_lamp(state.robot, state.lamp)}.")
    lines += [_held(resource, held) for resource, held in moment.held.items()]
    lines += [f"Fault: {fault}." for fault in state.faults]
    lines += [f"Refused so far: {count} x {kind}." for kind, count in state.refused.items()]
    lines += [f"log, {line.level}: {line.text}" for line in moment.log]
    return lines


def _sweep(outcome: SweepOutcome) -> str:
    """What came of one sweep of the lens."""
    said = []
    if outcome.lens_position is not None:
        peak = f"peak at lens position {outcome.lens_position:.1f} ± {outcome.sigma:.1f}"
        said.append(f"{peak}, quality {outcome.quality:.3f}")
    if outcome.x_m is not None:
        said.append(f"which puts the target at {_place(outcome.x_m, None)}")
    if outcome.rejected:
        said.append(f"rejected: {outcome.rejected}")
    if outcome.lamps is not UNSET and outcome.lit is not UNSET:
        said.append(f"by the light of {' and '.join(outcome.lamps) or 'nobody'}")
        if outcome.lamps != outcome.lit:
            said.append(f"while that of {' and '.join(outcome.lit) or 'nobody'} burned, as they say")
    return f"Sweep {outcome.sweep}: {', '.join(said)}."


def _lamp(robot: str, lamp: LampState) -> str:
    """Whose light there is, and what the own lamp does."""
    own = f"Its lamp burns at {100 * lamp.power:.0f} %" if lamp.power else "Its lamp is dark"
    if lamp.holder is None:
        return f"{own}; nobody has asked for light"
    lamps = " and ".join(lamp.lamps) or "nobody"
    if lamp.holder != robot:
        return f"{own}, by lease {lamp.lease} of {lamp.holder}, for which {lamps} light"
    what = "asks" if lamp.phase == "asks" else "has the light"
    return f"{own}; by its own lease {lamp.lease} it {what}, of {lamps}"


def _held(resource: str, held: Held) -> str:
    """Who has a resource, since when, and why."""
    if held.holder == NOBODY:
        return f"{resource.capitalize()}: nobody has had it since {held.since_s:.2f} s."
    why = next((row.why for row in priorities() if (row.resource, row.holder) == (resource, held.holder)), "")
    return f"{resource.capitalize()}: '{held.holder}' has had it since {held.since_s:.2f} s{f': {why}' if why else ''}."


def _knows(state: State) -> str:
    if state.knows == "sees":
        return f"sees the target, since iteration {state.acquired_t}, and is in the valid set S"
    return (
        "knows the target from others only and is not in S" if state.knows == "told" else "knows nothing of the target"
    )


def _neighbours(state: State, why: Explain) -> list[str]:
    """Whom it heard, and whose word counts how much.

    With `evidence` these are two things: what a robot has measured counts by whatever way it came, and also while its
    robot is not heard.
    """
    used = [neighbour.robot for neighbour in state.neighbours if neighbour.used]
    by_origin = bool(why.status)
    lines = ["What it heard:" if by_origin else f"Neighbours in S that counted: {', '.join(used) or 'none'}."]
    for n in state.neighbours:
        age_s = why.ages_s.get(n.robot, n.age_s)
        heard = "never heard" if age_s is None else f"{1e3 * age_s:.0f} ms old, {n.heard} heard, {n.gaps} lost"
        said = "sees the target" if n.valid else "does not see it"
        shared = "" if by_origin else _share(n.robot, why)
        lines.append(f"  {n.robot}: {heard}" + ("" if age_s is None else f"; {said}") + shared)
    known = sorted({*why.weights, *why.votes, *why.doubted})
    if by_origin:
        lines.append("Whose measurements are in the estimate:" + ("" if known else " nobody's."))
        for name in known:
            itself = " (itself)" if name == state.robot else ""
            lines.append(f"  {name}{itself}: {_share(name, why).removeprefix('; ')}")
    else:
        others = {n.robot for n in state.neighbours}
        lines += [f"  {name}{_share(name, why)}" for name in why.weights if name not in others]
    return lines


def _share(robot: str, why: Explain) -> str:
    """What one robot's word counted."""
    text = f"; weight {why.weights[robot]:.4f}" if robot in why.weights else ""
    if robot in why.votes:
        text += f"; {why.votes[robot]} agree with it, itself included"
    if robot in why.doubted:
        factor = why.doubted[robot]
        text += "; left out" if factor == 0.0 else f"; counts {factor:.2f} of what it claims"
    if robot in why.sway_m:
        text += f"; without it {1e3 * why.sway_m[robot]:.2f} mm away"
    return text


def _place(x_m: tuple[float, float, float] | None, sigma_m: float | None) -> str:
    if x_m is None:
        return "none"
    return f"({', '.join(f'{1e3 * x:.2f}' for x in x_m)}) mm" + (f" ± {1e3 * sigma_m:.2f} mm" if sigma_m else "")


def _moved(state: State, before: State | None) -> str:
    if before is None or before.posterior_m is None or state.posterior_m is None:
        return ""
    return f", {1e3 * math.dist(before.posterior_m, state.posterior_m):.2f} mm from the one of iteration {before.t}"
