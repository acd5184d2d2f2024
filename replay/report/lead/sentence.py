"""What came of a run, in one sentence: who found what, when, how surely, and what went wrong. Pure."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Literal, NamedTuple

from replay.report.lead.outcome import EARLY_S, Found, Outcome, Survey

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
ENDINGS = {"ended": "{} ended", "torn": "the recording of {} breaks off", "silent": "{} fell silent"}
UNBROKEN = "\u00a0"  # a space at which no line ends
UNIT = re.compile(r"(?<=±) | (?=(?:mm|s|min|%)(?:\W|$))")  # the space between a number and what it counts


class Part(NamedTuple):
    """A piece of the sentence; all of them one after the other are it."""

    kind: Literal["", "good", "bad"]
    text: str


def sentence(about: Outcome) -> list[Part]:
    """First what came of it, then what went wrong."""
    if not about.robots:
        nothing = about._replace(missing=())
        return _one([("bad", "no robot of this run left a recording that can be read"), *_wrong(nothing)], about)
    clauses: list[tuple[Literal["", "good", "bad"], str]] = []
    if about.survey is not None:
        enough = about.survey.share >= about.survey.wanted
        clauses.append(("good" if enough else "bad", _surveyed(about.survey, about.lasted_s)))
    for found in about.targets:
        if about.survey is not None and not found.known_s:  # a survey looks for none
            continue
        clauses.append(("good" if found.sigma_m else "bad", _found_words(found, about)))
    return _one([*clauses, *_wrong(about)], about)


def _one(clauses: Sequence[tuple[Literal["", "good", "bad"], str]], about: Outcome) -> list[Part]:
    """Clauses with semicolons between them; a name of a robot stays as it is written."""
    parts = [Part(kind, UNIT.sub(UNBROKEN, f"{text}; ")) for kind, text in clauses]
    parts[-1] = parts[-1]._replace(text=parts[-1].text.removesuffix("; ") + ".")
    first = parts[0].text
    if first.split()[0].rstrip(",") not in about.fleet:
        parts[0] = parts[0]._replace(text=first[0].upper() + first[1:])
    return parts


def _found_words(found: Found, about: Outcome) -> str:
    if not found.known_s:
        return f"nobody found the {found.target} in {seconds(about.lasted_s)}"
    who = ", ".join(_who(found, about))
    if not found.sigma_m:
        return f"{who}; at the end nobody knew where it is"
    lost = [name for name in found.known_s if name not in found.sigma_m]
    who_knew = "all" if len(found.sigma_m) == len(about.fleet) > 1 else names(found.sigma_m, about)
    forgot = f", {names(lost, about)} no longer did" if lost else ""
    return f"{who}; at the end {who_knew} knew its place to {_how_surely(found)}{forgot}"


def _who(found: Found, about: Outcome) -> Iterator[str]:
    seen = sorted(found.seen_s, key=lambda name: found.seen_s[name])
    told = [name for name in found.known_s if name not in found.seen_s]
    never = [name for name in about.robots if name not in found.seen_s and name not in found.known_s]
    if not seen:
        first = seconds(min(found.known_s.values()))
        yield f"{names(told, about)} heard of the {found.target} after {first} and never saw it"
    elif len(seen) == 1:
        yield f"{seen[0]} found the {found.target} after {seconds(found.seen_s[seen[0]])}"
    else:
        yield f"{names(seen, about)} saw the {found.target} ({seen[0]} first, after {seconds(found.seen_s[seen[0]])})"
    if seen and told:
        yield f"{names(told, about)} {'was' if len(told) == 1 else 'were'} told of it"
    if never:
        yield f"{names(never, about)} never knew of it"
    if found.in_view is not None:
        least, most = (f"{100 * share:.0f}" for share in found.in_view)
        yield f"in view for {least} %" + (f" to {most} %" if most != least else "") + " of the time"


def _how_surely(found: Found) -> str:
    """Of those that hold a place at the end, the least sure and the one that is farthest off."""
    sure, several = f"± {millimetres(max(found.sigma_m.values()))}", len(found.sigma_m) > 1
    if found.track_rms_m is not None:
        return f"{sure}, and on the way {'were' if several else 'was'} {millimetres(found.track_rms_m)} off (rms)"
    if found.off_m:
        most = millimetres(max(found.off_m.values()))
        where = "from its middle" if found.has_size else "off"
        return f"{sure}, and {'were at most' if several else 'was'} {most} {where}"
    if found.apart_m is not None:
        return f"{sure}, within {millimetres(max(found.apart_m, 1e-4))} of each other"
    return sure


def _surveyed(survey: Survey, lasted_s: float) -> str:
    known = f"{100 * survey.share:.0f} % of what is wanted is known after {seconds(lasted_s)}"
    asked = f"{100 * survey.wanted:.0f} % were asked for"
    return f"{known}, from {survey.keyframes} keyframes, and {asked}" + (
        "" if survey.alike else ", and the maps differ"
    )


def _wrong(about: Outcome) -> Iterator[tuple[Literal["bad"], str]]:
    if about.missing:
        yield "bad", f"nothing was heard of {names(about.missing, about)}"
    for name, robot in about.robots.items():
        if robot.mode == "failed":
            yield "bad", f"{name} failed after {seconds(robot.ends_s)}"
        elif about.lasted_s - robot.ends_s > EARLY_S:
            how = ENDINGS[robot.ending].format(name)
            yield "bad", f"{how} after {seconds(robot.ends_s)} of {seconds(about.lasted_s)}"
        if robot.starts > 1:
            yield "bad", f"{name} started again" + (f" {robot.starts - 1} times" if robot.starts > 2 else "")
    for what, text in (("ended with", "faults"), ("warned of", "warned")):
        by = {name: getattr(robot, text) for name, robot in about.robots.items() if getattr(robot, text)}
        if by:
            yield "bad", f"{names(by, about)} {what} {_first_of(list(dict.fromkeys(itertools.chain(*by.values()))))}"
    if about.torn:
        yield "bad", f"not finished by {'its writer' if len(about.torn) == 1 else 'their writers'}: {_list(about.torn)}"
    if about.verdict == "fail":
        yield "bad", f"it did not pass: {_first_of(about.reasons)}" if about.reasons else "it did not pass"


def _first_of(texts: Sequence[str]) -> str:
    more = len(texts) - 1
    return f"“{texts[0]}”" + (f" and {NUMBERS[more] if more < len(NUMBERS) else more} more" if more else "")


def names(of: Collection[str], about: Outcome) -> str:
    """Of robots, in the order of the fleet file: all of them are "all three robots"."""
    if len(of) == len(about.fleet) > 1:
        n = len(of)
        return "both robots" if n == 2 else f"all {NUMBERS[n] if n < len(NUMBERS) else n} robots"
    return _list([name for name in about.fleet if name in of])


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def seconds(s: float) -> str:
    if s < 9.95:
        return f"{s:.1f} s"
    minutes, rest = divmod(round(s), 60)
    if minutes < 2:
        return f"{s:.0f} s"
    return f"{minutes} min {rest} s" if rest else f"{minutes} min"


def millimetres(m: float) -> str:
    return f"{1e3 * m:.1f} mm" if m < 0.00995 else f"{1e3 * m:.0f} mm"


def plain(parts: Sequence[Part]) -> str:
    """As one text with ordinary spaces."""
    return "".join(part.text for part in parts).replace(UNBROKEN, " ")
