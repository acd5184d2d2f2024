"""`aucamp experiment`: each verb says what was asked, and which experiment answers."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, get_args

import typer

from agent.core.config import ConfigError, WaterKind
from agent.experiments.experiment import (
    DEFAULT_SENSOR,
    WATERS,
    FollowingPolicy,
    LightWater,
    LocalizationKind,
    ModelKind,
    NavigationCase,
    PosesKind,
    ScenePart,
    Sensor,
)
from agent.process.command import OutFolder, Seed, terminal

app = typer.Typer(no_args_is_help=True, help="The paper's experiments, on the twin.")

SensorName = Annotated[Sensor, typer.Option("--sensor", help="Camera of the twin.")]
# typer takes a list of an Enum, not of a Literal
Water = StrEnum("Water", [(kind, kind) for kind in WATERS])  # type: ignore[misc]
Waters = Annotated[list[Water] | None, typer.Option("--water", help="Only this kind; again for more; else all.")]


def kinds(water: list[Water] | None) -> tuple[WaterKind, ...]:
    """The kinds of water that were asked for, in that order; all if none was."""
    return tuple(kind for asked in water for kind in WATERS if kind == asked) if water else WATERS


@app.command("calibration", epilog="Example: aucamp experiment calibration --seed 3")
def experiment_calibration(seed: Seed = 0, out: OutFolder = None) -> None:
    """Range against focus position, on the twin's bench."""
    from agent.experiments import calibration as figures
    from agent.experiments import calibration as run
    from agent.experiments import calibration as tables
    from agent.experiments.experiment import perform

    asked = run.Settings(seed=seed)
    perform(run.run, asked, tables.table, out, terminal(), "distances of the board", figures.figures)


@app.command("depth", epilog="Example: aucamp experiment depth --seed 1")
def experiment_depth(seed: Seed = 0, out: OutFolder = None) -> None:
    """Depth of whole views from focus, against the twin's truth: our peak and the paper's."""
    from agent.experiments import depth as figures
    from agent.experiments import depth as run
    from agent.experiments import depth as tables
    from agent.experiments.experiment import perform

    asked = run.Settings(seed=seed)
    perform(run.run, asked, tables.table, out, terminal(), "sweeps of whole views", figures.figures)


@app.command("detection", epilog="Example: aucamp experiment detection --pictures my_pool")
def experiment_detection(
    seed: Seed = 0,
    count: Annotated[int, typer.Option(min=1, help="Places in each kind of water.")] = 200,
    sensor: SensorName = DEFAULT_SENSOR,
    water: Waters = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Not the twin: real pictures in this folder, balls in its truth.csv.")
    ] = None,
    out: OutFolder = None,
) -> None:
    """Whether the ball is found, and how exactly, in every kind of water, sharp and not, raw and enhanced.

    With --pictures every picture of a folder is searched for a ball of every colour.
    """
    from agent.experiments import detection as run
    from agent.experiments import detection as tables
    from agent.experiments import detection_pictures as picture_figures
    from agent.experiments import detection_pictures as picture_run
    from agent.experiments import detection_pictures as picture_tables
    from agent.experiments.experiment import perform

    if pictures is not None:
        own = picture_run.Settings(folder=pictures)
        figures = picture_figures.figures
        perform(picture_run.run, own, picture_tables.table, out, terminal(), "pictures", figures)
        return
    asked = run.Settings(seed=seed, count=count, sensor=sensor, waters=kinds(water))
    perform(run.run, asked, tables.table, out, terminal(), "places")


@app.command("peak-shift", epilog="Example: aucamp experiment peak-shift --water turbid")
def experiment_peak_shift(
    seed: Seed = 0, sensor: SensorName = DEFAULT_SENSOR, water: Waters = None, out: OutFolder = None
) -> None:
    """How far the focus peak moves when frames are enhanced before clarity is taken, in every kind of water."""
    from agent.experiments import peak_shift as run
    from agent.experiments import peak_shift as tables
    from agent.experiments.experiment import perform

    asked = run.Settings(seed=seed, sensor=sensor, waters=kinds(water))
    perform(run.run, asked, tables.table, out, terminal(), "sweeps")


@app.command("consistency", epilog="Example: aucamp experiment consistency --count 100")
def experiment_consistency(
    seed: Seed = 0, count: Annotated[int, typer.Option(min=1, help="Measurements.")] = 1000, out: OutFolder = None
) -> None:
    """Whether measurements of a ball are as wrong as they say: with focus, with size, with both."""
    from agent.experiments import consistency as run
    from agent.experiments import consistency as tables
    from agent.experiments.experiment import perform

    asked = run.Settings(seed=seed, count=count)
    perform(run.run, asked, tables.table, out, terminal(), "measurements")


@app.command("localization", epilog="Example: aucamp experiment localization --quick")
def experiment_localization(
    seed: Seed = 0,
    out: OutFolder = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few draws, small swarms: for a look.")] = False,
    full: Annotated[bool, typer.Option("--full", help="More draws, losses and robots.")] = False,
    only: Annotated[LocalizationKind | None, typer.Option("--only", help="This kind of case; else both.")] = None,
) -> None:
    """Protocols against the Cramer-Rao bound: graphs, loss, schedules of views, robots that are wrong or lie."""
    if quick and full:
        raise ConfigError("--quick and --full contradict each other; give one of them")
    from agent.experiments.experiment import perform
    from agent.experiments.localization import localization as figures
    from agent.experiments.localization import localization as run
    from agent.experiments.localization import localization as tables

    asked = run.Settings(seed=seed, quick=quick, full=full, only=only)
    perform(run.run, asked, tables.table, out, terminal(), "dives", figures.figures)


@app.command("orientation", epilog="Example: aucamp experiment orientation --seeds 5")
def experiment_orientation(
    seed: Seed = 0, seeds: Annotated[int, typer.Option(min=1, help="Robots per case.")] = 20, out: OutFolder = None
) -> None:
    """Push and depth step under the three control laws, real firmware on the twin's physics."""
    from agent.experiments import orientation as figures
    from agent.experiments import orientation as run
    from agent.experiments import orientation as tables
    from agent.experiments.experiment import perform

    asked = run.Settings(seed=seed, seeds=seeds)
    perform(run.run, asked, tables.table, out, terminal(), "dives of up to five robots", figures.figures)


@app.command("navigation", epilog="Example: aucamp experiment navigation --only hold --seeds 5")
def experiment_navigation(
    seed: Seed = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Worlds of each case.")] = 20,
    quick: Annotated[bool, typer.Option("--quick", help="One world, and little of it: for a look.")] = False,
    only: Annotated[NavigationCase | None, typer.Option("--only", help="This case; else all.")] = None,
    out: OutFolder = None,
) -> None:
    """Robots that swim: finding themselves, holding, going, turning, orbiting, keeping apart, and a target's place."""
    from agent.experiments.experiment import perform
    from agent.experiments.navigation import navigation as figures
    from agent.experiments.navigation import navigation as run
    from agent.experiments.navigation import navigation as tables

    asked = run.Settings(seed=seed, seeds=seeds, quick=quick, only=only)
    perform(run.run, asked, tables.table, out, terminal(), "worlds of robots that swim", figures.figures)


@app.command("reconstruction", epilog="Example: aucamp experiment reconstruction --seed 1 --seeds 1 --water tap")
def experiment_reconstruction(
    seed: Seed = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Tanks, from that seed on.")] = 5,
    water: Waters = None,
    poses: Annotated[PosesKind | None, typer.Option("--poses", help="Only these; else all.")] = None,
    model: Annotated[ModelKind, typer.Option(help="Image model; a field takes five minutes a case.")] = "surfels",
    only: Annotated[
        ScenePart | None,
        typer.Option(
            "--only",
            help="Scenes; sweeps that moored robots need; what swimmers learn; how it grows. Else all.",
        ),
    ] = None,
    out: OutFolder = None,
) -> None:
    """Scenes from focus sweeps: surfaces, poses and pictures against the twin's truth, in tap and coastal water; how
    many sweeps robots need that share what they saw; what robots that swim know after five minutes; and time and memory
    of a survey of 500 keyframes."""
    from agent.experiments.experiment import perform
    from agent.experiments.reconstruction import reconstruction as run
    from agent.experiments.reconstruction import reconstruction as tables

    asked = run.Settings(
        seeds=tuple(range(seed, seed + seeds)),
        waters=kinds(water) if water else run.WATERS,
        poses=(poses,) if poses else run.POSES,
        model=model,
        only=only,
    )
    perform(run.run, asked, tables.table, out, terminal(), "sweeps and surfaces")


@app.command("following", epilog="Example: aucamp experiment following --only share --robots 3 --seeds 5")
def experiment_following(
    seed: Seed = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Worlds of each case.")] = 20,
    only: Annotated[FollowingPolicy | None, typer.Option("--only", help="This policy; else all.")] = None,
    robots: Annotated[int | None, typer.Option("--robots", min=1, help="Fleets of 1, 2, 3 or 5; else all.")] = None,
    out: OutFolder = None,
) -> None:
    """Robots that follow a target that swims: sharing what they see, silent, or moored; with words lost."""
    from agent.experiments import following as figures
    from agent.experiments import following as run
    from agent.experiments import following as tables
    from agent.experiments.experiment import perform
    from agent.experiments.following_dive import all_cases

    if not all_cases(only, robots):
        raise ConfigError("no such case: share has 1, 2, 3 or 5 robots, silent and moored have 3; change --robots")
    asked = run.Settings(seed=seed, seeds=seeds, only=only, robots=robots)
    perform(run.run, asked, tables.table, out, terminal(), "seconds of work", figures.figures)


@app.command("lighting", epilog="Example: aucamp experiment lighting --water harbour --scenes 8")
def experiment_lighting(
    seed: Seed = 0,
    scenes: Annotated[int, typer.Option(min=1, help="Fleets of each size in each water.")] = 4,
    draws: Annotated[int, typer.Option(min=4, help="Sweeps of each robot in each light.")] = 6,
    water: Annotated[LightWater | None, typer.Option(help="Only this dark water; else all.")] = None,
    out: OutFolder = None,
) -> None:
    """Robots that light for each other in the dark: own lamp, all lamps, one set, the rule, the optimum."""
    from agent.experiments import lighting as figures
    from agent.experiments import lighting as run
    from agent.experiments import lighting as tables
    from agent.experiments.experiment import perform

    waters = (water,) if water else get_args(LightWater)
    asked = run.Settings(seed=seed, scenes=scenes, draws=draws, waters=waters)
    perform(run.run, asked, tables.table, out, terminal(), "distances and fleets", figures.figures)
