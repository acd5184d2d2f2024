"""The command line of Zenoh as a user types it."""

import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

from agent.core.config import Fleet
from agent.core.messages import State
from agent.process.transport import Transport
from tests.places import ROOT
from tests.waiting import until


def test_the_command_line_of_zenoh_shows_a_readable_line(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], tmp_path: Path
) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1",)})
    install_entry_points(tmp_path / "site")
    command = [Path(sys.executable).with_name("zenoh"), "--mode", "client", "--connect", fleet.robot["r1"].listen]
    command += ["subscribe", "-k", "aucamp/**", "--decoder", "aucamp", "--line", "{key} {value}"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])}
    printed = tmp_path / "printed"
    with (
        printed.open("wb") as output,
        Transport(fleet, "r1", time.time_ns) as r1,
        subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT) as zenoh,
    ):
        try:

            def line() -> bool:
                r1.show(state("r1", seq=42))
                assert zenoh.poll() is None, printed.read_text()
                return b"\n" in printed.read_bytes()

            until(line, timeout_s=60)
        finally:
            zenoh.kill()
    key, _, value = printed.read_text().splitlines()[0].partition(" ")
    assert key.endswith("/robot/r1/state")
    assert json.loads(value)["t"] == 42


def install_entry_points(site: Path) -> None:
    """Declare the entry points that pyproject.toml names, as an installation would."""
    about = site / "aucamp_under_test-0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: aucamp-under-test\nVersion: 0\n")
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in groups.items()]
    (about / "entry_points.txt").write_text("\n".join(lines))
