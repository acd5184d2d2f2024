"""What a run of a claim found: in the run's folder, kept in the repository, and told to people.

`result.json` in the run's folder has the figures, `run.json` beside it when and where they were measured. A figure that
is kept lies in docs/research/results/CLAIM.json with both: its own seeds, date, commit, processor and command. Pages
are written from there alone, so no figure on them was typed.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
from rich.table import Table

from agent.core.config import ConfigError, write_whole
from agent.experiments.claim import Claim, Figure, Measured, Verdict, verdict
from agent.experiments.registry import CLAIMS, HEADLINES, code_of, load
from agent.experiments.run_claim import Plan
from replay.files.mcap_file import environment

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

RESULT, RUN = "result.json", "run.json"
KEPT = Path("docs/research/results")

Number = float | Literal["inf", "-inf"]  # JSON has no infinity; float() reads both


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """One figure, its interval, and where it had to lie."""

    key: str
    words: str
    unit: str
    value: Number
    low: Number
    high: Number
    n: int
    least: float | None
    most: float | None
    paper: str
    verdict: Literal["met", "missed", "not shown", ""]

    @property
    def measured(self) -> Measured:
        return Measured(float(self.value), float(self.low), float(self.high), self.n)

    @property
    def figure(self) -> Figure:
        return Figure(self.key, self.words, self.unit, self.least, self.most, self.paper)


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """result.json: pure, for the same seeds give the same bytes."""

    claim: str
    settings: dict[str, Any]
    cases: list[str]
    seeds: tuple[int, int]  # the first and the last
    figures: list[Told]


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """run.json: when, where and of what."""

    date: str
    commit: str  # with a + where the files differed from it
    processor: str
    command: str
    code: str
    seconds_a_seed: float  # of one core
    quick: bool = False


class KeptFigure(msgspec.Struct, frozen=True, kw_only=True):
    """A figure with all that is to be known of it."""

    told: Told
    seeds: tuple[int, int]
    run: Run


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """docs/research/results/CLAIM.json."""

    claim: str
    figures: list[KeptFigure]


def tell(figure: Figure, measured: Measured) -> Told:
    value, low, high = (_number(one) for one in measured[:3])
    return Told(
        **figure._asdict(), value=value, low=low, high=high, n=measured.n, verdict=verdict(figure, measured)
    )  # fmt: skip


def result_of(plan: Plan, claim: Claim, measured: Mapping[str, Measured]) -> Result:
    return Result(
        claim=plan.name,
        settings=msgspec.to_builtins(plan.settings),
        cases=list(plan.cases),
        seeds=(plan.seeds[0], plan.seeds[-1]),
        figures=[tell(figure, measured[figure.key]) for figure in claim.figures if figure.key in measured],
    )


def write_result(result: Result, run: Run, folder: Path) -> None:
    write_whole(folder / RESULT, _text(result))
    write_whole(folder / RUN, _text(run))


def run_of(plan: Plan, command: str, seconds_a_seed: float, quick: bool) -> Run:
    about = environment()
    return Run(
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        commit=about["commit"][:10] + ("+" if about["dirty"] == "yes" else ""),
        processor=about["cpu"],
        command=command,
        code=plan.code,
        seconds_a_seed=round(seconds_a_seed, 2),
        quick=quick,
    )


def keep(folders: Sequence[Path], into: Path = KEPT) -> list[str]:
    """Take the figures of these runs in the place of older ones; the names of their claims.

    Raises ConfigError for a folder without a finished run, and for a run in quick.
    """
    names = []
    for folder in folders:
        result, run = _read(folder / RESULT, Result), _read(folder / RUN, Run)
        if run.quick:
            raise ConfigError(f"{folder}: is a run of --quick, which gives no verdict; run it without")
        kept = {one.told.key: one for one in read_kept(result.claim, into)}
        kept |= {told.key: KeptFigure(told=told, seeds=result.seeds, run=run) for told in result.figures}
        write_kept(result.claim, list(kept.values()), into)
        names.append(result.claim)
    return names


def read_kept(name: str, into: Path = KEPT) -> list[KeptFigure]:
    """Empty where nothing was kept of it."""
    path = into / f"{name}.json"
    return _read(path, Kept).figures if path.exists() else []


def write_kept(name: str, figures: list[KeptFigure], into: Path = KEPT) -> None:
    into.mkdir(parents=True, exist_ok=True)
    write_whole(into / f"{name}.json", _text(Kept(claim=name, figures=figures)))


def judged_anew(claim: Claim, kept: Sequence[KeptFigure]) -> list[KeptFigure]:
    """By the claim's words and limits of today, in its order; figures that it no longer states are left out."""
    by_key = {one.told.key: one for one in kept}
    return [
        msgspec.structs.replace(by_key[figure.key], told=tell(figure, by_key[figure.key].told.measured))
        for figure in claim.figures
        if figure.key in by_key
    ]


def _read(path: Path, kind: type[Any]) -> Any:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; give the folder of a run that has come to its end") from None
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); give the folder of a run") from None


def _number(value: float) -> Number:
    return value if math.isfinite(value) else "inf" if value > 0 else "-inf"


def _text(struct: msgspec.Struct) -> str:
    return json.dumps(msgspec.to_builtins(struct), indent=1) + "\n"


# --- pages and tables ---

PAGES = Path("docs/research")
ALL = "claims.md"
OLDER = "older than the code"  # beside figures whose code has changed since they were measured
HEAD = """# Claims

`aucamp experiment docs` writes this page from the results in [results](results). Nothing here has been in the sea.
Each claim has a page with its figures, their 90 % intervals and n: seeds, or trials of a share. A target is **met**
when the whole interval keeps it, **missed** when none of it does, else **not shown**: here they are counted. What a
figure was measured on:

* **twin**: our own simulation. It is optimistic where [it leaves something out](../twin.md).
* **model**: the estimators alone, on numbers drawn as their equations say.
* **real pictures**: photographs that nobody here took.
* **chip model**: instructions counted on an emulated STM32F407, never timed on one.
* **processes**: real agents on a real network stack of one computer, with cameras and motors that are a script.
* **outside judge**: a program that others wrote.
* **this machine**: times, as ratios of two ways in one run.

*Judged too*: programs of others measured the same thing, [at their own settings](../outside.md).

*Older than the code*: modules that the claim measures have changed since. Of most results before 2026-11-30 the ends of
narrower intervals were kept, and no seeds. Theirs are made of those ends, [as wide as others](../experiments.md).
"""


# --- words of a figure ---


def digits(value: float, count: int = 3) -> str:
    """So many significant digits, without an exponent."""
    if math.isinf(value):
        return "never" if value > 0 else "none"
    if value == 0.0:
        return "0"
    places = max(0, count - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}" if places <= 6 else f"{value:.2g}"


def value_of(told: Told) -> str:
    if not told.n:
        return "no case"
    if math.isinf(float(told.value)):
        return "never" if told.unit == "s" else "none"
    return f"{digits(float(told.value), 4 if is_exact(told) else 3)} {told.unit}".rstrip()


def is_exact(told: Told) -> bool:
    """One seed says all: no chance is in it, and it can be told more closely."""
    return told.n == 1 and told.low == told.high


def interval_of(told: Told) -> str:
    low, high = float(told.low), float(told.high)
    if is_exact(told):
        return "exact"
    ends = [digits(end) if math.isfinite(end) else "?" for end in (low, high)]
    return " to ".join(ends) if any(end != "?" for end in ends) else ""


def table(figures: Sequence[Told], title: str) -> Table:
    """As the terminal shows them."""
    shown = Table(title=title)
    for head in ("what", "measured", "90 % interval", "n", "target", ""):
        shown.add_column(head, justify="left" if head in ("what", "") else "right")
    for told in figures:
        shown.add_row(
            told.words, value_of(told), interval_of(told), str(told.n), told.figure.target, told.verdict
        )  # fmt: skip
    return shown


# --- pages ---

KeptClaims = Mapping[str, tuple[Claim, list[KeptFigure]]]  # by name

README, BEGIN, END = "README.md", "<!-- figures: aucamp experiment docs -->\n", "<!-- end of figures -->\n"


def write_pages(root: Path = Path()) -> list[Path]:
    """All pages, each claim's figure, the README's figures, and the results by today's words and limits. Returns what
    was written."""
    written, kept = [], kept_claims(root)
    if (readme := root / README).exists():
        readme.write_text(with_headlines(readme.read_text(encoding="utf-8"), kept), encoding="utf-8")
    (root / PAGES).mkdir(parents=True, exist_ok=True)
    for name, text in all_pages(kept).items():
        (root / PAGES / name).write_text(text, encoding="utf-8")
        written.append(root / PAGES / name)
    for name, (_, figures) in kept.items():
        if not figures:
            continue
        write_kept(name, figures, root / KEPT)
        path = root / PAGES / f"{name}.svg"
        write_drawing(drawing(figures), path)
        written.append(path)
    return written


def all_pages(kept: KeptClaims) -> dict[str, str]:
    """The text of every page by its name."""
    return {ALL: claims_page(kept)} | {f"{name}.md": claim_page(name, *one) for name, one in kept.items()}


def kept_claims(root: Path = Path()) -> KeptClaims:
    """Each claim of the table, with what was kept of it."""
    found = {}
    for name, entry in CLAIMS.items():
        claim = load(entry.module)
        found[name] = claim, judged_anew(claim, read_kept(name, root / KEPT))
    return found


def with_headlines(text: str, kept: KeptClaims) -> str:
    """The README with its figures. Raises ValueError where it has no place for them."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    told = {(name, one.told.key): one.told for name, (_, figures) in kept.items() for one in figures}
    rows = [
        f"| [{told[key].words}](docs/research/{key[0]}.md) | {told[key].paper} | {value_of(told[key])} | "
        f"{interval_of(told[key])} | {mark(told[key])} |"
        for key in HEADLINES
        if key in told
    ]
    head = ["| | paper | Aucamp | 90 % interval | target |", "|---|---|---|---|---|"]
    return before + BEGIN + "\n" + "\n".join([*head, *rows]) + "\n\n" + END + after


HEADS = ("figure", "paper", "measured", "90 % interval", "n", "target", "")
VERDICTS: tuple[Verdict, ...] = ("met", "not shown", "missed")


def claims_page(kept: KeptClaims) -> str:
    """Figures that the paper has and those that miss; then a row for each claim, below the heading of its group."""
    lines, told = [HEAD], [(name, one.told) for name, (_, figures) in kept.items() for one in figures]
    apart = {"Beside the paper": [one for one in told if one[1].paper],
             "Missed": [one for one in told if one[1].verdict == "missed"]}  # fmt: skip
    for heading, rows in apart.items():
        cells = [(f"[{name}]({name}.md): {one.words}", *row(one)[1:]) for name, one in rows]
        lines += [f"## {heading}", "", *tabled(cells), ""]
    for group in dict.fromkeys(entry.group for entry in CLAIMS.values()):
        lines += [f"## {group}", "", f"| claim | {' | '.join(VERDICTS)} | on | |", "|---|---|---|---|---|---|"]
        lines += [claim_row(name, *one) for name, one in kept.items() if CLAIMS[name].group == group]
        lines.append("")
    return "\n".join(lines)


def claim_row(name: str, claim: Claim, figures: Sequence[KeptFigure]) -> str:
    counts = Counter(one.told.verdict for one in figures)
    cells = [str(counts[verdict] or "") for verdict in VERDICTS]
    if not any(cells):
        cells[0] = "no target" if figures else "not measured"
    on = claim.measured_on + (f"; [judged too](../outside.md#{heading})" if (heading := CLAIMS[name].judged) else "")
    code = code_of(name) if figures else ""
    older = max((age(one, code) for one in figures), default="")
    return f"| [{name}]({name}.md): {CLAIMS[name].about} | {' | '.join(cells)} | {on} | {older} |"


def row(told: Told) -> tuple[str, ...]:
    return told.words, told.paper, value_of(told), interval_of(told), str(told.n), told.figure.target, mark(told)


def without_repeats(rows: Iterable[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """What rows that follow each other begin with, up to a colon, stands in the first of them."""
    before = ""
    for words, *cells in rows:
        case, colon, figure = words.partition(": ")
        yield (figure if colon and case == before else words, *cells)
        before = case if colon else before


def tabled(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """A table of figures, without columns in which nothing stands."""
    shown = [k for k in range(len(HEADS)) if k == 0 or any(cells[k] for cells in rows)]
    yield f"| {' | '.join(HEADS[k] for k in shown)} |"
    yield f"|{'---|' * len(shown)}"
    yield from (f"| {' | '.join(cells[k] for k in shown)} |" for cells in rows)


def mark(told: Told) -> str:
    return f"**{told.verdict}**" if told.verdict in ("missed", "not shown") else told.verdict


def age(one: KeptFigure, code: str) -> str:
    return "" if one.run.code == code else OLDER


def claim_page(name: str, claim: Claim, figures: Sequence[KeptFigure]) -> str:
    """Explanation, table, drawing, and where each figure is from."""
    entry = CLAIMS[name]
    lines = [f"# {name}: {entry.about}", "", " ".join(claim.explanation.split()), ""]
    lines += [f"Measured on: {claim.measured_on}. Run it: `aucamp experiment {name}`" + (
        f", or one of its cases, `--only {claim.cases[0]}`." if len(claim.cases) > 1 else "."), ""]  # fmt: skip
    if len(claim.cases) > 1:
        lines += [f"Cases: {', '.join(claim.cases)}.", ""]
    if not figures:
        return "\n".join([*lines, "Not measured in this state of the project.", ""])
    lines += tabled([*without_repeats(row(one.told) for one in figures)])
    lines += ["", f"![{name}]({name}.svg)", "", "## Where the figures are from", ""]
    code = code_of(name)
    lines += [*dict.fromkeys(origin(one, code) for one in figures), ""]
    return "\n".join(lines)


def origin(one: KeptFigure, code: str) -> str:
    run, (first, last) = one.run, one.seeds
    seeds = f"seed {first}" if first == last else f"seeds {first} to {last}"
    measured = f"{run.date}, commit {run.commit}, {run.processor}, {seeds}, {run.seconds_a_seed:g} s a seed"
    return f"* {measured}: `{run.command}`; {age(one, code)}".removesuffix("; ") + "."


# --- the drawing: each figure a line of its own, with its interval and its target ---


def drawing(figures: Sequence[KeptFigure]) -> Drawing:
    """Dot: measured. Bar: 90 % interval. Green: where it has to lie."""
    from matplotlib.figure import Figure as Drawing

    height_in = 0.55 * len(figures) + 0.3
    drawn = Drawing(figsize=(7.5, height_in), layout="constrained")
    panels = drawn.subplots(len(figures), 1, squeeze=False)[:, 0]
    for panel, one in zip(panels, figures, strict=True):
        told = one.told
        ends = [end for end in map(float, (told.low, told.value, told.high)) if math.isfinite(end)]
        limits = [limit for limit in (told.least, told.most) if limit is not None]
        if ends:
            panel.plot([min(ends), max(ends)], [0, 0], color="C0", linewidth=3, solid_capstyle="butt")
        if math.isfinite(float(told.value)):
            panel.plot([float(told.value)], [0], "o", color="C0")
        spread = [*ends, *limits] or [0.0]
        pad = 0.15 * (max(spread) - min(spread)) or 0.1 * abs(spread[0]) or 1.0
        low, high = min(spread) - pad, max(spread) + pad
        if limits:
            least = low if told.least is None else told.least
            panel.axvspan(least, high if told.most is None else told.most, color="C2", alpha=0.2, linewidth=0)
        panel.set(xlim=(low, high), yticks=[])
        panel.tick_params(labelsize="x-small")
        panel.set_ylabel(
            f"{told.words}, {told.unit}".rstrip(", "), rotation=0, ha="right", va="center", fontsize="x-small"
        )
        for side in ("left", "right", "top"):
            panel.spines[side].set_visible(False)
    return drawn


def write_drawing(drawn: Drawing, path: Path) -> None:
    """Text stays text; neither a date nor drawn ids make two of them differ."""
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": path.name}):
        drawn.savefig(path, metadata={"Date": None})
