"""The paper's figure: prior and posterior of each axis against the iteration, each robot's first view marked."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.core.config import Protocol
from agent.core.messages import Symmetric
from agent.experiments.figure_files import Figures
from agent.experiments.localization.graphs import graph
from agent.experiments.localization.lockstep import Swarm, prior, symmetric
from agent.experiments.localization.run import Result
from agent.experiments.localization.world import TARGET_M, THREE_M, Array, Dive, draw_dive, draw_world

ITERATIONS = 60
AXES = "xyz"
LINES: tuple[Protocol, ...] = ("paper", "evidence")


def figures(result: Result) -> Figures:
    """One without loss and one with 30 %, each as SVG and PNG."""
    for loss in (0.0, 0.3):
        drawn = figure(result.seed, result.world, loss)
        for suffix in ("svg", "png"):
            yield f"localization_loss_{round(100 * loss)}.{suffix}", drawn


def figure(seed: int, world_seed: int, loss: float) -> Figure:
    """One dive of the paper's three robots, the same samples under both protocols."""
    robots = len(THREE_M)
    world = draw_world(robots, "aniso", False, np.random.default_rng(world_seed))
    dive = draw_dive(world, "paper", 0.0, ITERATIONS, np.random.default_rng((seed, 0)))
    drawn = Figure(figsize=(3.6 * robots, 7.5), dpi=120, layout="constrained")
    drawn.suptitle(f"three robots, {loss:.0%} of the messages lost; millimetres from the target (simulation)")
    panels = drawn.subplots(len(AXES), robots, sharex=True, sharey="row")
    lines = {protocol: posteriors(protocol, dive, symmetric(world.random_m2), loss, seed) for protocol in LINES}
    for i in range(robots):
        panels[0, i].set_title(f"r{i + 1}")
        panels[-1, i].set_xlabel("iteration")
        for axis in range(len(AXES)):
            draw_axis(panels[axis, i], dive, lines, i, axis)
    for axis, name in enumerate(AXES):
        panels[axis, 0].set_ylabel(f"{name}, mm")
    panels[0, 0].legend(fontsize="small", loc="upper right")
    return drawn


def posteriors(protocol: Protocol, dive: Dive, random_m2: Sequence[Symmetric], loss: float, seed: int) -> Array:
    """What each robot believed after each iteration, (T, N, 3); NaN while it believed nothing."""
    robots = len(random_m2)
    swarm = Swarm(protocol, graph("full", robots), loss, Random(seed))
    zero = symmetric(np.zeros((robots, 3, 3)))
    believed = np.full(dive.sample_m.shape, np.nan)
    for k, (measured, sees) in enumerate(zip(dive.sample_m, dive.sees, strict=True)):
        swarm.iterate(
            [prior(measured[i], random_m2[i], zero[i], swarm.now_ns) if sees[i] else None for i in range(robots)]
        )
        for i, robot in enumerate(swarm.robots):
            if robot.posterior is not None:
                believed[k, i] = robot.posterior.x_m
    return believed


def draw_axis(panel: Axes, dive: Dive, lines: dict[Protocol, Array], i: int, axis: int) -> None:
    """Robot i, one of x, y and z; millimetres from the target."""
    t = np.arange(1, len(dive.sees) + 1)
    sees = dive.sees[:, i]
    off = 1e3 * (dive.sample_m[:, i, axis] - TARGET_M[axis])
    panel.plot(t[sees], off[sees], ".", color="0.65", markersize=3, label="prior")
    for protocol, believed in lines.items():
        panel.plot(t, 1e3 * (believed[:, i, axis] - TARGET_M[axis]), linewidth=1.2, label=f"posterior, {protocol}")
    panel.axhline(0.0, color="black", linewidth=0.6, linestyle="--")
    panel.axvline(float(t[sees][0]), color="C3", linewidth=0.8, label="first view")
