"""What documents say can be typed: every verb and option is there, every link leads somewhere, no verb is left out."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from agent.__main__ import app
from docs import draw_links, site_hook
from tests.places import ROOT

PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *(ROOT / name / "README.md" for name in ("hw", "replay", "router_config")),
    ]
)
CODE = re.compile(r"```[^\n]*\n(.*?)```|`([^`\n]+)`", re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def typed(text: str) -> list[list[str]]:
    """The words after each `aucamp` in code, one list a command; where a line goes on with \\, so does the command."""
    lines = [
        line for block, inline in CODE.findall(text) for line in (block or inline).replace("\\\n", " ").splitlines()
    ]
    lines = [re.sub(r"^\s*\$ ", "", line).strip() for line in lines]
    return [re.sub(r"\s#.*|[|&;].*|[\[\]]", "", line).split()[1:] for line in lines if line.startswith("aucamp ")]


def commands():
    """Every verb by its words: ("replay", "check") -> command."""
    found = {}

    def walk(command, words):
        found[words] = command
        for name, sub in getattr(command, "commands", {}).items():
            walk(sub, (*words, name))

    walk(get_command(app), ())
    return found


COMMANDS = commands()


def kinds(command) -> tuple[str, ...]:
    """The kinds of a verb whose first argument says which: those of `calibrate` are run, focus, ..."""
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    found = getattr(arguments[0].type, "choices", ()) if arguments else ()
    return tuple(str(kind) for kind in found if isinstance(kind, str))


def command_of(words: list[str]):
    """The verb that these words begin with, and its name."""
    name: tuple[str, ...] = ()
    for word in words:
        if (*name, word) not in COMMANDS:
            break
        name = (*name, word)
    return name, COMMANDS[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_has_typed_can_be_typed(page: Path) -> None:
    wrong = []
    for words in typed(page.read_text(encoding="utf-8")):
        name, command = command_of(words)
        known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)} | {"--help"}
        unknown = [word.split("=")[0] for word in words if word.startswith("--") and word.split("=")[0] not in known]
        rest = words[len(name) :]
        if unknown or (
            rest
            and not rest[0].startswith("-")
            and (hasattr(command, "commands") or (kinds(command) and rest[0] not in kinds(command)))
        ):
            wrong.append(f"aucamp {' '.join(words)}")
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        if not there.exists() or (anchor and anchor not in anchors(there)):
            broken.append(link)
    assert not broken


def anchors(page: Path) -> set[str]:
    """Of each heading, as sites that show Markdown make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {site_hook.slug(heading) for heading in headings}


def test_every_verb_and_each_of_its_kinds_is_in_a_document() -> None:
    told = set()
    for page in PAGES:
        for words in typed(page.read_text(encoding="utf-8")):
            name, command = command_of(words)
            told |= {name, (*name, *words[len(name) :][:1])} if kinds(command) else {name}
    wanted = {name for name, command in COMMANDS.items() if not hasattr(command, "commands")}
    wanted |= {(*name, kind) for name in wanted for kind in kinds(COMMANDS[name])}
    assert {("calibrate", "gamma"), ("experiment", "peak-shift"), ("bridge", "ros2")} < wanted
    assert not wanted - told


def test_the_site_names_every_page_once_and_no_other() -> None:
    """Of mkdocs.yml. A page outside docs/ stands under its own path, as docs/site_hook.py has it."""
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    docs = [page.relative_to(ROOT / "docs").as_posix() for page in ROOT.glob("docs/**/*.md")]
    assert sorted(named_pages(site["nav"])) == sorted([*docs, *site_hook.OUTSIDE])
    assert all((ROOT / page).is_file() for page in site_hook.OUTSIDE)


def test_a_page_that_pages_lead_to_is_on_the_site() -> None:
    led = {
        (page.parent / link.partition("#")[0]).resolve()
        for page in ROOT.glob("docs/**/*.md")
        for link in LINK.findall(page.read_text(encoding="utf-8"))
        if link.partition("#")[0].endswith(".md") and "://" not in link
    }
    outside = {page.relative_to(ROOT).as_posix() for page in led if not page.is_relative_to(ROOT / "docs")}
    assert outside and outside <= {"README.md", *site_hook.OUTSIDE}


def named_pages(entry: Any) -> list[str]:
    """Of a part of a navigation: a page, a title with a page or a part, or a list of these."""
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [page for part in parts for page in named_pages(part)]


@pytest.mark.parametrize(
    ("page", "link", "led"),
    [
        ("operate.md", "../hw/README.md#parts", "hw/README.md#parts"),
        ("hw/README.md", "../docs/calibrate.md", "../calibrate.md"),
        ("research/claims.md", "../twin.md", "../twin.md"),
        ("research/claims.md", "results", "results/index.md"),
        ("CONTRIBUTING.md", "docs/twin.md", "twin.md"),
        ("keys.md", "#measured", "#measured"),
        ("keys.md", "https://mcap.dev", "https://mcap.dev"),
    ],
)
def test_links_are_led_to_where_pages_lie_on_the_site(page: str, link: str, led: str) -> None:
    assert site_hook.relinked(f"[there]({link})", page) == f"[there]({led})"


def test_markdown_is_respelled_for_the_site() -> None:
    text = "Words:\n* one\n\n1. two\n\n   ```python a.py\n   x = 1\n   ```\n\n| `a\\|b` |\n"
    there = 'Words:\n\n* one\n\n1. two\n\n    ```python title="a.py"\n    x = 1\n    ```\n\n| `a|b` |\n'
    assert site_hook.respelled(text) == there


def test_the_first_use_of_a_term_leads_to_the_glossary() -> None:
    text = (
        "# A fleet\n\nThe `fleet` of [a fleet](fleet-file.md): Fleets swim. A fleet, its agent.\n\n    aucamp agent\n"
    )
    shown = site_hook.explained(text, "hw/README.md")
    fleet, agent = (site_hook.glossary()[term] for term in ("fleet", "agent"))
    there = "../concepts.md#glossary"
    assert shown == text.replace("Fleets", f'[Fleets]({there} "{fleet}")').replace(
        "its agent", f'its [agent]({there} "{agent}")'
    )


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent == ROOT / "docs"], ids=lambda page: page.name)
def test_terms_are_explained_once_and_nothing_else_changes(page: Path) -> None:
    text, name = page.read_text(encoding="utf-8"), page.name
    shown = site_hook.explained(text, name)
    link = re.compile(r"\[([^\]]*)\]\(concepts\.md#glossary \"([^\"]*)\"\)")
    meanings = [meaning for _, meaning in link.findall(shown)]
    assert link.sub(r"\1", shown) == text
    assert len(meanings) == len(set(meanings)) and set(meanings) <= set(site_hook.glossary().values())
    assert bool(meanings) == (not name.startswith(site_hook.UNEXPLAINED))


HOW_TO = [
    "first-ten-minutes",
    "page",
    "your-own-robots",
    "calibrate",
    "cameras",
    "depth-map",
    "enhancement",
    "landmarks",
    "swim",
    "survey",
    "night",
    "scenes",
    "operate",
    "orders",
    "bridges",
    "access",
    "doctor",
    "lighting",
]
PICTURES = sorted(path for kind in ("webp", "svg", "png", "jpg") for path in (ROOT / "docs").glob(f"*.{kind}"))


@pytest.mark.parametrize("page", HOW_TO)
def test_a_how_to_page_has_a_picture(page: str) -> None:
    shown = re.findall(r"!\[([^\]]+)\]\(([^)]+)\)", (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"))
    assert [name for about, name in shown if about and ROOT / "docs" / name in PICTURES]


@pytest.mark.parametrize("name", draw_links.PICTURES)
def test_a_drawing_is_what_its_program_draws(name: str) -> None:
    assert (ROOT / "docs" / f"{name}.svg").read_text(encoding="utf-8") == draw_links.PICTURES[name]()


def test_pictures_are_small_and_none_lies_about() -> None:
    """The clip of a dive is larger than a picture may be."""
    assert not [path.name for path in PICTURES if path.stat().st_size > 80_000 and path.name != "dive.webp"]
    assert sum(path.stat().st_size for path in PICTURES) <= 1_000_000
    told = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert not [path.name for path in PICTURES if path.name not in told]
