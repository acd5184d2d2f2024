"""Results that are kept, and the pages that are written from them: no figure on a page is typed."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.cli import experiments
from agent.core.config import ConfigError
from agent.experiments import registry, results
from agent.experiments.claim import Figure, Measured
from agent.experiments.results import (
    KEPT,
    OLDER,
    PAGES,
    all_pages,
    digits,
    interval_of,
    keep,
    kept_claims,
    read_kept,
    tell,
    with_headlines,
)
from agent.process.command import Failed
from tests.experiments import dice
from tests.places import ROOT


def without_age(text: str) -> str:
    return text.replace(f"; {OLDER}", "").replace(OLDER, "")


@pytest.mark.slow
def test_the_pages_say_what_the_results_say() -> None:
    """All but the age, which changes with every line of code."""
    wrong = []
    kept = kept_claims(ROOT)
    for name, text in all_pages(kept).items():
        path = ROOT / PAGES / name
        if not path.exists() or without_age(path.read_text(encoding="utf-8")) != without_age(text):
            wrong.append(name)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert not wrong and with_headlines(readme, kept) == readme, "write them with: aucamp experiment docs"


def test_the_readme_names_figures_that_there_are() -> None:
    for name, key in registry.HEADLINES:
        assert key in {figure.key for figure in registry.load(registry.CLAIMS[name].module).figures}


def test_every_result_is_of_a_claim_and_every_page_of_one() -> None:
    assert {path.stem for path in (ROOT / KEPT).glob("*.json")} <= set(registry.CLAIMS)
    assert {path.stem for path in (ROOT / PAGES).glob("*.md")} == {*registry.CLAIMS, "claims"}


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with docs, and a table that has the dice alone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").mkdir()
    for module in (registry, results, experiments):
        monkeypatch.setattr(module, "CLAIMS", {"dice": dice.ENTRY})
    return tmp_path


def thrown(*options: str) -> int:
    """Exit code of `aucamp experiment dice`, without the command line: its choice of names is made at import."""
    parts: dict[str, list[str]] = {"--only": [], "--set": []}
    for option, value in zip(options[::2], options[1::2], strict=True):
        parts.setdefault(option, []).append(value)
    seeds = int(parts.get("--seeds", ["20"])[0])
    plan = experiments.plan_of("dice", dice.CLAIM, seeds, 0, parts["--only"], parts["--set"], quick=False)
    return experiments.run(plan, dice.CLAIM, Path("run"), 1, None, quick=False)


def test_the_exit_code_is_the_worst_verdict(checkout: Path) -> None:
    code = thrown("--seeds", "20")
    result = json.loads((checkout / "run" / "result.json").read_text())
    verdicts = {told["key"]: told["verdict"] for told in result["figures"]}
    assert code == 1 and verdicts["other"] == "missed" and verdicts["six"] == "met"


def test_what_is_not_shown_is_3_and_what_is_met_0(checkout: Path) -> None:
    assert thrown("--seeds", "2", "--only", "one") == 3
    (checkout / "run").rename(checkout / "two")
    assert thrown("--seeds", "40", "--only", "one") == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--only", "three"), "--only three: choose from one, another"),
        (("--set", "eyes=3"), "--set eyes=3: write NAME=VALUE, NAME one of sides, seconds, colours"),
        (("--set", "sides=many"), "Expected `int`, got `str`"),
    ],
)
def test_bad_options_are_one_line(options: tuple[str, ...], said: str, checkout: Path) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        thrown(*options)


def test_a_result_is_kept_by_figure_and_says_when_the_code_has_changed(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    thrown("--seeds", "20")
    assert keep([checkout / "run"]) == ["dice"]
    (checkout / "run").rename(checkout / "whole")
    thrown("--seeds", "4", "--only", "another")
    keep([checkout / "run"])
    kept = {one.told.key: one for one in read_kept("dice")}
    assert kept["other"].run.command == "aucamp experiment dice --only another --seed 0 --seeds 4"
    assert kept["mean"].seeds == (0, 19) and kept["other"].seeds == (0, 3), "of that case alone"
    written = results.write_pages()
    assert {path.name for path in written} == {"claims.md", "dice.md", "dice.svg"}
    page = (checkout / PAGES / "dice.md").read_text()
    assert OLDER not in page and "A die is thrown." in page and "seeds 0 to 19" in page and "seeds 0 to 3" in page
    monkeypatch.setattr(results, "code_of", lambda name: "another")
    assert results.all_pages(results.kept_claims())["dice.md"].count(OLDER) == 2, "of each run"
    page = (checkout / PAGES / "claims.md").read_text()
    assert "| [dice](dice.md): a die | 3 |  | 1 | model |  |" in page and page.count("| **missed** |") == 1


def test_a_folder_without_a_result_is_not_kept(checkout: Path) -> None:
    with pytest.raises(ConfigError, match="no such file; give the folder of a run that has come to its end"):
        keep([checkout])


def test_quick_gives_no_verdict_and_is_not_kept(checkout: Path) -> None:
    plan = experiments.plan_of("dice", dice.CLAIM, 2, 0, (), (), quick=True)
    assert plan.settings.sides == 2
    assert experiments.run(plan, dice.CLAIM, Path("run"), 1, None, quick=True) == 0
    with pytest.raises(ConfigError, match="is a run of --quick"):
        keep([checkout / "run"])


def test_a_seed_that_fails_is_named_and_what_has_finished_stays(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = experiments.plan_of("dice", dice.CLAIM, 3, 0, ("one",), ("sides=-1",), quick=False)
    with pytest.raises(Failed, match="one, seed 0: a die has sides"):
        experiments.run(plan, dice.CLAIM, Path("run"), 1, None, quick=False)
    assert (checkout / "run" / "finished.jsonl").exists() and not (checkout / "run" / "result.json").exists()


def test_numbers_are_told_with_three_digits() -> None:
    assert [digits(value) for value in (0.0, 0.01234, 3.14159, 271.8, 12345.6)] == [
        "0",
        "0.0123",
        "3.14",
        "272",
        "12346",
    ]
    assert digits(float("inf")) == "never"
    told = tell(Figure("x", "x", most=1.0), Measured(0.5, 0.25, float("inf"), 20))
    assert interval_of(told) == "0.250 to ?" and told.high == "inf"


def test_the_code_that_a_claim_measures_is_what_it_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in (
        ("claim", "from agent import far\nfrom agent.experiments import registry\nCLAIM = 3\n"),
        ("far", '"""Far."""\ndef f():\n    """Doc."""\n    import agent.farther\n'),
        ("farther", "X = 1\n"),
        ("stranger", "Y = 1\n"),
        ("experiments/registry", "Z = 1\n"),
    ):
        path = tmp_path / "agent" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(registry, "ROOT", tmp_path)
    monkeypatch.setattr(registry, "read", registry.read.__wrapped__)  # that of the whole product is kept for the others

    def state() -> str:
        return registry.code_hash("agent.claim")

    def changed(name: str, old: str, new: str) -> bool:
        path, before = tmp_path / "agent" / f"{name}.py", state()
        path.write_text(path.read_text().replace(old, new))
        return state() != before

    assert changed("farther", "X = 1", "X = 2"), "an import inside a function counts"
    assert not changed("stranger", "Y = 1", "Y = 2") and not changed("experiments/registry", "Z = 1", "Z = 2")
    assert not changed("far", "Doc.", "Other words.") and not changed("far", "def f", "# Why.\ndef f")
    assert not changed("claim", "CLAIM = 3", "CLAIM = 4"), "words and limits measure nothing"


def test_the_list_names_every_claim(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    done = CliRunner().invoke(experiments.app, ["list"])
    assert done.exit_code == 0 and all(name in done.output for name in registry.CLAIMS)
    assert "is not there" not in done.output


def test_the_list_says_where_it_looks_for_results(checkout: Path) -> None:
    done = CliRunner().invoke(experiments.app, ["list"])
    assert f"looks for results in {checkout / KEPT}, which is not there; run it in a checkout" in done.output
