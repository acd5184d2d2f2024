"""Who lit for whom, in a fleet that lights for each other: a table of sweeps by their lamps, and when lamps burned."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence
from statistics import median

from matplotlib.figure import Figure
from matplotlib.patches import Patch
from msgspec import UNSET

from agent.core.step_io import SweepOutcome
from replay.report.page_template import Row, Table
from replay.report.robot_timeline import RobotTimeline

SPOILED = "spoiled: "  # agent.capabilities.light.lights writes it
FREE = "0.75"  # of a lamp that is its own robot's


def sweeps(timelines: Sequence[RobotTimeline]) -> Table | None:
    """How each robot's sweeps went, by whose lamps burned; None for a fleet without light of its own."""
    rows: list[Row] = [["robot", "lamps", "sweeps", "gave a place", "spoiled by a lamp", "else rejected", "peak ±"]]
    for timeline in timelines:
        by: defaultdict[tuple[str, ...], list[SweepOutcome]] = defaultdict(list)
        for sweep in timeline.sweeps:
            if sweep.outcome is not None and sweep.outcome.lamps is not UNSET:
                by[tuple(sweep.outcome.lamps)].append(sweep.outcome)
        for lamps, outcomes in sorted(by.items()):
            placed = [outcome for outcome in outcomes if outcome.x_m is not None]
            spoiled = sum(outcome.rejected.startswith(SPOILED) for outcome in outcomes)
            sigmas = [outcome.sigma for outcome in placed if outcome.sigma is not None]
            other = len(outcomes) - len(placed) - spoiled
            counts = [str(number) for number in (len(outcomes), len(placed), spoiled, other)]
            rows.append([timeline.label, " ".join(lamps), *counts, f"{median(sigmas):.1f}" if sigmas else "-"])
    if len(rows) == 1:
        return None
    return Table(
        "Sweeps of each robot by the lamps that it took to burn. Spoiled: a lamp changed meanwhile, and what was "
        "measured was thrown away. Peak: median of the standard deviation that the fits state, in lens positions.",
        rows,
    )


def lanes(timelines: Sequence[RobotTimeline]) -> Figure:
    """A lane for each robot's lamp: when it burned, in the colour of the robot for whose sweep; grey for itself while
    nobody had a lease. The line below a lane: when that robot had the light."""
    names = list(dict.fromkeys(timeline.robot for timeline in timelines))
    colours = {name: f"C{k}" for k, name in enumerate(names)}
    figure = Figure(figsize=(9.0, 0.7 + 0.6 * len(names)), layout="constrained")
    panel = figure.subplots()
    for row, name in enumerate(names):
        shown = sorted(
            ((t_s, state.lamp) for each in timelines if each.robot == name for t_s, state in each.states if state.lamp),
            key=lambda item: item[0],
        )
        for (t_s, lamp), (until_s, _) in itertools.pairwise(shown):
            leased = lamp.holder is not None and lamp.phase != "asks"
            if lamp.power > 0.0:
                colour = colours.get(lamp.holder or "", FREE) if leased else FREE
                panel.barh(row, until_s - t_s, left=t_s, height=0.55, color=colour, alpha=max(lamp.power, 0.3))
            if lamp.phase == "holds":
                panel.barh(row + 0.36, until_s - t_s, left=t_s, height=0.1, color=colours[name])
    panel.set(yticks=range(len(names)), yticklabels=names, xlabel="s", ylim=(len(names) - 0.45, -0.45))
    handles = [Patch(color=colour, label=f"for {name}") for name, colour in colours.items()]
    figure.legend(
        handles=[*handles, Patch(color=FREE, label="for itself")],
        loc="outside lower center",
        ncols=len(handles) + 1,
        fontsize="small",
        frameon=False,
    )
    return figure
