"""A text with brackets or a name of an emoji in it reaches the terminal as it was written."""

import ast
from pathlib import Path

import pytest
import typer.main
from rich.table import Table
from rich.text import Text

from agent.__main__ import app
from agent.process.command import plain_console, with_bar, with_spinner

ROOT = Path(__file__).parents[1]
TRICKY = "[focus] of [/] dive[1].png, pip install 'aucamp[enhance]' :bug: [red]"


def test_texts_tables_and_waits_stand_as_they_were_written(capsys):
    console = plain_console()
    console.print(TRICKY)
    table = Table(title=TRICKY)
    table.add_column("long enough", min_width=len(TRICKY))
    table.add_row(TRICKY)
    console.print(table)
    with with_spinner(console, TRICKY):
        pass
    with_bar(console, TRICKY, lambda show: show(1, 1))
    assert capsys.readouterr().out.count(TRICKY) == 5


def calls(name):
    """Where the house calls what is named so, with the names of its keyword arguments."""
    for room in ("agent", "replay", "hw"):
        for file in (ROOT / room).rglob("*.py"):
            text = file.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if f"{name}(" in text else ():
                if isinstance(node, ast.Call):
                    called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                    if called == name:
                        yield f"{file.relative_to(ROOT)}:{node.lineno}", node


def plain(node):
    return any(
        each.arg == "markup" and isinstance(each.value, ast.Constant) and each.value.value is False
        for each in node.keywords
    )


@pytest.mark.parametrize("name", ["Console", "TextColumn"])
def test_nothing_on_the_terminal_reads_markup(name):
    found = list(calls(name))
    assert found
    assert [where for where, node in found if not plain(node)] == []


def test_no_bar_has_columns_of_its_own_choice():
    """Those of rich read markup in a description."""
    found = [(where, node) for where, node in calls("Progress") if any(k.arg == "console" for k in node.keywords)]
    assert found
    assert [where for where, node in found if not node.args] == []


def help_texts(command, path="aucamp"):
    """What a command and those below it say of themselves, with their names."""
    own = [command.help, command.short_help, command.epilog, *(getattr(each, "help", "") for each in command.params)]
    yield from ((path, text) for text in own if text)
    for name, below in getattr(command, "commands", {}).items():
        yield from help_texts(below, f"{path} {name}")


def test_help_shows_each_bracket():
    """Help is marked up, for its boxes: a bracket in it needs a backslash."""
    texts = list(help_texts(typer.main.get_command(app)))
    assert any(r"\[focus]" in text for _, text in texts)
    swallowed = [each for each in texts if Text.from_markup(each[1]).plain != each[1].replace("\\[", "[")]
    assert swallowed == []
