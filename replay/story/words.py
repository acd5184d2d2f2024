"""The facts of a dive in one paragraph of plain sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from replay.files.info import Info
from replay.story.facts import MOST

MODES = {"failed": "a fault ended it", "degraded": "something was wrong with it at the end"}


def story(facts: Mapping[str, Any], about: Info) -> str:
    """One paragraph. `about`: the file's own account of itself."""
    return " ".join(_sentences(facts, about))


def _sentences(facts: Mapping[str, Any], about: Info) -> Iterator[str]:
    targets = facts["targets"]
    robots = sorted({robot for target in targets.values() for robot in target["robots"]})
    began = datetime.fromtimestamp(facts["first_ns"] * 1e-9, UTC)
    who = f"{'Robot' if len(robots) == 1 else 'Robots'} {listed(robots)} of the fleet {about.run.get('fleet', '?')}"
    yield f"{who} dived for {facts['lasts_s']:.1f} s from {began:%Y-%m-%d %H:%M:%S} UTC."
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
    if one["told_s"] is not None:
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
        measured = f"from {one['measurements']} measurements of its own" if one["measurements"] else "by others alone"
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


def listed(words: list[str]) -> str:
    """r1, r2 and r3."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
