"""Figures of the experiment: sigma over distance, and what fleets gain."""

from __future__ import annotations

from agent.experiments.figure_files import Figures
from agent.experiments.lighting.run import Result


def figures(result: Result) -> Figures:
    """sigma and usable."""
    from matplotlib.figure import Figure

    ladder = [row for row in result.cases if row["distance_m"] is not None]
    waters = list(dict.fromkeys(row["water"] for row in ladder))
    drawn = Figure(figsize=(4 * len(waters), 3.4), layout="constrained")
    axes = drawn.subplots(1, len(waters), squeeze=False, sharey=True)[0]
    for ax, water in zip(axes, waters, strict=True):
        for policy in ("own", "all", "rule"):
            rows = [row for row in ladder if (row["water"], row["policy"]) == (water, policy) and row["sigma_mm"]]
            ax.semilogy([row["distance_m"] for row in rows], [row["sigma_mm"] for row in rows], "o-", label=policy)
        ax.set_title(water)
        ax.set_xlabel("camera to ball, m")
    axes[0].set_ylabel("sigma of the range (noise), mm")
    axes[0].legend()
    yield "sigma.png", drawn

    fleets = [row for row in result.cases if row["distance_m"] is None]
    drawn = Figure(figsize=(4 * len(waters), 3.4), layout="constrained")
    axes = drawn.subplots(1, len(waters), squeeze=False, sharey=True)[0]
    for ax, water in zip(axes, waters, strict=True):
        for policy, loss in dict.fromkeys((row["policy"], row["loss"]) for row in fleets):
            rows = [row for row in fleets if (row["water"], row["policy"], row["loss"]) == (water, policy, loss)]
            label = policy + (f", {100 * loss:.0f} % lost" if loss else "")
            ax.plot([row["robots"] for row in rows], [100 * row["usable_share"] for row in rows], "o-", label=label)
        ax.set_title(water)
        ax.set_xlabel("robots")
    axes[0].set_ylabel("with a usable range, %")
    axes[-1].legend()
    yield "usable.png", drawn
