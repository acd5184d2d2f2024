"""The paper's figure: prior and posterior of each axis against the iteration, each robot's first view marked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.config import Protocol
from agent.experiments.graphs import graph
from agent.experiments.lockstep import Swarm, prior, symmetric
from agent.experiments.scene import TARGET_M, THREE_M, Array, Draw, draw, scene
from agent.messages import Symmetric

ITERATIONS = 60
AXES = "xyz"
LINES: tuple[Protocol, ...] = ("paper", "evidence")


def draw_iterations(seed: int, world_seed: int, loss: float, stem: Path) -> None:
    """Write stem.svg and stem.png: one dive of the paper's three robots, the same samples under both protocols."""
    robots = len(THREE_M)
    world = scene(robots, "aniso", False, np.random.default_rng(world_seed))
    samples = draw(world, "paper", 0.0, ITERATIONS, np.random.default_rng((seed, 0)))
    figure = Figure(figsize=(3.6 * robots, 7.5), layout="constrained")
    figure.suptitle(f"three robots, {loss:.0%} of the messages lost; millimetres from the target (simulation)")
    panels = figure.subplots(len(AXES), robots, sharex=True, sharey="row")
    lines = {protocol: posteriors(protocol, samples, symmetric(world.random_m2), loss, seed) for protocol in LINES}
    for i in range(robots):
        panels[0, i].set_title(f"r{i + 1}")
        panels[-1, i].set_xlabel("iteration")
        for axis in range(len(AXES)):
            draw_axis(panels[axis, i], samples, lines, i, axis)
    for axis, name in enumerate(AXES):
        panels[axis, 0].set_ylabel(f"{name}, mm")
    panels[0, 0].legend(fontsize="small", loc="upper right")
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text stays text
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
    figure.savefig(stem.with_suffix(".png"), dpi=120)


def posteriors(protocol: Protocol, samples: Draw, random_m2: Sequence[Symmetric], loss: float, seed: int) -> Array:
    """What each robot believed after each iteration, (T, N, 3); NaN while it believed nothing."""
    robots = len(random_m2)
    swarm = Swarm(protocol, graph("full", robots), loss, Random(seed))
    zero = symmetric(np.zeros((robots, 3, 3)))
    believed = np.full(samples.sample_m.shape, np.nan)
    for k, (measured, sees) in enumerate(zip(samples.sample_m, samples.sees, strict=True)):
        swarm.iterate(
            [prior(measured[i], random_m2[i], zero[i], swarm.now_ns) if sees[i] else None for i in range(robots)]
        )
        for i, robot in enumerate(swarm.robots):
            if robot.posterior is not None:
                believed[k, i] = robot.posterior.x_m
    return believed


def draw_axis(panel: Axes, samples: Draw, lines: dict[Protocol, Array], i: int, axis: int) -> None:
    t = np.arange(1, len(samples.sees) + 1)
    sees = samples.sees[:, i]
    off = 1e3 * (samples.sample_m[:, i, axis] - TARGET_M[axis])
    panel.plot(t[sees], off[sees], ".", color="0.65", markersize=3, label="prior")
    for protocol, believed in lines.items():
        panel.plot(t, 1e3 * (believed[:, i, axis] - TARGET_M[axis]), linewidth=1.2, label=f"posterior, {protocol}")
    panel.axhline(0.0, color="black", linewidth=0.6, linestyle="--")
    panel.axvline(float(t[sees][0]), color="C3", linewidth=0.8, label="first view")
