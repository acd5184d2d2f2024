"""How a survey goes, for whoever watches it: in 80 columns, a line for each robot."""

from __future__ import annotations

from msgspec import UNSET
from rich.box import SIMPLE_HEAD
from rich.table import Table

from agent.capabilities.survey.coverage_map import place_m, rotation
from agent.core.capability_messages import Claim, View, holds
from agent.core.messages import State
from agent.core.status import fault_kind
from agent.demo.coverage import SurveyWatch
from agent.demo.history import Histories
from agent.process.command import hears


def survey_table(histories: Histories, survey: SurveyWatch, title: str) -> Table:
    """What each robot knows, where it is, and where it looks next or now.

    map: whether it is that of most; is: x and y; looks: where the optical axis meets the floor.
    """
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for column in ("robot", "knows", "made", "holds", "map", "is cm", "± mm", "looks at cm", "hears", "faults"):
        table.add_column(column, no_wrap=column not in ("hears", "faults"))
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
    wrong = ", ".join(map(fault_kind, state.faults)) or ("motors off" if state.armed is False else "")
    return *place, looks, " ".join(hears(state)) or "-", wrong


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
