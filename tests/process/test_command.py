"""What a person at the tank reads while an agent runs."""

import ast
import threading

import pytest
import typer.main
from rich.table import Table
from rich.text import Text

from agent.__main__ import app
from agent.core.messages import LogLine, NeighbourState, State
from agent.process.agent_process import AGAIN_NS, ConsoleLog, standing
from agent.process.command import plain_console, with_bar, with_spinner
from tests.places import ROOT

START_NS = 1_700_000_000_000_000_000


class Shown:
    """A network that keeps what it is shown."""

    def __init__(self) -> None:
        self.messages: list[State | LogLine] = []

    def drain(self) -> tuple[tuple, tuple]:
        return (), ()

    def say(self, estimate) -> None: ...

    def orders(self) -> tuple:
        return ()

    def answer(self, answers) -> None: ...

    def show(self, message: State | LogLine) -> None:
        self.messages.append(message)


def state(after_ns: int = 0, r2_age_s: float | None = 0.05, **more) -> State:
    neighbour = NeighbourState(robot="r2", age_s=r2_age_s, valid=True, used=False, heard=9, gaps=0)
    about = {"fleet": "test", "robot": "r1", "incarnation": 1, "seq": 0, "target": "ball", "knows": "sees", "t": 7}
    return State(sent_ns=START_NS + after_ns, neighbours=(neighbour,), **{**about, **more})


def said(*messages: State | LogLine) -> list[str]:
    """The lines of a session in which these were shown, without the time of day."""
    lines: list[str] = []
    network = Shown()
    with ConsoleLog(network, lines.append) as console:
        for message in messages:
            console.show(message)
    assert network.messages == list(messages)  # all of it is published all the same
    return [line.split(" ", 1)[1].rstrip("\n") for line in lines]


def test_the_log_is_said_line_by_line() -> None:
    line = LogLine(robot="r1", sent_ns=START_NS, level="warning", text="no frames")
    assert said(line, line) == ["r1 warning no frames"] * 2


def test_where_it_stands_is_said_every_ten_seconds() -> None:
    states = [state(int(k * AGAIN_NS / 4)) for k in range(9)]
    lines = said(*states)
    assert lines[0] == "r1 info    hears r2"
    assert len(lines) == 3 and all("sees at iteration 7" in text for text in lines[1:])


def test_a_neighbour_that_falls_silent_is_news() -> None:
    lines = said(state(), state(1, r2_age_s=0.9), state(2, r2_age_s=3.0), state(3, r2_age_s=3.2), state(4))
    assert lines == ["r1 info    hears r2", "r1 warning hears r2 no more", "r1 info    hears r2"]


def test_nobody_claims_to_know_the_motors_of_a_board_that_is_silent() -> None:
    where = standing(state(posterior_m=(0.76, 0.56, 0.07), posterior_sigma_m=0.0016, armed=True))
    assert where == "ball: sees at iteration 7, 760.0 560.0 70.0 mm, sigma 1.6 mm; hears r2; motors on"
    assert standing(state(armed=None, faults=("no telemetry",))).endswith("hears r2; no telemetry")


def test_a_fault_is_said_by_its_kind_and_once() -> None:
    where = standing(state(armed=False, faults=("motors off: to start them, do this and that", "no camera: why")))
    assert where.endswith("hears r2; motors off; no camera")


def test_a_terminal_that_is_held_does_not_hold_the_loop() -> None:
    held = threading.Event()
    network = Shown()
    try:
        with ConsoleLog(network, lambda text: held.wait()) as console:
            for k in range(1000):
                console.show(LogLine(robot="r1", sent_ns=START_NS + k, level="info", text=str(k)))
            assert len(network.messages) == 1000
    finally:
        held.set()


def test_a_reader_who_has_gone_is_not_missed() -> None:
    def gone(text: str) -> None:
        raise BrokenPipeError

    with ConsoleLog(Shown(), gone) as console:
        for k in range(3):
            console.show(LogLine(robot="r1", sent_ns=START_NS, level="info", text=str(k)))


# --- plain console ---
# A text with brackets or a name of an emoji in it reaches the terminal as it was written.

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
    assert any(r"\[landmarks]" in text for _, text in texts)
    swallowed = [each for each in texts if Text.from_markup(each[1]).plain != Text(each[1].replace("\\[", "[")).plain]
    assert swallowed == []
