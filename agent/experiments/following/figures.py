"""How soon who lost it has it again, and one fleet's dive: who saw it when, and how far off they believed it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from agent.experiments.figure_files import Figures
from agent.experiments.following.cases import Case
from agent.experiments.following.counts import losses, share
from agent.experiments.following.dive import Draw
from agent.experiments.following.run import Result
from agent.experiments.navigation.basin import TANK


def figures(result: Result) -> Figures:
    """Each as SVG and PNG."""
    draws = result.shown.draws
    drawn = {"following_again": again(draws)}
    for case, of in draws.items():
        worst = min(of, key=lambda draw: share(draw)["seen_each"])
        name = f"following_{case.policy}_{case.robots}_{100 * case.loss:.0f}_{100 * case.speed_m_s:.0f}"
        drawn[name] = one_dive(case, worst)
    for name, figure in drawn.items():
        for suffix in ("svg", "png"):
            yield f"{name}.{suffix}", figure


def again(draws: dict[Case, list[Draw]]) -> Figure:
    """Share of the losses after which it was seen again by then, of all speeds together."""
    drawn = Figure(figsize=(6.4, 4.0), dpi=120, layout="constrained")
    panel = drawn.subplots()
    for key in dict.fromkeys((case.policy, case.robots, case.loss) for case in draws):
        every = [one for case, of in draws.items() if case[:3] == key for draw in of for one in losses(draw)]
        for by_others, words in ((True, "others see it"), (False, "nobody else")):
            seconds = sorted(one.seconds for one in every if one.by_others == by_others and one.seen)
            count = sum(one.by_others == by_others for one in every)
            if count:
                label = f"{key[0]}, {key[1]} robots, loss {key[2]:.0%}, {words} ({count})"
                panel.step([0.0, *seconds], np.arange(len(seconds) + 1) / count, where="post", label=label)
    panel.set(xlabel="s from when it was in sight", ylabel="share seen again", xlim=(0.0, 5.0), ylim=(0.0, 1.02))
    if panel.get_legend_handles_labels()[0]:
        panel.legend(fontsize="xx-small")
    return drawn


def one_dive(case: Case, draw: Draw) -> Figure:
    """The seed in which each saw least."""
    drawn = Figure(figsize=(9.0, 4.4), dpi=120, layout="constrained")
    above, time = drawn.subplots(1, 2)
    above.plot(*draw.target_m[draw.watched :, :2].T, color="black", linewidth=0.8, label="target")
    for k in range(draw.robots.shape[1]):
        above.plot(*draw.robots[draw.watched :, k, :2].T, linewidth=0.8, label=f"r{k + 1}")
        when = draw.t_s[draw.sees[:, k]]
        time.plot(when, np.full(len(when), -0.1 * (k + 1)), "|", markersize=4)
        time.plot(draw.t_s, draw.error_m[:, k], linewidth=0.8, color=f"C{k}")
    for weed in draw.weeds:
        above.plot(weed.x_m, weed.y_m, "o", color="green", markersize=8)
    above.set(xlim=(0.0, TANK.size_m[0]), ylim=(0.0, TANK.size_m[1]), aspect="equal")
    above.legend(fontsize="x-small")
    time.axvline(draw.t_s[draw.watched], color="grey", linewidth=0.6)
    time.set(xlabel="s", ylabel="error, m; below: frames that show it", ylim=(-0.1 * (draw.sees.shape[1] + 1), 1.0))
    drawn.suptitle(f"{case.policy}, {case.robots} robots, loss {case.loss:.0%}, {case.speed_m_s:g} m/s: worst seed")
    return drawn
