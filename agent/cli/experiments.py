"""`aucamp experiment NAME`: run a claim; `list`: which there are; `docs`: write their pages."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from agent.core.config import ConfigError
from agent.experiments.registry import CLAIMS, code_of, load
from agent.process.command import complain, refuse_options, terminal, with_bar

if TYPE_CHECKING:
    from agent.experiments.claim import Claim
    from agent.experiments.run_claim import Plan

app = typer.Typer()

LIST, DOCS = "list", "docs"
MISSED, NOT_SHOWN = 1, 3  # exit codes; 2 is bad input
# typer takes a choice of an Enum, not of names that are known at run time alone
Name = StrEnum("Name", [(name, name) for name in (*CLAIMS, LIST, DOCS)])  # type: ignore[misc]
WIDTH = max(map(len, CLAIMS), default=0)
HELP = "\n\n".join(
    [
        "Measure a claim for many seeds side by side, and say how sure the figures are. `list` shows the last results; "
        "`docs DIR...` keeps the results of these runs and writes docs/research.",
        "\b\n" + "\n".join(f"{name:{WIDTH}}  {entry.about}" for name, entry in CLAIMS.items()),
        "Exit 0: all targets are met; 1: one is missed; 3: one is not shown.",
    ]
)


@app.command(no_args_is_help=True, help=HELP, epilog="Example: aucamp experiment manoeuvres --only hold --seeds 20")
def experiment(
    name: Annotated[Name, typer.Argument(metavar="NAME", help="Which, of those above; list; docs.")],
    runs: Annotated[list[Path] | None, typer.Argument(metavar="DIR", help="docs: folders of runs to keep.")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="How many; the claim's own number if not given.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="The first; 0 if not given.")] = None,
    only: Annotated[list[str] | None, typer.Option(metavar="CASE", help="Only this case; again for more.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="One of the claim's settings.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Little of it, for a look; no verdict.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; if it is there, the run goes on. Else below runs.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes side by side; one a core if not given.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Of a Dask cluster that runs the seeds.")
    ] = None,
) -> None:
    given: dict[str, object] = {
        "--seeds": seeds,
        "--seed": seed,
        "--only": only,
        "--set": settings,
        "--quick": quick,
        "--out": out,
        "--jobs": jobs,
        "--scheduler": scheduler,
    }
    if name in (LIST, DOCS):
        refuse_options(f"experiment {name}", {**given, "DIR": runs}, ("DIR",) if name == DOCS else ())
        return show_list() if name == LIST else write_docs(runs or ())
    refuse_options(f"experiment {name}", {"DIR": runs}, ())
    claim = load(CLAIMS[name].module)
    plan = plan_of(str(name), claim, seeds, seed or 0, only or (), settings or (), quick)
    raise typer.Exit(run(plan, claim, out, jobs, scheduler, quick))


def plan_of(
    name: str, claim: Claim, seeds: int | None, first: int, only: Sequence[str], settings: Sequence[str], quick: bool
) -> Plan:
    """What the options ask for. Raises ConfigError."""
    from agent.experiments.run_claim import Plan

    for case in only:
        if case not in claim.cases:
            raise ConfigError(f"experiment {name}: --only {case}: choose from {', '.join(claim.cases)}")
    cases = tuple(case for case in claim.cases if case in (only or claim.by_default or claim.cases))
    count = seeds or (1 if quick or claim.exact else claim.seeds)
    chosen = asked(name, claim, settings, claim.quick if quick else {})
    return Plan(name, CLAIMS[name], code_of(name), chosen, cases, range(first, first + count))


def asked(name: str, claim: Claim, settings: Sequence[str], before: Any) -> msgspec.Struct:
    """Settings by NAME=VALUE. Raises ConfigError for a name or a value that is none."""
    fields, values = claim.settings.__struct_fields__, dict(before)
    for text in settings:
        key, is_given, value = text.partition("=")
        if key not in fields or not is_given:
            known = f"NAME one of {', '.join(fields)}" if fields else "it has no settings"
            raise ConfigError(f"experiment {name}: --set {text}: write NAME=VALUE, {known}")
        values[key] = value.split(",") if isinstance(getattr(claim.settings(), key, None), tuple) else value
    try:
        return msgspec.convert(values, claim.settings, strict=False)
    except msgspec.ValidationError as error:
        raise ConfigError(f"experiment {name}: {error}") from None


def run(plan: Plan, claim: Claim, out: Path | None, jobs: int | None, scheduler: str | None, quick: bool) -> int:
    """Run it, write the results and print the table; the exit code."""
    from agent.experiments.claim import measure
    from agent.experiments.results import result_of, run_of, table, write_result
    from agent.experiments.run_claim import run_plan

    console, folder = terminal(), out or folder_of(plan)
    what = f"{plan.name}: cases and seeds"
    try:
        found = with_bar(console, what, lambda show: run_plan(plan, folder, jobs, scheduler, show, claim))
    except (KeyboardInterrupt, SystemExit):
        complain(f"experiment {plan.name}: ended early; what has finished is kept, and --out {folder} goes on")
        raise
    plan = plan._replace(seeds=found.seeds)
    result = result_of(plan, claim, measure(claim, found.rows))
    write_result(result, run_of(plan, command_of(plan, claim), found.seconds_a_seed, quick), folder)
    console.print(table(result.figures, f"{plan.name}: {CLAIMS[plan.name].about} ({claim.measured_on})"))
    if found.kept:
        console.print(
            f"{found.kept} of {len(plan.pieces)} cases and seeds were in {folder} before; remove it to run anew"
        )
    console.print(f"written to {folder}")
    if quick:
        console.print("no verdict: --quick runs too little of it")
        return 0
    verdicts = {told.verdict for told in result.figures}
    return MISSED if "missed" in verdicts else NOT_SHOWN if "not shown" in verdicts else 0


def command_of(plan: Plan, claim: Claim) -> str:
    """What measures the same again, on any machine."""
    words = ["aucamp", "experiment", plan.name]
    if plan.cases != (claim.by_default or claim.cases):
        words += [word for case in plan.cases for word in ("--only", case)]
    usual = msgspec.to_builtins(claim.settings())
    changed = {key: value for key, value in msgspec.to_builtins(plan.settings).items() if value != usual[key]}
    for key, value in changed.items():
        told = ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
        words += ["--set", shlex.quote(f"{key}={told}")]
    words += [] if claim.exact else ["--seed", str(plan.seeds[0]), "--seeds", str(len(plan.seeds))]
    return " ".join(words)


def folder_of(plan: Plan) -> Path:
    """Named by what is measured, so that the same command goes on with the same folder."""
    mark = hashlib.sha256(json.dumps(plan.of, sort_keys=True).encode()).hexdigest()[:8]
    return Path("runs") / f"{plan.name}-{mark}"


def show_list() -> None:
    """Name, one line, cost and last result of each."""
    from rich.table import Table

    from agent.experiments.results import KEPT, age, read_kept

    shown = Table()
    for head in ("claim", "about", "two cores", "last result", ""):
        shown.add_column(head, justify="right" if head == "two cores" else "left")
    for name, entry in CLAIMS.items():
        kept = read_kept(name)
        code = code_of(name) if kept else ""
        counts = [
            f"{sum(one.told.verdict == verdict for one in kept)} {verdict}"
            for verdict in ("met", "missed", "not shown")
            if any(one.told.verdict == verdict for one in kept)
        ]
        dates = sorted({one.run.date for one in kept})
        runs = {one.run.command: one.run.seconds_a_seed * (one.seeds[1] - one.seeds[0] + 1) for one in kept}
        cost = f"{sum(runs.values()) / 2 / 60:.1f} min" if kept else ""
        old = next(filter(None, (age(one, code) for one in kept)), "")
        last = f"{', '.join(counts) or 'no targets'}; {dates[-1]}" if kept else "not measured"
        shown.add_row(name, entry.about, cost, last, old)
    terminal().print(shown)
    if not KEPT.is_dir():
        complain(f"experiment list: looks for results in {Path.cwd() / KEPT}, which is not there; run it in a checkout")


def write_docs(runs: Sequence[Path]) -> None:
    """Keep the results of these runs, and write all pages."""
    from agent.experiments.results import PAGES, keep, write_pages

    if not PAGES.parent.is_dir():
        raise ConfigError("experiment docs: there is no folder docs here; run it in a checkout of the repository")
    for name in keep(runs):
        terminal().print(f"kept {name}")
    terminal().print(f"{len(write_pages())} files written to {PAGES}")
