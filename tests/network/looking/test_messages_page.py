"""The Python of docs/messages.md runs as it stands there, but for the address; its Rust subscribes to the same."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable

from agent.core.config import Fleet
from agent.core.messages import State
from agent.process.transport import Transport
from tests.killing import killed_after
from tests.places import ROOT
from tests.waiting import until

PAGE = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
HERE = "tcp/127.0.0.1:17401"  # in the page


def code(language: str) -> str:
    """The one block of this language."""
    (block,) = re.findall(f"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return block


def test_ten_lines_of_python_print_what_a_robot_knows(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], tmp_path
) -> None:
    fleet, script, printed = make_fleet({"r1": ()}), tmp_path / "ten_lines.py", tmp_path / "printed"
    text = code("python").replace(HERE, fleet.robot["r1"].listen)
    assert len(text.strip().splitlines()) <= 11 and "agent" not in text
    script.write_text(text)
    with Transport(fleet, "r1", time.time_ns) as r1, printed.open("wb") as out:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        process = subprocess.Popen([sys.executable, str(script)], stdout=out, stderr=out, env=environment, cwd=tmp_path)
        with killed_after({"ten lines": process}):

            def heard() -> bool:
                r1.show(state("r1"))
                return b"\n" in printed.read_bytes()

            until(heard)
    assert printed.read_text().splitlines()[0] == "r1 blind ball None"


def test_the_rust_looks_at_the_same() -> None:
    assert re.findall('"aucamp/[^"]*"', code("rust")) == re.findall('"aucamp/[^"]*"', code("python"))
    assert HERE in code("rust") and HERE in code("python")
