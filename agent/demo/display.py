"""What a person sees of a demo, in 80 columns: how to look at it, how it goes, and what came of it."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

from msgspec import UNSET
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from agent.capabilities.survey.coverage_map import place_m, rotation
from agent.core.capability_messages import Claim, View, holds
from agent.core.config import Fleet
from agent.core.messages import LampState, State
from agent.core.robot_view import robot_view
from agent.core.topics import EVERY_FLEET
from agent.core.verdict import ORDER
from agent.demo.summary import EACH_SEES, ONE_SEES, PASS_PERCENT, SIGMAS, Histories, SurveyWatch, doubts
from agent.process.certificates import CONSOLE_FILE
from agent.process.keys import VARIABLE
from replay.report.creature_track import followed_cells
from replay.report.page import cell, percent

WRONG = "trust, remarks"  # heads the column of what is wrong
COLOURS = {"consistent": "green", "suspect": "yellow", "contradicted": "red", "missing": "red"}
MOST_CAUSES = 3  # below the table


def how_to_look(fleet: Fleet, path: Path, keys: Path | None = None) -> list[str]:
    """Commands that attach to a running fleet, each ready to paste into another terminal in this folder.

    What has to be installed first stands above them: not every shell passes over a comment behind a command. `keys`:
    the folder with the certificates of a secured fleet.
    """
    asked = next(iter(fleet.robot.values())).listen
    file = shlex.quote(str(path))
    missing = [] if shutil.which(program("zenoh")) else ["zenoh-cli"]
    missing += [] if importlib.util.find_spec("foxglove") else ["foxglove-sdk"]
    first = f" (first: {program('pip')} install {' '.join(missing)})" if missing else ""
    ours = f"{VARIABLE}={shlex.quote(str(keys))} " if fleet.secured and keys is not None else ""
    as_whom = f"--config {shlex.quote(str(keys / CONSOLE_FILE))} " if fleet.secured and keys is not None else ""
    attach = f"{program('zenoh')} --mode client {as_whom}--connect {asked}"
    console = f"{attach} subscribe -k '{EVERY_FLEET}' --decoder aucamp"
    return [
        "look at it from a second terminal in this folder: every message; all in Foxglove; a router for consoles"
        + first,
        f"  {console} --line '{{key}} {{value}}'",
        f"  {ours}{program('aucamp')} view {file}",
        f"  {ours}{program('aucamp')} router {file}",
    ]


def program(name: str) -> str:
    """A program of our environment as a shell finds it, whether or not the environment is activated.

    One that is not there yet is named as it will be when pip has brought it, if no other of that name is found.
    """
    ours, found = Path(sys.executable).with_name(name), shutil.which(name)
    activated = any(Path(folder) == ours.parent for folder in os.get_exec_path())
    if activated or (found and not ours.exists()):
        return name
    return shlex.quote(str(ours.relative_to(Path.cwd()) if ours.is_relative_to(Path.cwd()) else ours))


def progress_title(dive_s: float, duration_s: float, rate: float) -> str:
    return f"{dive_s:.0f} s into the dive, at {rate:.2f} times real time; at most {duration_s - dive_s:.0f} s to go"


def progress_table(histories: Histories, title: str) -> Table:
    """What each robot says of itself and of each target now, in 80 columns."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    lights = any(h.newest is not None and h.newest.lamp for of in histories.values() for h in of.values())
    also = ("light",) if lights else ()
    for column in ("target", "robot", "", "iter.", "saw at", "estimate mm", "± mm", "hears", *also, WRONG):
        table.add_column(column, no_wrap=column not in ("hears", WRONG), min_width=len(column))
    causes = []
    for target, of_target in histories.items():
        for name, history in of_target.items():
            table.add_row(target, name, *progress_row(history.newest))
            causes += [f"{target}, {name}: {cause}" for cause in (history.newest.causes if history.newest else ())]
    table.caption, table.caption_justify = Text("\n".join(causes[:MOST_CAUSES])) if causes else None, "left"
    return table


def progress_row(state: State | None) -> tuple[str | Text, ...]:
    """The cells behind target and robot."""
    if state is None:
        return ("…",)
    view = robot_view(state)
    return (
        state.knows,
        str(state.t),
        cell(state.acquired_t, "d"),
        " ".join(f"{1e3 * x:.1f}" for x in state.posterior_m) if state.posterior_m else "-",
        f"{1e3 * state.posterior_sigma_m:.1f}" if state.posterior_sigma_m else "-",
        " ".join(view.hears) or "-",
        *((whose_light(state.robot, state.lamp),) if state.lamp else ()),
        wrong(state),
    )


def wrong(state: State) -> Text:
    """Whether what it believes of this target can be trusted, in colour, and what is wrong beside that."""
    remarks = [remark for remark in robot_view(state).remarks if remark not in ORDER]
    told = [] if state.posterior_m is None and not state.causes else [trust(state.verdict)]
    return Text(", ").join([*told, *map(Text, remarks)])


def trust(verdict: str | None) -> Text:
    """The word in its colour; a dash for nothing said."""
    return Text("-") if verdict is None else Text(verdict, COLOURS[verdict])


def whose_light(robot: str, lamp: LampState) -> str:
    """Of the lamp of a robot, in a few characters: for whom it burns; of one that has the light, who gives it."""
    if lamp.phase == "holds" and lamp.holder == robot:
        return "by " + " ".join(lamp.lamps)
    if lamp.phase == "obeys":
        return f"for {lamp.holder}" if lamp.power else f"({lamp.holder})"
    return "own" if lamp.power else "dark"


BALL_SAYS = "rms: of its own measurements, in x y z. error: of its last estimate, in x y z and in all."
BOX_SAYS = """estimate: from the middle of the thing, in x y z. outside: how far it lies outside of the thing;
allowed: 3 of the standard deviations that the robot states, at most the thing's largest radius."""


def result_table(summary: dict[str, Any], target: str) -> Table:
    """What each robot measured of one target, and what it held at the end, against the truth; mm in x, y and z."""
    about = summary["targets"][target]
    if about.get("swims"):
        return track_table(summary, target)
    is_ball = about["radii_m"] is None
    place = ", ".join(f"{x:g}" for x in about["truth_m"])
    table = Table(
        title=f"{target} at ({place}) m, protocol {summary['protocol']}, twin seed {summary['seed']}",
        title_justify="left",
        caption=BALL_SAYS if is_ball else BOX_SAYS,
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=0,
        show_edge=False,
    )
    own = ("rms mm", "error mm", "in all", "%") if is_ball else ("estimate mm", "outside mm", "allowed mm")
    for column in ("robot", "saw at", "iter.", *own, "trust"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, row in about["agents"].items():
        acquired = row["acquired_iteration"]
        cells: tuple[str | Text, ...] = name, "never" if acquired is None else str(acquired), str(row["iterations"])
        error = " ".join(f"{v:+.1f}" for v in row["error_axis_mm"] or [])
        if is_ball:
            rms = " ".join(f"{v:.1f}" for v in row["prior_rmse_axis_mm"] or [])
            cells += (rms, error, cell(row["error_mm"], ".2f"), cell(row["relative_error_percent"], ".2f"))
        else:
            cells += (error, cell(row["outside_mm"], ".1f"), cell(row["allowed_mm"], ".1f"))
        table.add_row(*cells, trust(row.get("verdict")))
    return table


TRACK_SAYS = """knew, longest: in s. saw: share of the time in which its newest frame shows it.
off: of its track, rms and 95 %. NEES: 3 where errors are as large as it states."""


def track_table(summary: dict[str, Any], target: str) -> Table:
    """How each robot followed a target that swims."""
    about = summary["targets"][target]
    who = {"one": "by_one", "two": "by_two", "the mean robot": "mean", "the least": "least"}
    by = [f"{name} {percent(about[f'seen_{key}'])}" for name, key in who.items()]
    whole = about["whole"]
    off, nees = cell(about["track_rms_mm"], ".1f"), cell(about["nees"], ".2f")
    table = Table(
        title=f"{target}, followed for {about['followed_s']:.0f} s, twin seed {summary['seed']}; "
        f"saw it: {', '.join(by)}; tracks {off} mm rms, NEES {nees} (from the first moment on "
        f"{cell(whole['track_rms_mm'], '.1f')} mm, {cell(whole['nees'], '.2f')})",
        title_justify="left",
        caption=f"{TRACK_SAYS}\n{missed(about['bars'])}" if about["bars"] else TRACK_SAYS,
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=0,
        show_edge=False,
    )
    for column in ("robot", "knew", "saw", "lost", "longest", "mistook", "off mm", "95 %", "NEES", "trust"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, row in about["agents"].items():
        table.add_row(name, cell(row["known_s"], ".1f"), *followed_cells(row), trust(row.get("verdict")))
    return table


def missed(bars: dict[str, bool]) -> str:
    """Which of the bars that decide nothing were missed, in a sentence."""
    names = [NAMES[key] for key, met in bars.items() if not met]
    return f"Of what such a fleet should reach it missed: {', '.join(names)}." if names else "It reached all bars."


NAMES = {
    "seen_by_one": "seen by one 99 %",
    "seen_by_two": "by two 95 %",
    "seen_least": "by the least robot 85 %",
    "track_rms_mm": "track 25 mm rms",
    "nees": "NEES 2.2 to 4",
}


FOLLOWED = (
    f"one robot at least saw it for {100 * ONE_SEES:.0f} % of the time, each for "
    f"{100 * EACH_SEES:.0f} %, and every track is good to its length"
)


def verdict(summary: dict[str, Any]) -> str:
    """Whether all estimates are good enough, and for what that counts; of a survey, what is known, and by whom. Then
    who ended with a belief that cannot be trusted, and why."""
    return "; ".join([_judged(summary), *doubts(summary)])


def _judged(summary: dict[str, Any]) -> str:
    if "coverage" in summary:
        share = percent(summary["coverage"]["wanted_share"])
        known = f"every robot knows {share} of what is wanted at least, and all maps are the same"
        return f"{summary['verdict']}: {'; '.join(summary['reasons'] or [known])}"
    resting = [about for about in summary["targets"].values() if not about.get("swims")]
    is_ball = {about["radii_m"] is None for about in resting}
    balls = [f"every robot's error is below {PASS_PERCENT} %"] if True in is_ball else []
    boxes = [f"every robot's estimate lies on the thing, to within {SIGMAS:.0f} sigma"] if False in is_ball else []
    fish = [FOLLOWED] if len(resting) < len(summary["targets"]) else []
    return f"{summary['verdict']}: {'; '.join(summary['reasons'] or balls + boxes + fish)}"


# --- table of a survey ---
# How a survey goes, to be watched: in 80 columns, a line for each robot.


def survey_table(histories: Histories, survey: SurveyWatch, title: str) -> Table:
    """What each robot knows, where it is, and where it looks next or now.

    map: whether it is that of most; is: x and y; looks: where the optical axis meets the floor.
    """
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for column in ("robot", "knows", "made", "holds", "map", "is cm", "± mm", "looks at cm", "hears", "remarks"):
        table.add_column(column, no_wrap=column not in ("hears", "remarks"))
    claims, usual = survey.newest(), survey.usual_digest()
    for name in survey.robots:
        table.add_row(name, *claimed(claims.get(name), usual), *shown(newest_of(histories, name), claims.get(name)))
    return table


def claimed(claim: Claim | None, usual: str) -> tuple[str, ...]:
    """What it knows, keyframes that it made and holds, and whose map it has."""
    if claim is None:
        return "…", "-", "-", "-"
    own, held = holds(claim)
    return f"{100 * claim.share:.1f} %", str(own), str(held), "same" if claim.digest == usual else "other"


def shown(state: State | None, claim: Claim | None) -> tuple[str, ...]:
    """Where it is and looks, whom it hears, what is wrong."""
    if state is None:
        return ("…",)
    at = state.whereabouts
    place = (f"{100 * at.x_m:.0f} {100 * at.y_m:.0f}", f"{1e3 * at.place_sigma_m:.0f}") if at else ("-", "-")
    spot = None if claim is None or claim.view is UNSET else floor_spot(claim.view)
    looks = "-" if spot is None else f"{100 * spot[0]:.0f} {100 * spot[1]:.0f}"
    view = robot_view(state)
    return *place, looks, " ".join(view.hears) or "-", ", ".join(view.remarks)


def floor_spot(view: View) -> tuple[float, float] | None:
    """Where a view's optical axis meets the floor, m, world frame; None: it does not go down."""
    (x, y, z), r = place_m(view.place), rotation(view.turn)
    if r[2][2] >= 0.0:
        return None
    away = -z / r[2][2]
    return x + away * r[0][2], y + away * r[1][2]


def newest_of(histories: Histories, name: str) -> State | None:
    """Of all its states, about whatever target."""
    states = [of_target[name].newest for of_target in histories.values() if name in of_target]
    return max((state for state in states if state is not None), key=lambda state: state.sent_ns, default=None)
