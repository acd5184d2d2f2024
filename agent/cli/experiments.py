"""`aucamp experiment NAME`: which experiments there are, and which of the common options each takes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args

import msgspec
import typer

from agent.core.config import ConfigError
from agent.experiments.experiment import (
    WATERS,
    FollowingPolicy,
    LightWater,
    LocalizationKind,
    ModelKind,
    NavigationCase,
    PosesKind,
    ScenePart,
    no_figures,
    perform,
)
from agent.process.command import OutFolder, refuse_options, terminal

app = typer.Typer()


class Part(NamedTuple):
    """What `--only` chooses from."""

    field: str  # of the experiment's Settings
    names: tuple[str, ...]
    several: bool = True  # whether the field holds several of them


class Experiment(NamedTuple):
    """A module of agent.experiments with Settings, run, table and perhaps figures, and how options become Settings."""

    module: str
    about: str
    counted: str  # by the progress bar
    seeds: str = ""  # the field that --seeds sets; none: takes no --seeds
    only: tuple[Part, ...] = ()
    quick: bool = False


WATER = Part("waters", WATERS)
EXPERIMENTS = {
    "calibration": Experiment("calibration", "range against focus position, on the bench", "distances of the board"),
    "depth": Experiment("depth", "depth of whole views from focus: our peak, the paper's", "sweeps of whole views"),
    "detection": Experiment(
        "detection", "whether the ball is found, sharp or not, raw or enhanced", "places", "count", (WATER,)
    ),
    "peak-shift": Experiment("peak_shift", "how far enhancement moves the focus peak", "sweeps", only=(WATER,)),
    "consistency": Experiment("consistency", "whether measurements are as wrong as they say", "measurements", "count"),
    "localization": Experiment(
        "localization.localization",
        "protocols against the Cramer-Rao bound; loss, robots that lie",
        "dives",
        only=(Part("only", get_args(LocalizationKind), several=False),),
        quick=True,
    ),
    "orientation": Experiment(
        "orientation", "push and depth step under three control laws", "dives of up to five robots", "seeds"
    ),
    "navigation": Experiment(
        "navigation.navigation",
        "robots that swim: hold, go, turn, orbit, search, keep apart",
        "worlds of robots that swim",
        "seeds",
        (Part("only", get_args(NavigationCase), several=False),),
        quick=True,
    ),
    "reconstruction": Experiment(
        "reconstruction.reconstruction",
        "scenes from focus sweeps; what a survey learns and costs",
        "sweeps and surfaces",
        "seeds",
        (
            Part("only", get_args(ScenePart), several=False),
            WATER,
            Part("poses", get_args(PosesKind)),
            Part("model", get_args(ModelKind), several=False),
        ),
    ),
    "following": Experiment(
        "following",
        "a target that swims: robots that share, are silent, are moored",
        "seconds of work",
        "seeds",
        (Part("only", get_args(FollowingPolicy), several=False), Part("robots", ("1", "2", "3", "5"), several=False)),
    ),
    "lighting": Experiment(
        "lighting",
        "lamps lent in the dark: own, all, one set, the rule, the optimum",
        "distances and fleets",
        "scenes",
        (Part("waters", get_args(LightWater)),),
    ),
}
OWN_PICTURES = Experiment("detection_pictures", "", "pictures")

# typer takes a choice of an Enum, not of names that are known at run time alone
Name = StrEnum("Name", [(name, name) for name in EXPERIMENTS])  # type: ignore[misc]
WIDTH = max(map(len, EXPERIMENTS))
HELP = "\n\n".join(
    [
        "The paper's experiments, and more, on the twin: tables, figures and result.json.",
        "\b\n" + "\n".join(f"{name:{WIDTH}}  {one.about}" for name, one in EXPERIMENTS.items()),
        "What --only takes:",
        "\b\n"
        + "\n".join(
            f"{name:{WIDTH}}  {'; '.join(' '.join(part.names) for part in one.only)}"
            for name, one in EXPERIMENTS.items()
            if one.only
        ),
        "Exit 1 where a target is missed. docs/experiments.md has what each shows.",
    ]
)


@app.command(no_args_is_help=True, help=HELP, epilog="Example: aucamp experiment navigation --only hold --seeds 5")
def experiment(
    name: Annotated[Name, typer.Argument(metavar="NAME", help="Which, of those above.")],
    seed: Annotated[int | None, typer.Option(min=0, help="The first world of the twin; 0 if not given.")] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, help="How many worlds, places or measurements; what targets need if not given."),
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Only this part; again for more; else all.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Little of it, for a look; no verdict.")] = False,
    pictures: Annotated[
        Path | None, typer.Option(metavar="DIR", help="detection: of your own pictures, balls in DIR's truth.csv.")
    ] = None,
    out: OutFolder = None,
) -> None:
    which = EXPERIMENTS[name]
    given = {"--seed": seed, "--seeds": seeds, "--only": only, "--quick": quick, "--pictures": pictures}
    if pictures is not None and name == "detection":
        refuse_options("experiment detection --pictures", given, ("--pictures",))
        perform_one(OWN_PICTURES, {"folder": pictures}, out)
        return
    takes = [("--seeds", which.seeds), ("--only", which.only), ("--quick", which.quick)]
    refuse_options(f"experiment {name}", given, ("--seed", *(option for option, does in takes if does)))
    asked: dict[str, Any] = {"seed": seed or 0}
    if seeds is not None:
        asked[which.seeds] = seeds
    if quick:
        asked["quick"] = True
    perform_one(which, asked | parts(name, which, only or ()), out)


def parts(name: str, which: Experiment, only: Sequence[str]) -> dict[str, Any]:
    """Fields of Settings by what --only names. Raises ConfigError for a name that is none, or two where one goes."""
    known = [part_name for part in which.only for part_name in part.names]
    for asked in only:
        if asked not in known:
            raise ConfigError(f"experiment {name}: --only {asked}: choose from {', '.join(known)}")
    found: dict[str, Any] = {}
    for part in which.only:
        chosen = tuple(part_name for part_name in part.names if part_name in only)
        if len(chosen) > 1 and not part.several:
            raise ConfigError(f"experiment {name}: --only takes one of {', '.join(part.names)}; leave {chosen[1]} out")
        if chosen:
            found[part.field] = chosen if part.several else chosen[0]
    return found


def perform_one(which: Experiment, asked: dict[str, Any], out: Path | None) -> None:
    """Load the module, which takes seconds, and run it. Raises ConfigError and Failed."""
    module = import_module(f"agent.experiments.{which.module}")
    try:
        settings = msgspec.convert(asked, module.Settings, strict=False)
    except msgspec.ValidationError as error:
        raise ConfigError(f"experiment: {error}") from None
    figures = getattr(module, "figures", no_figures)
    perform(module.run, settings, module.table, out, terminal(), which.counted, figures)
